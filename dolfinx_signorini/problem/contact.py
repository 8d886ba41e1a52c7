"""Elastic contact: a body that a rigid obstacle stops, on a part of the boundary."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.kinds import (
    TRUTH,
    check,
    choice,
    instance,
    on_mesh,
    optional,
    positive,
)
from dolfinx_signorini.base.ranks import function_with
from dolfinx_signorini.pictures.contact_boundary import AlongDirection
from dolfinx_signorini.problem.arguments import checked_facets
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.problem.constraint import Constraint, Obstacle, Zone
from dolfinx_signorini.problem.directions import Direction, Directions
from dolfinx_signorini.problem.values import Data

if TYPE_CHECKING:
    from dolfinx_signorini.pictures.picture import Picture


class ContactProblem(BoundConstrainedProblem):
    """Signorini's problem: an elastic body on a rigid obstacle, without friction.

    Find the displacement u with u.d <= g on the contact boundary and a(u, v - u) >= L(v - u) for
    all such v. The surface is that of `SignoriniProblem`:

        a = elasticity(u, v, young=200.0, poisson=0.3)
        problem = ContactProblem(a, L, contact=facets, gap=g, bcs=[bc])
        u = problem.solve()

    Later solves see changed values in the forms, the gap and the Dirichlet data; the directions
    stay those of the mesh at the start.

    Args:
        a: A symmetric, positive (semi)definite bilinear form on a Lagrange space of vectors, with a
            component for each coordinate, see `elasticity`.
        L: A linear form.
        contact: The contact boundary, see `SignoriniProblem`.
        gap: The distance g from the body to the obstacle along the direction, at rest: a number, a
            UFL expression, a scalar function, or a callable of the coordinates, shape (3, n).
        direction: The direction d in which the obstacle lies: a constant vector, a UFL vector, a
            vector function, or a callable of the coordinates that returns shape (components, n); by
            default the outward normal, averaged over the facets around a node. For a constant
            direction, degree 1 and Bernstein elements the constraint holds at every point of the
            contact boundary against the interpolant of g; otherwise it holds at the nodes, and in
            the Bernstein basis, whose coefficients are no values, up to the square of the width. At
            nodes where Dirichlet data fix some components, the obstacle stops the others.
        bcs: Dirichlet conditions, on vectors or on components. A rigid motion that neither they nor
            the form stop is held by contact, if the load presses the body against the obstacle.
        held_weakly: Whether a rigid motion that neither data, nor form, nor contact stops is not
            refused, but held by springs. The load must do no work on the motion, so that the body
            rests wherever the motion takes the body. The springs are as many as these motions, at
            dofs that tell the motions apart, and carry no force: the solution is one of the problem
            without springs, the one in which the motions have no share, in the mean over the body.
        u: The function to be filled with the solution; a new one by default.
        petsc_options_prefix: The prefix of PETSc options; a prefix of its own by default.
        petsc_options: PETSc options of the linear solver and of TAO, without prefix; CG with
            multigrid by default. An option of the same name in PETSc's database wins.
        form_compiler_options, jit_options: See `dolfinx.fem.form`.

    Attributes:
        u: The displacement, after `solve`.
        result: The diagnostics of the last solve; None before.
        a, L: The forms.
        space: The space of the displacement.
        system: What the solvers see.

    Raises:
        InputError: The data are not finite, the space has no vectors, a direction is none, the
            contact boundary is none, the form is not symmetric or not definite, a rigid motion is
            not held, or the load moves the body away from the obstacle.

    Source: Kikuchi and Oden, Contact problems in elasticity, SIAM (1988), Chapter 6.
    """

    vector_valued = True

    def __init__(
        self,
        a: ufl.Form,
        L: ufl.Form,
        *,
        contact: Any,
        gap: Data = 0.0,
        direction: Direction = None,
        bcs: Sequence[fem.DirichletBC] = (),
        held_weakly: bool = False,
        u: fem.Function | None = None,
        petsc_options_prefix: str | None = None,
        petsc_options: Mapping[str, Any] | None = None,
        form_compiler_options: Mapping[str, Any] | None = None,
        jit_options: Mapping[str, Any] | None = None,
    ):
        def constraint(space: fem.FunctionSpace) -> Constraint:
            domain = space.mesh
            facets = checked_facets(domain, contact)
            check(gap=(gap, on_mesh(domain, callables=True)), held_weakly=(held_weakly, TRUTH))
            upper = Obstacle(-1.0, gap, "gap")
            zone = Zone(domain.topology.dim - 1, facets, (upper,))
            return Constraint((zone,), True, direction, held_weakly)

        options = petsc_options_prefix, petsc_options, form_compiler_options, jit_options
        super().__init__(a, L, constraint, bcs, u, *options)

    @property
    def contact_nodes(self) -> LocalIndices:
        """The owned nodes that have an obstacle and a free direction."""
        return self._layout.contact_nodes

    @property
    def gap(self) -> fem.Function:
        """The gap that is left, g - u.d, at nodes with an obstacle, a distance for |d| = 1.

        The gap is never negative, exactly 0 at the nodes in contact, and 0 away from the contact
        boundary; a function of the scalar space of one component.

        Raises:
            InputError: The problem has not been solved.
        """
        x, layout, directions = self._solution(), self._layout, self._directions
        free, left = layout.free, self._assembly.obstacles[0].copy()  # of held nodes what is left
        left[free] = (left[free] - x.array_r[layout.contact_dofs]) * directions.shares[free]
        gaps = np.maximum(left, 0.0) * directions.lengths
        return function_with(layout.nodal, layout.obstacle_nodes, gaps, "gap")

    @property
    def forces(self) -> fem.Function:
        """The contact force on the body at each contact node, against the direction: -p d.

        Raises:
            InputError: The problem has not been solved.
        """
        return self._against_direction(self.normal_forces)

    @property
    def force(self) -> Array:  # type: ignore[override]
        """The total contact force on the body, one number for each component; collective.

        Raises:
            InputError: The problem has not been solved.
        """
        size, owned = self.space.dofmap.bs, self.space.dofmap.index_map.size_local
        forces = self.forces.x.array[: owned * size].reshape(-1, size)
        return np.asarray(self.comm.allreduce(forces.sum(axis=0)))

    @property
    def along_direction(self) -> AlongDirection:
        """The contact along the direction of the obstacle, as that of a scalar; collective.

        Raises:
            InputError: The problem has not been solved.
        """
        layout, u, gap = self._layout, self.along(self.u), self.gap
        nodes, lengths = layout.obstacle_nodes, self._directions.lengths
        distances = u.x.array[nodes] + gap.x.array[nodes] / lengths
        distance = function_with(layout.nodal, nodes, distances, "distance")
        u = function_with(layout.nodal, nodes, lengths * u.x.array[nodes], u.name)
        known = u, gap, self.pressure, self.contact, nodes, layout.held_nodes
        return AlongDirection(layout.nodal, *known, self.directions, distance)

    @property
    def directions(self) -> fem.Function:
        """The unit vectors of the direction at nodes with an obstacle, 0 elsewhere; collective."""
        nodes, units = self._layout.obstacle_nodes, self._directions.units
        return function_with(self.space, nodes, units, "directions")

    @property
    def sense(self) -> float:
        """1: the vectors `forces` are forces on the body."""
        return 1.0

    @property
    def normal_forces(self) -> fem.Function:
        """The force along the direction at each contact node, a function of the scalar space.

        Raises:
            InputError: The problem has not been solved.
        """
        return self._normal(super().forces)

    def _normal(self, forces: fem.Function) -> fem.Function:
        """Turn forces on the dofs that the obstacle stops into those along the direction."""
        layout = self._layout
        forces.x.array[layout.contact_nodes] /= self._directions.shares[layout.free]
        forces.x.scatter_forward()
        return forces

    def _against_direction(self, normal: fem.Function) -> fem.Function:
        """Return vectors against the direction, of a size at each node."""
        nodes = self._layout.obstacle_nodes
        forces = -normal.x.array[nodes, None] * self._directions.units
        return function_with(self.space, nodes, forces, "forces")

    def _forces_of(self, values: Array) -> fem.Function:
        return self._against_direction(self._normal(self._layout.forces_at(-values)))

    def along(self, f: fem.Function) -> fem.Function:
        """Return f along the unit vector of the direction; collective.

        The scalar function is known at nodes with an obstacle.

        Args:
            f: A function of the space.
        """
        nodes = self._layout.obstacle_nodes
        blocks = f.x.array.reshape(-1, self.space.dofmap.bs)[nodes]
        values = np.einsum("ni,ni->n", blocks, self._directions.units)
        return function_with(self._layout.nodal, nodes, values, f"{f.name}.d")

    @property
    def direction(self) -> tuple[Data, ...]:
        """The components of the direction that is given, as data; () for the averaged normals."""
        return self._directions.parts

    def plot(
        self,
        path: Path | str | None = None,
        *,
        what: str = "contact",
        stress: Expr | None = None,
        scale: float | None = None,
        sides: Mapping[str, LocalIndices] | None = None,
    ) -> "Picture | None":
        """Draw gap and pressure along the contact boundary, or the deformed body; collective.

        The deformed body has the colours of a stress where one is given:

            problem.plot(what="deformed", stress=von_mises(problem.u, young=200.0, poisson=0.3))

        Args:
            path: Where to save the picture, with a suffix that matplotlib knows; not at all by
                default.
            what: "contact", or "deformed" for the body with the displacement and the obstacle.
            stress: A scalar expression that colours the deformed body; by default the size of the
                displacement.
            scale: How many times as large as it is the displacement is drawn, which the picture
                says; by default 1, or a larger number where the displacement would not be seen.
            sides: Facets of the mesh by the name of their side, written above the curves.

        Returns:
            The figure on rank 0, which a notebook shows, and None on the other ranks.

        Raises:
            InputError: The problem has not been solved, or an argument makes no sense.
        """
        check(
            what=(what, choice("contact", "deformed")),
            stress=(stress, optional(instance(Expr, "a UFL expression"))),
            scale=(scale, optional(positive)),
        )
        if stress is not None and stress.ufl_shape:
            raise InputError("must be a scalar, for example von_mises(...)", "stress")
        # Matplotlib is loaded by those alone who draw.
        from dolfinx_signorini.pictures.deformed import draw_deformed
        from dolfinx_signorini.pictures.picture import saved
        from dolfinx_signorini.pictures.problem_pictures import draw_problem

        if what == "contact":
            figure = draw_problem(self.along_direction, "contact", sides)
        else:
            label = "size of the displacement" if stress is None else "stress"
            figure = draw_deformed(self.u, self.along_direction, stress, label, scale)
        return saved(self.comm, figure, path)

    @property
    def _directions(self) -> Directions:
        directions = self._assembly.directions
        assert directions is not None
        return directions
