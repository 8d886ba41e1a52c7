"""The Signorini problem as users pose and solve it."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.costs import Cost, Ledger
from dolfinx_signorini.base.errors import InputError, require
from dolfinx_signorini.base.kinds import (
    TEXT,
    by_text,
    check,
    choice,
    instance,
    integer,
    on_mesh,
    optional,
    sequence,
)
from dolfinx_signorini.problem.arguments import (
    checked_facets,
    checked_space,
    conditions_of,
    functions_of,
)
from dolfinx_signorini.problem.assembly import Assembly, Data
from dolfinx_signorini.problem.coarse_rules import names_coarse_rule
from dolfinx_signorini.solvers.contact import ActiveSetSolver, solve_by_tao
from dolfinx_signorini.solvers.history import History
from dolfinx_signorini.solvers.methods import check_method, checked_tolerance
from dolfinx_signorini.solvers.pressure import ContactState, contact_state
from dolfinx_signorini.solvers.result import SolveResult
from dolfinx_signorini.solvers.system import Layout, System
from dolfinx_signorini.solvers.tao import DEFAULT_RTOL as TAO_RTOL

if TYPE_CHECKING:
    from dolfinx_signorini.pictures.picture import Picture

# In the norms of the paper, the algebraic error is then about 1e-6 of the discretisation error.
DEFAULT_RTOL = 1e-7
LINEARISED_RTOL = 1e-3

_counter = itertools.count()


class SignoriniProblem:
    """A variational inequality with a one-sided constraint on part of the boundary.

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
            communicate. The obstacle is used at the contact dofs only. For degree 1 and in the
            Bernstein basis, see `bernstein_space`, the constraint holds at every point of the
            boundary against the interpolant of g. In nodal elements of degree 2 and higher the
            constraint holds at the nodes, and u may fall below g between them.
        bound: "lower" for u >= g, "upper" for u <= g.
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
        system: What the solvers see; for an upper obstacle that is the problem for -u.
        sign: 1 for a lower obstacle, -1 for an upper one.

    Raises:
        InputError: The load, the obstacle or the Dirichlet data are not finite, the obstacle
            contradicts the Dirichlet data, the contact boundary is none, the form is not symmetric
            or not definite, or the problem has no or more than one solution.
    """

    @names_coarse_rule
    def __init__(
        self,
        a: ufl.Form,
        L: ufl.Form,
        *,
        contact: Any,
        obstacle: Data = 0.0,
        bound: str = "lower",
        bcs: Sequence[fem.DirichletBC] = (),
        u: fem.Function | None = None,
        petsc_options_prefix: str | None = None,
        petsc_options: Mapping[str, Any] | None = None,
        form_compiler_options: Mapping[str, Any] | None = None,
        jit_options: Mapping[str, Any] | None = None,
    ):
        self._system: System | None = None
        self._solver: ActiveSetSolver | None = None
        # The solution of the system, if it has been solved.
        self._x: PETSc.Vec | None = None
        self.result: SolveResult | None = None
        self._history = History()
        self.a, self.L, self.space = a, L, checked_space(a, L)
        self.u = fem.Function(self.space, name="u") if u is None else u
        check(
            u=(self.u, functions_of(self.space)),
            bound=(bound, choice("lower", "upper")),
            bcs=(bcs, sequence(conditions_of(self.space), "a list of Dirichlet conditions")),
            obstacle=(obstacle, on_mesh(self.space.mesh, callables=True)),
            petsc_options_prefix=(petsc_options_prefix, optional(TEXT)),
            petsc_options=(petsc_options, optional(by_text)),
            form_compiler_options=(form_compiler_options, optional(by_text)),
            jit_options=(jit_options, optional(by_text)),
        )
        self._options = dict(petsc_options or {})
        self._prefix = (
            f"dolfinx_signorini_{next(_counter)}_"
            if petsc_options_prefix is None
            else petsc_options_prefix
        )
        self.sign = 1.0 if bound == "lower" else -1.0
        facets = checked_facets(self.space.mesh, contact)
        compilation = form_compiler_options, jit_options
        self._assembly = Assembly(a, L, facets, obstacle, self.sign, bcs, *compilation)
        self._system = self._assembly.system()

    def __repr__(self) -> str:
        layout = self._layout
        contact = len(layout.contact_dofs) if self.comm.size == 1 else "some"
        state = "destroyed" if self._system is None else "not solved yet"
        if self.result is not None:
            state = (
                f"{self.result.active_dofs} dofs in contact, "
                f"natural residual {self.result.natural_residual:.1e}"
            )
        element = self.space.element.basix_element
        bound = "u >= g" if self.sign > 0.0 else "u <= g"
        return (
            f"<SignoriniProblem: {self.unknowns} dofs of degree {element.degree}, "
            f"{bound} at {contact} of them; {state}>"
        )

    def __del__(self) -> None:
        self.destroy()

    @property
    def comm(self) -> MPI.Comm:
        """The communicator of the mesh."""
        return self.space.mesh.comm

    @property
    def unknowns(self) -> int:
        """The global number of dofs."""
        return int(self.space.dofmap.index_map.size_global)

    @property
    def system(self) -> System:
        """The discrete problem as the solvers see it: with a lower obstacle, for sign * u.

        Raises:
            InputError: The problem was destroyed.
        """
        if self._system is None:
            raise InputError("its PETSc objects have been destroyed", "problem")
        return self._system

    @property
    def _layout(self) -> Layout:
        return self._assembly.layout

    @property
    def ledger(self) -> Ledger:
        """Where the costs of the problem are noted."""
        return self._layout.ledger

    @property
    def seconds(self) -> dict[str, float]:
        """The wall-clock seconds of the phases of the assembly: forms, matrix, load, checks."""
        return self._assembly.phases.seconds

    @property
    def A(self) -> PETSc.Mat:
        """The matrix, with the Dirichlet data eliminated."""
        return self.system.A

    @property
    def b(self) -> PETSc.Vec:
        """The load vector of the system, with the Dirichlet data eliminated."""
        return self.system.b

    @property
    def total_load(self) -> float:
        """L(1): the load on the function that is 1 everywhere."""
        return self._assembly.total_load

    @property
    def obstacle(self) -> Array:
        """The obstacle at the contact dofs."""
        return self.sign * self.system.obstacle

    @property
    def obstacle_data(self) -> Data:
        """The obstacle as it was given: a number, an expression, a function or a callable."""
        return self._assembly.data

    @property
    def contact(self) -> LocalIndices:
        """The contact facets that this rank knows."""
        return self._layout.facets

    @property
    def contact_dofs(self) -> LocalIndices:
        """The owned dofs on the contact boundary that have no Dirichlet data."""
        return self._layout.contact_dofs

    @property
    def fixed_dofs(self) -> LocalIndices:
        """The owned dofs with Dirichlet data."""
        return self._layout.fixed_dofs

    @property
    def active(self) -> LocalIndices:
        """The owned dofs in contact: where u is equal to the obstacle.

        Raises:
            InputError: The problem has not been solved.
        """
        return self.contact_dofs[self.system.touching(self._solution())]

    @property
    def gap(self) -> fem.Function:
        """The distance from u to the obstacle at the dofs on the contact boundary, 0 elsewhere.

        The gap is never negative, and exactly 0 at the dofs in contact. Each access makes a new
        function, which later solves do not change.

        Raises:
            InputError: The problem has not been solved.
        """
        x, dofs = self._solution(), self._layout.boundary_dofs
        gap = fem.Function(self.space, name="gap")
        gap.x.array[dofs] = np.maximum(x.array_r[dofs] - self.sign * self._assembly.obstacle, 0.0)
        gap.x.scatter_forward()
        return gap

    @property
    def pressure(self) -> fem.Function:
        """The density of the contact pressure; its integral is the sum of the forces.

        The pressure is a function of the space, never negative, and 0 away from the contact set:
        with nodal elements at all dofs that are not in contact, but on tetrahedra of degree 2 and
        higher, where facets in contact share their forces out to the facets that they touch. In the
        Bernstein basis the entries of the function are coefficients, 0 at the dofs that are not in
        contact, and no values. The pressure pushes u up from a lower obstacle, and down from an
        upper one. Each access is collective and makes a new function, which later solves do not
        change.

        Raises:
            InputError: The problem has not been solved.
        """
        return self._layout.density(self.forces.x.array[self.contact_dofs])

    @property
    def forces(self) -> fem.Function:
        """The contact force on each contact dof: the pressure times the basis function, integrated.

        The forces have the sign of the pressure, and vanish where the pressure does.

        Raises:
            InputError: The problem has not been solved.
        """
        x = self._solution()
        held, forces = self.system.touching(x), self.system.multiplier(x)
        return self._forces(np.where(held, np.maximum(forces, 0.0), 0.0))

    @property
    def force(self) -> float:
        """The total contact force on u, positive upwards: so negative for an upper obstacle.

        The force is the integral of the pressure, with the sign of its direction, and takes part in
        the balance of all forces on u. The call is collective.

        Raises:
            InputError: The problem has not been solved.
        """
        owned = self.forces.x.array[self.contact_dofs]
        return self.sign * float(self.comm.allreduce(float(owned.sum())))

    def contact_state(self) -> ContactState:
        """Return the solution with its pressure, as the solve on a finer mesh takes them.

        Raises:
            InputError: The problem has not been solved.
        """
        return contact_state(self.system, self._solution())

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
        from dolfinx_signorini.pictures.problem_pictures import draw_problem

        self._solution()
        figure = draw_problem(self, what, sides)
        if figure is not None and path is not None:
            figure.savefig(path)
        return figure

    @names_coarse_rule
    def solve_linearised(
        self, load: ufl.Form, rtol: float = LINEARISED_RTOL
    ) -> tuple[fem.Function, fem.Function]:
        """Solve the linear problem with the present contact set: the derivative of the solution.

        Find z with a(z, v) = load(v), where z and v vanish at the dofs in contact and at those with
        Dirichlet data.

        Args:
            load: A linear form on the space of the problem.
            rtol: The residual to reach, relative to the load.

        Returns:
            The solution z, and the forces a(z, v) - load(v) that hold z at the dofs in contact,
            with the basis functions as v.

        Raises:
            InputError: The problem has not been solved, or an argument makes no sense.
        """
        checked_space(self.a, load)
        rtol = checked_tolerance(rtol, LINEARISED_RTOL)
        system, held = self.system, self.system.touching(self._solution())
        if self._solver is None:
            self._solver = ActiveSetSolver(system, self._prefix, self._options)
        b = fem_petsc.assemble_vector(compiled.form(load, "load"))
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        b.array_w[system.fixed_dofs] = 0.0
        zero = 0.0 * system.obstacle, 0.0 * system.fixed_values
        linear = replace(system, b=b, obstacle=zero[0], fixed_values=zero[1])
        x = system.A.createVecRight()
        x.set(0.0)
        try:
            self._solver.linear.solve(linear, x, held, rtol * b.norm())
            z = fem.Function(self.space)
            z.x.array[: x.getLocalSize()] = x.array_r
            z.x.scatter_forward()
            return z, self._forces(np.where(held, linear.multiplier(x), 0.0))
        finally:
            for item in (x, b):
                item.destroy()

    def costs(self) -> list[Cost]:
        """Return what was made for this problem so far; the call is collective."""
        return self.ledger.read(self.comm)

    @names_coarse_rule
    def solve(
        self,
        method: str = "cascade",
        *,
        coarse: ContactState | None = None,
        start: fem.Function | None = None,
        rtol: float | None = None,
        warm_start: bool = True,
        max_iterations: int | None = None,
        max_evaluations: int | None = None,
    ) -> fem.Function:
        """Solve the problem, with the present values of its data.

        Args:
            method: "cascade" predicts the active set from a coarse solution or from the last
                solution, if one is at hand, solves linear systems with CG and multigrid, and lets
                TAO accept the result. Any bound-constrained type of TAO
                (`dolfinx_signorini.METHODS`) does everything alone.
            coarse: The contact state of a solution on another mesh, for the cascade.
            start: A function of the space to start from, in place of the last solution.
            rtol: The natural residual to reach, relative to the data; by default 1e-7 for the
                cascade and 1e-8 for TAO. A cascade without an `rtol` stops earlier, where the
                algebraic error is estimated to be below 1/50 of the discretisation error, if a
                coarse solution is given, the degree is 1, and the mesh has coarser meshes for
                multigrid; `result.algebraic_share` tells.
            warm_start: Whether to start from the last solution of this problem with its active set
                and its multigrid set-up; False to solve from nothing.
            max_iterations: The limit on the iterations of TAO.
            max_evaluations: The limit on TAO's evaluations of energy and gradient.

        Returns:
            The solution `u`, the same function for each solve.

        Raises:
            InputError: An argument makes no sense, the form is found to be indefinite, or changed
                data make no sense.
            NotConvergedError: The residual was not reached.
        """
        check_method(method)
        limits = {"max_iterations": max_iterations, "max_evaluations": max_evaluations}
        given = {name: limit for name, limit in limits.items() if limit is not None}
        check(
            **{name: (limit, integer(1)) for name, limit in given.items()},
            coarse=(coarse, optional(instance(ContactState, "a contact state"))),
            start=(start, optional(functions_of(self.space))),
        )
        if method == "cascade" and given:
            raise InputError("only for the methods of TAO", ", ".join(given))
        if method != "cascade" and coarse is not None:
            raise InputError("only for the cascade", "coarse")
        early = rtol is None and coarse is not None
        rtol = checked_tolerance(rtol, DEFAULT_RTOL if method == "cascade" else TAO_RTOL)
        warm = warm_start and start is None and self.result is not None
        for name, values in (("start", start), ("u", self.u if warm else None)):
            finite = values is None or bool(np.isfinite(values.x.array).all())
            require(self.comm, finite, "has a value that is not finite", name)
        self.update()
        system = self.system
        if not warm_start:
            self._free_solver()
        if not warm_start or self.result is None:
            self._history = History()
        held = None
        if start is None:
            x = system.start(self.sign * self.u.x.array if warm else None)
        else:
            x = system.start(self.sign * start.x.array)
            held = system.touching(x)
        self.result = None
        try:
            if method == "cascade":
                if self._solver is None:
                    self._solver = ActiveSetSolver(system, self._prefix, self._options)
                known = self._history, held, coarse
                self.result = self._solver.solve(system, x, rtol, *known, early)
            else:
                self.result = solve_by_tao(
                    system, method, x, self._history, rtol, self._prefix, self._options, given
                )
        except BaseException:
            x.destroy()
            raise
        self._x = x
        self.u.x.array[: x.getLocalSize()] = self.sign * x.array_r
        self.u.x.scatter_forward()
        return self.u

    @names_coarse_rule
    def update(self, matrix: bool = False) -> None:
        """Assemble again what depends on changed data; `solve` calls this method by itself.

        Gap, pressure and active set belong to the system before, and are gone until `solve`. Data
        that are refused may be mended: the next call looks at all data again.

        Args:
            matrix: Assemble matrix and load in any case, for example because the mesh has moved:
                changed values in the form a are noticed by themselves.

        Raises:
            InputError: The changed data make no sense.
        """
        system = self.system
        self._free_solution()
        self._system = self._assembly.renewed(system, matrix)

    def integrate(self, a: ufl.Form | None = None, L: ufl.Form | None = None) -> None:
        """Assemble forms in place of `a` and `L` that differ in how they are integrated alone.

        As soon as data of `a` or `L` change, these forms themselves are assembled again.

        Args:
            a, L: The forms; None for those so far.

        Raises:
            InputError: The forms make no sense.
        """
        system = self.system
        self._free_solver()
        self._free_solution()
        self._system = self._assembly.integrated(system, a, L)

    def destroy(self) -> None:
        """Free the PETSc objects; `u` and `result` stay."""
        self._free_solver()
        self._free_solution()
        if self._system is not None:
            self._system.A.destroy()
            self._system.b.destroy()
        self._system = None

    def _solution(self) -> PETSc.Vec:
        _ = self.system
        if self._x is None:
            raise InputError("has not been solved yet: call solve() first", "problem")
        return self._x

    def _forces(self, values: Array) -> fem.Function:
        """The function with these coefficients at the contact dofs, 0 elsewhere."""
        result = fem.Function(self.space, name="forces")
        result.x.array[self.contact_dofs] = values
        result.x.scatter_forward()
        return result

    def _free_solution(self) -> None:
        if self._x is not None:
            self._x.destroy()
        self._x = None

    def _free_solver(self) -> None:
        if self._solver is not None:
            self._solver.destroy()
        self._solver = None
