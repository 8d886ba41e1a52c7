"""Solving a scene: on its own mesh by the cascade, or on the mesh that an accuracy needs."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.accuracy.model import Trial
from dolfinx_signorini.accuracy.search import MAX_UNKNOWNS, Outcome, solve_to
from dolfinx_signorini.problem import SignoriniProblem
from dolfinx_signorini.scenes.expectations import Expectation, check_norms, check_solution, expect
from dolfinx_signorini.scenes.posing import PosedScene, pose, scene_family
from dolfinx_signorini.scenes.scene import Scene
from dolfinx_signorini.solvers.cascade import solve_cascade
from dolfinx_signorini.solvers.result import SolveResult


@dataclass(frozen=True)
class Level:
    """One mesh of the way to the finest.

    The levels of a solved scene tell what the scene took:

        for level in solve_scene(scene).levels:
            print(level.unknowns, level.seconds)

    Attributes:
        unknowns: The number of dofs.
        linear_solves, linear_iterations: What the solve took.
        seconds: Wall-clock seconds, mesh and assembly included.
    """

    unknowns: int
    linear_solves: int
    linear_iterations: int
    seconds: float


@dataclass(frozen=True)
class SceneResult:
    """A solved scene.

    For example:

        result = solve_scene(load_scene(Path("scene.toml")))
        print(result.solve.active_dofs, result.gap.x.array.max())
        result.destroy()

    Attributes:
        posed: The scene on its finest mesh.
        u: The solution.
        gap: The distance from u to the obstacle on the contact boundary, 0 elsewhere.
        pressure: The density of the contact pressure, 0 away from the contact boundary. The
            pressure is never negative, and pushes u up from a lower obstacle and down from an upper
            one.
        solve: The diagnostics of the last solve.
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
    chosen from cheap coarse runs, see `accuracy.search.solve_to`.

    Args:
        scene: The scene.
        comm: The communicator that shares the mesh.
        accuracy: The largest error allowed, in the unit of the norm; the scene's by default.
        budget: In place of an accuracy, the seconds that may be spent.
        norm: The norm of the error; the scene's by default.
        max_unknowns: The limit on the dofs that are chosen.
        on_trial: Is told of every run of the search when the run is done.

    Raises:
        InputError: The problem has no or more than one solution, some data make no sense, or the
            accuracy is out of reach; the message says what the best would be.
        NotConvergedError: A solve failed.
    """
    if accuracy is None and budget is None:
        accuracy = scene.accuracy
    if accuracy is None and budget is None:
        return _solve_on_its_mesh(scene, comm)
    norm = scene.norm if norm is None else norm
    _look_at_solution(scene, comm, norm)
    outcome = solve_to(
        comm,
        scene_family(scene),
        norm,
        accuracy=accuracy,
        budget=budget,
        max_unknowns=max_unknowns,
        on_trial=on_trial,
    )
    posed = outcome.run.posed
    assert isinstance(posed, PosedScene)
    expectation = expect(posed.scene, posed.sided)
    return _result(posed, expectation, outcome.seconds, outcome=outcome)


def _look_at_solution(scene: Scene, comm: MPI.Comm, norm: str) -> None:
    """Refuse a solution without finite values or norms before anything is solved."""
    coarsest = scene.levels()[0]
    sided = coarsest.domain.make(comm)
    expectation = expect(scene, sided)
    check_norms([norm], expectation, "norm")
    if scene.solution is None:
        return
    check_norms(scene.norms, expectation, "norms")
    posed = pose(coarsest, comm, sided)
    try:
        check_solution(posed, [norm, *scene.norms])
    finally:
        posed.problem.destroy()


def _solve_on_its_mesh(scene: Scene, comm: MPI.Comm) -> SceneResult:
    ascent = _Ascent(scene, comm)
    solve_cascade(ascent.pose, scene.levels(), rtol=scene.rtol, on_level=ascent.note)
    seconds = sum(level.seconds for level in ascent.levels)
    return _result(ascent.posed, ascent.expectation, seconds, levels=tuple(ascent.levels))


class _Ascent:
    """Poses a scene on the meshes of the cascade, and notes what each of them took.

    Args:
        scene: The scene.
        comm: The communicator that shares the meshes.

    Attributes:
        posed: The scene on the last mesh.
        expectation: What is to be expected of the scene, found on the first mesh.
        levels: The meshes that the scene has been solved on.
    """

    posed: PosedScene
    expectation: Expectation

    def __init__(self, scene: Scene, comm: MPI.Comm):
        self.scene, self.comm = scene, comm
        self.levels: list[Level] = []
        self.began = time.perf_counter()

    def pose(self, level: Scene, coarser: SignoriniProblem | None) -> SignoriniProblem:
        self.posed = pose(level, self.comm)
        if coarser is None:
            self.expectation = expect(self.scene, self.posed.sided)
            if self.scene.solution is not None:
                check_norms(self.scene.norms, self.expectation, "norms")
            check_solution(self.posed, self.scene.norms)
        return self.posed.problem

    def note(self, problem: SignoriniProblem) -> None:
        assert problem.result is not None
        counts = problem.result.linear_solves, problem.result.linear_iterations
        now = time.perf_counter()
        self.levels.append(Level(problem.unknowns, *counts, now - self.began))
        self.began = now


def _result(
    posed: PosedScene, expectation: Expectation, seconds: float, **more: Any
) -> SceneResult:
    problem = posed.problem
    assert problem.result is not None
    return SceneResult(
        posed=posed,
        u=problem.u,
        gap=problem.gap,
        pressure=problem.pressure,
        solve=problem.result,
        seconds=seconds,
        expectation=expectation,
        **more,
    )
