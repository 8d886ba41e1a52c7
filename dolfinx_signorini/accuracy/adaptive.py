"""The adaptive loop: solve, estimate, mark, refine, until the solution is as accurate as asked."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from dolfinx_signorini.accuracy.estimates import Reader
from dolfinx_signorini.accuracy.first_mesh import Resolved, first_mesh
from dolfinx_signorini.accuracy.loop import REACHED, Loop, posed
from dolfinx_signorini.accuracy.problem_data import (
    STIFFNESS,
    coefficients_of,
    data_of,
    unknown_between_nodes,
)
from dolfinx_signorini.accuracy.steps import MAX_UNKNOWNS, Pose, Request, Step
from dolfinx_signorini.accuracy.targets import Functional, target
from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.kinds import (
    TRUTH,
    by_text,
    callable_,
    check,
    instance,
    integer,
    optional,
    positive,
    sequence,
    simplices,
)
from dolfinx_signorini.base.logs import log
from dolfinx_signorini.data.coefficients import Coefficients
from dolfinx_signorini.data.interfaces.following import follow
from dolfinx_signorini.data.interfaces.piecewise_forms import data_in_pieces
from dolfinx_signorini.data.sampling import Datum
from dolfinx_signorini.meshes.curved_sides import CurvedSides, Projection, arcs
from dolfinx_signorini.meshes.sided_meshes import SidedMesh
from dolfinx_signorini.norms.pointwise import Quantity
from dolfinx_signorini.problem.bound_constrained import DEFAULT_RTOL, BoundConstrainedProblem
from dolfinx_signorini.solvers.cascade import checked_tolerance

POLYGON = "the polygon is taken as the domain"
BENDS = (
    "side %r: %s, and a smooth curve is up to about %.0e away; `geometry`, or [domain.curves] in a "
    "scene file, tells the curve"
)
BENDS_INSIDE = (
    "%s: %s there, and a smooth curve is up to about %.0e away; curves inside of the domain cannot "
    "be told, and a finer first mesh is nearer to them"
)


@dataclass(frozen=True)
class AdaptiveSolution:
    """What the adaptive loop found.

    For example:

        found = solve_adaptively(pose, sided, norm="Linf", accuracy=1e-3)
        print(found.problem.u, found.estimate, found.reached)

    Attributes:
        problem: The solved problem of the last step, on the finest mesh.
        sided: The finest mesh with its sides.
        request: What was asked for.
        stopped: Why the loop ended, in words.
        steps: The steps.
        cells: For each owned cell what the coarse cell around the cell leaves in the error.
        polygonal: The sides whose facets bend like those of a curve that is not known, "edge of R"
            for the edge of a region R inside of the domain, "all" for the boundary without a name.
            These facets are taken as the domain, and the estimate knows of no curve. For each side
            about how far a smooth curve is from the first mesh.
        notes: What is not known of the data, or not resolved by the first mesh, in words.
    """

    problem: BoundConstrainedProblem
    sided: SidedMesh
    request: Request
    stopped: str
    steps: tuple[Step, ...]
    cells: Array
    polygonal: Mapping[str, float]
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return (
            f"<AdaptiveSolution: {self.steps[-1].unknowns} unknowns, "
            f"error about {self.estimate:.1e} in {self.request.target.name}; {self.stopped}>"
        )

    @property
    def estimate(self) -> float:
        """The estimated error of the solution."""
        return self.steps[-1].estimate

    @property
    def reached(self) -> bool:
        """Whether the estimate is at most the accuracy; True where none was asked for.

        The estimate of the first step, of which no rate of convergence is known, does not count.
        The domain is that of the mesh where `polygonal` names a side, and `stopped` says so.
        """
        return self.request.accuracy is None or self.stopped.startswith(REACHED)

    @property
    def seconds(self) -> float:
        """Wall-clock seconds of the whole loop."""
        return self.steps[-1].seconds


def _poses(value: Any) -> str:
    """The kind of what poses problems: a function, or functions by degree."""
    if not isinstance(value, Mapping):
        return callable_(value)
    if not value:
        return "is empty"
    degrees = sequence(integer(1), "degrees")(value.keys())
    return degrees or next(filter(None, map(callable_, value.values())), "")


def _sided(value: Any) -> str:
    """The kind of meshes with sides that can be refined."""
    message = instance(SidedMesh, "a SidedMesh")(value)
    return message or simplices(2, 3, straight=True)(value.mesh)


def solve_adaptively(
    pose: Pose | Mapping[int, Pose],
    sided: SidedMesh,
    *,
    norm: str | Functional = "H1",
    of: Quantity | None = None,
    accuracy: float | None = None,
    budget: float | None = None,
    max_unknowns: int = MAX_UNKNOWNS,
    rtol: float | None = None,
    on_step: Callable[[Step], None] = lambda step: None,
    geometry: Mapping[str, Projection | None] | None = None,
    read_data: bool = True,
) -> AdaptiveSolution:
    """Solve a problem on adapted meshes, to an accuracy or for as long as a time allows.

    Args:
        pose: Poses the problem on a mesh. Each mesh is a refinement of the first one, up to
            vertices that are moved and edges that are split, along jumps of the diffusion and at
            singular points of data, see `read_data`. Or such a function for each degree of elements
            that the loop may choose: the first step is done with the lowest degree, and tells which
            degree takes least time.
        sided: The first mesh, which should be coarse, with the sides that `pose` needs.
        norm: The norm of the error, see `norm_names.parse_norm`; or a functional of the solution,
            given as a function that returns the UFL form of its argument. The estimate is the error
            of the solution in the functional; `notes` tell where the functional's own quadrature
            rule leaves more.
        of: What of the solution the L^p norm is of, a function that returns a UFL expression,
            linear in the first derivatives of its argument: the stress, or for the energy norm
            `weighted_strain`. By default the norm is that of the solution.
        accuracy: The largest error allowed, in the unit of the norm.
        budget: The wall-clock seconds of the whole loop; at least two meshes are solved on.
        max_unknowns: The limit on the dofs of a mesh; a mesh with more is not solved on.
        rtol: The natural residual of the solves, relative to the data, at most; by default solves
            stop where the estimated error hides what they leave.
        on_step: Is told of each step when the step has been done.
        geometry: For curved sides the projection onto the curve or surface, a function of points,
            shape (3, points), that returns the nearest points of the curve; "all" stands for the
            whole boundary. New vertices of the side go onto the curve, and what facets leave in
            the error is part of the estimate. The functions are called on rank 0 alone. None in
            place of a function: the facets are the domain.
        read_data: Whether forms and obstacle are read, where they are UFL expressions of the
            coordinates. The first mesh is refined until polynomials on its cells follow the data,
            and fitted to jumps of the diffusion, so that no narrow feature is overlooked; in the
            plane it has vertices where data are like a power of the distance from a point, and
            where they jump or have a kink on a side. Data that jump inside of cells are integrated
            piece by piece, and count in the estimate.

    Returns:
        The best solution that was computed. `reached` tells whether the accuracy was reached.

    Raises:
        InputError: An argument makes no sense, the first mesh has too many unknowns or is too
            coarse for the geometry, or the problem is refused.
        NotConvergedError: A solve failed.
    """
    if accuracy is None and budget is None:
        raise InputError("give an accuracy or a budget", "accuracy")
    check(
        pose=(pose, _poses),
        sided=(sided, _sided),
        of=(of, optional(callable_)),
        accuracy=(accuracy, optional(positive)),
        budget=(budget, optional(positive)),
        max_unknowns=(max_unknowns, positive),
        on_step=(on_step, callable_),
        geometry=(geometry, optional(by_text)),
        read_data=(read_data, TRUTH),
    )
    if rtol is not None:
        rtol = checked_tolerance(rtol, DEFAULT_RTOL)
    request = Request(target(norm, of), accuracy, budget, max_unknowns, rtol)
    poses = dict(pose) if isinstance(pose, Mapping) else {0: pose}
    began = time.perf_counter()
    curves = CurvedSides(geometry or {})
    curves.check(sided)
    first, known = Resolved(sided, ()), None
    if read_data:
        first, known = _first_mesh(poses[min(poses)], sided, max_unknowns)
    for note in first.notes:
        log.warning("%s", note)
    reading: dict[str, Any] = {}
    if known is not None:
        poses = {degree: data_in_pieces()(pose) for degree, pose in poses.items()}
        reading = {"read": coefficients_of, "fit": lambda level: follow(level, known.entries)}
    return adapt(poses, first, request, on_step, began, curves, **reading)


def adapt(
    poses: Mapping[int, Pose],
    first: Resolved,
    request: Request,
    on_step: Callable[[Step], None],
    began: float,
    curves: CurvedSides,
    *,
    read: Reader | None = None,
    fit: Callable[[SidedMesh], None] = lambda sided: None,
) -> AdaptiveSolution:
    """Run the adaptive loop for data that have been read, see `solve_adaptively`; collective.

    Args:
        poses: Functions that pose the problem on a mesh, by the degree of the elements.
        first: The first mesh, with what is not known of the data.
        request: What is asked for.
        on_step: Is told of each step when the step has been done.
        began: When the seconds began, by `time.perf_counter`.
        curves: The curves that sides stand for, which have been checked.
        read: Returns what is known of the coefficients of a problem; None where nothing is read.
        fit: Moves vertices of a refined mesh onto what the mesh is to follow.
    """
    polygonal = arcs(first.sided, curves.known)
    for name, distance in polygonal.items():
        on_boundary = name in (*first.sided.sides, "all")
        log.warning(BENDS if on_boundary else BENDS_INSIDE, name, POLYGON, distance)
    known = read, fit, curves, first.singular
    loop = Loop(poses, first.sided, request, on_step, began, *known)
    loop.run()
    return AdaptiveSolution(
        problem=loop.problem,
        sided=loop.last.division.sided,
        request=request,
        stopped=f"{loop.stopped}; {POLYGON}" if polygonal else loop.stopped,
        steps=tuple(loop.steps),
        cells=loop.last.remaining[loop.last.division.parents],
        polygonal=polygonal,
        notes=(*first.notes, *loop.notes),
    )


def _first_mesh(
    pose: Pose, sided: SidedMesh, max_unknowns: float
) -> tuple[Resolved, Coefficients | None]:
    """Return the first mesh of the loop, and what is read.

    Args:
        pose: Poses the problem.
        sided: The user's mesh.
        max_unknowns: The limit on the dofs of a mesh.
    """
    problem = posed(pose, sided)
    if not isinstance(problem, BoundConstrainedProblem):
        return Resolved(sided, ()), None
    known, data = coefficients_of(problem), data_of(problem)
    notes = unknown_between_nodes(problem)
    stiffness = STIFFNESS if problem.space.dofmap.bs > 1 else ()
    problem.destroy()

    def data_on(level: SidedMesh) -> list[Datum]:
        if level is sided:
            return data
        other = posed(pose, level)
        found = data_of(other)
        other.destroy()
        return found

    degree = problem.space.element.basix_element.degree
    first = first_mesh(sided, data_on, known, degree, max_unknowns, stiffness, "pose")
    return replace(first, notes=(*notes, *first.notes)), known


def found_lines(found: AdaptiveSolution) -> list[tuple[str, str]]:
    """Return what was asked for and what came out, as pairs of name and text."""
    request = found.request
    asked = [] if request.accuracy is None else [f"error of {request.accuracy:g}"]
    if request.budget is not None:
        asked.append(f"{request.budget:g} s")
    rows = [
        ("asked for", f"{' or '.join(asked)}, {request.target.name}"),
        ("came out", f"error about {found.estimate:.2e} (estimated)"),
        ("because", found.stopped),
    ]
    if found.polygonal:
        sides = ", ".join(f"{name} {distance:.0e}" for name, distance in found.polygonal.items())
        rows.append(("domain", f"that of the facets; smooth curves are so far away: {sides}"))
    return rows
