"""Small variational inequalities around chosen dofs, which tell the active set near these dofs.

Where the active set of a start is nearly right, what is wrong sits at the ends of the set: the
detachment points. The discrete problem restricted to a patch around these points, with everything
outside frozen, is solved in milliseconds. Each rank solves the patch around the dofs that it owns,
with rows of other ranks where the patch crosses over.
"""

import numpy as np
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.petsc import destroy, without_nodes
from dolfinx_signorini.base.tolerances import power_of_two
from dolfinx_signorini.solvers.system import System

# Layers of neighbours around the chosen dofs, by dimension: in space the ends of a contact set are
# curves. With more, patches cost more than they save (benchmarks/any_mesh.py, elastic.py).
RINGS = {1: 12, 2: 12, 3: 3}
# Of all dofs, by dimension: a patch of so many costs more than the linear solves that it saves.
LARGE = {1: 0.25, 2: 0.25, 3: 0.5}
MAX_STEPS = 60  # of active sets: twice what starts with all dofs held take, down to rounding
# Relative residual of the linear solves of a patch, each of which starts from the last. Below it a
# set that patches correct is solved for to the end.
SETTLED = 1e-3


def patch_dofs(system: System, seeds: LocalIndices, layers: int) -> LocalIndices:
    """Return the global indices of the dofs within some layers of neighbours of the seeds.

    Args:
        system: The system, whose matrix tells which dofs are neighbours.
        seeds: Owned dofs, local indices.
        layers: The number of layers.
    """
    rows = seeds.astype(np.int32) + system.A.getOwnershipRange()[0]
    index_set = PETSc.IS().createGeneral(rows, comm=PETSc.COMM_SELF)
    system.A.increaseOverlap(index_set, layers)
    dofs = np.unique(index_set.getIndices())
    index_set.destroy()
    return dofs


def affordable_patch(system: System, seeds: LocalIndices, share: float) -> tuple[LocalIndices, int]:
    """Return the largest patch around the seeds that is no larger than a share of all dofs.

    Args:
        system: The system; the call is collective.
        seeds: Owned dofs, local indices.
        share: The number of dofs of the patches of all ranks over the number of all dofs.

    Returns:
        The global indices of the dofs, and the number of layers of neighbours, at least one even
        where that is more than the share.
    """
    layers = RINGS[system.space.mesh.topology.dim]
    dofs = patch_dofs(system, seeds, layers)
    while layers > 1 and system.comm.allreduce(len(dofs)) > share * system.unknowns:
        layers = 2 * layers // 3
        dofs = patch_dofs(system, seeds, layers)
    return dofs, layers


def active_in_patch(
    system: System, x: PETSc.Vec, multiplier: PETSc.Vec, held: Mask, seeds: LocalIndices
) -> Mask:
    """Solve the patch problem near the seeds, and return the active set with that of the patch.

    Where the patch is too large to be cheap, the set stays as it is.

    Args:
        system: The system.
        x: A feasible vector; the owned values in the patch are overwritten by the solution there.
        multiplier: A x - b, right in the patch.
        held: The active set so far, one entry per contact dof of this rank.
        seeds: Owned dofs around which to correct it, local indices.
    """
    share = LARGE[system.space.mesh.topology.dim]
    dofs, _ = affordable_patch(system, seeds, share)
    if len(dofs) > share * system.unknowns:
        dofs = dofs[:0]  # a patch of nothing: what follows is collective
    index_set = PETSc.IS().createGeneral(dofs, comm=PETSc.COMM_SELF)
    (matrix,) = system.A.createSubMatrices(index_set)
    start, residual = _gather(x, index_set), _gather(multiplier, index_set)
    vector = x.duplicate()
    lower, upper = (_gather(vector, index_set, values) for values in system.bounds)
    destroy(vector, index_set)
    first, last = system.A.getOwnershipRange()
    mine = (dofs >= first) & (dofs < last)
    sides = np.zeros(last - first)
    sides[system.contact_dofs[held]] = system.signs[held]
    if len(dofs):
        active, values = solve_small(matrix, residual, lower, upper, start)
        x.array_w[dofs[mine] - first] = values[mine]
        sides[dofs[mine] - first] = active[mine]
    matrix.destroy()
    return np.asarray(sides[system.contact_dofs] == system.signs)


def _gather(vec: PETSc.Vec, index_set: PETSc.IS, new: Array | None = None) -> Array:
    """The entries of a vector, which gets new values before, at global indices of all ranks."""
    if new is not None:
        vec.array_w[:] = new
    target = PETSc.Vec().createSeq(index_set.getLocalSize())
    scatter = PETSc.Scatter().create(vec, index_set, target, None)
    scatter.scatter(vec, target)
    values = target.array_r.copy()
    destroy(scatter, target)
    return values


def solve_small(
    A: PETSc.Mat, residual: Array, lower: Array, upper: Array, start: Array
) -> tuple[Array, Array]:
    """Take primal-dual active set steps.

    Args:
        A: The matrix of the patch.
        residual: A x - b in the whole problem, at the start.
        lower, upper: The bounds, infinite where there is none.
        start: Start vector.

    Returns:
        The last active set, 1 at lower and -1 at upper bounds that are active, else 0, and the last
        values; those of the start where a linear solve fails.
    """
    diagonal = A.getDiagonal().array_r.copy()
    unit = power_of_two(diagonal.max())  # held rows are no outliers of the matrix
    first = sides = _sides(start <= lower, start >= upper)
    held = without_nodes(A.duplicate())
    correction, rhs = A.createVecs()
    ksp = PETSc.KSP().create(PETSc.COMM_SELF)
    ksp.setType("cg")
    ksp.getPC().setType("sor")
    ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    ksp.setTolerances(rtol=SETTLED, atol=0.0)
    x, multiplier = start.copy(), residual.copy()
    for _ in range(MAX_STEPS):
        A.copy(held, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        active = sides != 0.0
        held.zeroRowsColumns(np.flatnonzero(active).astype(np.int32), diag=unit)
        g = np.where(sides > 0.0, lower, upper)
        shift = np.where(active, g - x, 0.0)
        correction.array_w[:] = shift
        A.mult(correction, rhs)
        rhs.array_w[:] = np.where(active, 0.0, -(multiplier + rhs.array_r))
        size = power_of_two(rhs.norm(PETSc.NormType.INFINITY))
        rhs.scale(1.0 / size)
        ksp.setOperators(held)
        ksp.solve(rhs, correction)
        if not np.isfinite(correction.array_r).all():
            sides, x = first, start
            break
        correction.array_w[:] = np.where(active, shift, size * correction.array_r)
        A.mult(correction, rhs)
        x += correction.array_r
        multiplier += rhs.array_r
        with np.errstate(over="ignore"):
            update = _sides(
                multiplier > diagonal * (x - lower), multiplier < diagonal * (x - upper)
            )
        if (update == sides).all():
            break
        sides = update
    destroy(ksp, held, correction, rhs)
    return sides, np.select([sides > 0.0, sides < 0.0], [lower, upper], x)


def _sides(below: Mask, above: Mask) -> Array:
    """1 where a lower bound is active, -1 where an upper one is, else 0."""
    return below.astype(np.float64) - (above & ~below)
