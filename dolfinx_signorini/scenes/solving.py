"""The solve of a scene: on its own mesh by the cascade, or on adapted meshes."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.accuracy.adaptive import AdaptiveSolution, adapt
from dolfinx_signorini.accuracy.first_mesh import Resolved, first_mesh
from dolfinx_signorini.accuracy.steps import MAX_UNKNOWNS, Request, Step
from dolfinx_signorini.base.kinds import (
    COMMUNICATOR,
    TEXT,
    callable_,
    check,
    instance,
    integer,
    optional,
    positive,
)
from dolfinx_signorini.base.logs import log
from dolfinx_signorini.base.timing import Phases
from dolfinx_signorini.data.coefficients import Coefficients
from dolfinx_signorini.data.interfaces.following import follow
from dolfinx_signorini.meshes.curved_sides import CurvedSides
from dolfinx_signorini.meshes.elements import HIGHEST_DEGREE
from dolfinx_signorini.meshes.sided_meshes import SidedMesh
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.scenes.expectations import (
    CUT,
    Expectation,
    check_errors,
    check_norms,
    diffusion_is_cut,
    expect,
)
from dolfinx_signorini.scenes.files.elasticity import STIFFNESS
from dolfinx_signorini.scenes.files.scene import Scene
from dolfinx_signorini.scenes.posing import PosedScene, coefficients, pose
from dolfinx_signorini.scenes.scene_data import data_of
from dolfinx_signorini.solvers.cascade import solve_cascade
from dolfinx_signorini.solvers.result import SolveResult

if TYPE_CHECKING:
    from dolfinx_signorini.pictures.picture import Picture


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
        gap: The distance from u to the nearest obstacle where there is one, 0 elsewhere. Of
            obstacles in the domain and on the boundary those in the domain count.
        pressure: The density of the contact pressure, 0 away from the contact set. The pressure of
            one obstacle is never negative, and pushes u up from a lower obstacle and down from an
            upper one; of two obstacles the upper one has a negative pressure.
        solve: The diagnostics of the last solve.
        phases: The wall-clock seconds of the phases so far.
        expectation: What was to be expected.
        levels: The meshes, coarsest first, of a scene on its own mesh.
        found: What the adaptive loop did; None for a solution on the mesh of the scene.
    """

    posed: PosedScene
    u: fem.Function
    gap: fem.Function
    pressure: fem.Function
    solve: SolveResult
    phases: Phases
    expectation: Expectation
    levels: tuple[Level, ...] = ()
    found: AdaptiveSolution | None = None

    def __repr__(self) -> str:
        return f"<SceneResult: {self.posed.scene.title}; {self.found or self.posed.problem}>"

    def plot(self, path: Path | str | None = None, *, what: str = "solution") -> "Picture | None":
        """Draw the solution with the parts of the boundary, or gap and pressure; collective.

        The solution of an elastic body is its deformed shape with the von Mises stress.

        Args:
            path: Where to save the picture; not at all by default.
            what: "solution", or "contact" for gap and pressure along the contact boundary.

        Returns:
            The figure on rank 0, which a notebook shows, and None on the other ranks.

        Raises:
            InputError: There is no such picture.
        """
        # Matplotlib is loaded by those alone who draw.
        from dolfinx_signorini.pictures.picture import saved
        from dolfinx_signorini.scenes.output.pictures import draw_result

        return saved(self.posed.problem.comm, draw_result(self, what), path)

    @property
    def seconds(self) -> float:
        """The wall-clock seconds of all phases so far."""
        return self.phases.total

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
    degree: int | None = None,
    on_step: Callable[[Step], None] = lambda step: None,
    phases: Phases | None = None,
) -> SceneResult:
    """Solve a scene.

    With an accuracy or a budget, the mesh is not that of the scene: a coarse mesh is refined where
    the data need it, see `resolved_mesh`, and then where the solution does, see `solve_adaptively`.

    Args:
        scene: The scene.
        comm: The communicator that shares the mesh.
        accuracy: The largest error allowed, in the unit of the norm; the scene's by default.
        budget: In place of an accuracy, the seconds that may be spent.
        norm: The norm of the error, see `Scene.target`; the scene's by default.
        max_unknowns: The limit on the dofs of adapted meshes.
        degree: The degree of the elements on adapted meshes. By default the loop chooses: in the
            plane from 2 to 4, in space 2, and in any case not below that of the scene.
        on_step: Is told of every step of the adaptive loop when the step is done.
        phases: A stopwatch that runs already; a new one by default.

    Raises:
        InputError: The problem has no or more than one solution, or some data make no sense.
        NotConvergedError: A solve failed.
    """
    check(
        scene=(scene, instance(Scene, "a scene, see load_scene")),
        comm=(comm, COMMUNICATOR),
        accuracy=(accuracy, optional(positive)),
        budget=(budget, optional(positive)),
        norm=(norm, optional(TEXT)),
        max_unknowns=(max_unknowns, positive),
        degree=(degree, optional(integer(1, HIGHEST_DEGREE))),
        on_step=(on_step, callable_),
        phases=(phases, optional(instance(Phases, "a stopwatch, Phases"))),
    )
    wanted = scene.target(scene.norm if norm is None else norm)
    if accuracy is None and budget is None:
        accuracy = scene.accuracy
    asked = {"accuracy": accuracy, "budget": budget, "norm": norm}
    scene.refuse([name for name, value in asked.items() if value is not None])
    phases = Phases(comm) if phases is None else phases
    if accuracy is None and budget is None:
        return _solve_on_its_mesh(scene, comm, phases)
    degrees = _degrees(scene) if degree is None else (degree,)
    request = Request(wanted, accuracy, budget, max_unknowns, scene.rtol)
    return _solve_on_adapted_meshes(scene, comm, phases, degrees, request, on_step)


def _solve_on_adapted_meshes(
    scene: Scene,
    comm: MPI.Comm,
    phases: Phases,
    degrees: tuple[int, ...],
    request: Request,
    on_step: Callable[[Step], None],
) -> SceneResult:
    """Solve a scene by the adaptive loop; see `solve_adaptively` for what is asked."""
    began = time.perf_counter()
    scene = replace(scene, domain=scene.domain.first(), degree=degrees[0])
    sided = scene.domain.make(comm)
    expectation = _look_at_solution(scene, sided, request.target.name)
    first = _first_mesh(scene, sided, request.max_unknowns)
    expectation = replace(expectation, notes=(*expectation.notes, *first.notes))
    phases.lap("first mesh")
    posed: list[PosedScene] = []

    def pose_on(degree: int, sided: SidedMesh) -> BoundConstrainedProblem:
        posed[:] = [pose(replace(scene, degree=degree), comm, sided)]
        return posed[0].problem

    curves = CurvedSides(scene.domain.geometry)
    curves.check(first.sided)
    found = adapt(
        {degree: partial(pose_on, degree) for degree in degrees},
        replace(first, notes=()),
        request,
        on_step,
        began,
        curves,
        read=lambda _: coefficients(scene),
        fit=lambda refined: follow(refined, scene.diffusion_entries),
    )
    notes = [note for note in expectation.notes if note != CUT]  # cells have followed a jump
    notes += [CUT] if diffusion_is_cut(scene, found.sided) else []
    expectation = replace(expectation, notes=tuple(notes))
    phases.lap("adaptive loop")
    return _result(posed[0], expectation, phases, found=found)


def _look_at_solution(scene: Scene, sided: SidedMesh, norm: str) -> Expectation:
    """Refuse a solution without finite values or norms before anything is solved."""
    expectation = expect(scene, sided)
    check_norms([norm], expectation, "norm")
    if scene.solution is not None:
        posed = pose(scene, sided.mesh.comm, sided)
        try:
            check_errors(posed, expectation, norm)
        finally:
            posed.problem.destroy()
    return expectation


def _degrees(scene: Scene) -> tuple[int, ...]:
    """Return the degrees of elements that the adaptive loop may choose.

    Degree 2 has two digits more for the same unknowns than degree 1.
    """
    lowest = max(scene.degree, 2)
    highest = HIGHEST_DEGREE if scene.domain.dimension == 2 else lowest
    return tuple(range(lowest, highest + 1))


def _first_mesh(scene: Scene, sided: SidedMesh, max_unknowns: int) -> Resolved:
    """Return the first mesh of the adaptive loop."""
    solution = scene.solution if scene.manufactured else None  # the load jumps where this does
    known = Coefficients(solution or scene.load, scene.reaction, scene.diffusion)
    stiffness = () if scene.elasticity is None else STIFFNESS
    limits = scene.degree, max_unknowns
    return first_mesh(sided, partial(data_of, scene), known, *limits, stiffness, "elasticity")


def _solve_on_its_mesh(scene: Scene, comm: MPI.Comm, phases: Phases) -> SceneResult:
    ascent = _Ascent(scene, comm, phases)
    solve_cascade(ascent.pose, scene.levels(), rtol=scene.rtol, on_level=ascent.note)
    return _result(ascent.posed, ascent.expectation, phases, levels=tuple(ascent.levels))


class _Ascent:
    """Poses a scene on the meshes of the cascade, and notes what each of them took."""

    posed: PosedScene
    expectation: Expectation

    def __init__(self, scene: Scene, comm: MPI.Comm, phases: Phases):
        self.scene, self.comm, self.phases = scene, comm, phases
        self.levels: list[Level] = []
        self.began = phases.total

    def pose(
        self, level: Scene, coarser: BoundConstrainedProblem | None
    ) -> BoundConstrainedProblem:
        if coarser is None:
            sided = level.domain.make(self.comm)
        else:
            sided = level.domain.make_after(self.posed.scene.domain, self.posed.sided)
        self.phases.lap("meshes")
        self.posed = pose(level, self.comm, sided)
        if coarser is None:
            self.expectation = expect(self.scene, self.posed.sided)
            check_errors(self.posed, self.expectation)
        self.phases.lap("assembly")
        return self.posed.problem

    def note(self, problem: BoundConstrainedProblem) -> None:
        assert problem.result is not None
        counts = problem.result.linear_solves, problem.result.linear_iterations
        self.phases.lap("solve")
        level = Level(problem.unknowns, *counts, self.phases.total - self.began)
        self.levels.append(level)
        self.began = self.phases.total
        text = "%8d unknowns, %d linear solves, %.2f s"
        log.debug(text, level.unknowns, level.linear_solves, level.seconds)


def _result(
    posed: PosedScene, expectation: Expectation, phases: Phases, **more: Any
) -> SceneResult:
    problem = posed.problem
    assert problem.result is not None
    return SceneResult(
        posed=posed,
        u=problem.u,
        gap=problem.zones[0].gap,
        pressure=problem.pressure,
        solve=problem.result,
        phases=phases,
        expectation=expectation,
        **more,
    )
