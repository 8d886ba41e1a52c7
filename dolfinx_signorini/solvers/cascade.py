"""From coarse to fine: contact for about the price of one linear solve.

A coarse solution is carried to the next mesh at the contact boundary only: its values and the
density of its contact pressure predict the active set there, by the sign of pressure minus gap.
(Values alone do not: where u vanishes together with its flux, half of them are rounding.) Small
problems around the ends of the predicted contact set, with the coarse solution outside, settle it
to the dof. What follows is one linear solve, and a check by TAO.
"""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.errors import InputError
from dolfinx_signorini.solvers.active_set import HeldSystem, solve_active_set
from dolfinx_signorini.solvers.patch import LARGE, MAX_PATCH, active_in_patch, patch_dofs
from dolfinx_signorini.solvers.pressure import ContactState, boundary_weights, contact_state
from dolfinx_signorini.solvers.residual import Optimality, SolveResult
from dolfinx_signorini.solvers.tao import TaoRounds
from dolfinx_signorini.system import DiscreteProblem

Mask = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int32]

# With it the algebraic error is about 1e-6 of the discretisation error in the norms of the paper.
DEFAULT_RTOL = 1e-7
PADDING = 0.1  # of the coarse cell size: how far a fine boundary may lie outside the coarse mesh


def solve_contact(
    problem: DiscreteProblem,
    coarse: ContactState | None = None,
    *,
    rtol: float = DEFAULT_RTOL,
    options: Mapping[str, Any] | None = None,
) -> SolveResult:
    """Solve the discrete problem by predicting the active set, one linear solve, and TAO.

    Args:
        problem: The assembled problem.
        coarse: A solution on a coarser mesh. Without it the active set is found from scratch,
            by several inexact linear solves.
        rtol: The natural residual to reach, relative to the data.
        options: PETSc options of the linear solver, without prefix; CG with BoomerAMG by default.

    Raises:
        InputError: rtol makes no sense or the form is found to be indefinite.
        NotConvergedError: The natural residual was not reached, by TAO's Newton method either.
    """
    if not 0.0 < rtol < 1.0:
        raise InputError(f"rtol: must lie between 0 and 1, not {rtol}")
    began = time.perf_counter()
    x = problem.start_values()
    optimality, system = Optimality(problem, rtol), HeldSystem(problem, options)
    try:
        held = predict(problem, coarse)
        predicted = time.perf_counter()
        residual = solve_active_set(system, optimality, x, held, rtol, coarse is not None)
        system.destroy()  # its memory is TAO's
        problem.project(x)
        solved = time.perf_counter()
        rounds = TaoRounds(problem, "bncg" if residual <= rtol else "bntr")
        residual = rounds.run(x, optimality, rtol)
        seconds = {
            "predict": predicted - began,
            "solve": solved - predicted,
            "accept": time.perf_counter() - solved,
        }
        return rounds.result(
            x, residual, rtol, "cascade", (system.solves, system.iterations), seconds
        )
    finally:
        for item in (system, optimality, x):
            item.destroy()


def solve_cascade(
    make_problem: Callable[[int], DiscreteProblem],
    levels: Iterable[int],
    *,
    rtol: float = DEFAULT_RTOL,
    options: Mapping[str, Any] | None = None,
) -> tuple[DiscreteProblem, SolveResult]:
    """Solve a family of problems from coarse to fine, and return the last with its result.

    Args:
        make_problem: Assembles the problem of a level, for example of a number of cells per side.
        levels: The levels, coarsest first; the meshes need not be nested.
        rtol: See `solve_contact`.
        options: See `solve_contact`.

    Raises:
        InputError: There is no level, or a problem is refused.
        NotConvergedError: Some level did not converge.
    """
    coarse, previous = None, None
    for level in levels:
        problem = make_problem(level)
        if previous is not None:
            coarse = contact_state(*previous)
            previous[0].destroy()
        result = solve_contact(problem, coarse, rtol=rtol, options=options)
        previous = (problem, result.u)
    if previous is None:
        raise InputError("levels: a cascade needs at least one")
    return problem, result


def predict(problem: DiscreteProblem, coarse: ContactState | None) -> Mask:
    """Predict the active set from a coarser solution.

    Args:
        problem: The problem on the finer mesh.
        coarse: The coarser solution; only cells at the contact boundary and near the ends of the
            contact set are looked up. Without one, everything is predicted to be in contact.

    Returns:
        One entry per contact dof of this rank.
    """
    dofs = problem.contact_dofs
    if coarse is None:
        return np.full(len(dofs), True)
    u, density = fem.Function(problem.space), fem.Function(problem.space)
    contact = fem.Function(problem.space)
    contact.x.array[dofs] = 1.0
    contact.x.scatter_forward()
    layer = _cells_with(problem, contact.x.array > 0.0)
    interpolate_between([(coarse.u, u), (coarse.density, density)], layer)
    gap = u.x.array[dofs] - problem.obstacle
    pressure = boundary_weights(problem) * density.x.array[dofs]
    held = pressure - problem.contact_diagonal * gap > 0.0

    seeds = _ends(problem, held, layer)
    marked = problem.A.createVecRight()
    marked.set(0.0)
    near = patch_dofs(problem, seeds, more=1)
    marked.setValues(near, np.ones(len(near)))
    marked.assemble()
    if not 0.0 < marked.sum() <= min(problem.comm.size * MAX_PATCH, LARGE * problem.unknowns):
        marked.destroy()
        return held
    patch = fem.Function(problem.space)
    patch.x.array[: len(marked.array_r)] = marked.array_r
    patch.x.scatter_forward()
    marked.destroy()
    interpolate_between([(coarse.u, u)], _cells_with(problem, patch.x.array > 0.0))
    x = problem.vector_of(u)
    x.array_w[dofs[held]] = problem.obstacle[held]
    problem.project(x)
    residual = x.duplicate()
    problem.A.mult(x, residual)
    residual.axpy(-1.0, problem.b)
    held = active_in_patch(problem, x, residual, held, seeds)
    x.destroy()
    residual.destroy()
    return held


def interpolate_between(pairs: Sequence[tuple[fem.Function, fem.Function]], cells: Indices) -> None:
    """Interpolate functions between two meshes, on some cells of the target mesh only."""
    source, target = (function.function_space for function in pairs[0])
    topology = source.mesh.topology
    sample = np.arange(min(topology.index_map(topology.dim).size_local, 1), dtype=np.int32)
    size = float(source.mesh.h(topology.dim, sample).max(initial=0.0))
    padding = PADDING * source.mesh.comm.allreduce(size, op=MPI.MAX)
    data = fem.create_interpolation_data(target, source, cells, padding=padding)
    for old, new in pairs:
        new.interpolate_nonmatching(old, cells, data)
        new.x.scatter_forward()


def _cells_with(problem: DiscreteProblem, dofs: Mask) -> Indices:
    """Cells of this rank, ghosts included, that have one of the marked dofs."""
    cells = problem.space.dofmap.list
    return np.unique(np.flatnonzero(dofs[cells.ravel()]) // cells.shape[1]).astype(np.int32)


def _ends(problem: DiscreteProblem, held: Mask, layer: Indices) -> Indices:
    """Owned contact dofs of cells that have held and free contact dofs."""
    state = fem.Function(problem.space)
    state.x.array[problem.contact_dofs] = np.where(held, 1.0, -1.0)
    state.x.scatter_forward()
    cells = problem.space.dofmap.list[layer]
    values = state.x.array[cells]
    mixed = (values > 0.0).any(axis=1) & (values < 0.0).any(axis=1)
    marked = np.zeros(len(state.x.array), dtype=bool)
    marked[cells[mixed][values[mixed] != 0.0]] = True
    owned = problem.space.dofmap.index_map.size_local
    return np.flatnonzero(marked[:owned]).astype(np.int32)
