"""Variational inequalities with bounds, as users solve them, wherever the obstacle is."""

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base import compiled, kernels
from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.costs import Cost, costs_of
from dolfinx_signorini.base.errors import InputError, NotConvergedError, require
from dolfinx_signorini.base.kinds import (
    TEXT,
    by_text,
    check,
    indices,
    instance,
    integer,
    optional,
    sequence,
)
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.base.ranks import function_with
from dolfinx_signorini.data.interfaces.piecewise_forms import warn_of_cut_coefficients
from dolfinx_signorini.problem.arguments import (
    checked_space,
    conditions_of,
    functions_of,
    has_choices,
)
from dolfinx_signorini.problem.assembly import Assembly
from dolfinx_signorini.problem.checks import check_unique
from dolfinx_signorini.problem.coarse_rules import warn_of_coarse_rule
from dolfinx_signorini.problem.constraint import Constraint, Obstacle
from dolfinx_signorini.problem.contact_zones import ContactZone, OnContact
from dolfinx_signorini.problem.held import check_free, warn_of_loose
from dolfinx_signorini.problem.values import Data
from dolfinx_signorini.solvers.cascade import check_method, checked_tolerance
from dolfinx_signorini.solvers.contact import ActiveSetSolver, solve_by_tao
from dolfinx_signorini.solvers.history import History
from dolfinx_signorini.solvers.linear.solver import set_residual
from dolfinx_signorini.solvers.pressure import ContactState, contact_state
from dolfinx_signorini.solvers.result import SolveResult
from dolfinx_signorini.solvers.system import Layout, System
from dolfinx_signorini.solvers.tao import DEFAULT_RTOL as TAO_RTOL

# In the norms of the paper, the algebraic error is then about 1e-6 of the discretisation error.
DEFAULT_RTOL = 1e-7

# Where obstacles act: a problem with obstacles in the domain or on the boundary, or a zone of one
# that has both.
Contact: TypeAlias = "BoundConstrainedProblem | ContactZone"

_counter = itertools.count()


class BoundConstrainedProblem(OnContact):
    """What problems with obstacles on the boundary and in the domain share.

    Users pose a `SignoriniProblem` or an `ObstacleProblem`, and solve it:

        problem = SignoriniProblem(a, L, contact=facets, obstacle=g, bcs=[bc])
        u = problem.solve()

    A later `solve` sees changed values of the Constants and Functions in the forms, the obstacles
    and the Dirichlet data. The solve starts from the last solution and its active set, and uses the
    multigrid set-up again where that pays.

    Args:
        a: A symmetric, positive (semi)definite bilinear form on a scalar Lagrange space.
        L: A linear form.
        constraint: The obstacles, for a space of the form.
        bcs, u, petsc_options_prefix, petsc_options, form_compiler_options, jit_options: See
            `SignoriniProblem`; none has a default.

    Attributes:
        u: The solution, after `solve`.
        result: The diagnostics of the last solve; None before.
        a, L: The forms.
        space: The function space.
        system: What the solvers see.
        sign: -1 where the only obstacle is an upper one, else 1.

    Raises:
        InputError: The load, an obstacle or the Dirichlet data are not finite, an obstacle
            contradicts the Dirichlet data or the other obstacle, the form is not symmetric or not
            definite, or the problem has no or more than one solution.
    """

    vector_valued = False  # whether the unknowns are vectors
    unknown = "u"  # what is on one side of the obstacle, as matplotlib sets it
    # What is there before the constructor has succeeded, and is freed in any case.
    _system: System | None = None
    _solver: ActiveSetSolver | None = None
    _x: PETSc.Vec | None = None  # the solution of the system, if it has been solved

    def __init__(
        self,
        a: ufl.Form,
        L: ufl.Form,
        constraint: Callable[[fem.FunctionSpace], Constraint],
        bcs: Sequence[fem.DirichletBC],
        u: fem.Function | None,
        petsc_options_prefix: str | None,
        petsc_options: Mapping[str, Any] | None,
        form_compiler_options: Mapping[str, Any] | None,
        jit_options: Mapping[str, Any] | None,
    ):
        self.result: SolveResult | None = None
        self._history = History()
        self.a, self.L, self.space = a, L, checked_space(a, L, self.vector_valued)
        self.u = fem.Function(self.space, name="u") if u is None else u
        check(
            u=(self.u, functions_of(self.space)),
            bcs=(bcs, sequence(conditions_of(self.space), "a list of Dirichlet conditions")),
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
        warn_of_coarse_rule(a)
        kernels.load(self.comm)
        self._constraint = constraint(self.space)
        self.sign = max(obstacle.sign for obstacle in self._constraint.obstacles)
        compilation = form_compiler_options, jit_options
        self._assembly = Assembly(a, L, self._constraint, bcs, *compilation)
        self._system = self._assembly.system()

    def __repr__(self) -> str:
        layout = self._layout
        contact = len(layout.free_dofs) if self.comm.size == 1 else "some"
        state = "destroyed" if self._system is None else "not solved yet"
        if self.result is not None:
            state = (
                f"{self.result.active_dofs} dofs in contact, "
                f"natural residual {self.result.natural_residual:.1e}"
            )
        element = self.space.element.basix_element
        bound = "u >= g" if self.sign > 0.0 else "u <= g"
        bound = "two obstacles" if len(layout.sides) > 1 else bound
        return (
            f"<{type(self).__name__}: {self.unknowns} dofs of degree {element.degree}, "
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
        return int(self.space.dofmap.index_map.size_global * self.space.dofmap.bs)

    @property
    def system(self) -> System:
        """The discrete problem as the solvers see it.

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
    def assembled_forms(self) -> tuple[ufl.Form, ufl.Form]:
        """The forms that stand for a and L in the system, which `integrate` may have replaced."""
        return self._assembly.assembled

    @property
    def bcs(self) -> list[fem.DirichletBC]:
        """The Dirichlet conditions."""
        return self._assembly.bcs

    @property
    def total_load(self) -> float:
        """L(1): the load on the function that is 1 everywhere."""
        return self._assembly.total_load

    @property
    def obstacle(self) -> Array:
        """The obstacle at the contact dofs; with two obstacles shape (2, dofs), the lower first.

        Where there are obstacles in the domain and on the boundary, the tighter one; 1e292 away
        where a dof has none on that side.
        """
        values = self.system.obstacle.reshape(len(self._layout.sides), -1)
        return values[0] if len(values) == 1 else values

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """The obstacles as they were given, each with its sign: a lower one first."""
        return self._constraint.obstacles

    @property
    def obstacle_data(self) -> Data:
        """The obstacle as it was given: a number, an expression, a function or a callable.

        Raises:
            InputError: The problem has two obstacles.
        """
        one = len(self.obstacles) == 1
        require(self.comm, one, "has two obstacles; known for one only", "problem")
        return self.obstacles[0].data

    @property
    def sense(self) -> float:
        """By what `forces` are multiplied to be forces on u: -1 with an upper obstacle, else 1."""
        return self.sign

    def along(self, f: fem.Function) -> fem.Function:
        """Return the scalar function that the obstacles bound where f is the solution; collective.

        Args:
            f: A function of the space.
        """
        return f

    @property
    def direction(self) -> tuple[Data, ...]:
        """The components of a direction of any length along which the obstacles are given, as data.

        There are none where the obstacles bound the scalar function `along` of the solution.
        """
        return ()

    @property
    def zones(self) -> "tuple[Contact, ...]":
        """Where the obstacles act: cells and facets where there are both, else the problem."""
        zones = self._constraint.zones
        if len(zones) == 1:
            return (self,)
        return tuple(ContactZone(self, zone, number) for number, zone in enumerate(zones))

    def zone_dofs(self, number: int) -> LocalIndices:
        """The owned dofs of a zone, with or without Dirichlet data."""
        return self._assembly.zone_dofs[number]

    def obstacle_values(self, number: int) -> list[Array]:
        """The values of each obstacle of a zone at its dofs."""
        return self._assembly.values_in(number)

    @property
    def contact_dofs(self) -> LocalIndices:
        """The owned dofs that have an obstacle and no Dirichlet data."""
        return self._layout.free_dofs

    @property
    def active_sides(self) -> tuple[LocalIndices, ...]:
        """For each of the obstacles the owned dofs in contact: where u is equal to the obstacle.

        For vectors these are nodes.

        Raises:
            InputError: The problem has not been solved.
        """
        return tuple(active for zone in range(len(self.zones)) for active in self.active_in(zone))

    @property
    def touching(self) -> Mask:
        """Whether each constraint holds u; where both obstacles of a dof do, the first one alone.

        Raises:
            InputError: The problem has not been solved.
        """
        return self.system.touching_once(self._solution())

    def active_in(self, number: int) -> tuple[LocalIndices, ...]:
        """For each obstacle of a zone the owned dofs in contact whose tightest obstacle is of it.

        Args:
            number: The number of the zone.

        Raises:
            InputError: The problem has not been solved.
        """
        layout, sides = self._layout, list(self._layout.sides)
        touching = self.system.touching(self._solution()).reshape(len(sides), -1)
        nodes, found = self.contact_dofs // layout.block, []
        for obstacle in self._constraint.zones[number].obstacles:
            side = sides.index(obstacle.sign)
            held = touching[side]
            if self._assembly.owners:
                held = held & (self._assembly.owners[side][layout.free] == number)
            found.append(nodes[held])
        return tuple(found)

    @property
    def gap(self) -> fem.Function:
        """The distance from u to the nearest obstacle at the dofs that have one, 0 elsewhere.

        The gap is never negative, and exactly 0 at the dofs in contact. Each access makes a new
        function, which later solves do not change.

        Raises:
            InputError: The problem has not been solved.
        """
        layout = self._layout
        bounds = zip(layout.sides, self._assembly.obstacles, strict=True)
        return self.gap_at(layout.obstacle_dofs, bounds)

    def gap_at(self, dofs: LocalIndices, bounds: Iterable[tuple[float, Array]]) -> fem.Function:
        """Return the distance from u to the nearest of some obstacles, 0 away from some dofs.

        Args:
            dofs: Owned dofs.
            bounds: The sign of each obstacle, and its values at these dofs.

        Raises:
            InputError: The problem has not been solved.
        """
        values = self._solution().array_r[dofs]
        gaps = [sign * (values - bound) for sign, bound in bounds]
        return function_with(self.space, dofs, np.maximum(np.min(gaps, axis=0), 0.0), "gap")

    @property
    def pressure(self) -> fem.Function:
        """The density of the contact pressure; its integral is the sum of the forces.

        The pressure is a function of the space, or for vectors, along the direction, of the scalar
        space of one component. With one obstacle the pressure is never negative at nodes, and 0
        away from the contact set: with nodal elements at all dofs that are not in contact, but of
        degree 2 and higher where the obstacle acts on triangles or tetrahedra, which share their
        forces out to those that they touch. In the Bernstein basis the entries of the function are
        coefficients, 0 at the dofs that are not in contact, and no values. The pressure pushes u up
        from a lower obstacle, and down from an upper one; with two obstacles the pressure of the
        upper one is negative. Each access is collective and makes a new function, which later
        solves do not change.

        Raises:
            InputError: The problem has not been solved.
        """
        return self._layout.density(self.zones[0].normal_forces)

    @property
    def forces(self) -> fem.Function:
        """The contact force on each contact dof: the pressure times the basis function, integrated.

        The forces have the sign of the pressure, and vanish where the pressure does.

        Raises:
            InputError: The problem has not been solved.
        """
        x = self._solution()
        held, values = self.system.touching(x), self.system.multiplier(x)
        forces = self._layout.forces_at(np.where(held, np.maximum(values, 0.0), 0.0))
        forces.x.array[:] *= self.sign
        return forces

    def contact_state(self) -> ContactState:
        """Return the solution with its pressure, as the solve on a finer mesh takes them.

        Raises:
            InputError: The problem has not been solved.
        """
        return contact_state(self.system, self._solution())

    def solve_linearised(
        self,
        load: ufl.Form | fem.Function,
        rtol: float = 1e-3,
        *,
        released: LocalIndices | None = None,
    ) -> tuple[fem.Function, fem.Function]:
        """Solve the linear problem with the present contact set: the derivative of the solution.

        Find z with a(z, v) = load(v), where z and v vanish at the dofs in contact and at those with
        Dirichlet data.

        Args:
            load: A linear form on the space of the problem, or a function whose coefficients are
                the values of the form for the basis functions; the work of the latter on motions
                that nothing stops is left out.
            rtol: The residual to reach, relative to the load at the dofs where z is free.
            released: Owned dofs in contact, of vectors nodes, at which z is free; none by default.

        Returns:
            The solution z, and the forces a(z, v) - load(v) that hold z at the dofs in contact,
            with the basis functions as v: a function of the space, of vectors, too.

        Raises:
            InputError: The problem has not been solved, an argument makes no sense, or a form does
                work on a motion that nothing stops.
        """
        if isinstance(load, fem.Function):
            check(load=(load, functions_of(self.space)))
        else:
            checked_space(self.a, load, self.vector_valued)
        rtol = checked_tolerance(rtol, DEFAULT_RTOL)
        system, held = self.system, self.touching
        if released is not None:
            nodes = self._layout.contact_nodes
            known = not indices(released) and bool(np.isin(released, nodes[held]).all())
            require(self.comm, known, "must be owned dofs in contact", "released")
            held = held & ~np.isin(nodes, released)
        if self._solver is None:
            self._solver = ActiveSetSolver(system, self._prefix, self._options)
        of_form = isinstance(load, ufl.Form)
        if isinstance(load, ufl.Form):
            load = compiled.assembled(compiled.form(load, "load"), self.space)
        b = system.vector_of(load)
        b.array_w[system.fixed_dofs] = 0.0
        zero = np.zeros_like(system.obstacle), np.zeros_like(system.fixed_values)
        linear = replace(system, b=b, obstacle=zero[0], fixed_values=zero[1])
        x, rest = system.A.createVecRight(), system.A.createVecRight()
        x.set(0.0)
        try:
            if of_form:
                check_free(linear)
            b.array_w[:] -= system.shares @ self.comm.allreduce(b.array_r @ system.free)
            unit = set_residual(linear, x, held, b, rest)
            self._solver.linear.solve(linear, x, held, rtol * unit * rest.norm())
            z = fem.Function(self.space)
            system.fill(z, x)
            return z, self._forces_of(np.where(held, linear.multiplier(x), 0.0))
        finally:
            destroy(x, rest, b)

    def _forces_of(self, values: Array) -> fem.Function:
        """Return the forces on u that go with a force of each constraint towards its side."""
        return self._layout.forces_at(values)

    def costs(self) -> list[Cost]:
        """Return what this problem holds now, and the seconds of its phases; collective.

        The phases are those of the assembly so far, and of the last solve.
        """
        solved = {} if self.result is None else self.result.seconds
        forms = dict(zip("aL", self.assembled_forms, strict=True))
        return costs_of(self.comm, self, forms, self.seconds | solved)

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
                coarse solution is given, the unknown is a scalar, the degree is 1, and the mesh
                has coarser meshes for multigrid; `result.algebraic_share` tells.
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
        # Conjugate gradients are slower for vectors, and the early stop takes an algebraic error of
        # three times that of the elements for one of 0.015 of it (Hertz, degree 1, 6,714 unknowns).
        early = rtol is None and coarse is not None and self.space.dofmap.bs == 1
        rtol = checked_tolerance(rtol, DEFAULT_RTOL if method == "cascade" else TAO_RTOL)
        warm = warm_start and start is None and self.result is not None
        for name, values in (("start", start), ("u", self.u if warm else None)):
            finite = values is None or bool(np.isfinite(values.x.array).all())
            require(self.comm, finite, "has a value that is not finite", name)
        self.update()
        system = self.system
        # Coefficients of vectors are not read, and those that are integrated by pieces are known.
        read = not self.vector_valued and self.assembled_forms[0] is self.a
        if read and self.result is None and coarse is None and has_choices(self.a):
            warn_of_cut_coefficients(self.a, self.space.mesh)
        if not warm_start:
            self._free_solver()
        if not warm_start or self.result is None:
            self._history = History()
        held = None
        if start is None:
            x = system.start(self.u.x.array if warm else None)
        else:
            x = system.start(start.x.array)
            held = system.touching(x)
        self.result = None
        try:
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
            except NotConvergedError:
                check_unique(system, x)  # Newton's method may stagnate where nothing is held
                raise
            check_unique(system, x)
        except BaseException:
            self.result = None
            x.destroy()
            raise
        self._x = x
        if self.vector_valued:
            warn_of_loose(system, x)
        system.fill(self.u, x)
        return self.u

    def update(self, matrix: bool = False) -> None:
        """Assemble again what depends on changed data; `solve` calls this method by itself.

        Gap, pressure and active set belong to the system before, and are gone until `solve`. Data
        that are refused may be mended: the next call checks all data again.

        Args:
            matrix: Assemble matrix and load in any case. Changed values in the form a, and a mesh
                that has moved, are noticed by themselves.

        Raises:
            InputError: The changed data make no sense.
        """
        system = self.system
        self._free_solution()
        self._system = self._assembly.renewed(system, matrix)

    def destroy(self) -> None:
        """Free the PETSc objects; `u` and `result` stay."""
        self._free_solver()
        self._free_solution()
        if self._system is not None:
            destroy(self._system.A, self._system.b)
        self._system = None

    def check_unchanged(self) -> None:
        """Refuse a problem whose data are others than those of its solution; collective.

        Raises:
            InputError: The forms, the obstacles or the Dirichlet data have changed since the solve.
        """
        require(
            self.comm,
            not self._assembly.has_changed(),
            "its data have changed since it was solved; keep what a solve or a step overwrites, "
            "such as the last solution, in a function of its own",
            "problem",
        )

    def _solution(self) -> PETSc.Vec:
        _ = self.system
        if self._x is None:
            raise InputError("has not been solved yet: call solve() first", "problem")
        return self._x

    def _free_solution(self) -> None:
        if self._x is not None:
            self._x.destroy()
        self._x = None

    def _free_solver(self) -> None:
        if self._solver is not None:
            self._solver.destroy()
        self._solver = None
