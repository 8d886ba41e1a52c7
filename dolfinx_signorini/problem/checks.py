"""Checks of an assembled problem: forms and data without a solution are refused before a solve."""

from collections.abc import Callable, Sequence

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.errors import INDEFINITE, InputError, require
from dolfinx_signorini.base.logs import warn_once
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.base.ranks import anywhere, function_with
from dolfinx_signorini.base.tolerances import FAR, ROUNDING, SOLVED, TINY
from dolfinx_signorini.meshes.elements import (
    control_points,
    is_bernstein,
    values_at_control_points,
)
from dolfinx_signorini.meshes.sided_meshes import box
from dolfinx_signorini.problem.arguments import SCOPE
from dolfinx_signorini.problem.constraint import Obstacle
from dolfinx_signorini.solvers.motions import owned_places
from dolfinx_signorini.solvers.system import Layout, System

HATS = 200  # nodes of the grid of `check_definite`, about
MOST_UNKNOWNS = 20_000  # of a mesh that data are checked on: the first level of a cascade has fewer


def check_finite(space: fem.FunctionSpace, dofs: LocalIndices, values: Array, name: str) -> None:
    """Refuse values at dofs that are not finite; the subject of the InputError is the name."""
    bad = dofs[~np.isfinite(values)]
    message = f"not a finite number at {place(space, bad[0])}" if len(bad) else ""
    require(space.mesh.comm, not message, message, name)


def apart(
    layout: Layout,
    obstacles: Sequence[Array],
    upper_name: Callable[[int], str],
    size: Callable[[], float],
) -> list[Array]:
    """Return obstacles with an upper one nowhere below the lower one; refuse one far below.

    The values at the places of the dofs decide. Values may be out of order by as much as rounding,
    as in `clamped`. In the Bernstein basis coefficients may be out of order where the values are
    not, on cells that are too coarse for the obstacles. Both obstacles are their mean then.

    Args:
        layout: The dofs with an obstacle.
        obstacles: One obstacle at these dofs, or the lower and the upper one; collective.
        upper_name: Returns the name of the upper obstacle at one of these dofs.
        size: Tells about the size of the solution; asked for only where values are out of order.

    Raises:
        InputError: The subject is the name of the upper obstacle.
    """
    if len(obstacles) < 2:
        return list(obstacles)
    comm, (lower, upper) = layout.space.mesh.comm, obstacles
    if not anywhere(comm, lower > upper):
        return list(obstacles)
    tiny = ROUNDING * size()
    dofs = layout.obstacle_dofs
    low, high = (_values_at_nodes(layout.space, dofs, obstacle)[dofs] for obstacle in obstacles)
    refusal: tuple[str, str] | None = None
    for k in np.flatnonzero(low - high > tiny)[:1]:
        where = place(layout.space, layout.obstacle_dofs[k])
        message = f"{high[k]:.6g} lies below the lower obstacle {low[k]:.6g} at {where}"
        refusal = message, upper_name(int(k))
    for found in comm.allgather(refusal):  # on all ranks that of the first one
        if found is not None:
            raise InputError(*found)
    mean = 0.5 * (lower + upper)
    return [np.minimum(lower, mean), np.maximum(upper, mean)]


def _values_at_nodes(space: fem.FunctionSpace, dofs: LocalIndices, coefficients: Array) -> Array:
    """The values at all nodes of a function with some coefficients, whose other ones are 0."""
    return values_at_control_points(space, function_with(space, dofs, coefficients).x.array)


def clamped(
    layout: Layout,
    given: Obstacle,
    dofs: LocalIndices,
    obstacle: Array,
    data: Array,
    size: Callable[[], float],
) -> Array:
    """Return an obstacle, moved to those Dirichlet data that lie beyond; refuse data far beyond.

    Data may lie beyond the obstacle by as much as rounding: 1e-12 of the size of the solution. In
    the Bernstein basis values are compared, for coefficients may lie beyond where the data do not.
    Interpolants of the two may cross between the vertices, which is told and not refused.

    Args:
        layout: The dofs with an obstacle and those with Dirichlet data.
        given: The obstacle, with its sign and its name.
        dofs: The dofs that have the obstacle.
        obstacle: The obstacle at these dofs.
        data: The Dirichlet data at their dofs.
        size: Tells about the size of the solution; asked for only where data lie beyond.

    Raises:
        InputError: The subject is the name of the obstacle.
    """
    space, fixed = layout.space, layout.fixed_dofs
    comm, upper = space.mesh.comm, given.sign < 0.0
    i = np.flatnonzero(np.isin(dofs, fixed))
    j = np.searchsorted(fixed, dofs[i])
    own, known = obstacle[i], data[j]
    moved = obstacle.copy()
    moved[i] = (np.maximum if upper else np.minimum)(own, known)
    everywhere = not is_bernstein(space)
    if not everywhere and anywhere(comm, len(i) > 0):
        own = _values_at_nodes(space, dofs, obstacle)[dofs[i]]
        known = _values_at_nodes(space, fixed, data)[dofs[i]]
    beyond = given.sign * (own - known)
    if not anywhere(comm, beyond > 0.0):
        return moved
    far, beside = beyond > ROUNDING * size(), "below" if upper else "above"
    known_there = everywhere | _at_vertices(space, dofs[i])
    message = ""
    for k in np.flatnonzero(far & known_there)[:1]:
        message = (
            f"{own[k]:.6g} lies {beside} the Dirichlet data {known[k]:.6g} at "
            f"{place(space, fixed[j[k]])}"
        )
    require(comm, not message, message, given.name)
    if anywhere(comm, far):
        warn_once(
            f"{given.name}: its interpolant lies {beside} the Dirichlet data between vertices, "
            "where the solution has the data; dolfinx_signorini.dirichlet takes both at one place"
        )
    return moved


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


def check_range(system: System, diagonal: Array, given: Sequence[Obstacle]) -> None:
    """Refuse an operator, forces or a solution too large or small to have all their digits.

    Args:
        system: The system.
        diagonal: The diagonal of its matrix, the rows of this rank.
        given: The obstacles, with their names.

    Raises:
        InputError: The subject is "form a", "load", the name of an obstacle, or "load and" with
            that name.
    """
    load = np.abs(system.b.array_r).max(initial=0.0)
    sides = system.layout.sides
    names = [next(each.name for each in given if each.sign == sign) for sign in sides]
    with np.errstate(over="ignore", under="ignore"):
        forces = system.contact_diagonal * system.signs * system.obstacle
        forces[np.abs(system.obstacle) == FAR] = 0.0
        heights = forces.reshape(len(sides), -1)
        pushes, fars = heights.max(axis=1, initial=0.0), np.abs(heights).max(axis=1, initial=0.0)
        local = np.array([diagonal.max(initial=0.0), load, *pushes, *fars])
        operator, load, *largest = np.max(system.comm.allgather(local), axis=0)
        pushes, fars = np.split(np.array(largest), 2)
        force = max(load, *pushes)
        size, total = force / operator, fars * system.space.dofmap.index_map.size_global
    pushing = names[int(np.argmax(pushes))]
    for subject, name, value in (
        ("form a", "its largest diagonal entry", operator),
        ("load", "its largest entry", load),
        (pushing, "its force", force),
        (f"load and {pushing}", "the size of the solution", size),
    ):
        if value != 0.0 and not TINY <= value <= 1.0 / TINY:
            raise InputError(
                f"{name}, {value:.3g}, is not between {TINY:.0e} and {1.0 / TINY:.0e}; "
                "choose other units",
                subject,
            )
    for name, far in zip(names, total, strict=True):
        if np.isinf(far):
            message = "too far away for floating-point numbers; 1e300 away is none"
            raise InputError(message, name)


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
    destroy(x, y, product)
    symmetric = defect <= SOLVED * size
    message = f"not symmetric, so that no energy is minimised; {SCOPE}"
    require(comm, symmetric, message, "form a")


def check_definite(A: PETSc.Mat, layout: Layout, diagonal: Array) -> None:
    """Refuse a form that is negative for some combination of the hat functions of a coarse grid.

    A solver notices an indefinite form only where the free dofs have a negative direction, and
    contact may hold just these dofs. The hats of a grid on the box around the domain, P, are
    products of hats in each coordinate, and 0 at Dirichlet dofs. Rounding in a(Pc, Pc) is small
    beside the sum of c_j^2 r_j, where r is P applied to the diagonal of A, because the rows of P
    are convex combinations. Of vectors each component has the hats, turned as the dofs of contact
    nodes are. A form that vanishes on some functions passes.

    Args:
        A: The matrix.
        layout: The dofs; nothing is checked where they are too many.
        diagonal: The diagonal of the matrix, the rows of this rank.

    Raises:
        InputError: The subject is "form a".
    """
    if A.getSize()[0] > MOST_UNKNOWNS:
        return
    hats = _hats(layout)
    P = hats
    if layout.frame is not None:
        turn = layout.frame.matrix()
        P = turn.matMult(hats)
        turn.destroy()
    product = A.ptap(P)
    first, last = product.getOwnershipRange()
    coarse, weights = np.zeros((product.getSize()[0],) * 2), P.createVecRight()
    rows, columns, values = product.getValuesCSR()
    coarse[np.repeat(np.arange(first, last), np.diff(rows)), columns] = values
    vector = A.createVecLeft()
    vector.array_w[:] = diagonal
    hats.multTranspose(vector, weights)
    comm = layout.space.mesh.comm
    scale = np.concatenate(comm.allgather(weights.array_r.copy()))
    destroy(hats, P, product, weights, vector)
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


def _hats(layout: Layout) -> PETSc.Mat:
    """The values at the nodes of the hat functions of a coarse grid, which are 0 at fixed dofs.

    Each component has them.
    """
    comm, dimension, block = layout.space.mesh.comm, layout.space.mesh.geometry.dim, layout.block
    points = owned_places(layout.nodal)[:, :dimension]
    count, (low, high) = len(points), box(comm, points)
    # A smaller grid for few dofs: a fourth of their number is enough.
    few = min(0.25 * layout.nodal.dofmap.index_map.size_global, HATS)
    nodes = max(round(few ** (1.0 / dimension)), 3)
    place = (points - low) / np.where(high > low, high - low, 1.0) * (nodes - 1)
    cell = np.clip(place.astype(np.int32), 0, nodes - 2)
    place -= cell
    columns: LocalIndices = np.zeros((count, 1), dtype=np.int32)
    values: Array = np.ones((count, 1))
    for k in range(dimension):
        shape = count, 2 ** (k + 1)
        columns = (columns[:, :, None] * nodes + cell[:, k, None, None] + [0, 1]).reshape(shape)
        ends = np.stack((1.0 - place[:, k], place[:, k]), axis=1)
        values = (values[:, :, None] * ends[:, None, :]).reshape(shape)
    columns = columns[:, None, :] * block + np.arange(block, dtype=np.int32)[:, None]
    columns = columns.reshape(count * block, columns.shape[2])
    values = np.repeat(values, block, axis=0)
    values[layout.fixed_dofs] = 0.0
    rows = np.arange(count * block + 1, dtype=np.int32) * columns.shape[1]
    return PETSc.Mat().createAIJ(
        ((count * block, None), (None, block * nodes**dimension)),
        csr=(rows, columns.ravel().astype(np.int32), values.ravel()),
        comm=comm,
    )


def check_held(system: System) -> None:
    """Refuse a system without a unique solution where its form vanishes on constants of a body.

    These constants are the only functions on which a form may vanish. Where a form does, the load
    has to press the body against the obstacle. Between two obstacles a load may be balanced, see
    `check_unique`.

    Raises:
        InputError: The subject is "load", or "contact" or "cells" where no dof has an obstacle.
    """
    if not system.singular:
        return
    where_obstacles = "cells" if system.layout.in_domain else "contact facets"
    parts = system.layout.components
    touchable = parts.counts(system.contact_dofs)
    work, loads = parts.sums(system.b.array_r), parts.sums(np.abs(system.b.array_r))
    for k in np.flatnonzero(system.loose.counts):
        where = f" on {parts.names[k]}, where" if parts.count > 1 else ", while"
        if not touchable[k]:
            raise InputError(
                f"empty{where} the form a vanishes on constants: the operator is singular; "
                f"give {where_obstacles}, a Dirichlet condition or a reaction term",
                where_obstacles.split()[0],
            )
        if len(system.layout.sides) > 1:
            continue
        (sign,) = system.layout.sides
        pressing = -sign * work[k]
        if not pressing > ROUNDING * loads[k]:
            unbounded = pressing < -ROUNDING * loads[k]
            wanted = "negative" if sign > 0.0 else "positive"
            raise InputError(
                f"L(1) = {work[k]:.6g} is not {wanted}{where} the form a vanishes on constants: "
                + ("the energy is unbounded" if unbounded else "the solution is not unique")
                + "; the load must press against the obstacle",
                "load",
            )


def check_unique(system: System, x: PETSc.Vec) -> None:
    """Refuse a solution that is one of many: with a load that is balanced, on a body that the form
    does not hold, and with contact on one side or none.

    Contact on both sides leaves no room to move the body.

    Args:
        system: The system; the call is collective.
        x: Its solution.

    Raises:
        InputError: The subject is "load".
    """
    if not system.singular or len(system.layout.sides) < 2:
        return
    parts, touching = system.layout.components, system.touching(x)
    work, loads = parts.sums(system.b.array_r), parts.sums(np.abs(system.b.array_r))
    below, above = (
        parts.counts(system.contact_dofs[touching & (system.signs == sign)])
        for sign in system.layout.sides
    )
    balanced = np.abs(work) <= ROUNDING * loads
    for k in np.flatnonzero(balanced & ((below == 0) | (above == 0)) & (system.loose.counts > 0)):
        where = f" on {parts.names[k]}, where" if parts.count > 1 else ", while"
        raise InputError(
            f"L(1) = 0{where} the form a vanishes on constants, and there is not contact with both "
            "obstacles: the solution is not unique",
            "load",
        )


def place(space: fem.FunctionSpace, dof: int) -> str:
    """Return the coordinates of a dof of a scalar space in words."""
    x = control_points(space)[dof]
    return "(" + ", ".join(f"{c:.6g}" for c in x) + ")"
