"""Solving a scene: on its own mesh by the cascade, or on the mesh that an accuracy needs."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.accuracy.model import Trial
from dolfinx_signorini.accuracy.search import MAX_UNKNOWNS, Outcome, solve_to
from dolfinx_signorini.scenes.expectations import Expectation, expect
from dolfinx_signorini.scenes.family import scene_family
from dolfinx_signorini.scenes.posing import PosedScene, interpolate_near, pose
from dolfinx_signorini.scenes.scene import Scene
from dolfinx_signorini.solvers.pressure import ContactState
from dolfinx_signorini.solvers.residual import SolveResult


@dataclass(frozen=True)
class Level:
    """One mesh of the way to the finest.

    Attributes:
        unknowns: Its number of dofs.
        linear_solves, linear_iterations: What its solve took.
        seconds: Wall-clock seconds, mesh and assembly included.
    """

    unknowns: int
    linear_solves: int
    linear_iterations: int
    seconds: float


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
        seconds: Wall-clock seconds of everything.
        expectation: What was to be expected.
        levels: The meshes, coarsest first, of a scene on its own mesh.
        outcome: How mesh, degree and tolerance were chosen; None for those of the scene.
    """

    posed: PosedScene
    u: fem.Function
    gap: fem.Function
    pressure: fem.Function
    solve: SolveResult
    seconds: float
    expectation: Expectation
    levels: tuple[Level, ...] = ()
    outcome: Outcome | None = None

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.posed.problem.destroy()


def solve_scene(
    scene: Scene,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    accuracy: float | None = None,
    budget: float | None = None,
    norm: str | None = None,
    max_unknowns: int = MAX_UNKNOWNS,
    on_trial: Callable[[Trial], None] = lambda trial: None,
) -> SceneResult:
    """Solve a scene.

    With an accuracy or a budget, mesh, degree and tolerance are not those of the scene: they are
    chosen from cheap coarse runs, see `accuracy.solve_to`.

    Args:
        scene: The scene.
        comm: The communicator that shares the mesh.
        accuracy: The largest error allowed, in the unit of the norm; the scene's by default.
        budget: In place of an accuracy, the seconds that may be spent.
        norm: The norm of the error; the scene's by default.
        max_unknowns: Limit on the dofs that are chosen.
        on_trial: Is told of every run of the search when it is done.

    Raises:
        InputError: The problem has no or more than one solution, some data make no sense, or the
            accuracy is out of reach; the message says what the best would be.
        NotConvergedError: A solve failed.
    """
    if accuracy is None and budget is None:
        accuracy = scene.accuracy
    if accuracy is None and budget is None:
        return _solve_on_its_mesh(scene, comm)
    outcome = solve_to(
        comm,
        scene_family(scene),
        scene.norm if norm is None else norm,
        accuracy=accuracy,
        budget=budget,
        max_unknowns=max_unknowns,
        on_trial=on_trial,
    )
    posed = outcome.run.posed
    assert isinstance(posed, PosedScene)
    state = posed.problem.contact_state(outcome.run.result.u)
    expectation = expect(posed.scene, posed.sided)
    return _result(posed, outcome.run.result, state, expectation, outcome.seconds, outcome=outcome)


def _solve_on_its_mesh(scene: Scene, comm: MPI.Comm) -> SceneResult:
    levels: list[Level] = []
    state: ContactState | None = None
    posed: PosedScene | None = None
    expectation: Expectation | None = None
    try:
        for current in scene.levels():
            began = time.perf_counter()
            if posed is not None:
                posed.problem.destroy()
            posed = pose(current, comm)
            expectation = expectation or expect(scene, posed.sided)
            solve = posed.problem.solve(coarse=state, rtol=scene.rtol)
            state = posed.problem.contact_state(solve.u)
            seconds = time.perf_counter() - began
            counts = solve.linear_solves, solve.linear_iterations
            levels.append(Level(posed.problem.unknowns, *counts, seconds))
    except Exception:
        if posed is not None:
            posed.problem.destroy()
        raise
    assert posed is not None and state is not None and expectation is not None
    seconds = sum(level.seconds for level in levels)
    return _result(posed, solve, state, expectation, seconds, levels=tuple(levels))


def _result(
    posed: PosedScene,
    solve: SolveResult,
    state: ContactState,
    expectation: Expectation,
    seconds: float,
    *,
    levels: tuple[Level, ...] = (),
    outcome: Outcome | None = None,
) -> SceneResult:
    return SceneResult(
        posed=posed,
        u=posed.solution(solve.u),
        gap=_gap(posed, solve.u),
        pressure=state.density,
        solve=solve,
        seconds=seconds,
        expectation=expectation,
        levels=levels,
        outcome=outcome,
    )


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
