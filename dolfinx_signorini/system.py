"""The discrete problem: forms, contact facets, obstacle and Dirichlet data become arrays in PETSc.

The solvers of this package see one system,

    minimise 1/2 v.A v - b.v  over all v with  v_i >= g_i at the contact dofs,

with the Dirichlet data eliminated symmetrically: a Dirichlet row of A has only its diagonal entry.
An upper obstacle, u <= g, is the system for -u, with -b and -g. What the problem does not mention
is neither assembled nor stored; the obstacle is an array over the contact dofs.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc
from ufl.core.expr import Expr

from dolfinx_signorini import compat
from dolfinx_signorini.costs import Ledger
from dolfinx_signorini.meshes import cells_with_dofs, facet_cells

Indices = npt.NDArray[np.int32]
Array = npt.NDArray[np.float64]
Data: TypeAlias = "float | Expr | fem.Function | Callable[[Array], Array]"


@dataclass(frozen=True)
class Layout:
    """The dofs of a problem that have a constraint or Dirichlet data; they never change.

    Attributes:
        space: The function space.
        facets: The contact facets that this rank knows.
        boundary_dofs: The owned dofs on the contact boundary, those with Dirichlet data included.
        fixed_dofs: The owned dofs with Dirichlet data.
        ledger: Where the costs of the problem are noted.
    """

    space: fem.FunctionSpace
    facets: Indices
    boundary_dofs: Indices
    fixed_dofs: Indices
    ledger: Ledger = field(repr=False)

    @functools.cached_property
    def free(self) -> npt.NDArray[np.bool_]:
        """Whether a dof on the contact boundary has no Dirichlet data."""
        return ~np.isin(self.boundary_dofs, self.fixed_dofs)

    @functools.cached_property
    def contact_dofs(self) -> Indices:
        """The owned dofs on the contact boundary without Dirichlet data."""
        return self.boundary_dofs[self.free]

    @property
    def owned_facets(self) -> Indices:
        """The contact facets that this rank owns."""
        dimension = self.space.mesh.topology.dim - 1
        return self.facets[self.facets < self.space.mesh.topology.index_map(dimension).size_local]

    @property
    def measure(self) -> ufl.Measure:
        """The UFL measure of the contact boundary."""
        pairs = facet_cells(self.space.mesh, self.owned_facets).flatten()
        return ufl.Measure("ds", self.space.mesh, subdomain_data=[(1, pairs)])(1)

    @functools.cached_property
    def weights(self) -> Array:
        """The share of the contact boundary that belongs to each contact dof of this rank.

        The shares are the diagonal of the boundary mass matrix, scaled so that they add up to the
        size of the boundary. Unlike the integrals of the basis functions they are positive for
        every degree and dimension. The first call is collective.

        Source: Hinton, Rock and Zienkiewicz, Earthq. Eng. Struct. Dyn. 4 (1976) 245-249.
        """
        u, v = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        matrix = fem_petsc.assemble_matrix(fem.form(u * v * self.measure))
        matrix.assemble()
        self.ledger.add("matrix", "boundary mass matrix", matrix)
        diagonal = matrix.getDiagonal()
        ones, rows = diagonal.duplicate(), diagonal.duplicate()
        ones.set(1.0)
        matrix.mult(ones, rows)
        total, trace = rows.sum(), diagonal.sum()
        weights = diagonal.array_r[self.contact_dofs] * (total / trace if trace > 0.0 else 1.0)
        for item in (matrix, diagonal, ones, rows):
            item.destroy()
        return np.asarray(weights)


@dataclass(frozen=True)
class System:
    """A discrete problem with a lower obstacle, as every solver of this package takes it.

    A system belongs to a problem, which makes it and frees its PETSc objects:

        system = SignoriniProblem(a, L, contact=facets).system
        gap = x.array_r[system.contact_dofs] - system.obstacle

    Attributes:
        layout: The dofs with a constraint or Dirichlet data.
        A, b: PETSc matrix and vector, with the Dirichlet data eliminated.
        obstacle: The obstacle at the contact dofs.
        contact_diagonal: The diagonal entries of A at the contact dofs.
        fixed_values: The Dirichlet data at the fixed dofs.
        singular: Whether the form vanishes on constants, so that only contact holds the solution.
    """

    layout: Layout
    A: PETSc.Mat
    b: PETSc.Vec
    obstacle: Array
    contact_diagonal: Array
    fixed_values: Array
    singular: bool

    @property
    def space(self) -> fem.FunctionSpace:
        """The function space."""
        return self.layout.space

    @property
    def contact_dofs(self) -> Indices:
        """The owned dofs on the contact boundary that have no Dirichlet data."""
        return self.layout.contact_dofs

    @property
    def fixed_dofs(self) -> Indices:
        """The owned dofs with Dirichlet data."""
        return self.layout.fixed_dofs

    @property
    def ledger(self) -> Ledger:
        """Where the costs of the problem are noted."""
        return self.layout.ledger

    @property
    def comm(self) -> MPI.Comm:
        """The communicator of the mesh."""
        return self.space.mesh.comm

    @property
    def unknowns(self) -> int:
        """The global number of dofs."""
        return int(self.space.dofmap.index_map.size_global)

    def start(self, values: Array | None = None) -> PETSc.Vec:
        """Return a feasible new vector: values of the owned dofs, or zero, projected."""
        x = self.A.createVecRight()
        x.array_w[:] = 0.0 if values is None else values[: x.getLocalSize()]
        self.project(x)
        return x

    def vector_of(self, u: fem.Function) -> PETSc.Vec:
        """Return the owned values of a function of the space as a new vector."""
        x = self.A.createVecRight()
        x.array_w[:] = u.x.array[: x.getLocalSize()]
        return x

    def project(self, x: PETSc.Vec) -> None:
        """Lift x to the obstacle where x lies below, and set the Dirichlet data."""
        values = x.array_w
        values[self.contact_dofs] = np.maximum(values[self.contact_dofs], self.obstacle)
        values[self.fixed_dofs] = self.fixed_values

    def multiplier(self, x: PETSc.Vec) -> Array:
        """Return A x - b at the contact dofs of this rank: the force on each of them."""
        force = x.duplicate()
        self.A.mult(x, force)
        force.axpy(-1.0, self.b)
        values = force.array_r[self.contact_dofs].copy()
        force.destroy()
        return values


def dofs_on_facets(space: fem.FunctionSpace, facets: Indices) -> Indices:
    """Return the owned dofs on facets, also on facets that only another rank owns.

    Args:
        space: The function space.
        facets: Facets that this rank knows; the call is collective.
    """
    tdim = space.mesh.topology.dim
    space.mesh.topology.create_connectivity(tdim - 1, tdim)
    dofs = fem.locate_dofs_topological(space, tdim - 1, facets)
    return dofs[dofs < space.dofmap.index_map.size_local]


def evaluator(space: fem.FunctionSpace, value: Data, dofs: Indices) -> Callable[[], Array]:
    """Return a function that evaluates data at dofs, each time with the present values.

    A UFL expression is compiled once, and evaluated on the cells that have one of the dofs.

    Args:
        space: A scalar Lagrange space.
        value: A number, a UFL expression, a function of the space or of another one on its mesh,
            or a callable of the coordinates, shape (3, n), which returns shape (n,).
        dofs: Dofs of this rank.
    """
    if isinstance(value, int | float | np.number):
        return lambda: np.full(len(dofs), float(value))
    if isinstance(value, fem.Function) and value.function_space == space:
        return lambda: value.x.array[dofs].copy()
    if callable(value) and not isinstance(value, Expr):
        x = space.tabulate_dof_coordinates()[dofs].T
        return lambda: np.broadcast_to(np.asarray(value(x), dtype=np.float64), (len(dofs),)).copy()
    marked = np.zeros(len(space.tabulate_dof_coordinates()), dtype=bool)
    marked[dofs] = True
    cells = cells_with_dofs(space, marked)
    points = compat.interpolation_points(space.element)
    expression = fem.Expression(value, points, comm=space.mesh.comm)
    g = fem.Function(space)

    def evaluate() -> Array:
        g.interpolate(expression, cells0=cells)
        return g.x.array[dofs].copy()

    return evaluate


def dirichlet_dofs(space: fem.FunctionSpace, bcs: Sequence[fem.DirichletBC]) -> Indices:
    """Return the owned dofs that some Dirichlet conditions fix."""
    marked = np.zeros(space.dofmap.index_map.size_local, dtype=bool)
    for bc in bcs:
        dofs, owned = bc.dof_indices()
        marked[dofs[:owned]] = True
    return np.flatnonzero(marked).astype(np.int32)


def dirichlet_values(
    space: fem.FunctionSpace, bcs: Sequence[fem.DirichletBC], dofs: Indices
) -> Array:
    """Return the data of Dirichlet conditions at dofs that they fix; the last condition wins."""
    values = np.zeros(len(dofs))
    if bcs:
        index_map = space.dofmap.index_map
        everywhere = np.zeros(index_map.size_local + index_map.num_ghosts)
        for bc in bcs:
            bc.set(everywhere)
        values[:] = everywhere[dofs]
    return values


def assembled_matrix(
    form: fem.Form, bcs: Sequence[fem.DirichletBC], fixed: Indices, A: PETSc.Mat | None = None
) -> PETSc.Mat:
    """Return the matrix of a form; Dirichlet rows get a diagonal of the size of the other rows.

    With the largest diagonal entry in place of 1 the unit in which the form is written is free.

    Args:
        form: The bilinear form, compiled.
        bcs: The Dirichlet conditions.
        fixed: The owned dofs with Dirichlet data.
        A: A matrix of the same form, to be assembled again; a new one by default.
    """
    if A is None:
        A = fem_petsc.assemble_matrix(form, bcs=list(bcs))
    else:
        A.zeroEntries()
        fem_petsc.assemble_matrix(A, form, bcs=list(bcs))
    A.assemble()
    if bcs:
        diagonal = A.getDiagonal()
        diagonal.array_w[fixed] = 0.0
        diagonal.array_w[fixed] = _size(diagonal)
        A.setDiagonal(diagonal)
        A.assemble()
        diagonal.destroy()
    return A


def assembled_load(
    load: fem.Form,
    form: fem.Form,
    bcs: Sequence[fem.DirichletBC],
    fixed: Indices,
    A: PETSc.Mat,
) -> PETSc.Vec:
    """Return the load vector with the Dirichlet data lifted.

    Args:
        load: The linear form, compiled.
        form: The bilinear form, compiled.
        bcs: The Dirichlet conditions.
        fixed: The owned dofs with Dirichlet data.
        A: The matrix, whose Dirichlet rows have their diagonal.
    """
    b = fem_petsc.assemble_vector(load)
    if bcs:
        fem_petsc.apply_lifting(b, [form], bcs=[list(bcs)])
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    if bcs:
        diagonal = A.getDiagonal()
        values = dirichlet_values(load.function_spaces[0], bcs, fixed)
        b.array_w[fixed] = diagonal.array_r[fixed] * values
        diagonal.destroy()
    return b


def _size(diagonal: PETSc.Vec) -> float:
    largest = float(diagonal.norm(PETSc.NormType.INFINITY))
    return largest if largest > 0.0 else 1.0
