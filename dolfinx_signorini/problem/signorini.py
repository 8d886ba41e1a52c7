"""The Signorini problem: obstacles on a part of the boundary."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import ufl
from dolfinx import fem

from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.kinds import instance
from dolfinx_signorini.problem.arguments import checked_facets
from dolfinx_signorini.problem.bound_constrained import DEFAULT_RTOL, BoundConstrainedProblem
from dolfinx_signorini.problem.constraint import (
    Constraint,
    Obstacle,
    Zone,
    is_default,
    obstacles_of,
    one_obstacle,
)
from dolfinx_signorini.problem.values import Data

if TYPE_CHECKING:
    from dolfinx_signorini.pictures.picture import Picture

__all__ = ["DEFAULT_RTOL", "SignoriniProblem"]


class SignoriniProblem(BoundConstrainedProblem):
    """A variational inequality with one obstacle, or two, on part of the boundary.

    Find u >= g on the contact boundary with a(u, v - u) >= L(v - u) for all v >= g there. The
    surface is that of `dolfinx.fem.petsc.LinearProblem`:

        problem = SignoriniProblem(a, L, contact=facets, obstacle=g, bcs=[bc])
        u = problem.solve()

    A later `solve` sees changed values of the Constants and Functions in the forms, the obstacle
    and the Dirichlet data. The solve starts from the last solution and its active set, and uses the
    multigrid set-up again where that pays.

    Args:
        a: A symmetric, positive (semi)definite bilinear form on a scalar Lagrange space.
        L: A linear form.
        contact: The contact boundary: indices of facets, local to the rank, as `dolfinx.mesh` gives
            them; or MeshTags of facets, alone or in a pair with one value or several.
        obstacle: The obstacle g: a number, a UFL expression, a function, or a callable of the
            coordinates, shape (3, n), which is called on the ranks that have points and must not
            communicate. The obstacle is used at the contact dofs only. For degree 1
            and in the Bernstein basis, see `bernstein_space`, the constraint holds at every point
            of the boundary against the interpolant of g. In nodal elements of degree 2 and higher
            the constraint holds at the nodes, and u may fall below g between them.
        bound: "lower" for u >= g, "upper" for u <= g.
        lower, upper: In place of `obstacle` and `bound`, a lower obstacle, an upper one, or both:
            lower <= u <= upper.
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
            contradicts the Dirichlet data or the other obstacle, the contact boundary is none, the
            form is not symmetric or not definite, or the problem has no or more than one solution.
    """

    def __init__(
        self,
        a: ufl.Form,
        L: ufl.Form,
        *,
        contact: Any,
        obstacle: Data = 0.0,
        bound: str = "lower",
        lower: Data | None = None,
        upper: Data | None = None,
        bcs: Sequence[fem.DirichletBC] = (),
        u: fem.Function | None = None,
        petsc_options_prefix: str | None = None,
        petsc_options: Mapping[str, Any] | None = None,
        form_compiler_options: Mapping[str, Any] | None = None,
        jit_options: Mapping[str, Any] | None = None,
    ):
        def constraint(space: fem.FunctionSpace) -> Constraint:
            domain = space.mesh
            given: tuple[Obstacle, ...] = (one_obstacle(domain, obstacle, bound),)
            facets = checked_facets(domain, contact)
            if lower is not None or upper is not None:
                if not is_default(obstacle, bound):
                    raise InputError("has a lower or an upper obstacle beside", "obstacle")
                given = obstacles_of(domain, lower, upper)
            return Constraint((Zone(domain.topology.dim - 1, facets, given),))

        options = petsc_options_prefix, petsc_options, form_compiler_options, jit_options
        super().__init__(a, L, constraint, bcs, u, *options)

    def plot(
        self,
        path: Path | str | None = None,
        *,
        what: str = "contact",
        sides: Mapping[str, LocalIndices] | None = None,
    ) -> "Picture | None":
        """Draw gap and pressure along the contact boundary, or the solution; collective.

        Args:
            path: Where to save the picture, with a suffix that matplotlib knows; not at all by
                default.
            what: "contact", or "solution" for u with the facets in contact.
            sides: Facets of the mesh by the name of their side, written above the curves.

        Returns:
            The figure on rank 0, which a notebook shows, and None on the other ranks.

        Raises:
            InputError: The problem has not been solved, or there is no such picture.
        """
        # Matplotlib is loaded by those alone who draw.
        from dolfinx_signorini.pictures.picture import saved
        from dolfinx_signorini.pictures.problem_pictures import draw_problem

        self._solution()
        figure = draw_problem(self, what, sides)
        return saved(self.comm, figure, path)


def one_sided(value: Any) -> str:
    """The kind of problems with one obstacle on the boundary."""
    message = instance(SignoriniProblem, "a solved problem")(value)
    if isinstance(value, BoundConstrainedProblem) and (message or len(value.obstacles) > 1):
        return "must be one with one obstacle on the boundary"
    return message
