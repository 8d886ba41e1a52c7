"""The cascade from coarse to fine meshes: contact for about the price of one linear solve.

A coarse solution predicts the active set on the next mesh; one linear solve with this set follows,
and TAO accepts the result. `solve_cascade` is the driver of all computations on several meshes, and
`coarse_levels` is the rule for these meshes.
"""

import gc
from collections.abc import Callable, Sequence
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError, together
from dolfinx_signorini.base.kinds import callable_, check, integer, optional, sequence
from dolfinx_signorini.solvers.pressure import ContactState
from dolfinx_signorini.solvers.tao import METHODS as TAO_METHODS

METHODS = ("cascade", *TAO_METHODS)
COARSEST = {2: 64, 3: 16}  # cells across: up to here a solution from scratch costs little
# Between the widths of successive meshes, and of a mesh and its coarse space: patch problems bridge
# 8, but not 11, and smaller ones cost more than the linear solves that they save.
RATIO = {2: 8, 3: 4}
# Generations of Python's collector that have the objects made last. The rules by which UFL
# transforms forms refer to themselves, and by the forms to meshes. In later generations such rules
# keep hundreds of communicators of meshes, and loops on two ranks took 1.7 times as long.
NEW = 1


class Solvable(Protocol):
    """What the cascade needs of a problem, for example of a `SignoriniProblem`."""

    @property
    def comm(self) -> MPI.Comm:
        """The communicator of the mesh."""

    def solve(
        self, method: str = ..., *, coarse: ContactState | None = ..., rtol: float | None = ...
    ) -> fem.Function:
        """Solve the problem."""

    def contact_state(self) -> ContactState:
        """Return what a finer mesh starts from."""

    def destroy(self) -> None:
        """Free the PETSc objects."""


Problem = TypeVar("Problem", bound=Solvable)
Level = TypeVar("Level")


def coarse_levels(
    n: int, dimension: int = 2, *, coarsest: int | None = None, ratio: int | None = None
) -> list[int]:
    """Return the levels of a cascade below a mesh, coarsest first.

    All levels are odd or all are even, like n: a detachment point in the middle of the unit
    square's side lies in the middle of a cell or on a node on every level.

    Args:
        n: The number of cells across the domain.
        dimension: The dimension of space.
        coarsest: The number of cells across up to which a mesh needs no coarser level; by default
            64 in the plane and 16 in space.
        ratio: The ratio of successive levels; by default 8 in the plane and 4 in space.

    Returns:
        The numbers of cells across.

    Raises:
        InputError: An argument is out of range.
    """
    check(n=(n, integer(1)), dimension=(dimension, integer(2, 3)))
    check(coarsest=(coarsest, optional(integer(1))), ratio=(ratio, optional(integer(2))))
    coarsest = COARSEST[dimension] if coarsest is None else coarsest
    ratio = RATIO[dimension] if ratio is None else ratio
    levels: list[int] = []
    while n > coarsest:
        n = n // ratio + (n // ratio + n) % 2
        if n == 0:
            break
        levels.insert(0, n)
    return levels


class Cascade(Generic[Level, Problem]):
    """Problems on one mesh after the other, each started from the contact state of the one before.

    The meshes need not be nested. A problem is destroyed when the problem of the next level has
    been posed, and the last one where an exception leaves the `with` statement:

        with Cascade(make_problem) as cascade:
            for cells in (8, 64, 512):
                problem = cascade.solve(cells)

    Args:
        make_problem: See `solve_cascade`.
        coarse: A contact state to start the first level from.

    Attributes:
        problem: The problem of the last level; None before the first one.
        coarse: The contact state that the last level started from.
    """

    def __init__(
        self,
        make_problem: Callable[[Level, Problem | None], Problem],
        coarse: ContactState | None = None,
    ):
        self._make_problem, self.coarse = make_problem, coarse
        self.problem: Problem | None = None

    def __enter__(self) -> "Cascade[Level, Problem]":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None and self.problem is not None:
            self.problem.destroy()
        del self._make_problem  # which may refer to the owner of the cascade, and so to all meshes
        gc.collect(NEW)

    def solve(
        self,
        level: Level,
        start: Callable[[Problem], fem.Function] | None = None,
        **keywords: Any,
    ) -> Problem:
        """Pose and solve the problem of the next level.

        Args:
            level: The level.
            start: Returns for the problem what its linear solves start from; zero by default.
            keywords: Those of the problem's own `solve`.

        Raises:
            InputError: The problem is refused.
            NotConvergedError: The solve failed.
        """
        posed = self._make_problem(level, self.problem)
        check(make_problem=(posed, returned_problem))
        if self.problem is not None:
            self.coarse = self.problem.contact_state()
            self.problem.destroy()
        self.problem = posed
        gc.collect(NEW)
        known = self.coarse if keywords.get("method", "cascade") == "cascade" else None
        begun = {} if start is None else {"start": start(posed)}
        posed.solve(coarse=known, **begun, **keywords)
        return posed


def returned_problem(value: Any) -> str:
    """The kind of what functions return that pose a problem."""
    known = hasattr(value, "contact_state")
    return "" if known else f"must return a problem, not {type(value).__name__}"


def solve_cascade(
    make_problem: Callable[[Level, Problem | None], Problem],
    levels: Sequence[Level],
    *,
    method: str = "cascade",
    rtol: float | None = None,
    coarse_rtol: float | None = None,
    coarse: ContactState | None = None,
    on_level: Callable[[Problem], None] = lambda problem: None,
) -> Problem:
    """Solve a problem on several meshes from coarse to fine, and return the finest problem, solved.

    Each level starts from the contact state of the level before. The meshes need not be nested.

    Args:
        make_problem: Poses the problem of a level, for example of a number of cells per side. The
            second argument is the solved problem of the level before, or None, for whoever needs
            more of the coarser solution than the cascade does.
        levels: The levels, coarsest first.
        method: The method of the last level, see `SignoriniProblem.solve`.
        rtol: The natural residual to reach on the last level, relative to the data; by default the
            solve stops where the discretisation error hides the rest, see `SignoriniProblem.solve`.
        coarse_rtol: The natural residual to reach on the levels before; `rtol` by default.
        coarse: A contact state to start the first level from.
        on_level: Is told of the problem of each level when the problem has been solved.

    Raises:
        InputError: The cascade has no level, or a problem is refused.
        NotConvergedError: A level did not converge.
    """
    check(
        make_problem=(make_problem, callable_),
        levels=(levels, sequence(lambda level: "", "a list of levels")),
        on_level=(on_level, callable_),
    )
    if not len(levels):
        raise InputError("a cascade needs at least one", "levels")
    check_method(method)
    checked_tolerance(rtol, 1.0)
    checked_tolerance(coarse_rtol, 1.0, "coarse_rtol")
    loose = {"rtol": rtol if coarse_rtol is None else coarse_rtol}
    with Cascade(make_problem, coarse) as cascade:
        for number, level in enumerate(levels, start=1):
            last = number == len(levels)
            problem = cascade.solve(level, **({"method": method, "rtol": rtol} if last else loose))
            with together(problem.comm, "on_level"):
                on_level(problem)
    return problem


def check_method(method: Any) -> None:
    """Refuse what is no name of a solver.

    Raises:
        InputError: The subject is "method".
    """
    if not isinstance(method, str) or method not in METHODS:
        raise InputError(f"unknown {method!r}, known are {', '.join(METHODS)}", "method")


def checked_tolerance(rtol: Any, default: float, subject: str = "rtol") -> float:
    """Return a tolerance between 0 and 1, or the default in place of None.

    Args:
        rtol: The tolerance, or None.
        default: The default.
        subject: The name of the argument.

    Raises:
        InputError: The tolerance is no number between 0 and 1.
    """
    if rtol is None:
        return default
    if not isinstance(rtol, int | float | np.number) or not 0.0 < rtol < 1.0:
        raise InputError(f"must lie between 0 and 1, not {rtol}", subject)
    return float(rtol)
