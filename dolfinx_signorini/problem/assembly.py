"""Assembly: forms, contact facets, obstacle and Dirichlet data become a system.

The system is made once, and again from the parts whose data have changed.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
import ufl
from dolfinx import fem, mesh
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc
from ufl.core.expr import Expr

from dolfinx_signorini.base import compat, compiled
from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.changed_values import Watch
from dolfinx_signorini.base.costs import Ledger
from dolfinx_signorini.base.errors import InputError, together
from dolfinx_signorini.base.ranks import marked
from dolfinx_signorini.base.sums_of_squares import is_sum_of_squares
from dolfinx_signorini.base.timing import Phases
from dolfinx_signorini.meshes.elements import (
    coefficients_of,
    control_points,
    is_bernstein,
    nodal_space,
)
from dolfinx_signorini.meshes.sided_meshes import cells_with_dofs, covering_cells
from dolfinx_signorini.problem import checks
from dolfinx_signorini.solvers.system import Layout, System

Data: TypeAlias = "float | Expr | fem.Function | Callable[[Array], Array]"


class Assembly:
    """What a system is assembled from.

    An assembly makes a system, and later the system for changed data:

        assembly = Assembly(a, L, facets, obstacle, 1.0, bcs)
        system = assembly.system()
        wind.value = 2.0
        system = assembly.renewed(system)

    Args:
        a: The bilinear form.
        L: The linear form.
        facets: The contact facets that this rank knows.
        obstacle: The obstacle, see `SignoriniProblem`.
        sign: 1 for a lower obstacle, -1 for an upper one.
        bcs: The Dirichlet conditions.
        form_compiler_options, jit_options: See `dolfinx.fem.form`.

    Attributes:
        layout: The dofs with a constraint or Dirichlet data.
        data: The obstacle as it was given.
        obstacle: The obstacle of the last system at the owned dofs on the contact boundary.
        phases: The seconds of the phases so far.
        total_load: L(1), the sum of the load on all basis functions.
    """

    total_load: float

    def __init__(
        self,
        a: ufl.Form,
        L: ufl.Form,
        facets: LocalIndices,
        obstacle: Data,
        sign: float,
        bcs: Sequence[fem.DirichletBC],
        form_compiler_options: Mapping[str, Any] | None = None,
        jit_options: Mapping[str, Any] | None = None,
    ):
        space = a.arguments()[0].ufl_function_space()
        self.sign, self.bcs, self.comm, self._forms = sign, list(bcs), space.mesh.comm, (a, L)
        self.phases, ledger = Phases(self.comm), Ledger()
        with self.phases("forms"):
            boundary = dofs_on_facets(space, facets)
            fixed = _dirichlet_dofs(space, self.bcs)
            self.layout = Layout(space, facets, boundary, fixed, ledger)
            self._options: dict[str, Any] = {
                "form_compiler_options": form_compiler_options,
                "jit_options": jit_options,
            }
            self._take(a, L)
            self.data = obstacle
            self._obstacle_at = evaluator(space, obstacle, boundary)
            self._watch_a, self._watch_L = Watch(a), Watch(L)
            self._replaced = False  # whether other forms are assembled than the given ones
            self._refused = False  # whether the entries of the last system were refused

    def _take(self, a: ufl.Form | None, L: ufl.Form | None) -> None:
        """Take forms, where they are given."""
        ledger, options = self.layout.ledger, self._options
        if a is not None:
            self._a = _compiled(ledger, "a", a, options)
        if L is not None:
            self._L = _compiled(ledger, "L", L, options)

    def system(self) -> System:
        """Assemble the system.

        Raises:
            InputError: The data make no sense, see `SignoriniProblem`.
        """
        made = self._assembled(None, self._bounds(), True)
        count, fixed = len(made.contact_dofs), len(made.fixed_dofs)
        made.ledger.add("array", "contact dofs, their obstacle and diagonal", 20 * count)
        if self.comm.allreduce(fixed):
            made.ledger.add("array", "Dirichlet dofs and data", 12 * fixed)
        return made

    def renewed(self, old: System, matrix: bool = False) -> System:
        """Return the system for the present data; the old one must not be used any more.

        Args:
            old: The system so far.
            matrix: Assemble matrix and load in any case, on a mesh that may have moved.

        Raises:
            InputError: The data make no sense, see `SignoriniProblem`. The entries of the old
                system are lost then, and the next call assembles all of them again.
        """
        if matrix:  # the shares of the boundary and the places of the dofs are others
            self.layout = replace(self.layout)
            self._obstacle_at = evaluator(self.layout.space, self.data, self.layout.boundary_dofs)
        obstacle, data = self._bounds()  # first: a refusal must not use up the changes of a and L
        changed = self._watch_a.changed(self.comm), self._watch_L.changed(self.comm)
        if self._replaced and (matrix or any(changed)):  # the forms were made of other data
            self._take(*self._forms)
            self._replaced, matrix = False, True
        matrix = changed[0] or matrix or self._refused
        load = changed[1] or matrix
        moved = bool((data != old.fixed_values).any())
        if not self.comm.allreduce(load or moved, op=MPI.LOR):
            return replace(old, obstacle=obstacle)
        self._refused = True
        made = self._assembled(old, (obstacle, data), matrix)
        old.b.destroy()
        self._refused = False
        return made

    def integrated(self, old: System, a: ufl.Form | None, L: ufl.Form | None) -> System:
        """Return the system of forms that are integrated otherwise; the old one is used up.

        Args:
            old: The system so far.
            a, L: The forms, see `SignoriniProblem.integrate`.
        """
        with self.phases("forms"):
            self._take(a, L)
        self._replaced = False
        made = self.renewed(old, matrix=True)
        self._replaced = True
        return made

    def _bounds(self) -> tuple[Array, Array]:
        """Return the present obstacle at the contact dofs and the Dirichlet data, both checked."""
        space, fixed = self.layout.space, self.layout.fixed_dofs
        obstacle, data = self._obstacle_at(), _dirichlet_values(space, self.bcs, fixed)
        obstacle = checks.check_bounds(self.layout, obstacle, data, self.sign < 0.0, self._reach)
        self.obstacle = obstacle
        return self.sign * obstacle[self.layout.free], self.sign * data

    def _reach(self) -> float:
        """Return about how large the solution is without any bounds, up to a power of the size."""
        A, b = fem_petsc.assemble_matrix(self._a), fem_petsc.assemble_vector(self._L)
        A.assemble()
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        diagonal = A.getDiagonal()
        reach = float(b.norm(PETSc.NormType.NORM_1)) / _size(diagonal)
        for item in (A, b, diagonal):
            item.destroy()
        return reach

    def _assembled(self, old: System | None, bounds: tuple[Array, Array], matrix: bool) -> System:
        A = self._matrix(old) if matrix or old is None else old.A
        with self.phases("load"):
            b = fem_petsc.assemble_vector(self._L)
            with b.localForm() as local:
                self.total_load = self.comm.allreduce(float(local.array_r.sum()))
            _lift(b, self._a, self.bcs, self.layout, A)
            b.scale(self.sign)
        self.layout.ledger.add("vector", "load b", b, self.phases.seconds["load"])
        with self.phases("checks"):
            try:
                return self._checked(A, b, bounds, old, matrix)
            except InputError:
                b.destroy()
                if old is None:
                    A.destroy()
                raise

    def _matrix(self, old: System | None) -> PETSc.Mat:
        with self.phases("matrix"):
            fixed = self.layout.fixed_dofs
            A = _assembled_matrix(self._a, self.bcs, fixed, None if old is None else old.A)
        self.layout.ledger.add("matrix", "A", A, self.phases.seconds["matrix"])
        return A

    def _checked(
        self,
        A: PETSc.Mat,
        b: PETSc.Vec,
        bounds: tuple[Array, Array],
        old: System | None,
        matrix: bool,
    ) -> System:
        """Return the system of its parts, after a check of what is new."""
        vector = A.getDiagonal()
        diagonal = np.array(vector.array_r)
        vector.destroy()
        checks.check_entries(self.comm, diagonal, b.array_r)
        assembled = old.assembled + matrix if old is not None else 1
        doubtful = (old is None or matrix) and not is_sum_of_squares(self._forms[0])
        if doubtful:
            checks.check_symmetry(A)
        if old is None or matrix:
            loose = checks.vanishes_on_constants(self._forms[0], A, self.layout, diagonal)
        else:
            loose = old.loose
        made = System(
            layout=self.layout,
            A=A,
            b=b,
            obstacle=bounds[0],
            contact_diagonal=diagonal[self.layout.contact_dofs],
            fixed_values=bounds[1],
            loose=loose,
            assembled=assembled,
        )
        checks.check_range(made, diagonal)
        if doubtful:
            checks.check_definite(A, made.space, made.fixed_dofs, diagonal)
        checks.check_held(made)
        return made


def dofs_on_facets(space: fem.FunctionSpace, facets: LocalIndices) -> LocalIndices:
    """Return the owned dofs on facets, also on facets that only another rank owns.

    Args:
        space: The function space.
        facets: Facets that this rank knows; the call is collective.
    """
    tdim = space.mesh.topology.dim
    space.mesh.topology.create_connectivity(tdim - 1, tdim)
    dofs = fem.locate_dofs_topological(space, tdim - 1, facets)
    return dofs[dofs < space.dofmap.index_map.size_local]


def evaluator(space: fem.FunctionSpace, value: Data, dofs: LocalIndices) -> Callable[[], Array]:
    """Return a function that evaluates data at dofs, each time with the present values.

    In the Bernstein basis the values of the dofs are the coefficients of the interpolant of the
    data at the control points. A UFL expression is compiled once, and evaluated on few cells that
    together have all of the dofs.

    Args:
        space: A scalar Lagrange space.
        value: A number, a UFL expression, a function of the space or of another one on its mesh,
            or a callable of the coordinates, shape (3, n), which returns shape (n,).
        dofs: Dofs of this rank: all of them on some facets.
    """
    if isinstance(value, int | float | np.number):
        return lambda: np.full(len(dofs), float(value))
    if isinstance(value, fem.Function) and value.function_space == space:
        return lambda: value.x.array[dofs].copy()
    if is_bernstein(space):
        return _coefficients(space, value, dofs)
    g = fem.Function(space)
    wanted = np.zeros(len(g.x.array), dtype=bool)
    wanted[dofs] = True
    cells = covering_cells(space, wanted, cells_with_dofs(space, wanted))
    if callable(value) and not isinstance(value, Expr):
        x = control_points(space, cells)[dofs].T
        return lambda: called(space.mesh.comm, value, x)
    points = compat.interpolation_points(space.element)
    expression = compiled.expression(value, points, space.mesh.comm)

    def evaluate() -> Array:
        g.interpolate(expression, cells0=cells)
        return g.x.array[dofs].copy()

    return evaluate


def _coefficients(space: fem.FunctionSpace, value: Data, dofs: LocalIndices) -> Callable[[], Array]:
    """As `evaluator`, in the Bernstein basis; the call is collective."""
    wanted = marked(space, dofs)
    known = np.flatnonzero(wanted).astype(np.int32)
    cells, values_at = cells_with_dofs(space, wanted), evaluator(nodal_space(space), value, known)

    def evaluate() -> Array:
        values = np.zeros(len(wanted))
        values[known] = values_at()
        return coefficients_of(space, values, cells)[dofs]

    return evaluate


def called(comm: MPI.Comm, value: Callable[[Array], Any], x: Array) -> Array:
    """Return the values of a callable at points, shape (n,).

    Args:
        comm: The communicator; the call is collective.
        value: The callable, which returns one value for each point or one for all; a callable is
            not called where this rank has no point.
        x: The points, shape (3, n).

    Raises:
        InputError: The callable raises an exception on some rank, or returns no such values; the
            subject is "obstacle".
    """
    values = np.zeros(x.shape[1])
    with together(comm, "obstacle"):
        try:
            found = np.asarray(value(x) if len(values) else 0.0)
            if np.iscomplexobj(found):
                raise TypeError("the values are complex")
            values[:] = np.broadcast_to(found.astype(np.float64), values.shape)
        except Exception as error:
            message = f"the callable returned no values: {type(error).__name__}: {error}"
            raise InputError(message, "obstacle") from error
    return values


def _dirichlet_dofs(space: fem.FunctionSpace, bcs: Sequence[fem.DirichletBC]) -> LocalIndices:
    """The owned dofs that some Dirichlet conditions fix."""
    parts = [dofs[:owned] for dofs, owned in (bc.dof_indices() for bc in bcs)]
    return np.unique(np.concatenate([*parts, np.empty(0, dtype=np.int32)])).astype(np.int32)


def _dirichlet_values(
    space: fem.FunctionSpace, bcs: Sequence[fem.DirichletBC], dofs: LocalIndices
) -> Array:
    """The data of Dirichlet conditions at dofs; the last condition on a dof wins."""
    values = np.zeros(len(dofs))
    if bcs:
        index_map = space.dofmap.index_map
        everywhere = np.zeros(index_map.size_local + index_map.num_ghosts)
        for bc in bcs:
            bc.set(everywhere)
        values[:] = everywhere[dofs]
    return values


def _assembled_matrix(
    form: fem.Form, bcs: Sequence[fem.DirichletBC], fixed: LocalIndices, A: PETSc.Mat | None = None
) -> PETSc.Mat:
    """The matrix of a form; Dirichlet rows get a diagonal of the size of the other rows."""
    if A is None:
        A = fem_petsc.assemble_matrix(form, bcs=list(bcs))
    else:
        A.zeroEntries()
        fem_petsc.assemble_matrix(A, form, bcs=list(bcs))  # type: ignore[misc, arg-type]
    A.assemble()
    if bcs:
        diagonal = A.getDiagonal()
        diagonal.array_w[fixed] = 0.0  # the largest entry and not 1: the unit of the form is free
        diagonal.array_w[fixed] = _size(diagonal)
        A.setDiagonal(diagonal)
        A.assemble()
        diagonal.destroy()
    return A


def _lift(
    b: PETSc.Vec, form: fem.Form, bcs: Sequence[fem.DirichletBC], layout: Layout, A: PETSc.Mat
) -> None:
    """Lift the Dirichlet data in a load vector whose shares of the ranks are not added up yet."""
    if bcs:
        fem_petsc.apply_lifting(b, [form], bcs=[list(bcs)])
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    if bcs:
        fixed, diagonal = layout.fixed_dofs, A.getDiagonal()
        b.array_w[fixed] = diagonal.array_r[fixed] * _dirichlet_values(layout.space, bcs, fixed)
        diagonal.destroy()


def restricted(form: ufl.Form, domain: mesh.Mesh, cells: LocalIndices) -> ufl.Form:
    """Return a form whose integrals over cells are over some of their cells only.

    Args:
        form: A form of integrals over cells and exterior facets.
        domain: The mesh of the form.
        cells: Cells of this rank; ghosts among them are left out.
    """
    owned = cells[cells < domain.topology.index_map(domain.topology.dim).size_local]
    parts: list[tuple[int, LocalIndices]] = []
    integrals = []
    for integral in form.integrals():
        if integral.integral_type() == "cell":
            data, number = integral.subdomain_data(), integral.subdomain_id()
            known = {} if data is None else dict(data)
            here = owned
            if number not in ("everywhere", "otherwise"):
                here = np.intersect1d(owned, known[number]).astype(np.int32)
            parts.append((len(parts), here))
            change = {"subdomain_id": len(parts) - 1, "subdomain_data": parts}
            integral = integral.reconstruct(**change)
        integrals.append(integral)
    return ufl.Form(integrals)


def _size(diagonal: PETSc.Vec) -> float:
    largest = float(diagonal.norm(PETSc.NormType.INFINITY))
    return largest if largest > 0.0 else 1.0


def _compiled(ledger: Ledger, name: str, form: ufl.Form, options: Mapping[str, Any]) -> fem.Form:
    start = time.perf_counter()
    made = compiled.form(form, {"a": "form a", "L": "load"}[name], **options)
    ledger.add("form", name, form, time.perf_counter() - start)
    return made
