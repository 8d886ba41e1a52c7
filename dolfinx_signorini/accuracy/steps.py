"""The request to the adaptive loop, and the result of each of its steps."""

from collections.abc import Callable
from dataclasses import dataclass

from dolfinx_signorini.accuracy.targets import Target
from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.meshes.refinement import Refinement
from dolfinx_signorini.meshes.sided_meshes import SidedMesh
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem

Pose = Callable[[SidedMesh], BoundConstrainedProblem]

MAX_UNKNOWNS = 1_000_000  # by default: 1 to 11 GB, see `expectations.BYTES`


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


def step_line(step: Step) -> str:
    """Return one step of the loop in words."""
    return (
        f"{step.unknowns:8d} unknowns, error about {step.estimate:.2e}, after {step.seconds:.2f} s"
    )


@dataclass(frozen=True)
class Result:
    """What a step of the loop came to:

        result = Result(step, division, values, remaining, share=1e-6, pose=pose)

    Attributes:
        step: The step.
        division: The division of the mesh, on which the better solution is.
        values: The dofs of this solution on this rank, ghosts included.
        remaining: What each owned cell of the mesh leaves in the error of this solution.
        share: What further solves may leave, relative to the solution.
        pose: What posed the problem.
    """

    step: Step
    division: Refinement
    values: Array
    remaining: Array
    share: float
    pose: Pose


@dataclass(frozen=True)
class Request:
    """What the loop is asked for:

        Request(target("L4"), accuracy=1e-3)

    Attributes:
        target: What is to be accurate.
        accuracy: The largest error allowed; None for no such limit.
        budget: The seconds that may be spent; None for no such limit.
        max_unknowns: The limit on the dofs of a mesh.
        rtol: The natural residual of solves, relative to the data, at most; None for no such limit.
    """

    target: Target
    accuracy: float | None = None
    budget: float | None = None
    max_unknowns: int = MAX_UNKNOWNS
    rtol: float | None = None
