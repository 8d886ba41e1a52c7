"""The loop between the solves: estimate, mark, refine, and choose the degree.

Each step solves the problem on a mesh and on the mesh with every cell divided. The second solution
is the one that is handed out. The cells that leave most of its error are divided for the next step.
The first estimate is discarded: no convergence rate has been measured yet.
"""

import functools
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.accuracy.cells import volumes
from dolfinx_signorini.accuracy.estimates import Estimator, Hidden
from dolfinx_signorini.accuracy.indicators import Solution, size
from dolfinx_signorini.accuracy.marking import GROWTH, Divided, mark, mark_worst
from dolfinx_signorini.accuracy.moved_sides import MovedSides
from dolfinx_signorini.accuracy.steps import Request, Result, Step
from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.errors import InputError, NotConvergedError, together
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.meshes.curved_sides import CurvedSides
from dolfinx_signorini.meshes.refinement import Refinement, refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, longest_side
from dolfinx_signorini.problem.signorini import DEFAULT_RTOL, SignoriniProblem
from dolfinx_signorini.solvers.cascade import Cascade

AIM = 0.9  # estimate aimed at, over the accuracy
LEAST = 0.8  # of the estimate: to fall less is not worth a step
CLOSE = 1.5  # times the accuracy: further steps from here aim lower and lower
GAIN = 0.6  # more than the conforming mesh gains on the prediction is not counted on
SMALLEST_GROWTH = 1.2  # of the number of cells: a smaller one is not worth a step
RESERVE = 1.2  # how much longer than predicted a step may take
PATIENCE = 4  # steps in which the estimate does not fall
RISEN = 20.0  # times the smallest estimate
ROUNDING = 1e-7  # of the size of the solution: so small are estimates that may be rounding
ALGEBRAIC = 1e-2  # of the last estimate: the residual to reach, where both are relative
SMALLEST_RTOL = 1e-13
ROUNDED_RTOL = 1e-11  # rounding may allow no residual below
ROUNDED = "rounding"  # why a loop ended, in its first word

# Up to which factor between the first estimate and the accuracy a degree takes the least time.
ENOUGH = {1: 3.0, 2: 30.0, 3: 1000.0, 4: math.inf}
RESOLVED = 0.5  # of the size of the solution: a larger first estimate tells nothing about degrees

Pose = Callable[[SidedMesh], SignoriniProblem]


def posed(pose: Pose, sided: SidedMesh) -> SignoriniProblem:
    """Pose a problem on a mesh by the user's function; the call is collective.

    Raises:
        InputError: The function raises an exception, or poses a problem on another mesh.
    """
    with together(sided.mesh.comm, "pose"):
        problem = pose(sided)
    if isinstance(problem, SignoriniProblem) and problem.space.mesh is not sided.mesh:
        raise InputError("poses the problem on another mesh than that of its argument", "pose")
    return problem


class Loop:
    """What the adaptive loop does between two solves: estimate, mark, refine.

    Args:
        poses: Functions that pose the problem on a mesh, by the degree of the elements.
        sided: The first mesh.
        request: What is asked for.
        on_step: Is told of each step.
        began: When the seconds began.
        hidden: Returns what the data add to the error inside of each owned cell; None for nothing.
        fit: Moves vertices of a refined mesh onto what the mesh is to follow.
        curves: The curves that sides of the mesh stand for.

    Attributes:
        pose: The function that poses the problem, with elements of the present degree.
        problem: The problem that was solved last.
        division: The division of the present mesh.
        owners: For each cell of the present mesh the cell of the last mesh; None on the first mesh.
        rounds: The number of steps with elements of the present degree.
        predicted: The estimate that was predicted for the present mesh; 0 for none.
        estimator: The estimates, with elements of the present degree.
        steps: The steps so far.
        best: The result with the least estimate.
        last: The result of the problem that was solved last.
        whole: The size of the last solution in the norm that is asked for.
        stopped: Why the loop ended.
        keywords: The keywords of the next solves.
    """

    problem: SignoriniProblem
    division: Refinement
    estimator: Estimator
    owners: LocalIndices | None
    best: Result
    last: Result
    whole: float
    _cascade: Cascade[SidedMesh, SignoriniProblem]

    def __init__(
        self,
        poses: Mapping[int, Pose],
        sided: SidedMesh,
        request: Request,
        on_step: Callable[[Step], None],
        began: float,
        hidden: Hidden | None,
        fit: Callable[[SidedMesh], None],
        curves: CurvedSides,
    ):
        self.poses, self.pose = poses, poses[min(poses)]
        self.sided, self.request, self.on_step = sided, request, on_step
        self.comm, self.began, self.hidden, self.fit = sided.mesh.comm, began, hidden, fit
        self.curves = curves
        self.steps: list[Step] = []
        self.stopped = ""
        self.keywords: dict[str, Any] = {}

    def run(self) -> None:
        """Solve, solve on the divided mesh, estimate, mark and refine until the loop ends.

        Raises:
            InputError: A problem is refused, or there is no room for the first meshes.
            NotConvergedError: A solve failed.
        """
        with Cascade(lambda sided, _: posed(self.pose, sided)) as self._cascade:
            self.division = refined(self.sided)
            self._solve(self.sided)
            self._require_room()
            self._begin()
            while True:
                coarse = Solution(self.problem.u, self.problem.forces)
                self._solve(self.division.sided)
                self._estimate(coarse)
                if self._takes_another_degree():
                    self.division = refined(self.sided)  # with the vertices before they were moved
                    self._solve(self.sided)
                    self._begin()
                    continue
                divided = self._next_mesh()
                if divided is None:
                    break
                self._solve(divided.sided)
            self._solve_best_again()

    def _solve(self, sided: SidedMesh) -> None:
        """Solve on a mesh, to the residual that is asked for or to the one that rounding allows."""
        keywords = self.keywords
        solve: Callable[..., object] = functools.partial(self._cascade.solve, sided)
        while True:
            try:
                solve(**keywords)
                break
            except NotConvergedError:
                rtol = 10.0 * keywords.get("rtol", DEFAULT_RTOL)
                if rtol > ROUNDED_RTOL or self._cascade.problem is None:
                    raise
                keywords = {"rtol": rtol}
                solve = functools.partial(self._cascade.problem.solve, coarse=self._cascade.coarse)
        assert self._cascade.problem is not None
        self.problem = self._cascade.problem

    def _estimate(self, coarse: Solution) -> None:
        """Compare the solution with the one on the mesh before the division, and note the step."""
        cells = self.division.parents, self.owners
        value = self.estimator.compared(coarse, self.problem, *cells)
        target, u = self.request.target, self.problem.u
        moved = MovedSides(self.curves, self.sided, self.division, u, target)
        if moved:
            self._solve(self.division.sided)
        self._note(self.estimator.settled(value, self.problem, *cells, moved))

    def _solve_best_again(self) -> None:
        """Solve on the mesh of the best result again if rounding has spoilt the results since."""
        if not self.stopped.startswith(ROUNDED) or self.last is self.best:
            return
        self.last, self.keywords = self.best, dict(self.best.keywords)
        self._solve(self.best.division.sided)
        seconds = self.comm.bcast(time.perf_counter() - self.began)
        self._tell(replace(self.best.step, seconds=seconds))

    def _require_room(self) -> None:
        needed = _unknowns(self.division.sided, self.problem.space)
        if needed > self.request.max_unknowns:
            message = f"the coarsest meshes need {needed}, not {self.request.max_unknowns}"
            raise InputError(message, "max_unknowns")

    def _begin(self) -> None:
        """Begin the rounds with elements of one degree, on the mesh that was just solved on."""
        self.estimator = Estimator(self.problem.space, self.request.target, self.hidden)
        self.owners, self.rounds, self.predicted = None, 0, 0.0

    def _takes_another_degree(self) -> bool:
        """Choose the degree when the first step with the lowest one has been done."""
        accuracy, lowest = self.request.accuracy, min(self.poses)
        if accuracy is None or len(self.steps) > 1:
            return False
        estimate = self.steps[0].estimate
        if estimate > RESOLVED * self.whole:
            return False
        # Facets in place of curves leave the same with all degrees.
        ratio = (estimate - self.estimator.polygon) / accuracy
        best = next((k for k in sorted(self.poses) if ratio <= ENOUGH.get(k, math.inf)), lowest)
        more = (best / lowest) ** self.sided.mesh.topology.dim if lowest else 1.0
        room = more * self.steps[0].unknowns <= self.request.max_unknowns
        if best == lowest or not room or self._affordable() < SMALLEST_GROWTH * more:
            return False
        self.pose = self.poses[best]
        return True

    def _note(self, estimate: float) -> None:
        """Note the step, after which the algebraic error is to be far below the estimate."""
        seconds = self.comm.bcast(time.perf_counter() - self.began)
        step = Step(self.problem.unknowns, estimate, seconds)
        remaining = self.estimator.prediction.remaining
        self.last = Result(step, self.division, remaining, self.keywords)
        if not self.steps or estimate < self.best.step.estimate:
            self.best = self.last
        self.whole = size(self.problem.u, self.request.target)
        if self.whole > 0.0:
            share = self._share_in_derivatives()
            rtol = ALGEBRAIC * estimate / self.whole * share
            # The stop of a solve by default looks at values and not at derivatives.
            free = share == 1.0 and rtol >= DEFAULT_RTOL
            rtol = min(max(rtol, SMALLEST_RTOL), DEFAULT_RTOL)
            self.keywords = {} if free else {"rtol": rtol}
        self._tell(step)

    def _tell(self, step: Step) -> None:
        """Note a step, and tell the user's function of the step."""
        self.steps.append(step)
        with together(self.comm, "on_step"):
            self.on_step(step)

    def _share_in_derivatives(self) -> float:
        """By what an algebraic error is to be smaller so that derivatives in L^p, p > d, are right.

        On the smallest cells, of size h in d dimensions, differences of values are divided by h,
        which is h^(d/p - 1) in the norm.
        """
        norm, domain = self.request.target.norm, self.sided.mesh
        dim = domain.topology.dim
        if norm is None or norm.derivatives == 0 or norm.p <= dim:
            return 1.0
        smallest = float(volumes(domain).min(initial=math.inf)) ** (1.0 / dim)
        smallest = self.comm.allreduce(smallest, op=MPI.MIN)
        return float(
            (smallest / longest_side(self.comm, domain.geometry.x)) ** (1.0 - dim / norm.p)
        )

    def _next_mesh(self) -> Divided | None:
        """Divide the mesh for the next step; None, with the reason, if the loop ends here."""
        accuracy, estimate = self.request.accuracy, self.steps[-1].estimate
        self.rounds += 1
        rates, found = self.estimator.rates, self.estimator.found
        if self.rounds == 1:
            marks = mark_worst(self.sided, found.cells, rates.order, rates.power)
            divided = marks.apply(self.sided, self.curves.fit)
        else:
            if accuracy is not None and estimate <= accuracy:
                self.stopped = "the accuracy is reached"
                return None
            if self._standing():
                self.stopped = f"{ROUNDED}: the estimate does not fall any more"
                return None
            goal = 0.0
            if accuracy is not None:
                close = sum(step.estimate <= CLOSE * accuracy for step in self.steps)
                goal = AIM * accuracy / (estimate * self._gain(estimate))
                goal = min(goal, LEAST ** max(close, 1))
            growth = self._affordable()
            if growth < SMALLEST_GROWTH:
                return None
            marks = mark(self.sided, self.estimator.prediction, goal, min(growth, GROWTH))
            if not highest(self.comm, marks.levels) > 0.0:
                self.stopped = f"{ROUNDED}: the cells with the error cannot be divided any more"
                return None
            divided = marks.apply(self.sided, self.curves.fit)
            self.predicted = marks.factor * estimate
        with together(self.comm, "fit"):
            self.fit(divided.sided)
        division = refined(divided.sided)
        if _unknowns(division.sided, self.problem.space) > self.request.max_unknowns:
            self.stopped = f"a finer mesh has more than {self.request.max_unknowns} unknowns"
            return None
        rates.refine(self.sided.mesh, found.local, marks, divided)
        self.sided, self.division, self.owners = divided.sided, division, divided.owners
        return divided

    def _gain(self, estimate: float) -> float:
        """The estimate over what was predicted: cells that only follow others gain, too."""
        if self.predicted == 0.0 or math.isinf(self.estimator.rates.power):
            return 1.0
        return min(max(estimate / self.predicted, GAIN), 1.0)

    def _standing(self) -> bool:
        """Whether the estimate is small, and has risen far, or not fallen in the last steps."""
        estimates = [step.estimate for step in self.steps]
        late, early = estimates[-PATIENCE:], estimates[:-PATIENCE]
        if estimates[-1] < RISEN * min(estimates) and min(late) <= min(early, default=math.inf):
            return False
        return estimates[-1] < ROUNDING * self.whole

    def _affordable(self) -> float:
        """By how much the mesh may grow; where that is too little, note why."""
        last, request = self.steps[-1], self.request
        growth = request.max_unknowns / last.unknowns
        self.stopped = f"a finer mesh has more than {request.max_unknowns} unknowns"
        if request.budget is not None:
            spent = last.seconds - (self.steps[-2].seconds if len(self.steps) > 1 else 0.0)
            left = request.budget - self.comm.bcast(time.perf_counter() - self.began)
            if left / (RESERVE * spent) < growth:
                growth = left / (RESERVE * spent)
                self.stopped = "the next step would take longer than the time that is left"
        return growth


def _unknowns(sided: SidedMesh, space: fem.FunctionSpace) -> int:
    """The number of dofs that a space of the same kind has on another mesh."""
    topology, count = sided.mesh.topology, 0
    for dim, dofs in enumerate(space.element.basix_element.num_entity_dofs):
        if dofs[0]:
            topology.create_entities(dim)
            count += dofs[0] * topology.index_map(dim).size_global
    return int(count)
