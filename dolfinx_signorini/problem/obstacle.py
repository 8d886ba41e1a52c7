"""The obstacle problem: obstacles in the domain, or in some cells of it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import ufl
from dolfinx import fem

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.problem.arguments import checked_cells, checked_facets
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.problem.constraint import (
    Constraint,
    Zone,
    is_default,
    obstacles_of,
    one_obstacle,
)
from dolfinx_signorini.problem.contact_zones import ContactZone
from dolfinx_signorini.problem.values import Data

if TYPE_CHECKING:
    from dolfinx_signorini.pictures.picture import Picture


class ObstacleProblem(BoundConstrainedProblem):
    """A variational inequality with one obstacle, or two, in the domain.

    Find u with lower <= u <= upper and a(u, v - u) >= L(v - u) for all v with these bounds. The
    surface is that of `dolfinx.fem.petsc.LinearProblem`:

        problem = ObstacleProblem(a, L, lower=g, bcs=[bc])
        u = problem.solve()

    A later `solve` sees changed values of the Constants and Functions in the forms, the obstacles
    and the Dirichlet data, see `SignoriniProblem`.

    Args:
        a: A symmetric, positive (semi)definite bilinear form on a scalar Lagrange space.
        L: A linear form.
        lower, upper: The obstacles: numbers, UFL expressions, functions, or callables of the
            coordinates, shape (3, n), which are called on the ranks that have points and must not
            communicate; one of them or both. For degree 1 and in the Bernstein basis, see
            `bernstein_space`, the constraint holds at every point of the domain against the
            interpolants of the obstacles. In nodal elements of degree 2 and higher the constraint
            holds at the nodes alone.
        cells: The cells that have the obstacles: indices, local to the rank, or MeshTags of cells,
            alone or in a pair with one value or several; all cells by default.
        contact, obstacle, bound: A contact boundary and its obstacle beside those in the domain,
            see `SignoriniProblem`; none by default. Where there are two lower obstacles, or two
            upper ones, the tighter one bounds the solution.
        bcs: Dirichlet conditions.
        u: The function to be filled with the solution; a new one by default.
        petsc_options_prefix: The prefix of PETSc options; a prefix of its own by default.
        petsc_options: PETSc options of the linear solver and of TAO, without prefix; CG with
            multigrid by default. An option of the same name in PETSc's database wins.
        form_compiler_options, jit_options: See `dolfinx.fem.form`.

    Attributes:
        u: The solution, after `solve`.
        result: The diagnostics of the last solve; None before.
        a, L: The forms.
        space: The function space.
        system: What the solvers see.
        sign: -1 where the only obstacle is an upper one, else 1.

    Raises:
        InputError: The load, an obstacle or the Dirichlet data are not finite, an obstacle
            contradicts the Dirichlet data or the other obstacle, there is no obstacle or no cell,
            the form is not symmetric or not definite, or the problem has no or more than one
            solution.
    """

    def __init__(
        self,
        a: ufl.Form,
        L: ufl.Form,
        *,
        lower: Data | None = None,
        upper: Data | None = None,
        cells: Any = None,
        contact: Any = None,
        obstacle: Data = 0.0,
        bound: str = "lower",
        bcs: Sequence[fem.DirichletBC] = (),
        u: fem.Function | None = None,
        petsc_options_prefix: str | None = None,
        petsc_options: Mapping[str, Any] | None = None,
        form_compiler_options: Mapping[str, Any] | None = None,
        jit_options: Mapping[str, Any] | None = None,
    ):
        def constraint(space: fem.FunctionSpace) -> Constraint:
            domain, dim = space.mesh, space.mesh.topology.dim
            chosen = checked_cells(domain, cells)
            zones = [Zone(dim, chosen, obstacles_of(domain, lower, upper))]
            if contact is not None:
                known = checked_facets(domain, contact), (one_obstacle(domain, obstacle, bound),)
                zones.append(Zone(dim - 1, *known))
            elif not is_default(obstacle, bound):
                raise InputError("is for a contact boundary: give `contact`", "obstacle")
            return Constraint(tuple(zones))

        options = petsc_options_prefix, petsc_options, form_compiler_options, jit_options
        super().__init__(a, L, constraint, bcs, u, *options)

    @property
    def boundary(self) -> ContactZone:
        """Contact on the boundary: gap, pressure, forces and active dofs of the facets `contact`.

        `pressure` of the problem is that in the domain, and `gap`, `forces`, `force` and `active`
        are those of both.

        Raises:
            InputError: The problem has no contact boundary beside the obstacles in the domain.
        """
        zone = self.zones[-1]
        if not isinstance(zone, ContactZone):
            raise InputError("has obstacles in the domain alone", "problem")
        return zone

    def plot(
        self,
        path: Path | str | None = None,
        *,
        what: str = "solution",
        plane: tuple[str, float] | None = None,
    ) -> "Picture | None":
        """Draw the solution or the pressure, and where contact in the domain ends; collective.

        Args:
            path: Where to save the picture, with a suffix that matplotlib knows; not at all by
                default.
            what: "solution" for u, "contact" for the pressure, "boundary" for gap and pressure
                along the contact boundary, see `boundary`.
            plane: In space the slice to draw, for example ("z", 0.5); by default the slice through
                the middle at right angles to z.

        Returns:
            The figure on rank 0, which a notebook shows, and None on the other ranks.

        Raises:
            InputError: The problem has not been solved, or there is no such picture or slice.
        """
        # Matplotlib is loaded by those alone who draw.
        from dolfinx_signorini.pictures.contact_region import draw_region
        from dolfinx_signorini.pictures.picture import saved
        from dolfinx_signorini.pictures.problem_pictures import draw_problem

        self._solution()
        if what == "boundary":
            figure = draw_problem(self.boundary, "contact", None)
        else:
            figure = draw_region(self.zones[0], what, plane=plane)
        return saved(self.comm, figure, path)
