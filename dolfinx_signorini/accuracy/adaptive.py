"""The adaptive loop: solve, estimate, mark, refine, until the solution is as accurate as asked.

Each step solves the problem on a mesh and on the mesh with every cell divided. The difference of
the two solutions, with the measured rates of convergence, estimates the error of the second one,
which is the one that is handed out. The cells that leave most of this error are divided for the
next step. The first mesh is divided everywhere: no estimate of the first step is believed.
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from dolfinx import fem

from dolfinx_signorini.accuracy.cells import Array, Indices, collected, joined, total
from dolfinx_signorini.accuracy.contact_ends import cells_at_contact_ends, rate_at_ends
from dolfinx_signorini.accuracy.indicators import Indicators, difference, indicators, size
from dolfinx_signorini.accuracy.marking import GROWTH, Divided, Outlook, mark, mark_worst
from dolfinx_signorini.accuracy.misfits import obstacle_misfits
from dolfinx_signorini.accuracy.rates import Rates
from dolfinx_signorini.accuracy.targets import Functional, Target, target
from dolfinx_signorini.errors import InputError
from dolfinx_signorini.kinds import callable_, check, instance, optional, positive
from dolfinx_signorini.meshes import SidedMesh, owned_cells
from dolfinx_signorini.problem import SignoriniProblem
from dolfinx_signorini.refinement import Refinement, carried_across, refined
from dolfinx_signorini.solvers.cascade import ascend

MAX_UNKNOWNS = 1_000_000
SAFETY = 1.3  # the estimate over what the measured rates say
SURE = 1.1  # the same in H1, where errors of levels are orthogonal
AIM = 0.9  # estimate aimed at, over the accuracy
LEAST = 0.8  # of the estimate: to fall less is not worth a step
CLOSE = 1.5  # times the accuracy: further steps from here aim lower and lower
GAIN = 0.6  # more than the conforming mesh gains on the prediction is not counted on
SMALLEST_GROWTH = 1.2  # of the number of cells: a smaller one is not worth a step
RESERVE = 1.2  # how much longer than predicted a step may take
PATIENCE = 4  # steps in which the estimate does not fall
ROUNDING = 1e-7  # of the size of the solution
FALLEN = 0.3  # of the estimate before: steps that gain less do not correct the next estimate
CORRECTION = 5.0  # at most

# Up to which factor between the first estimate and the accuracy a degree takes the least time.
ENOUGH = {1: 3.0, 2: 30.0, 3: 1000.0, 4: math.inf}

Pose = Callable[[SidedMesh], SignoriniProblem]
Hidden = Callable[[SignoriniProblem, Target], Array]


@dataclass(frozen=True)
class Step:
    """One step of the adaptive loop:

        print(step.unknowns, step.estimate, step.seconds)

    Attributes:
        unknowns: The number of dofs of the better solution.
        estimate: The estimated error of this solution.
        seconds: Wall-clock seconds since the loop began.
    """

    unknowns: int
    estimate: float
    seconds: float


@dataclass(frozen=True)
class Request:
    """What the loop is asked for:

        Request(target("L4"), accuracy=1e-3)

    Attributes:
        target: What is to be accurate.
        accuracy: The largest error allowed; None for no such limit.
        budget: The seconds that may be spent; None for no such limit.
        max_unknowns: The limit on the dofs of a mesh.
    """

    target: Target
    accuracy: float | None = None
    budget: float | None = None
    max_unknowns: int = MAX_UNKNOWNS


@dataclass(frozen=True)
class AdaptiveSolution:
    """What the adaptive loop found.

    For example:

        found = solve_adaptively(pose, sided, norm="Linf", accuracy=1e-3)
        print(found.problem.u, found.estimate, found.reached)

    Attributes:
        problem: The solved problem of the last step, on the finest mesh.
        sided: This mesh with its sides.
        request: What was asked for.
        stopped: Why the loop ended, in words.
        steps: The steps.
        cells: For each owned cell what the coarse cell around the cell leaves in the error.
    """

    problem: SignoriniProblem
    sided: SidedMesh
    request: Request
    stopped: str
    steps: tuple[Step, ...]
    cells: Array

    @property
    def estimate(self) -> float:
        """The estimated error of the solution."""
        return self.steps[-1].estimate

    @property
    def reached(self) -> bool:
        """Whether the estimate is at most the accuracy; True where none was asked for."""
        return self.request.accuracy is None or self.estimate <= self.request.accuracy

    @property
    def seconds(self) -> float:
        """Wall-clock seconds of the whole loop."""
        return self.steps[-1].seconds


def _poses(value: Any) -> str:
    """The kind of what poses problems: a function, or functions by degree."""
    if isinstance(value, Mapping):
        return next(filter(None, map(callable_, value.values())), "" if value else "is empty")
    return callable_(value)


def solve_adaptively(
    pose: Pose | Mapping[int, Pose],
    sided: SidedMesh,
    *,
    norm: str | Functional = "H1",
    accuracy: float | None = None,
    budget: float | None = None,
    max_unknowns: int = MAX_UNKNOWNS,
    on_step: Callable[[Step], None] = lambda step: None,
    began: float | None = None,
    hidden: Hidden | None = None,
    fit: Callable[[SidedMesh], None] = lambda sided: None,
) -> AdaptiveSolution:
    """Solve a problem on adapted meshes, to an accuracy or for as long as a time allows.

    Args:
        pose: Poses the problem on a mesh. Each mesh is a refinement of the first one. Or such a
            function for each degree of elements that the loop may choose: the first step is done
            with the lowest degree, and tells which degree is going to take the least time.
        sided: The first mesh, which should be coarse, with the sides that `pose` needs.
        norm: The norm of the error, see `norm_names.parse_norm`; or a functional of the solution,
            given as a function that returns the UFL form of its argument.
        accuracy: The largest error allowed, in the unit of the norm.
        budget: The wall-clock seconds of the whole loop; at least two meshes are solved on.
        max_unknowns: The limit on the dofs of a mesh; a mesh with more is not solved on.
        on_step: Is told of each step when the step has been done.
        began: When the seconds began, by `time.perf_counter`; now by default.
        hidden: Returns for each owned cell what the data add to the error inside of the cell, which
            no comparison of solutions shows; its arguments are the solved problem and what is to be
            accurate.
        fit: Moves vertices of a refined mesh onto what the mesh is to follow.

    Returns:
        The best solution that was computed. `reached` tells whether the accuracy was reached.

    Raises:
        InputError: An argument makes no sense, the first mesh has too many unknowns, or the problem
            is refused.
        NotConvergedError: A solve failed.
    """
    if accuracy is None and budget is None:
        raise InputError("give an accuracy or a budget", "accuracy")
    check(
        pose=(pose, _poses),
        sided=(sided, instance(SidedMesh, "a SidedMesh")),
        accuracy=(accuracy, optional(positive)),
        budget=(budget, optional(positive)),
        max_unknowns=(max_unknowns, positive),
        on_step=(on_step, callable_),
        began=(began, optional(instance(float, "a time of time.perf_counter"))),
    )
    request = Request(target(norm), accuracy, budget, max_unknowns)
    poses = dict(pose) if isinstance(pose, Mapping) else {0: pose}
    if not poses:
        raise InputError("give a function that poses the problem", "pose")
    began = time.perf_counter() if began is None else began
    loop = _Loop(poses, sided, request, on_step, began)
    loop.hidden, loop.fit = hidden, fit
    for problem in ascend(lambda level, _: loop.pose(level), loop.levels()):
        loop.problem = problem
    return AdaptiveSolution(
        problem=loop.problem,
        sided=loop.division.sided,
        request=request,
        stopped=loop.stopped,
        steps=tuple(loop.steps),
        cells=loop.outlook.remaining[loop.division.parents],
    )


class _Loop:
    """The loop between the solves: it decides on the next mesh when the last one is solved on.

    Args:
        poses: Functions that pose the problem on a mesh, by the degree of the elements.
        sided: The first mesh.
        request: What is asked for.
        on_step: Is told of each step.
        began: When the seconds began.

    Attributes:
        pose: The function that poses the problem, with elements of the present degree.
        problem: The problem that was solved last.
        division: The division of the present mesh.
        outlook: What the cells of the present mesh leave in the error.
        last: The last solution, the parents of the cells of its mesh, and its uncorrected estimate.
        steps: The steps so far.
        stopped: Why the loop ended.
    """

    problem: SignoriniProblem
    division: Refinement
    outlook: Outlook
    last: tuple[fem.Function, Indices, float]
    hidden: Hidden | None
    fit: Callable[[SidedMesh], None]

    def __init__(
        self,
        poses: Mapping[int, Pose],
        sided: SidedMesh,
        request: Request,
        on_step: Callable[[Step], None],
        began: float,
    ):
        self.poses, self.pose = poses, poses[min(poses)]
        self.sided, self.request, self.on_step = sided, request, on_step
        self.comm, self.began = sided.mesh.comm, began
        self.steps: list[Step] = []
        self.stopped = ""
        self.rounds = 0  # with elements of the present degree
        self.correction = 1.0
        self.predicted = 0.0  # estimate; 0 for none
        self.safety = SURE if request.target.is_energy else SAFETY

    def levels(self) -> Iterator[tuple[SidedMesh, dict[str, Any]]]:
        """Yield the meshes to solve on: a mesh and its division in turn."""
        self.division = refined(self.sided)
        yield self.sided, {}
        self._require_room()
        self._begin()
        while True:
            u = self.problem.u
            yield self.division.sided, {}
            found = indicators(u, self.problem, self.division.parents, self.request.target)
            if self.rounds:
                self.rates.measure(found.local)
            ends = cells_at_contact_ends(self.problem, self.division.parents, len(found.cells))
            self.rates.limit(ends, rate_at_ends(self.request.target))
            self._estimate(found)
            self._note()
            if self._takes_another_degree():
                yield self.sided, {}
                self._begin()
                continue
            divided = self._next_mesh(found)
            if divided is None:
                return
            yield divided.sided, {}

    def _require_room(self) -> None:
        needed = _unknowns(self.division.sided, self.problem.space)
        if needed > self.request.max_unknowns:
            message = f"the coarsest meshes need {needed}, not {self.request.max_unknowns}"
            raise InputError(message, "max_unknowns")

    def _begin(self) -> None:
        """Begin the rounds with elements of one degree, on the mesh that was just solved on."""
        space, target = self.problem.space, self.request.target
        degree, dimension = space.element.basix_element.degree, space.mesh.topology.dim
        order, power, dual = target.order(degree), target.power, target.weighted
        self.rates = Rates(order, power, len(owned_cells(space.mesh)), dimension, dual)
        self.rounds, self.correction, self.predicted = 0, 1.0, 0.0

    def _takes_another_degree(self) -> bool:
        """Choose the degree when the first step with the lowest one has been done."""
        accuracy, lowest = self.request.accuracy, min(self.poses)
        if accuracy is None or len(self.steps) > 1:
            return False
        ratio = self.steps[0].estimate / accuracy
        best = next((k for k in sorted(self.poses) if ratio <= ENOUGH.get(k, math.inf)), lowest)
        more = (best / lowest) ** self.sided.mesh.topology.dim if lowest else 1.0
        room = more * self.steps[0].unknowns <= self.request.max_unknowns
        if best == lowest or not room or self._affordable() < SMALLEST_GROWTH * more:
            return False
        self.pose = self.poses[best]
        return True

    def _estimate(self, found: Indicators) -> None:
        """Estimate the error of the last solution.

        The estimate before is tried out: if the solution has moved by more than the estimate has
        fallen, all estimates are too small by about this ratio.
        """
        self.outlook = self.rates.outlook(found.cells)
        power = self.rates.power
        whole = total(found.cells, power, self.comm)
        share = total(self.outlook.remaining, power, self.comm) / whole if whole > 0.0 else 1.0
        estimate = found.difference * share
        estimate = self._with_hidden(self._with_misfits(estimate))
        if self.rounds:
            u, parents, before = self.last
            cells = self.owners[self.division.parents]
            old = carried_across(u, parents, self.problem.space, cells)
            moved = size(difference(self.problem.u, old), self.request.target)
            fallen = math.sqrt(abs(before**2 - estimate**2))
            if before - estimate > FALLEN * before:
                self.correction = min(max(moved / fallen, 1.0), CORRECTION)
        self.last = self.problem.u, self.division.parents, estimate
        self.estimate = estimate * self.correction

    def _with_misfits(self, estimate: float) -> float:
        """Add to an estimate, and to the outlook, what the obstacle shows between the nodes."""
        norm = self.request.target.norm
        if norm is None or norm.boundary:
            return estimate
        misfits = obstacle_misfits(self.problem, norm)
        hidden = collected(misfits, self.division.parents, len(self.outlook.remaining), norm.p)
        whole = total(hidden, norm.p, self.comm)
        if whole == 0.0:
            return estimate
        if self.request.target.weighted:  # parts of cells add up as they are
            parts = hidden**norm.p / whole ** (norm.p - 1.0)
            remaining = self.outlook.remaining + parts
        else:
            remaining = joined(self.outlook.remaining, hidden, norm.p)
        self.outlook = replace(self.outlook, remaining=remaining)
        return float(joined(np.array(estimate), np.array(whole), norm.p))

    def _with_hidden(self, estimate: float) -> float:
        """Add to an estimate, and to the outlook, what the data hide inside of cells."""
        if self.hidden is None:
            return estimate
        values = self.hidden(self.problem, self.request.target)
        power, remaining = self.rates.power, self.outlook.remaining
        hidden = collected(values, self.division.parents, len(remaining), power)
        whole = total(remaining, power, self.comm)
        if total(hidden, power, self.comm) == 0.0:
            return estimate
        remaining = np.maximum(remaining * (estimate / whole if whole > 0.0 else 1.0), hidden)
        self.outlook = replace(self.outlook, remaining=remaining)
        return max(estimate, total(remaining, power, self.comm))

    def _note(self) -> None:
        """Note the step."""
        seconds = self.comm.bcast(time.perf_counter() - self.began)
        step = Step(self.problem.unknowns, self.safety * self.estimate, seconds)
        self.steps.append(step)
        self.on_step(step)

    def _next_mesh(self, found: Indicators) -> Divided | None:
        """Divide the mesh for the next step; None, with the reason, if the loop ends here."""
        accuracy, estimate = self.request.accuracy, self.steps[-1].estimate
        self.rounds += 1
        if self.rounds == 1:
            marks = mark_worst(self.sided, found.cells, self.rates.order, self.rates.power)
            divided = marks.apply(self.sided)
        else:
            if accuracy is not None and estimate <= accuracy:
                self.stopped = "the accuracy is reached"
                return None
            if self._standing():
                self.stopped = "rounding: the estimate does not fall any more"
                return None
            goal = 0.0
            if accuracy is not None:
                close = sum(step.estimate <= CLOSE * accuracy for step in self.steps)
                goal = AIM * accuracy / (estimate * self._gain(estimate))
                goal = min(goal, LEAST ** max(close, 1))
            growth = self._affordable()
            if growth < SMALLEST_GROWTH:
                return None
            marks = mark(self.sided, self.outlook, goal, min(growth, GROWTH))
            divided = marks.apply(self.sided)
            self.predicted = marks.factor * estimate
        self.fit(divided.sided)
        division = refined(divided.sided)
        if _unknowns(division.sided, self.problem.space) > self.request.max_unknowns:
            self.stopped = f"a finer mesh has more than {self.request.max_unknowns} unknowns"
            return None
        self.rates.refine(self.sided.mesh, found.local, marks, divided)
        self.sided, self.division, self.owners = divided.sided, division, divided.owners
        return divided

    def _gain(self, estimate: float) -> float:
        """The estimate over what was predicted: cells that only follow others gain, too."""
        local = not self.request.target.weighted and not math.isinf(self.rates.power)
        if self.predicted == 0.0 or not local:
            return 1.0
        return min(max(estimate / self.predicted, GAIN), 1.0)

    def _standing(self) -> bool:
        """Whether the estimate is small, and has not fallen in the last steps."""
        estimates = [step.estimate for step in self.steps]
        if len(estimates) <= PATIENCE or min(estimates[-PATIENCE:]) <= min(estimates[:-PATIENCE]):
            return False
        return estimates[-1] < ROUNDING * size(self.problem.u, self.request.target)

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
