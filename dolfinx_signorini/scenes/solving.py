"""Solving a scene: the cascade over its meshes, or refinement until an accuracy is reached."""

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.cascade import interpolate_between
from dolfinx_signorini.contact import ContactState
from dolfinx_signorini.errors import NotConvergedError
from dolfinx_signorini.meshes import owned_cells
from dolfinx_signorini.norms import error_norms
from dolfinx_signorini.optimality import SolveResult
from dolfinx_signorini.scenes.domains import MAX_VERTICES
from dolfinx_signorini.scenes.expectations import Expectation, expect
from dolfinx_signorini.scenes.posing import PosedScene, interpolate_near, pose
from dolfinx_signorini.scenes.scene import Scene


@dataclass(frozen=True)
class Level:
    """One mesh of the way to the finest.

    Attributes:
        unknowns: Its number of dofs.
        linear_solves, linear_iterations: What its solve took.
        seconds: Wall-clock seconds, mesh and assembly included.
        estimate: The estimated relative L2 error, where it was asked for and two meshes tell.
    """

    unknowns: int
    linear_solves: int
    linear_iterations: int
    seconds: float
    estimate: float | None


@dataclass(frozen=True)
class SceneResult:
    """A solved scene.

    Attributes:
        posed: The scene on its finest mesh.
        u: The solution.
        gap: Its distance to the obstacle on the contact boundary, 0 elsewhere.
        pressure: The density of the contact pressure, 0 away from the contact boundary; it is
            not negative, and pushes u up from a lower obstacle and down from an upper one.
        solve: The diagnostics of the last solve; its u is -u where the obstacle is an upper one.
        levels: The meshes, coarsest first.
        expectation: What was to be expected.
    """

    posed: PosedScene
    u: fem.Function
    gap: fem.Function
    pressure: fem.Function
    solve: SolveResult
    levels: tuple[Level, ...]
    expectation: Expectation

    @property
    def estimate(self) -> float | None:
        """The estimated L2 error relative to the L2 norm of u, where it was asked for."""
        return self.levels[-1].estimate

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.posed.problem.destroy()


def solve_scene(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> SceneResult:
    """Solve a scene.

    Args:
        scene: The scene; with an accuracy its mesh is only the first one.
        comm: The communicator that shares the mesh.

    Raises:
        InputError: The problem has no or more than one solution, or some data make no sense.
        NotConvergedError: A solve failed, or the accuracy needs too large a mesh.
    """
    levels: list[Level] = []
    state: ContactState | None = None
    posed: PosedScene | None = None
    expectation: Expectation | None = None
    differences: list[float] = []
    try:
        for current in _meshes(scene):
            began = time.perf_counter()
            if posed is not None:
                posed.problem.destroy()
            posed = pose(current, comm)
            expectation = expectation or expect(scene, posed.sided)
            coarse = state
            solve = posed.problem.solve(coarse=coarse, rtol=scene.rtol)
            state = posed.problem.contact_state(solve.u)
            estimate = None
            if scene.accuracy is not None and coarse is not None:
                differences.append(_difference(solve.u, coarse.u))
                estimate = differences[-1] / (2.0 ** _order(differences, expectation) - 1.0)
            seconds = time.perf_counter() - began
            counts = solve.linear_solves, solve.linear_iterations
            levels.append(Level(posed.problem.unknowns, *counts, seconds, estimate))
            if estimate is not None and scene.accuracy is not None and estimate <= scene.accuracy:
                break
    except Exception:
        if posed is not None:
            posed.problem.destroy()
        raise
    assert posed is not None and state is not None and expectation is not None
    return SceneResult(
        posed=posed,
        u=posed.solution(solve.u),
        gap=_gap(posed, solve.u),
        pressure=state.density,
        solve=solve,
        levels=tuple(levels),
        expectation=expectation,
    )


def _meshes(scene: Scene) -> Iterator[Scene]:
    """The scene on its meshes, coarsest first; with an accuracy as long as memory lasts."""
    if scene.accuracy is None:
        yield from scene.levels()
        return
    while scene.domain.vertices <= MAX_VERTICES:
        yield scene
        scene = scene.finer()
    raise NotConvergedError(
        f"accuracy: {scene.accuracy:g} needs a mesh of more than {MAX_VERTICES} vertices",
        np.inf,
        "the largest mesh was reached",
    )


def _difference(u: fem.Function, coarse: fem.Function) -> float:
    """The L2 norm of what changed since the coarser mesh, relative to that of u."""
    size = error_norms(u, None, ["L2"])["L2"]
    change = fem.Function(u.function_space)
    cells = owned_cells(u.function_space.mesh)
    interpolate_between([(coarse, change)], cells)
    change.x.array[:] -= u.x.array
    return error_norms(change, None, ["L2"])["L2"] / size if size > 0.0 else 0.0


def _order(differences: Iterable[float], expectation: Expectation) -> float:
    """The order of convergence to trust: the expected one, or the observed one if it is lower."""
    order = expectation.orders["L2"]
    last = list(differences)[-2:]
    if len(last) < 2 or last[1] <= 0.0:
        return min(order, 1.0)
    return float(np.clip(np.log2(last[0] / last[1]), 0.5, order))


def _gap(posed: PosedScene, solved: fem.Function) -> fem.Function:
    """The distance to the obstacle on the contact boundary, Dirichlet data included."""
    space, given = posed.problem.space, posed.obstacle
    tdim = space.mesh.topology.dim
    dofs = fem.locate_dofs_topological(space, tdim - 1, posed.problem.contact)
    gap = fem.Function(space, name="gap")
    if isinstance(given, fem.Function):
        gap.x.array[dofs] = given.x.array[dofs]
    elif isinstance(given, float):
        gap.x.array[dofs] = given
    else:
        gap.x.array[dofs] = interpolate_near(space, given, dofs).x.array[dofs]
    gap.x.array[dofs] = solved.x.array[dofs] - gap.x.array[dofs]
    return gap
