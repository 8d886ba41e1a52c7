"""Checks of an assembled problem: forms and data without a solution are refused before a solve."""

from collections.abc import Callable

import numpy as np
import ufl
from dolfinx import default_scalar_type, fem, la
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc
from ufl.algorithms.apply_derivatives import apply_derivatives

from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.errors import INDEFINITE, InputError, require
from dolfinx_signorini.base.tolerances import ROUNDING, SOLVED
from dolfinx_signorini.meshes.elements import control_points, is_bernstein
from dolfinx_signorini.meshes.sided_meshes import box
from dolfinx_signorini.solvers.system import Layout, System

HATS = {
    1: 200,
    2: 13,
    3: 6,
}  # for each dimension: nodes along each side of the grid of `check_definite`
MOST_UNKNOWNS = 20_000  # of a mesh that data are checked on: the first level of a cascade has fewer
SMALLEST, LARGEST = 1e-290, 1e290  # beyond, products of entries lose digits or overflow


def check_bounds(
    layout: Layout, obstacle: Array, data: Array, upper: bool, reach: Callable[[], float]
) -> Array:
    """Refuse an obstacle or Dirichlet data that are not finite, or data beyond the obstacle.

    Data may lie beyond the obstacle by as much as rounding: 1e-12 of the largest datum, or of the
    size of the solution. In the Bernstein basis they are compared at vertices: the coefficients of
    other dofs are no values, and may lie beyond where the data do not.

    Args:
        layout: The dofs on the contact boundary and those with Dirichlet data.
        obstacle: The obstacle at the dofs on the contact boundary.
        data: The Dirichlet data at their dofs.
        upper: Whether the obstacle is an upper one.
        reach: Tells about the size of the solution; asked for only where data lie beyond.

    Returns:
        The obstacle, moved to those data that lie beyond.

    Raises:
        InputError: The subject is "obstacle" or "Dirichlet data".
    """
    space, dofs, fixed = layout.space, layout.boundary_dofs, layout.fixed_dofs
    comm = space.mesh.comm
    for subject, places, values in (("obstacle", dofs, obstacle), ("Dirichlet data", fixed, data)):
        bad = places[~np.isfinite(values)]
        message = f"not a finite number at {_place(space, bad[0])}" if len(bad) else ""
        require(comm, not message, message, subject)
    i = np.flatnonzero(~layout.free)
    j = np.searchsorted(fixed, dofs[i])
    beyond = (data[j] - obstacle[i]) if upper else (obstacle[i] - data[j])
    clamped = obstacle.copy()
    clamped[i] = (np.maximum if upper else np.minimum)(obstacle[i], data[j])
    if is_bernstein(space):
        beyond[~_at_vertices(space, dofs[i])] = 0.0
    if not comm.allreduce(bool((beyond > 0.0).any()), op=MPI.LOR):
        return clamped
    sizes = np.abs(obstacle).max(initial=0.0), np.abs(data).max(initial=0.0)
    size = max(comm.allreduce(float(max(sizes)), op=MPI.MAX), reach())
    message = ""
    for k in np.flatnonzero(beyond > ROUNDING * size)[:1]:
        message = (
            f"{obstacle[i[k]]:.6g} lies {'below' if upper else 'above'} the Dirichlet data "
            f"{data[j[k]]:.6g} at {_place(space, fixed[j[k]])}"
        )
    require(comm, not message, message, "obstacle")
    return clamped


def _at_vertices(space: fem.FunctionSpace, dofs: LocalIndices) -> Mask:
    """Tell which dofs belong to vertices."""
    places = np.concatenate(space.element.basix_element.entity_dofs[0])
    return np.isin(dofs, space.dofmap.list[:, places])


def check_entries(comm: MPI.Comm, diagonal: Array, load: Array) -> None:
    """Refuse entries that are not finite, or a diagonal that is not positive.

    Args:
        comm: The communicator of the mesh.
        diagonal: The diagonal of the matrix, the rows of this rank.
        load: The load vector, the rows of this rank.

    Raises:
        InputError: The subject is "load" or "form a".
    """
    finite = bool(np.isfinite(load).all())
    require(comm, finite, "the form L, of load and fluxes, has an entry that is not finite", "load")
    finite = bool(np.isfinite(diagonal).all())
    require(comm, finite, "the assembled matrix has an entry that is not finite", "form a")
    positive = bool((diagonal > 0.0).all())
    require(comm, positive, f"{INDEFINITE}, a diagonal entry is not positive", "form a")


def check_range(system: System, diagonal: Array) -> None:
    """Refuse an operator, forces or a solution too large or small to have all their digits.

    Args:
        system: The system.
        diagonal: The diagonal of its matrix, the rows of this rank.

    Raises:
        InputError: The subject is "form a", "load", "obstacle" or "load and obstacle".
    """
    load = np.abs(system.b.array_r).max(initial=0.0)
    with np.errstate(over="ignore", under="ignore"):
        push = (system.contact_diagonal * np.maximum(system.obstacle, 0.0)).max(initial=0.0)
        far = np.abs(system.contact_diagonal * system.obstacle).max(initial=0.0)
        local = np.array([diagonal.max(initial=0.0), load, max(load, push), far])
        operator, load, force, far = np.max(system.comm.allgather(local), axis=0)
        height, total = force / operator, far * system.space.dofmap.index_map.size_global
    for subject, name, size in (
        ("form a", "its largest diagonal entry", operator),
        ("load", "its largest entry", load),
        ("obstacle", "its force", force),
        ("load and obstacle", "the size of the solution", height),
    ):
        if size != 0.0 and not SMALLEST <= size <= LARGEST:
            raise InputError(
                f"{name}, {size:.3g}, is not between {SMALLEST:g} and {LARGEST:g}; "
                "choose other units",
                subject,
            )
    if np.isinf(total):
        raise InputError("too far away for floating-point numbers; 1e300 away is none", "obstacle")


def check_symmetry(A: PETSc.Mat) -> None:
    """Refuse a matrix that is not symmetric: compare x.(A y) with y.(A x) for two vectors.

    Raises:
        InputError: The subject is "form a".
    """
    x, y, product = (A.createVecRight() for _ in range(3))
    index = np.arange(*A.getOwnershipRange(), dtype=np.float64)
    x.array_w[:] = np.cos(1.7 * index**2)
    y.array_w[:] = np.sin(2.3 * index**2 + 1.0)
    A.mult(y, product)
    largest = product.norm(PETSc.NormType.INFINITY)
    x.scale(1.0 / largest)  # no product overflows
    forward = x.dot(product)
    size = largest * x.norm(PETSc.NormType.NORM_1)
    A.mult(x, product)
    defect = abs(forward - y.dot(product))
    comm = A.comm.tompi4py()
    for vec in (x, y, product):
        vec.destroy()
    symmetric = defect <= SOLVED * size
    require(comm, symmetric, "not symmetric, so that no energy is minimised", "form a")


def vanishes_on_constants(a: ufl.Form, A: PETSc.Mat, layout: Layout, diagonal: Array) -> Mask:
    """Return on the constants of which bodies a form vanishes; refuse one with a(1, 1) < 0.

    Row sums of the matrix tell only to rounding, which a fine mesh makes larger than a small
    reaction. Where row sums leave a doubt, the form itself is asked: a(1, v) is assembled without
    the terms that have a gradient of the constant, and a(1, 1) is compared with the energy of the
    coordinates in units of the domain's size, which does not depend on the mesh.

    Args:
        a: The form.
        A: The matrix of the form.
        layout: The dofs with Dirichlet data.
        diagonal: The diagonal of the matrix, the rows of this rank.

    Returns:
        One entry per body; none where each cell has a row sum beyond doubt or Dirichlet data.

    Raises:
        InputError: The subject is "form a".
    """
    comm = A.comm.tompi4py()
    x, product = A.createVecRight(), A.createVecLeft()
    x.set(1.0)
    x.array_w[layout.fixed_dofs] = 0.0
    A.mult(x, product)
    energy, bound = x.dot(product), comm.allreduce(float(diagonal.sum()))
    sums = np.abs(product.array_r)
    x.destroy()
    product.destroy()
    definite = energy >= -ROUNDING * bound
    require(comm, definite, f"{INDEFINITE}, a(1, 1) is negative", "form a")
    if _held_in_all_cells(layout, sums > SOLVED * np.abs(diagonal)):
        return np.empty(0, dtype=bool)
    parts = layout.bodies
    loose = (parts.sums(sums) <= SOLVED * bound) & (parts.counts(layout.fixed_dofs) == 0)
    if not loose.any():
        return loose
    space = a.arguments()[0].ufl_function_space()
    one = fem.Constant(space.mesh, default_scalar_type(1.0))
    reaction = apply_derivatives(ufl.replace(a, {a.arguments()[1]: one}))
    if reaction.empty():
        return loose
    vector = fem_petsc.assemble_vector(compiled.form(reaction))
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    energies = parts.sums(vector.array_r)
    vector.destroy()
    return loose & (energies <= ROUNDING * _energy_of_coordinates(A, space))


def _held_in_all_cells(layout: Layout, beyond_doubt: Mask) -> bool:
    """Whether each cell of each rank has Dirichlet data or a row sum that is beyond doubt."""
    held = la.vector(layout.space.dofmap.index_map, dtype=np.int8)
    held.array[: len(beyond_doubt)] = beyond_doubt
    held.array[layout.fixed_dofs] = 1
    held.scatter_forward()
    everywhere = bool(held.array[layout.space.dofmap.list].any(axis=1).all())
    return bool(layout.space.mesh.comm.allreduce(everywhere, op=MPI.LAND))


def _energy_of_coordinates(A: PETSc.Mat, space: fem.FunctionSpace) -> float:
    """The sum of a(x, x) over the coordinates x, in units of the size of the domain."""
    points, lowest, sizes = _in_box(space)
    x, product = A.createVecRight(), A.createVecLeft()
    total = 0.0
    for k in range(points.shape[1]):
        x.array_w[:] = (points[:, k] - lowest[k]) / sizes.max()
        A.mult(x, product)
        total += float(x.dot(product))
    x.destroy()
    product.destroy()
    return total


def _in_box(space: fem.FunctionSpace) -> tuple[Array, Array, Array]:
    """The owned nodes, shape (n, dimension), the lowest corner of their box, and its sizes."""
    count, dimension = space.dofmap.index_map.size_local, space.mesh.geometry.dim
    points = control_points(space)[:count, :dimension]
    lowest, highest = box(space.mesh.comm, points)
    return points, lowest, highest - lowest


def check_definite(
    A: PETSc.Mat, space: fem.FunctionSpace, fixed: LocalIndices, diagonal: Array
) -> None:
    """Refuse a form that is negative for some combination of the hat functions of a coarse grid.

    A solver notices an indefinite form only where the free dofs have a negative direction, and
    contact may hold just these dofs. The hats of a grid on the box around the domain, P, are
    products of hats in each coordinate, and 0 at Dirichlet dofs. Rounding in a(Pc, Pc) is small
    beside the sum of c_j^2 r_j, where r is P applied to the diagonal of A, because the rows of P
    are convex combinations. A form that vanishes on some functions passes.

    Args:
        A: The matrix.
        space: The function space; nothing is checked where its dofs are too many.
        fixed: The owned dofs with Dirichlet data.
        diagonal: The diagonal of the matrix, the rows of this rank.

    Raises:
        InputError: The subject is "form a".
    """
    if A.getSize()[0] > MOST_UNKNOWNS:
        return
    P = _hats(space, fixed)
    product = A.ptap(P)
    first, last = product.getOwnershipRange()
    coarse, weights = np.zeros((product.getSize()[0],) * 2), P.createVecRight()
    rows, columns, values = product.getValuesCSR()
    coarse[np.repeat(np.arange(first, last), np.diff(rows)), columns] = values
    vector = A.createVecLeft()
    vector.array_w[:] = diagonal
    P.multTranspose(vector, weights)
    comm = space.mesh.comm
    scale = np.concatenate(comm.allgather(weights.array_r.copy()))
    for item in (P, product, weights, vector):
        item.destroy()
    coarse = comm.allreduce(coarse)
    used = scale > 0.0
    scale = np.sqrt(scale[used])
    coarse = coarse[np.ix_(used, used)] / scale[:, None] / scale
    message = f"{INDEFINITE}, a(v, v) is negative for some v that is linear on a coarse grid"
    require(comm, _nearly_definite(coarse), message, "form a")


def _nearly_definite(matrix: Array) -> bool:
    """Whether all eigenvalues of a symmetric matrix with a diagonal of 0 to 1 exceed -ROUNDING.

    A Cholesky factorization tells for a tenth of the price of the eigenvalues.
    """
    try:
        np.linalg.cholesky(matrix + ROUNDING * np.eye(len(matrix)))
    except np.linalg.LinAlgError:
        return False
    return True


def _hats(space: fem.FunctionSpace, fixed: LocalIndices) -> PETSc.Mat:
    """The values at the nodes of the hat functions of a coarse grid, which are 0 at fixed dofs."""
    points, lowest, sizes = _in_box(space)
    count, dimension = points.shape
    # A smaller grid for few dofs: a fourth of their number is enough.
    few = round((0.25 * space.dofmap.index_map.size_global) ** (1.0 / dimension))
    nodes = min(max(few, 3), HATS[dimension])
    place = (points - lowest) / np.where(sizes > 0.0, sizes, 1.0) * (nodes - 1)
    cell = np.clip(place.astype(np.int32), 0, nodes - 2)
    place -= cell
    columns, values = np.zeros((count, 1), dtype=np.int32), np.ones((count, 1))
    for k in range(dimension):
        shape = count, 2 ** (k + 1)
        columns = (columns[:, :, None] * nodes + cell[:, k, None, None] + [0, 1]).reshape(shape)
        ends = np.stack((1.0 - place[:, k], place[:, k]), axis=1)
        values = (values[:, :, None] * ends[:, None, :]).reshape(shape)
    values[fixed] = 0.0
    rows = np.arange(count + 1, dtype=np.int32) * columns.shape[1]
    P = PETSc.Mat().createAIJ(
        ((count, None), (None, nodes**dimension)),
        csr=(rows, columns.ravel().astype(np.int32), values.ravel()),
        comm=space.mesh.comm,
    )
    return P


def check_held(system: System) -> None:
    """Refuse a system without a unique solution where its form vanishes on constants of a body.

    These constants are the only functions on which a form may vanish. Where a form does, the load
    has to press the body against the obstacle.

    Raises:
        InputError: The subject is "contact" or "load".
    """
    if not system.singular:
        return
    parts = system.layout.bodies
    touchable = parts.counts(system.contact_dofs)
    work, loads = parts.sums(system.b.array_r), parts.sums(np.abs(system.b.array_r))
    for k in np.flatnonzero(system.loose):
        where = f" on {parts.names[k]}, where" if parts.count > 1 else ", while"
        if not touchable[k]:
            raise InputError(
                f"empty{where} the form a vanishes on constants: the operator is singular; "
                "give contact facets, a Dirichlet condition or a reaction term",
                "contact",
            )
        if not work[k] < -ROUNDING * loads[k]:
            unbounded = work[k] > ROUNDING * loads[k]
            raise InputError(
                f"L(1) = {work[k]:.6g} is not negative{where} the form a vanishes on constants: "
                + ("the energy is unbounded" if unbounded else "the solution is not unique")
                + "; the load must press against the obstacle",
                "load",
            )


def _place(space: fem.FunctionSpace, dof: int) -> str:
    x = control_points(space)[dof]
    return "(" + ", ".join(f"{c:.6g}" for c in x) + ")"
