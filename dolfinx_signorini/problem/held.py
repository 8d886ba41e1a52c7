"""Bodies that contact holds: which rigid motions are loose, and whether the load presses on them.

A rigid motion r on which the form vanishes, and that is zero at Dirichlet data, costs no energy.
Contact stops the motions that move some contact node towards the obstacle, so that the body may
still make those of a cone K. There is one solution where the load does negative work on all of K
but zero: the load presses the body against the obstacle. A motion of K on which the work is
positive has no end, and one on which the work is zero leads from one solution to another.

A motion that moves no contact node along its direction is free both ways. Where the load does no
work on such motions, springs at as many dofs, which tell the motions apart, make the solution
unique and carry no force: the balance of a body along these motions has the forces of the springs
alone.

Source: Fichera, Handbuch der Physik VI a/2 (1972), for solutions of Signorini's problem under loads
in equilibrium.
"""

import numpy as np
import ufl
from dolfinx import default_scalar_type, fem, la
from mpi4py import MPI
from petsc4py import PETSc
from scipy.optimize import linprog
from ufl.algorithms.apply_derivatives import apply_derivatives

from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.errors import INDEFINITE, InputError, require
from dolfinx_signorini.base.logs import log
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.base.tolerances import (
    HALF_OF_THE_DIGITS,
    ROUNDING,
    SIX_DIGITS,
    SOLVED,
    TINY,
)
from dolfinx_signorini.meshes.elements import discontinuous_space
from dolfinx_signorini.meshes.sided_meshes import box, owned_cells
from dolfinx_signorini.solvers.loose import Loose
from dolfinx_signorini.solvers.motions import motions_of, owned_places
from dolfinx_signorini.solvers.system import Layout, System

PRESSING = 1e-3  # of its size: a load that presses by less is one that does not press
MOST_ROUNDS = 100  # of linear programs, each with the rows that the last one violates


def loose_motions(a: ufl.Form, A: PETSc.Mat, layout: Layout, diagonal: Array) -> Loose:
    """Return the rigid motions on which a form vanishes and that are zero at Dirichlet data.

    Of one component these motions are constants.

    Args:
        a: The form.
        A: The matrix of the form, turned, with the Dirichlet data eliminated.
        layout: The dofs; the call is collective.
        diagonal: The diagonal of the matrix, the rows of this rank.

    Raises:
        InputError: The form of one component is negative for constants; the subject is "form a".
    """
    if layout.block == 1 and _held_in_all_cells(A, layout, diagonal):
        return Loose.nothing(layout.space.mesh.comm)
    parts, motions, comm = layout.components, motions_of(layout), layout.space.mesh.comm
    counts = np.full(parts.count, motions.shape[1], dtype=np.int32)
    one = layout.block == 1
    numbers = parts.numbers if one else np.repeat(parts.numbers, layout.block)
    every = Loose(comm, counts, numbers, motions)
    at_data = np.zeros_like(motions)
    at_data[layout.fixed_dofs] = motions[layout.fixed_dofs]
    found: list[Array] = []
    for total, fixing in zip(every.products(), every.products(at_data, at_data), strict=True):
        values, vectors = np.linalg.eigh(total)
        basis = vectors / np.sqrt(values)
        values, vectors = np.linalg.eigh(basis.T @ fixing @ basis)
        size = np.sqrt(np.trace(total) / len(total))
        found.append(basis @ vectors[:, values <= ROUNDING] * size)
    loose = every.combined(found)
    if not loose:
        return Loose.nothing(comm)
    loose = loose.combined(_without_energy(a, A, layout, diagonal, loose))
    loose.rows[layout.fixed_dofs] = 0.0
    return loose


def divided(loose: Loose, layout: Layout, weakly: bool) -> tuple[Loose, Array]:
    """Return the loose motions that contact may stop, and orthonormal ones that nothing stops.

    Args:
        loose: All loose motions; the call is collective.
        layout: The dofs.
        weakly: Whether motions that nothing stops are not refused.

    Raises:
        InputError: The subject is "bcs".
    """
    stopped, still = zip(*loose.parted(layout.contact_dofs), strict=True)
    free = loose.combined(list(still))
    columns = []
    for k in np.flatnonzero(free.counts):
        own = free.rows * (free.numbers == k)[:, None]
        own = own[:, : free.counts[k]]
        if not weakly:
            raise InputError(
                f"{_name(layout, k, own[:, 0])} is free: neither Dirichlet conditions, nor the "
                "form a, nor contact stops it; fix it by a condition, or in Python by a reaction "
                "term or held_weakly=True",
                "bcs",
            )
        values, vectors = np.linalg.eigh(loose.comm.allreduce(own.T @ own))
        columns.append(own @ (vectors / np.sqrt(values)))
    none = np.empty((len(loose.rows), 0))
    return loose.combined(list(stopped)), np.concatenate([none, *columns], axis=1)


def shares_of(free: Array, layout: Layout) -> Array:
    """Return the weights with which values of dofs tell the nearest of some motions in L2.

    What a function has of the motions does not depend on the mesh then, as it would in the mean
    over nodes: so the functions without such a part converge when the mesh is refined.

    Args:
        free: The motions, columns; the call is collective.
        layout: The dofs.
    """
    if not free.shape[1]:
        return free
    motion, v = fem.Function(layout.space), ufl.TestFunction(layout.space)
    form, loads = compiled.form(ufl.inner(motion, v) * ufl.dx), []
    for column in free.T:
        motion.x.array[: len(column)] = layout.turned_back(column)
        motion.x.scatter_forward()
        load = compiled.assembled(form, layout.space).x.array[: len(column)]
        loads.append(layout.turned(load))
    weights = np.stack(loads, axis=1)
    return weights @ np.linalg.inv(layout.space.mesh.comm.allreduce(free.T @ weights))


def add_springs(A: PETSc.Mat, free: Array) -> None:
    """Add springs on the diagonal, at as many dofs as there are motions, which tell them apart.

    A spring is as stiff as its dof is already.

    Args:
        A: The matrix, changed in place; the call is collective.
        free: The motions, orthonormal columns.
    """
    comm, rest, diagonal = A.comm.tompi4py(), free.copy(), A.getDiagonal()
    for _ in range(free.shape[1]):
        sizes = np.einsum("ni,ni->n", rest, rest)
        owners = comm.allgather(float(sizes.max(initial=0.0)))
        row = np.zeros(free.shape[1])
        if comm.rank == int(np.argmax(owners)):
            dof = int(np.argmax(sizes))
            row = rest[dof] / np.sqrt(sizes[dof])
            diagonal.array_w[dof] *= 2.0
        row = comm.allreduce(row)
        rest -= np.outer(rest @ row, row)
    if free.shape[1]:
        A.setDiagonal(diagonal)
        A.assemble()
    diagonal.destroy()


def check_held(system: System) -> None:
    """Refuse a load that does work on a motion that nothing stops, or does not press.

    Args:
        system: The system; the call is collective.

    Raises:
        InputError: The subject is "load".
    """
    check_free(system)
    layout, loose, load = system.layout, system.loose, system.b.array_r
    if not loose:
        return
    works, pushes = loose.sums(load), layout.components.sums(_at_nodes(load, layout))
    dofs = system.contact_dofs
    rows, numbers = system.signs[:, None] * loose.rows[dofs], loose.numbers[dofs]
    for k in np.flatnonzero(loose.counts):
        count = int(loose.counts[k])
        own = rows[numbers == k, :count]
        unit = works[k, :count] / max(pushes[k], TINY)
        found, message = _unpressed(system.comm, own, unit)
        if found is not None:
            column = loose.rows[:, :count] @ found * (loose.numbers == k)
            raise InputError(f"{_name(layout, k, column)} {message}", "load")


def check_free(system: System) -> None:
    """Refuse a load that does work on a motion that nothing stops.

    Args:
        system: The system; the call is collective.

    Raises:
        InputError: The subject is "load".
    """
    layout, load = system.layout, system.b.array_r
    sizes = _at_nodes(load, layout) * sum(
        (_at_nodes(motion, layout) for motion in system.free.T), start=np.zeros(1)
    )
    size, work = (
        system.comm.allreduce(float(sizes.sum())),
        system.comm.allreduce(load @ system.free),
    )
    for j in np.flatnonzero(np.abs(work) > SOLVED * size)[:1]:
        name = _name(layout, None, system.free[:, j])
        raise InputError(
            f"does work on {name}, which nothing stops: the energy is unbounded", "load"
        )


def warn_of_loose(system: System, x: PETSc.Vec) -> None:
    """Warn of a solution that is one of many: the nodes with a contact force leave a motion.

    On a coarse mesh, or under a small load, the whole force may be that of one node, around which
    the body turns without energy as far as the gaps of other nodes let it.

    Args:
        system: The system of a body; the call is collective.
        x: Its solution.
    """
    loose, layout = system.loose, system.layout
    if not loose:
        return
    forces = system.multiplier(x)
    pressed = forces > SIX_DIGITS * highest(system.comm, forces)
    for k, (_, still) in enumerate(loose.parted(system.contact_dofs[pressed])):
        for motion in still.T[:1]:
            column = loose.rows @ motion * (loose.numbers == k)
            log.warning(
                "the solution is one of many: no node with a contact force stops %s; a finer mesh "
                "or a larger load has more of these nodes",
                _name(layout, k, column),
            )


def _at_nodes(values: Array, layout: Layout) -> Array:
    """The length of a vector at each owned node."""
    return np.asarray(np.linalg.norm(values.reshape(-1, layout.block), axis=1))


def _unpressed(comm: MPI.Comm, rows: Array, work: Array) -> tuple[Array | None, str]:
    """A motion that contact allows, rows @ r >= 0, and on which the load does no negative work."""
    motion = _extreme(comm, rows, work)
    if work @ motion > SIX_DIGITS:
        return (
            motion,
            "takes the body away from the obstacle, and the load does work on it: the energy is "
            "unbounded; the load must press against the obstacle",
        )
    for j in range(len(work)):
        for sign in (1.0, -1.0):
            goal = sign * np.eye(len(work))[j]
            motion = _extreme(comm, rows, goal, work)
            if goal @ motion > PRESSING:
                return motion, (
                    "takes the body away from the obstacle, and the load does no work on it: the "
                    "solution is not unique; the load must press against the obstacle"
                )
    return None, ""


def _extreme(comm: MPI.Comm, rows: Array, goal: Array, work: Array | None = None) -> Array:
    """The r in the box [-1, 1] with rows @ r >= 0 and work @ r >= 0 at which goal @ r is largest.

    Rows of all ranks join a linear program as far as its solution violates them.
    """
    chosen = np.empty((0, len(goal))) if work is None else work[None]
    motion: Array = np.zeros(len(goal))
    for _ in range(MOST_ROUNDS):
        right = np.zeros(len(chosen))
        found = linprog(-goal, A_ub=-chosen, b_ub=right, bounds=(-1.0, 1.0), method="highs")
        motion = np.asarray(found.x, dtype=np.float64)
        violated = rows @ motion
        worst = np.argsort(violated)[: int(violated.min(initial=0.0) < -SIX_DIGITS)]
        more = np.concatenate(comm.allgather(rows[worst]))
        if not len(more):
            break
        chosen = np.concatenate((chosen, more))
    return motion


def _held_in_all_cells(A: PETSc.Mat, layout: Layout, diagonal: Array) -> bool:
    """Whether each cell of each rank has Dirichlet data or a row sum that is not rounding.

    Then the form vanishes on no constant, and nobody has to know the components of the mesh. A form
    with a(1, 1) < 0 is refused.
    """
    one, comm = np.ones((len(diagonal), 1)), layout.space.mesh.comm
    one[layout.fixed_dofs] = 0.0
    sums = _products(A, one)[:, 0]
    energy, size = comm.allreduce(np.array([one[:, 0] @ sums, diagonal.sum()]))
    definite = bool(energy >= -ROUNDING * size)
    require(comm, definite, f"{INDEFINITE}, a(1, 1) is negative", "form a")
    held = la.vector(layout.space.dofmap.index_map, dtype=np.int8)
    held.array[: len(sums)] = np.abs(sums) > SOLVED * np.abs(diagonal)
    held.array[layout.fixed_dofs] = 1
    held.scatter_forward()
    everywhere = bool(held.array[layout.space.dofmap.list].any(axis=1).all())
    return bool(comm.allreduce(everywhere, op=MPI.LAND))


def _products(A: PETSc.Mat, columns: Array) -> Array:
    """The products of a matrix with columns; collective."""
    x, y = A.createVecs()
    products = []
    for column in columns.T:
        x.array_w[:] = column
        A.mult(x, y)
        products.append(y.array_r.copy())
    destroy(x, y)
    return np.stack(products, axis=1)


def _without_energy(
    a: ufl.Form, A: PETSc.Mat, layout: Layout, diagonal: Array, loose: Loose
) -> list[Array]:
    """For each component the combinations of motions on which a form vanishes, orthonormal columns.

    The matrix tells to rounding, which a fine mesh makes larger than the energy of soft springs or
    of a small reaction. Where the matrix leaves a doubt, the form itself is asked, in units of the
    energy of stretching the domain by its size, which does not depend on the mesh.
    """
    masked = loose.rows.copy()
    masked[layout.fixed_dofs] = 0.0
    by_matrix = loose.products(masked, _products(A, masked))
    scales = loose.products(masked, diagonal[:, None] * masked)
    result: list[Array] = [np.empty((n, 0)) for n in loose.counts]
    doubtful: list[int] = []
    for k, n in enumerate(loose.counts):
        inverse = np.linalg.inv(np.linalg.cholesky(scales[k][:n, :n]))
        least = np.linalg.eigvalsh(inverse @ by_matrix[k][:n, :n] @ inverse.T)
        doubtful += [k] * bool(n and least[0] <= SOLVED)
    if not doubtful:
        return result
    by_form, stretched = _energies(a, layout, loose)
    for k in doubtful:
        n = loose.counts[k]
        values, vectors = np.linalg.eigh(0.5 * (by_form[k] + by_form[k].T)[:n, :n])
        still = values <= ROUNDING * stretched
        result[k] = vectors[:, still]
    return result


def _energies(a: ufl.Form, layout: Layout, loose: Loose) -> tuple[Array, float]:
    """The products of the motions of each component in a form, and the energy of stretching.

    The domain is stretched by its size, all components along all coordinates: a form may miss some
    of the derivatives. Functions that are 1 in one cell tell the energy of each cell, so that all
    bodies are asked at once. A form of derivatives alone vanishes on constants.
    """
    space, nodal, comm = layout.space, layout.nodal, layout.space.mesh.comm
    test, trial = a.arguments()
    if layout.block == 1:
        constant = fem.Constant(space.mesh, default_scalar_type(1.0))
        if apply_derivatives(ufl.replace(a, {trial: constant})).empty():
            return np.zeros((len(loose.counts), 1, 1)), 0.0
    first, second, parts = fem.Function(space), fem.Function(space), layout.components
    in_cells = discontinuous_space(space.mesh, 0)
    one = ufl.TestFunction(in_cells)
    integrals = [
        each.reconstruct(
            integrand=each.integrand()
            * (ufl.avg(one) if each.integral_type() == "interior_facet" else one)
        )
        for each in ufl.replace(a, {test: first, trial: second}).integrals()
    ]
    form = compiled.form(ufl.Form(integrals), "form a")
    known = fem.Function(nodal)
    known.x.array[: len(parts.numbers)] = parts.numbers
    known.x.scatter_forward()
    cells = owned_cells(space.mesh)
    numbers = np.rint(known.x.array[nodal.dofmap.list[cells, 0]]).astype(np.int64)

    def product(u: Array, v: Array) -> Array:
        for function, values in ((first, u), (second, v)):
            function.x.array[: len(values)] = values
            function.x.scatter_forward()
        energies = compiled.assembled(form, in_cells).x.array[in_cells.dofmap.list[cells, 0]]
        return np.asarray(comm.allreduce(np.bincount(numbers, energies, parts.count)))

    own = [layout.turned_back(column) for column in loose.rows.T]
    places = owned_places(nodal)[:, : space.mesh.geometry.dim]
    low, high = box(comm, places)
    stretched = 0.0
    for coordinate in ((places - low) / (high - low).max()).T:
        for unit in np.eye(layout.block):
            values = np.outer(coordinate, unit).ravel()
            stretched += float(product(values, values).sum())
    products = np.array([[product(u, v) for v in own] for u in own])
    return np.moveaxis(products, 2, 0), stretched


def _name(layout: Layout, component: int | None, column: Array) -> str:
    """A rigid motion in words; collective."""
    comm, parts = layout.space.mesh.comm, layout.components
    values = layout.turned_back(column).reshape(-1, layout.block)
    moving = np.abs(values).max(axis=1, initial=0.0) > 0.0
    total, count = comm.allreduce(values.sum(axis=0)), comm.allreduce(int(moving.sum()))
    mean = total / max(count, 1)
    turn = highest(comm, np.abs(values[moving] - mean))
    turns = turn > HALF_OF_THE_DIGITS * np.abs(mean).max()
    of = f" of {parts.names[component]}" if component is not None and parts.count > 1 else ""
    if turns:
        return f"a turn{of}"
    unit = mean / np.linalg.norm(mean)
    unit[np.abs(unit) < ROUNDING] = 0.0
    return f"a translation{of} along ({', '.join(f'{c:.4g}' for c in unit)})"
