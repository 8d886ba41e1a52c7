"""The Signorini problem as users pose and solve it."""

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini import checks, system
from dolfinx_signorini.changes import Watch
from dolfinx_signorini.costs import Cost, Ledger
from dolfinx_signorini.errors import InputError, require
from dolfinx_signorini.solvers import METHODS
from dolfinx_signorini.solvers.active_set import solve_active_set
from dolfinx_signorini.solvers.held import HeldSolver
from dolfinx_signorini.solvers.prediction import Mask, predict
from dolfinx_signorini.solvers.pressure import ContactState, contact_state
from dolfinx_signorini.solvers.residual import NaturalResidual
from dolfinx_signorini.solvers.result import SolveResult
from dolfinx_signorini.solvers.tao import DEFAULT_RTOL as TAO_RTOL
from dolfinx_signorini.solvers.tao import TaoRounds
from dolfinx_signorini.system import Array, Data, Indices, Layout, System
from dolfinx_signorini.timing import Phases

# With it the algebraic error is about 1e-6 of the discretisation error in the norms of the paper.
DEFAULT_RTOL = 1e-7

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
            coordinates, shape (3, n). The obstacle is used at the contact dofs only: for degree 1
            the constraint then holds on the whole boundary against the interpolant of g; for
            degree 2 at vertices and edge midpoints, and u may fall below g between them.
        bound: "lower" for u >= g, "upper" for u <= g.
        bcs: Dirichlet conditions.
        u: The function to be filled with the solution; a new one by default.
        petsc_options_prefix: The prefix of PETSc options; a prefix of its own by default.
        petsc_options: PETSc options of the linear solver and of TAO, without prefix; CG with
            BoomerAMG by default. An option of the same name in PETSc's database wins.
        form_compiler_options, jit_options: See `dolfinx.fem.form`.

    Attributes:
        u: The solution, after `solve`.
        result: The diagnostics of the last solve; None before.
        space: The function space.
        system: What the solvers see; for an upper obstacle that is the problem for -u.
        sign: 1 for a lower obstacle, -1 for an upper one.
        seconds: The wall-clock seconds of the phases of the assembly.

    Raises:
        InputError: The load, the obstacle or the Dirichlet data are not finite, the obstacle
            contradicts the Dirichlet data, the contact boundary is none, the form is not symmetric
            or not definite, or the problem has no or more than one solution.
    """

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
        self._solver: HeldSolver | None = None
        # The last solution of the system; None before the first and after a solve that failed.
        self._x: PETSc.Vec | None = None
        self.result: SolveResult | None = None
        self.space = _scalar_space(a, L)
        self.u = fem.Function(self.space, name="u") if u is None else u
        if self.u.function_space != self.space:
            raise InputError("belongs to another function space than the form a", "u")
        if bound not in ("lower", "upper"):
            raise InputError(f"must be 'lower' or 'upper', not {bound!r}", "bound")
        self.sign = 1.0 if bound == "lower" else -1.0
        self.bcs, self._options = list(bcs), dict(petsc_options or {})
        self._prefix = (
            f"dolfinx_signorini_{next(_counter)}_"
            if petsc_options_prefix is None
            else petsc_options_prefix
        )
        self.ledger, phases = Ledger(), Phases(self.comm)
        with phases("forms"):
            facets = _facets(self.space.mesh, contact)
            boundary = system.dofs_on_facets(self.space, facets)
            fixed = system.dirichlet_dofs(self.space, self.bcs)
            self._layout = Layout(self.space, facets, boundary, fixed, self.ledger)
            options = form_compiler_options, jit_options
            self._a, self._L = self._compiled("a", a, *options), self._compiled("L", L, *options)
            self._obstacle_at = system.evaluator(self.space, obstacle, boundary)
            self._watch_a, self._watch_L = Watch(a), Watch(L)
        self._assemble(phases, matrix=True, load=True)
        self.seconds = phases.seconds

    def __repr__(self) -> str:
        layout = self._layout
        contact = self.comm.allreduce(len(layout.contact_dofs)) if self.comm.size == 1 else "some"
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
    def A(self) -> PETSc.Mat:
        """The matrix, with the Dirichlet data eliminated."""
        return self.system.A

    @property
    def b(self) -> PETSc.Vec:
        """The load vector of the system, with the Dirichlet data eliminated."""
        return self.system.b

    @property
    def obstacle(self) -> Array:
        """The obstacle at the contact dofs."""
        return self.sign * self.system.obstacle

    @property
    def contact(self) -> Indices:
        """The contact facets that this rank knows."""
        return self._layout.facets

    @property
    def contact_dofs(self) -> Indices:
        """The owned dofs on the contact boundary that have no Dirichlet data."""
        return self._layout.contact_dofs

    @property
    def fixed_dofs(self) -> Indices:
        """The owned dofs with Dirichlet data."""
        return self._layout.fixed_dofs

    @property
    def active(self) -> Indices:
        """The owned dofs in contact: where u is equal to the obstacle.

        Raises:
            InputError: The problem has not been solved.
        """
        return self.contact_dofs[self._held()]

    @property
    def gap(self) -> fem.Function:
        """The distance from u to the obstacle at the dofs on the contact boundary, 0 elsewhere.

        The gap is never negative, and exactly 0 at the dofs in contact.

        Raises:
            InputError: The problem has not been solved.
        """
        x, dofs = self._solution(), self._layout.boundary_dofs
        gap = fem.Function(self.space, name="gap")
        gap.x.array[dofs] = np.maximum(x.array_r[dofs] - self.sign * self._obstacle_at(), 0.0)
        gap.x.scatter_forward()
        return gap

    @property
    def pressure(self) -> fem.Function:
        """The density of the contact pressure at the contact dofs, 0 elsewhere.

        The pressure is never negative, and exactly 0 at the dofs that are not in contact. The
        pressure pushes u up from a lower obstacle, and down from an upper one.

        Raises:
            InputError: The problem has not been solved.
        """
        held, forces = self._held(), self.system.multiplier(self._solution())
        pressure = fem.Function(self.space, name="pressure")
        pressure.x.array[self.contact_dofs] = (
            np.where(held, np.maximum(forces, 0.0), 0.0) / self._layout.weights
        )
        pressure.x.scatter_forward()
        return pressure

    def contact_state(self) -> ContactState:
        """Return the solution with its pressure, as the solve on a finer mesh takes them.

        Raises:
            InputError: The problem has not been solved.
        """
        return contact_state(self.system, self._solution())

    def costs(self) -> list[Cost]:
        """Return what was made for this problem so far; the call is collective."""
        return self.ledger.read(self.comm)

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
                solution, if one is at hand, solves linear systems with CG and algebraic multigrid,
                and lets TAO accept the result. Any bound-constrained type of TAO
                (`dolfinx_signorini.METHODS`) does everything alone.
            coarse: The contact state of a solution on another mesh, for the cascade.
            start: A function of the space to start from, in place of the last solution.
            rtol: The natural residual to reach, relative to the data; by default 1e-7 for the
                cascade and 1e-8 for TAO, so that the algebraic error is small against that of the
                discretisation.
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
        limits = {"max_iterations": max_iterations, "max_evaluations": max_evaluations}
        given = {name: limit for name, limit in limits.items() if limit is not None}
        rtol = self._checked(method, coarse, rtol, given)
        began = time.perf_counter()
        warm = warm_start and start is None and self.result is not None
        held = self._held() if warm else None
        self.update()
        if start is None and warm:
            start = self.u
        x = self.system.start(None if start is None else self.sign * start.x.array)
        if held is not None:
            held |= self._at_obstacle(x)  # where the obstacle has risen
        elif start is not None:
            held = self._at_obstacle(x)
        if self._solver is not None and not warm_start:
            self._solver.destroy()
            self._solver = None
        self._free_solution()
        try:
            if method == "cascade":
                self.result = self._by_active_sets(x, held, coarse, rtol, began)
            else:
                self.result = self._by_tao(x, method, rtol, given, began)
        except BaseException:
            x.destroy()
            raise
        self._x = x
        self.u.x.array[: x.getLocalSize()] = self.sign * x.array_r
        self.u.x.scatter_forward()
        return self.u

    def update(self, matrix: bool = False) -> None:
        """Assemble again what depends on changed data; `solve` calls this method by itself.

        Args:
            matrix: Assemble matrix and load in any case, for example because the mesh has moved:
                changed values in the form a are noticed by themselves.

        Raises:
            InputError: The changed data make no sense.
        """
        _ = self.system
        matrix = self._watch_a.changed(self.comm) or matrix
        load = self._watch_L.changed(self.comm) or matrix
        self._assemble(Phases(self.comm), matrix, load)

    def destroy(self) -> None:
        """Free the PETSc objects; the solution stays."""
        if self._solver is not None:
            self._solver.destroy()
        if self._x is not None:
            self._x.destroy()
            self._x = None
        if self._system is not None:
            self._system.A.destroy()
            self._system.b.destroy()
        self._solver = self._system = None

    def _checked(
        self, method: str, coarse: ContactState | None, rtol: float | None, given: Mapping[str, int]
    ) -> float:
        """Refuse arguments of `solve` that make no sense, and return the tolerance."""
        if method not in METHODS:
            raise InputError(f"unknown {method!r}, known are {', '.join(METHODS)}", "method")
        if method == "cascade" and given:
            raise InputError("only for the methods of TAO", ", ".join(given))
        if method != "cascade" and coarse is not None:
            raise InputError("only for the cascade", "coarse")
        if rtol is None:
            rtol = DEFAULT_RTOL if method == "cascade" else TAO_RTOL
        if not 0.0 < rtol < 1.0:
            raise InputError(f"must lie between 0 and 1, not {rtol}", "rtol")
        return rtol

    def _by_active_sets(
        self,
        x: PETSc.Vec,
        held: Mask | None,
        coarse: ContactState | None,
        rtol: float,
        began: float,
    ) -> SolveResult:
        """Find the active set, and let TAO accept the solution or, if need be, improve it."""
        system = self.system
        if self._solver is None:
            self._solver = HeldSolver(system, self._prefix, self._options)
        solver = self._solver
        counts = solver.solves, solver.iterations
        measure = NaturalResidual(system, rtol)
        if coarse is not None:
            held = predict(system, coarse)
        guess = np.full(len(self.contact_dofs), True) if held is None else held
        predicted = time.perf_counter()
        try:
            trusted = coarse is not None
            residual = solve_active_set(system, solver, measure, x, guess, rtol, trusted)
            system.project(x)
            if residual > rtol:  # Newton's method needs the memory
                solver.destroy()
                self._solver = None
            solved = time.perf_counter()
            rounds = TaoRounds(system, "bncg" if residual <= rtol else "bntr", prefix=self._prefix)
            residual = _run(rounds, x, measure, rtol, "cascade")
        finally:
            measure.destroy()
        seconds = {"predict": predicted - began, "solve": solved - predicted}
        seconds["accept"] = time.perf_counter() - solved
        linear = solver.solves - counts[0], solver.iterations - counts[1]
        return self._result("cascade", x, rounds, residual, linear, seconds)

    def _by_tao(
        self, x: PETSc.Vec, method: str, rtol: float, limits: Mapping[str, int], began: float
    ) -> SolveResult:
        measure = NaturalResidual(self.system, rtol)
        rounds = TaoRounds(
            self.system, method, prefix=self._prefix, options=self._options, **limits
        )
        try:
            residual = _run(rounds, x, measure, rtol, method)
        finally:
            measure.destroy()
        seconds = {"solve": time.perf_counter() - began}
        return self._result(method, x, rounds, residual, (0, 0), seconds)

    def _result(
        self,
        method: str,
        x: PETSc.Vec,
        rounds: TaoRounds,
        residual: float,
        linear: tuple[int, int],
        seconds: dict[str, float],
    ) -> SolveResult:
        self.ledger.add("vector", "solution u", x)
        for phase, value in seconds.items():
            self.ledger.add("phase", phase, seconds=value)
        return SolveResult(
            method=method,
            reason=f"TAO {rounds.method}: {rounds.reason}",
            iterations=rounds.iterations,
            linear_solves=linear[0],
            linear_iterations=linear[1] + rounds.linear_iterations,
            natural_residual=residual,
            active_dofs=self.comm.allreduce(int(self._at_obstacle(x).sum())),
            seconds=self.seconds | seconds,
        )

    def _assemble(self, phases: Phases, matrix: bool, load: bool) -> None:
        """Make the system anew from the parts whose data have changed."""
        fixed = self._layout.fixed_dofs
        obstacle = self._obstacle_at()
        data = system.dirichlet_values(self.space, self.bcs, fixed)
        checks.check_bounds(
            self.space, self._layout.boundary_dofs, obstacle, fixed, data, self.sign < 0.0
        )
        old = self._system
        obstacle, data = self.sign * obstacle[self._layout.free], self.sign * data
        if old is not None:
            load = self.comm.allreduce(load or bool((data != old.fixed_values).any()), op=MPI.LOR)
            if not matrix and not load:
                self._system = replace(old, obstacle=obstacle)
                return
        if matrix:
            with phases("matrix"):
                A = system.assembled_matrix(
                    self._a, self.bcs, fixed, None if old is None else old.A
                )
            self.ledger.add("matrix", "A", A, phases.seconds["matrix"])
            if self._solver is not None:
                self._solver.matrix_changed()
        else:
            assert old is not None
            A = old.A
        with phases("load"):
            b = system.assembled_load(self._L, self._a, self.bcs, fixed, A)
            b.scale(self.sign)
        self.ledger.add("vector", "load b", b, phases.seconds["load"])
        if old is not None:
            old.b.destroy()
        with phases("checks"):
            self._system = self._checked_system(A, b, obstacle, data, matrix, old)

    def _checked_system(
        self,
        A: PETSc.Mat,
        b: PETSc.Vec,
        obstacle: Array,
        data: Array,
        matrix: bool,
        old: System | None,
    ) -> System:
        diagonal_vector = A.getDiagonal()
        diagonal = np.array(diagonal_vector.array_r)
        diagonal_vector.destroy()
        try:
            checks.check_entries(self.comm, diagonal, b.array_r)
            singular = False if old is None else old.singular
            if matrix:
                checks.check_symmetry(A)
                singular = checks.vanishes_on_constants(A, self.fixed_dofs, diagonal)
            made = System(
                layout=self._layout,
                A=A,
                b=b,
                obstacle=obstacle,
                contact_diagonal=diagonal[self.contact_dofs],
                fixed_values=data,
                singular=singular,
            )
            checks.check_range(made, diagonal)
            checks.check_held(made)
        except InputError:
            for item in (A, b):
                item.destroy()
            self._system = None
            raise
        if old is None:
            self._note()
        return made

    def _note(self) -> None:
        """Enter the arrays of the constraints into the ledger."""
        count, fixed = len(self.contact_dofs), len(self.fixed_dofs)
        self.ledger.add("array", "contact dofs, their obstacle and diagonal", 20 * count)
        if self.comm.allreduce(fixed):
            self.ledger.add("array", "Dirichlet dofs and data", 12 * fixed)

    def _compiled(
        self,
        name: str,
        form: ufl.Form,
        form_compiler_options: Mapping[str, Any] | None,
        jit_options: Mapping[str, Any] | None,
    ) -> fem.Form:
        start = time.perf_counter()
        compiled = fem.form(
            form, form_compiler_options=form_compiler_options, jit_options=jit_options
        )
        self.ledger.add("form", name, form, time.perf_counter() - start)
        return compiled

    def _solution(self) -> PETSc.Vec:
        _ = self.system
        if self._x is None:
            raise InputError("has not been solved yet", "problem")
        return self._x

    def _held(self) -> Mask:
        """Whether a contact dof of this rank is in contact."""
        return self._at_obstacle(self._solution())

    def _at_obstacle(self, x: PETSc.Vec) -> Mask:
        return np.asarray(x.array_r[self.contact_dofs] <= self.system.obstacle)

    def _free_solution(self) -> None:
        if self._x is not None:
            self._x.destroy()
        self._x = self.result = None


def _run(
    rounds: TaoRounds, x: PETSc.Vec, measure: NaturalResidual, rtol: float, name: str
) -> float:
    """Run TAO, and return the residual; raise NotConvergedError unless the residual is rtol."""
    try:
        residual = rounds.run(x, measure, rtol)
    finally:
        rounds.destroy()
    if not residual <= rtol:
        raise rounds.failure(name, residual, rtol)
    return residual


def _scalar_space(a: ufl.Form, L: ufl.Form) -> fem.FunctionSpace:
    """Return the space of the forms, if the space is one that can be solved on."""
    arguments = a.arguments()
    if len(arguments) != 2:
        raise InputError(f"needs a trial and a test function, has {len(arguments)}", "form a")
    space = arguments[0].ufl_function_space()
    element = space.ufl_element()
    if space.dofmap.bs != 1 or element.family_name != "P" or element.discontinuous:
        raise InputError("the space must be a scalar, continuous Lagrange space", "form a")
    if len(L.arguments()) != 1:
        raise InputError(f"the form L needs one test function, has {len(L.arguments())}", "load")
    return space


def _facets(domain: mesh.Mesh, contact: Any) -> Indices:
    """Return the facets that an argument `contact` names."""
    tags, values = contact if isinstance(contact, tuple) else (contact, None)
    if not isinstance(tags, mesh.MeshTags):
        return np.asarray(contact, dtype=np.int32)
    dimension = domain.topology.dim - 1
    require(domain.comm, tags.dim == dimension, f"tags of dimension {tags.dim}", "contact")
    if values is None:
        return np.asarray(tags.indices, dtype=np.int32)
    return np.asarray(tags.indices[np.isin(tags.values, values)], dtype=np.int32)
