"""Assembly: forms, contact facets, obstacle and Dirichlet data to a discrete problem in PETSc.

A problem is assembled once, into the matrix A and the load b of

    minimise 1/2 v.A v - b.v  over all v with  v_i >= g_i at the contact dofs,

with Dirichlet data already eliminated (symmetrically: A has unit rows there). What the problem
does not mention is neither assembled nor stored; the obstacle is an array over the contact dofs.
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

from dolfinx_signorini.errors import InputError, require
from dolfinx_signorini.meshes import facet_cells

Indices = npt.NDArray[np.int32]
Array = npt.NDArray[np.float64]
Obstacle: TypeAlias = "float | Expr | fem.Function | Callable[[Array], Array]"

SYMMETRY_TOLERANCE = 1e-10  # relative; assembly rounds at 1e-15


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
        self.a = a
        self.contact = np.asarray(contact, dtype=np.int32)
        form, load = fem.form(a), fem.form(L)
        self.fixed_dofs, self.fixed_values = _dirichlet_data(self.space, bcs)
        dofs = _dofs_on_facets(self.space, self.contact)
        values = _values_at(self.space, obstacle, dofs)
        self._check_obstacle(dofs, values)
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
        fem_petsc.set_bc(self.b, list(bcs))
        vector = time.perf_counter()
        try:
            self._check_operator()
        except InputError:
            self.destroy()
            raise
        self.seconds = {
            "forms": compiled - start,
            "matrix": matrix - compiled,
            "load": vector - matrix,
            "checks": time.perf_counter() - vector,
        }

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

    def _check_obstacle(self, dofs: Indices, values: Array) -> None:
        comm = self.comm
        bad = ~np.isfinite(values)
        x = self.space.tabulate_dof_coordinates()
        where = x[dofs[bad][0]] if bad.any() else None
        require(comm, not bad.any(), f"obstacle: it is not a finite number at {_point(where)}")
        bad = ~np.isfinite(self.fixed_values)
        where = x[self.fixed_dofs[bad][0]] if bad.any() else None
        require(comm, not bad.any(), f"Dirichlet data: not a finite number at {_point(where)}")
        common, i, j = np.intersect1d(dofs, self.fixed_dofs, return_indices=True)
        above = np.flatnonzero(values[i] > self.fixed_values[j])
        message = ""
        if len(above):
            k = above[0]
            message = (
                f"obstacle: {values[i[k]]:.6g} lies above the Dirichlet data "
                f"{self.fixed_values[j[k]]:.6g} at {_point(x[common[k]])}"
            )
        require(comm, not message, message)

    def _check_operator(self) -> None:
        comm, owned = self.comm, self.A.getOwnershipRange()
        finite = bool(np.isfinite(self.b.array_r).all())
        require(comm, finite, "load: the assembled form L has an entry that is not finite")
        diagonal = self.A.getDiagonal()
        entries = diagonal.array_r.copy()
        diagonal.destroy()
        self.contact_diagonal = entries[self.contact_dofs]
        finite = bool(np.isfinite(entries).all())
        require(comm, finite, "form a: the assembled matrix has an entry that is not finite")
        positive = bool((entries > 0.0).all())
        require(comm, positive, "form a: not positive definite, a diagonal entry is not positive")

        # x.(A y) against y.(A x) for two vectors without structure.
        x, y, product = (self.A.createVecRight() for _ in range(3))
        index = np.arange(*owned, dtype=np.float64)
        x.array_w[:] = np.cos(1.7 * index**2)
        y.array_w[:] = np.sin(2.3 * index**2 + 1.0)
        self.A.mult(y, product)
        forward, size = x.dot(product), product.norm() * x.norm()
        self.A.mult(x, product)
        defect = abs(forward - y.dot(product))
        symmetric = defect <= SYMMETRY_TOLERANCE * size
        # One without Dirichlet data: constants are the only functions a form may leave out.
        x.set(1.0)
        x.array_w[self.fixed_dofs] = 0.0
        self.A.mult(x, product)
        energy, bound = x.dot(product), comm.allreduce(float(entries.sum()))
        work = self.b.dot(x)
        singular = comm.allreduce(len(self.fixed_dofs)) == 0 and product.norm() <= 1e-12 * bound
        loads = comm.allreduce(float(np.abs(self.b.array_r).sum()))
        for vec in (x, y, product):
            vec.destroy()
        require(comm, symmetric, "form a: not symmetric, so that no energy is minimised")
        definite = energy >= -1e-12 * bound
        require(comm, definite, "form a: not positive definite, a(1, 1) is negative")
        if singular:
            self._check_singular(work, loads)

    def _check_singular(self, work: float, loads: float) -> None:
        """A form that vanishes on constants needs a load that presses against the obstacle."""
        contact = self.comm.allreduce(len(self.contact_dofs))
        require(
            self.comm,
            contact > 0,
            "contact: empty, while the form a vanishes on constants: the operator is singular; "
            "give contact facets, a Dirichlet condition or a reaction term",
        )
        require(
            self.comm,
            work < -1e-12 * loads,
            f"load: L(1) = {work:.6g} is not negative, while the form a vanishes on constants: "
            + ("the energy is unbounded" if work > 1e-12 * loads else "the solution is not unique")
            + "; the load must press against the obstacle",
        )


def _scalar_space(a: ufl.Form) -> fem.FunctionSpace:
    arguments = a.arguments()
    if len(arguments) != 2:
        raise InputError(f"form a: needs a trial and a test function, has {len(arguments)}")
    space = arguments[0].ufl_function_space()
    if space.dofmap.bs != 1 or space.element.basix_element.family.name != "P":
        raise InputError("form a: the space must be a scalar Lagrange space")
    return space


def _point(x: Array | None) -> str:
    return "" if x is None else "(" + ", ".join(f"{c:.6g}" for c in x) + ")"


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
    points = space.element.interpolation_points()
    g = fem.Function(space)
    g.interpolate(fem.Expression(value, points, comm=space.mesh.comm), cells0=cells)
    return g.x.array[dofs].copy()
