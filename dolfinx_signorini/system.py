"""Assembly: forms, contact facets, obstacle and Dirichlet data to a discrete problem in PETSc.

A problem is assembled once, into the matrix A and the load b of

    minimise 1/2 v.A v - b.v  over all v with  v_i >= g_i at the contact dofs,

with Dirichlet data already eliminated (symmetrically: A has only a diagonal there). What the
problem does not mention is neither assembled nor stored; the obstacle is an array over the contact
dofs.
"""

import time
from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc
from ufl.core.expr import Expr

from dolfinx_signorini import checks, compat
from dolfinx_signorini.costs import Cost, Ledger
from dolfinx_signorini.errors import InputError
from dolfinx_signorini.meshes import facet_cells

Indices = npt.NDArray[np.int32]
Array = npt.NDArray[np.float64]
Obstacle: TypeAlias = "float | Expr | fem.Function | Callable[[Array], Array]"


class DiscreteProblem:
    """The assembled problem that every solver of this package works on.

    Args:
        a: Symmetric, positive (semi)definite bilinear UFL form on a scalar Lagrange space.
        L: Linear UFL form.
        contact: Indices of the contact facets, local to the rank, as `dolfinx.mesh` gives them.
        obstacle: The obstacle g: a number, a UFL expression, a function or a callable of the
            coordinates (3, n). It is used at the contact dofs only: for degree 1 the constraint
            then holds on the whole boundary against the interpolant of g; for degree 2 at
            vertices and edge midpoints, and u may fall below g between them.
        bcs: Dirichlet conditions.

    Attributes:
        space: The function space.
        A, b: PETSc matrix and vector, with the Dirichlet data eliminated.
        contact_dofs: The owned dofs on the contact boundary that have no Dirichlet data.
        obstacle: The obstacle at these dofs.
        contact_diagonal: The diagonal of A at these dofs.
        fixed_dofs, fixed_values: The owned dofs with Dirichlet data, and the data.
        singular: Whether the form vanishes on constants, so that only contact holds u.
        seconds: Wall-clock seconds of each phase so far.

    Raises:
        InputError: The load, the obstacle or the Dirichlet data are not finite, the obstacle lies
            above the Dirichlet data, the form is not symmetric or not definite, or the problem
            has no or more than one solution.
    """

    def __init__(
        self,
        a: ufl.Form,
        L: ufl.Form,
        *,
        contact: Indices,
        obstacle: Obstacle = 0.0,
        bcs: Sequence[fem.DirichletBC] = (),
    ):
        start = time.perf_counter()
        self.space = _scalar_space(a)
        if len(L.arguments()) != 1:
            raise InputError(f"load: the form L needs one test function, has {len(L.arguments())}")
        self.a = a
        self.ledger = Ledger()
        self.contact = np.asarray(contact, dtype=np.int32)
        form, load = self._compile("a", a), self._compile("L", L)
        self.fixed_dofs, self.fixed_values = _dirichlet_data(self.space, bcs)
        dofs = _dofs_on_facets(self.space, self.contact)
        values = _values_at(self.space, obstacle, dofs)
        checks.check_bounds(self, dofs, values)
        free = ~np.isin(dofs, self.fixed_dofs)
        self.contact_dofs, self.obstacle = dofs[free], values[free]
        compiled = time.perf_counter()

        self.A = fem_petsc.assemble_matrix(form, bcs=list(bcs))
        self.A.assemble()
        matrix = time.perf_counter()
        self.b = fem_petsc.assemble_vector(load)
        if bcs:
            fem_petsc.apply_lifting(self.b, [form], bcs=[list(bcs)])
        self.b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        if bcs:
            self._fix_rows()
        vector = time.perf_counter()
        try:
            diagonal = checks.check_entries(self)
            self.contact_diagonal = diagonal[self.contact_dofs]
            checks.check_range(self, diagonal)
            checks.check_symmetry(self)
            self.singular = checks.check_definite(self, diagonal)
        except InputError:
            self.destroy()
            raise
        self._note(matrix - compiled, vector - matrix)
        self.seconds = {
            "forms": compiled - start,
            "matrix": matrix - compiled,
            "load": vector - matrix,
            "checks": time.perf_counter() - vector,
        }

    def costs(self) -> list[Cost]:
        """Return what was made for this problem so far; the call is collective."""
        return self.ledger.read(self.comm)

    @property
    def contact_integrals(self) -> Indices:
        """The owned contact facets as a UFL measure takes them."""
        owned = self.space.mesh.topology.index_map(self.space.mesh.topology.dim - 1).size_local
        return facet_cells(self.space.mesh, self.contact[self.contact < owned]).flatten()

    @property
    def comm(self) -> MPI.Comm:
        """The communicator of the mesh."""
        return self.space.mesh.comm

    @property
    def unknowns(self) -> int:
        """The global number of dofs."""
        return int(self.space.dofmap.index_map.size_global)

    def start_values(self) -> PETSc.Vec:
        """Return zero, lifted to the obstacle, with the Dirichlet data."""
        x = self.A.createVecRight()
        x.set(0.0)
        self.project(x)
        return x

    def vector_of(self, u: fem.Function) -> PETSc.Vec:
        """Return the owned values of a function of the space as a new vector."""
        x = self.A.createVecRight()
        x.array_w[:] = u.x.array[: x.getLocalSize()]
        return x

    def project(self, x: PETSc.Vec) -> None:
        """Lift x to the obstacle where it lies below, and set the Dirichlet data."""
        values = x.array_w
        values[self.contact_dofs] = np.maximum(values[self.contact_dofs], self.obstacle)
        values[self.fixed_dofs] = self.fixed_values

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for item in (self.A, self.b):
            item.destroy()

    def _compile(self, name: str, form: ufl.Form) -> fem.Form:
        start = time.perf_counter()
        compiled = fem.form(form)
        self.ledger.add("form", name, form, time.perf_counter() - start)
        return compiled

    def _fix_rows(self) -> None:
        """Give the Dirichlet rows the size of the others, so that the unit of the form is free."""
        diagonal = self.A.getDiagonal()
        diagonal.array_w[self.fixed_dofs] = 0.0
        largest = diagonal.norm(PETSc.NormType.INFINITY)
        size = largest if largest > 0.0 else 1.0
        diagonal.array_w[self.fixed_dofs] = size
        self.A.setDiagonal(diagonal)
        self.A.assemble()
        diagonal.destroy()
        self.b.array_w[self.fixed_dofs] = size * self.fixed_values

    def _note(self, matrix: float, vector: float) -> None:
        """Enter what was made into the ledger, with the seconds of matrix and load."""
        self.ledger.add("matrix", "A", self.A, matrix)
        self.ledger.add("vector", "load b", self.b, vector)
        bounds = self.contact_dofs.nbytes + self.obstacle.nbytes + self.contact_diagonal.nbytes
        self.ledger.add("array", "contact dofs, their obstacle and diagonal", bounds)
        if self.comm.allreduce(len(self.fixed_dofs)):
            fixed = self.fixed_dofs.nbytes + self.fixed_values.nbytes
            self.ledger.add("array", "Dirichlet dofs and data", fixed)


def _scalar_space(a: ufl.Form) -> fem.FunctionSpace:
    arguments = a.arguments()
    if len(arguments) != 2:
        raise InputError(f"form a: needs a trial and a test function, has {len(arguments)}")
    space = arguments[0].ufl_function_space()
    element = space.ufl_element()
    if space.dofmap.bs != 1 or element.family_name != "P" or element.discontinuous:
        raise InputError("form a: the space must be a scalar, continuous Lagrange space")
    return space


def _dofs_on_facets(space: fem.FunctionSpace, facets: Indices) -> Indices:
    """Return the owned dofs on facets, also on those that only another rank knows as its own."""
    tdim = space.mesh.topology.dim
    space.mesh.topology.create_connectivity(tdim - 1, tdim)
    dofs = fem.locate_dofs_topological(space, tdim - 1, facets)
    return dofs[dofs < space.dofmap.index_map.size_local]


def _dirichlet_data(
    space: fem.FunctionSpace, bcs: Sequence[fem.DirichletBC]
) -> tuple[Indices, Array]:
    if not bcs:
        return np.empty(0, dtype=np.int32), np.empty(0)
    marker, values = fem.Function(space), fem.Function(space)
    for bc in bcs:
        dofs, _ = bc.dof_indices()
        marker.x.array[dofs] = 1.0
        bc.set(values.x.array)
    owned = space.dofmap.index_map.size_local
    dofs = np.flatnonzero(marker.x.array[:owned]).astype(np.int32)
    return dofs, values.x.array[dofs]


def _values_at(space: fem.FunctionSpace, value: Obstacle, dofs: Indices) -> Array:
    """Evaluate the obstacle at dofs; an expression only on the cells that have one of them."""
    if isinstance(value, int | float | np.number):
        return np.full(len(dofs), float(value))
    if isinstance(value, fem.Function) and value.function_space == space:
        return value.x.array[dofs].copy()
    if callable(value) and not isinstance(value, Expr):
        x = space.tabulate_dof_coordinates()[dofs]
        return np.broadcast_to(np.asarray(value(x.T), dtype=np.float64), (len(dofs),)).copy()
    cells = np.flatnonzero(np.isin(space.dofmap.list, dofs).any(axis=1)).astype(np.int32)
    points = compat.interpolation_points(space.element)
    g = fem.Function(space)
    g.interpolate(fem.Expression(value, points, comm=space.mesh.comm), cells0=cells)
    return g.x.array[dofs].copy()
