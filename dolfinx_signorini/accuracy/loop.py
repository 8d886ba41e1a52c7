"""The loop between the solves: estimate, mark, refine, and choose the degree.

Each step solves the problem on a mesh and on the mesh with every cell divided. The second solution
is the one that is handed out. The cells that leave most of its error are divided for the next step.
"""

import functools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfinx_signorini.accuracy.cells import volumes
from dolfinx_signorini.accuracy.estimates import Estimator, Reader
from dolfinx_signorini.accuracy.marking import GROWTH, SAFETY, Divided, mark_for_all
from dolfinx_signorini.accuracy.moved_sides import MovedSides
from dolfinx_signorini.accuracy.quadrature_errors import missed_of_functional
from dolfinx_signorini.accuracy.steps import Pose, Request, Result, Step
from dolfinx_signorini.accuracy.targets import checked_target, size
from dolfinx_signorini.accuracy.terms import Solution, Solved
from dolfinx_signorini.base import tolerances
from dolfinx_signorini.base.errors import InputError, NotConvergedError, together
from dolfinx_signorini.base.kinds import check
from dolfinx_signorini.base.logs import log
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.data.powers import SingularPoint
from dolfinx_signorini.meshes.curved_sides import CurvedSides, TurnedOverError
from dolfinx_signorini.meshes.refinement import Refinement, refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, longest_side
from dolfinx_signorini.problem.bound_constrained import DEFAULT_RTOL, BoundConstrainedProblem
from dolfinx_signorini.solvers.cascade import Cascade, returned_problem
from dolfinx_signorini.solvers.stop import SHARE

PATIENCE = 4  # steps in which the estimate does not fall
# Why a loop ended, in its first words.
REACHED, ROUNDED, CURVES = "the accuracy is reached", "rounding", "geometry"
ROUGH = (
    "norm: a finer quadrature rule changes the functional of this solution by {:.0e}, more than "
    "its error does; give the integral a higher quadrature_degree, or a weight that jumps on facets"
)


def posed(pose: Pose, sided: SidedMesh) -> BoundConstrainedProblem:
    """Pose a problem on a mesh by the user's function; the call is collective.

    Raises:
        InputError: The function raises an exception, or poses a problem on another mesh.
    """
    with together(sided.mesh.comm, "pose"):
        problem = pose(sided)
        check(pose=(problem, returned_problem))
    if isinstance(problem, BoundConstrainedProblem) and problem.space.mesh is not sided.mesh:
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
        read: Returns what is known of the coefficients of a problem; None where nothing is read.
        fit: Moves vertices of a refined mesh onto what the mesh is to follow.
        curves: The curves that sides of the mesh stand for.
        singular: Where data make the solution like a power of the distance.

    Attributes:
        pose: The function that poses the problem, with elements of the present degree.
        problem: The problem that was solved last.
        division: The division of the present mesh.
        rounds: The number of steps with elements of the present degree.
        estimator: The estimates, with elements of the present degree.
        steps: The steps so far.
        notes: What is not known of the norm, in words.
        best: The result with the least estimate.
        last: The result of the problem that was solved last.
        whole: The size of the last solution in the norm that is asked for.
        rounded: Whether the residual that the last estimate asks for is below rounding.
        early: Whether solves may stop where the discretisation error hides the rest; never where a
            residual is asked for.
        stopped: Why the loop ended.
        share: What solves may leave, relative to the solution.
    """

    problem: BoundConstrainedProblem
    division: Refinement
    estimator: Estimator
    best: Result
    last: Result
    whole: float
    _cascade: Cascade[SidedMesh, BoundConstrainedProblem]

    def __init__(
        self,
        poses: Mapping[int, Pose],
        sided: SidedMesh,
        request: Request,
        on_step: Callable[[Step], None],
        began: float,
        read: Reader | None,
        fit: Callable[[SidedMesh], None],
        curves: CurvedSides,
        singular: Sequence[SingularPoint],
    ):
        self.poses, self.pose = poses, poses[min(poses)]
        self.sided, self.request, self.on_step = sided, request, on_step
        self.comm, self.began, self.read, self.fit = sided.mesh.comm, began, read, fit
        self.curves, self._singular = curves, singular
        self.steps: list[Step] = []
        self.notes: list[str] = []
        self.rounded, self.early, self.stopped = False, request.rtol is None, ""
        self.share = math.inf

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
            try:
                self._go_on()
            except TurnedOverError as error:
                if not self.steps:
                    raise
                self.stopped = f"{CURVES} {error.message}"
            self._solve_best_again()
            self._check_functional()

    def _go_on(self) -> None:
        """Estimate, mark, refine and solve until the loop ends."""
        while True:
            self._estimate(self._solve_divided())
            if self._takes_another_degree():
                self.division = refined(self.sided)  # with the vertices before they were moved
                self._solve(self.sided)
                self._begin()
                continue
            divided = self._next_mesh()
            if divided is None:
                return
            self._solve(divided.sided)

    def _solve_divided(self) -> Solved:
        """Solve on the mesh with every cell divided: from zero, so that no error is in both."""
        coarse = Solution(self.problem.u, self.problem.forces)
        self._solve(self.division.sided)
        return Solved(coarse, self.problem, self.division.parents, self.request.target)

    def _solve(
        self,
        sided: SidedMesh,
        start: Callable[[BoundConstrainedProblem], fem.Function] | None = None,
    ) -> None:
        """Solve on a mesh, to the residual that is asked for or to the one that rounding allows."""
        keywords = self.keywords_on(sided.mesh)
        solve: Callable[..., object] = functools.partial(self._cascade.solve, sided, start)
        while True:
            try:
                solve(**keywords)
                break
            except NotConvergedError:
                rtol = 10.0 * keywords.get("rtol", DEFAULT_RTOL)
                most = self.request.rtol or SOLVED
                if rtol > most or self._cascade.problem is None:
                    raise
                keywords = {"rtol": rtol}
                solve = functools.partial(self._cascade.problem.solve, coarse=self._cascade.coarse)
        assert self._cascade.problem is not None
        self.problem = self._cascade.problem

    def _estimate(self, solved: Solved) -> None:
        """Compare the solution with the one on the mesh before the division, and note the step."""
        target, estimator = self.request.target, self.estimator
        estimator.compare(solved)
        moved = MovedSides(self.curves, self.sided, self.division, solved.fine.u, target)
        if moved:
            self._solve(self.division.sided)
            estimator.add_polygon(moved, replace(solved, fine=self.problem))
        self._doubt(estimator.doubt)
        self._note(estimator.estimate)

    def _solve_best_again(self) -> None:
        """Solve from the best result again if the results since are spoilt, or not complete."""
        spoilt, best = self.stopped.startswith((ROUNDED, CURVES)), self.best.division.sided
        if not spoilt or self.problem.space.mesh is best.mesh:
            return
        self.last, self.pose, self.share = self.best, self.best.pose, self.best.share

        def start(problem: BoundConstrainedProblem) -> fem.Function:
            found = fem.Function(problem.space)
            found.x.array[:] = self.best.values
            return found

        self._solve(best, start)
        seconds = self.comm.bcast(time.perf_counter() - self.began)
        self._tell(replace(self.best.step, seconds=seconds))

    def _check_functional(self) -> None:
        """Tell where the functional's own rule leaves more than the error of the solution."""
        functional, accuracy = self.request.target.functional, self.request.accuracy or 0.0
        missed = 0.0 if functional is None else missed_of_functional(functional, self.problem.u)
        if missed > max(self.steps[-1].estimate, accuracy):
            self._doubt(ROUGH.format(missed))

    def _doubt(self, text: str) -> None:
        """Tell what the estimate does not know, once."""
        if text and text not in self.notes:
            log.warning("%s", text)
            self.notes.append(text)

    def _require_room(self) -> None:
        needed = _unknowns(self.sided, self.problem.space)
        if needed > self.request.max_unknowns:
            message = f"the coarsest meshes need {needed}, not {self.request.max_unknowns}"
            raise InputError(message, "max_unknowns")

    def _begin(self) -> None:
        """Begin the rounds with elements of one degree, on the mesh that was just solved on."""
        target = checked_target(self.request.target, self.problem.space)
        self.request = replace(self.request, target=target)
        self.estimator = Estimator(self.problem.space, target, self.read, self._singular)
        self.rounds = 0

    def _takes_another_degree(self) -> bool:
        """Choose the degree when the first step with the lowest one has been done."""
        accuracy, lowest = self.request.accuracy, min(self.poses)
        if accuracy is None or len(self.steps) > 1:
            return False
        estimate = self.steps[0].estimate
        if len(self.poses) == 1 or estimate > self.whole:  # which tells nothing
            return False
        dim, order = self.sided.mesh.topology.dim, self.request.target.order
        # Along curves of d - 1 dimensions no degree has more than the lowest order.
        along = self.estimator.along_curves
        ratio, curved = ((part / accuracy) for part in (estimate - along, along))
        least = max(curved ** ((dim - 1) / order(1)), 1.0)
        # A mesh has k^d dofs for each of its cells, whose number grows with the power d / order.
        best = min(self.poses, key=lambda k: (k**dim * max(ratio ** (dim / order(k)), least), k))
        more = (best / lowest) ** dim
        room = more * self.steps[0].unknowns <= self.request.max_unknowns
        if best == lowest or not room or self._affordable() < SAFETY * more:
            return False
        self.pose = self.poses[best]
        return True

    def _note(self, estimate: float) -> None:
        """Note the step, after which the algebraic error is to be far below the estimate."""
        self.whole = size(self.problem.u, self.request.target)
        if self.whole > 0.0:
            self.share = SHARE * estimate / self.whole
            loss = self._loss_on(self.division.sided.mesh)
            self.rounded = self.share < tolerances.ROUNDING * loss
            # The stop of a solve by default looks at values, and neither at derivatives nor at a
            # functional in which the errors of the elements cancel.
            self.early &= loss == 1.0 and self.estimator.found.algebra <= SHARE * estimate
        seconds = self.comm.bcast(time.perf_counter() - self.began)
        step = Step(self.problem.unknowns, estimate, seconds)
        values, remaining = self.problem.u.x.array.copy(), self.estimator.prediction.remaining
        self.last = Result(step, self.division, values, remaining, self.share, self.pose)
        if not self.steps or estimate < self.best.step.estimate:
            self.best = self.last
        self._tell(step)

    def _tell(self, step: Step) -> None:
        """Note a step, and tell the user's function of the step."""
        self.steps.append(step)
        with together(self.comm, "on_step"):
            self.on_step(step)

    def keywords_on(self, domain: Mesh) -> dict[str, Any]:
        """The keywords of a solve on a mesh, whose smallest cells tell what may be left."""
        most = self.request.rtol or DEFAULT_RTOL
        rtol = self.share / self._loss_on(domain)
        if self.early and rtol >= DEFAULT_RTOL:
            return {}
        # Half of the share: no estimate of a norm has what a solve leaves.
        return {"rtol": min(max(0.5 * rtol, tolerances.ROUNDING), most)}

    @property
    def _lost(self) -> float:
        """The power of 1/h that derivatives in L^p, p > d, lose of an error of values; or 0.

        On cells of size h in d dimensions, differences of values are divided by h, which is
        h^(d/p - 1) in the norm.
        """
        norm, dim = self.request.target.norm, self.sided.mesh.topology.dim
        if norm is None or norm.derivatives == 0:
            return 0.0
        return max(1.0 - dim / norm.p, 0.0)

    def _loss_on(self, domain: Mesh) -> float:
        """By how much the smallest cells raise the share of an algebraic error in derivatives."""
        if self._lost == 0.0:
            return 1.0
        smallest = float(volumes(domain).min(initial=math.inf)) ** (1.0 / domain.topology.dim)
        smallest = self.comm.allreduce(smallest, op=MPI.MIN)
        return float((longest_side(domain) / smallest) ** self._lost)

    def _smallest_size(self) -> float:
        """The size of cells on which rounding leaves in derivatives what is asked for; 0 for none.

        Divisions beyond that raise the error.
        """
        asked = self.request.accuracy or self.steps[-1].estimate
        if self._lost == 0.0 or asked >= self.whole:
            return 0.0
        share = (tolerances.ROUNDING * self.whole / asked) ** (1.0 / self._lost)
        return float(share * longest_side(self.sided.mesh))

    def _next_mesh(self) -> Divided | None:
        """Divide the mesh for the next step; None, with the reason, if the loop ends here.

        Where the first two meshes see no error at all, all cells are divided.
        """
        accuracy, estimate = self.request.accuracy, self.steps[-1].estimate
        self.rounds += 1
        blind = self.rounds == 1 and estimate == 0.0
        if not blind and self._is_done(accuracy is not None and estimate <= accuracy):
            return None
        # A step costs as much as all before: what gains too little is not worth a step.
        goal = min(accuracy / estimate, 1.0 / SAFETY) if accuracy and estimate else 0.0
        growth = self._affordable()
        if growth < SAFETY:
            if self.rounds > 1:
                return None
            growth = SAFETY  # the seconds of the first step have those of the compiler
        predictions = self.estimator.predictions
        growth, smallest = min(growth, GROWTH), self._smallest_size()
        marks = mark_for_all(self.sided, predictions, goal, growth, smallest)
        if blind:
            marks = replace(marks, levels=np.ones(len(marks.levels)))
        elif not highest(self.comm, marks.levels) > 0.0:
            self.stopped = f"{ROUNDED}: the cells with the error cannot be divided any more"
            return None
        divided = marks.apply(self.sided, self.curves.fit)
        self.fit(divided.sided)
        if _unknowns(divided.sided, self.problem.space) > self.request.max_unknowns:
            self.stopped = f"a finer mesh has more than {self.request.max_unknowns} unknowns"
            return None
        self.estimator.rates.refine(self.sided.mesh, self.estimator.found.local, marks, divided)
        self.sided, self.division = divided.sided, refined(divided.sided)
        return divided

    def _is_done(self, reached: bool) -> bool:
        """Whether no step is to follow, and note why.

        Args:
            reached: Whether the last estimate is at most the accuracy.
        """
        rates = self.estimator.rates
        infinite = self.estimator.infinite_at(
            rates.singular_corners if reached else rates.standing_corners
        )
        if infinite and self.steps[-1].estimate > DEFAULT_RTOL * self.whole:
            self.stopped = infinite
        elif reached:
            self.stopped = REACHED
        elif self._standing():
            self.stopped = f"{ROUNDED}: the estimate does not fall any more"
        else:
            return False
        return True

    def _standing(self) -> bool:
        """Whether the estimate is as small as rounding, and has not fallen in the last steps.

        One step tells where solves cannot be as accurate as the estimate wants them to be.
        """
        estimates, last = [step.estimate for step in self.steps], 1 if self.rounded else PATIENCE
        late, early = estimates[-last:], estimates[:-last]
        fallen = SAFETY * min(late) < min(early, default=math.inf)
        return not fallen and late[-1] < DEFAULT_RTOL * self.whole

    def _affordable(self) -> float:
        """By how much the mesh may grow; where that is too little, note why."""
        last, request = self.steps[-1], self.request
        growth = request.max_unknowns / last.unknowns
        self.stopped = f"a finer mesh has more than {request.max_unknowns} unknowns"
        if request.budget is not None:
            spent = last.seconds - (self.steps[-2].seconds if len(self.steps) > 1 else 0.0)
            left = request.budget - self.comm.bcast(time.perf_counter() - self.began)
            if left / (SAFETY * spent) < growth:
                growth = left / (SAFETY * spent)
                self.stopped = "the next step would take longer than the time that is left"
        return growth


def _unknowns(sided: SidedMesh, space: fem.FunctionSpace) -> int:
    """The number of dofs that a space of the same kind has on a mesh with every cell divided.

    The nodes are those that elements of twice the degree have on the mesh itself.
    """
    topology, inside = sided.mesh.topology, 2 * space.element.basix_element.degree - 1
    nodes = 0
    for dim in range(topology.dim + 1):
        topology.create_entities(dim)
        nodes += math.comb(inside, dim) * topology.index_map(dim).size_global
    return nodes * int(space.dofmap.bs)
