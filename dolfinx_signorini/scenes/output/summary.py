"""The numbers of a solved scene: size, contact set, forces and their balance, accuracy, time."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_signorini.accuracy.adaptive import found_lines
from dolfinx_signorini.accuracy.corners import places_below
from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.arrays import Array, by_place
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.base.tables import listed
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.data.formulas import COORDINATES
from dolfinx_signorini.data.node_values import values_in_cells, vectors_at_nodes
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.references import Reference
from dolfinx_signorini.pictures.contact_boundary import ContactBoundary
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.problem.detachment import ALIKE, DetachmentPoint, detachment_points
from dolfinx_signorini.scenes.bounds import bound_of_scene
from dolfinx_signorini.scenes.posing import PosedScene
from dolfinx_signorini.scenes.regularity import point_text
from dolfinx_signorini.scenes.solving import SceneResult
from dolfinx_signorini.solvers.motions import at_rest

Force: TypeAlias = float | tuple[float, ...]  # of a body with a number for each component

MAX_DIGITS = 8  # of a coordinate


@dataclass(frozen=True)
class Summary:
    """The numbers of a solved scene.

    For example:

        summary = summarise(result, scene_boundaries(result))
        print(listing(lines(summary)))

    Attributes:
        cells, unknowns: The number of cells of the finest mesh, and of the dofs of its problem.
        contact_size: The size of the contact set, where the gap is zero: the length or area, and
            with an obstacle in the domain the area or volume. On a boundary in the plane the set
            reaches up to the detachment points.
        undecided_size: The length or area of what is not in contact, but has a gap that is too
            small for the mesh to tell; the piece that has a detachment point is decided. 0 with an
            obstacle in the domain.
        boundary_size: The size of the whole contact boundary, or of the cells with an obstacle.
        beside: Of a scene with obstacles in the domain and on the boundary these three sizes for
            the contact boundary; those above are for the cells.
        detachment_points: In the plane, the points where contact ends.
        uncertainties: How far off each of these points may be.
        forces: What acts on u, by name, positive upwards; of a body the components. The sum is 0.
        imbalance: The size of the computed sum, relative to the sizes of the forces, at all dofs
            if these are larger.
        natural_residual: The natural residual, relative to the data.
        algebraic_share: The estimate of the algebraic over the discretisation error, where the
            solve stopped by this.
        body: Of an elastic body the number of nodes in contact, and largest values, by name.
        infinite_stress: Where the stress of an elastic body is infinite, in words; "" for nowhere.
        errors: Norms of the error where the solution is known, by name.
        bound: Where asked for, the proven bound of the energy error with its parts, in words.
        choice: With an accuracy or a budget, what was asked for and what came out, by name.
        seconds: Wall-clock seconds of everything so far.
        phases: The seconds of the phases, which add up to these.
    """

    cells: int
    unknowns: int
    contact_size: float
    undecided_size: float
    boundary_size: float
    beside: tuple[float, float, float] | None
    detachment_points: tuple[tuple[float, ...], ...]
    uncertainties: tuple[float, ...]
    forces: dict[str, Force]
    imbalance: float
    natural_residual: float
    algebraic_share: float | None
    body: dict[str, float]
    infinite_stress: str
    errors: dict[str, float]
    bound: dict[str, str]
    choice: dict[str, str]
    seconds: float
    phases: dict[str, float]


def summarise(
    result: SceneResult, boundaries: Sequence[ContactBoundary | None], bound: bool = False
) -> Summary:
    """Return the numbers of a solved scene; the call is collective.

    Args:
        result: The solved scene.
        boundaries: Where its obstacles are, see `scene_boundaries`.
        bound: Whether to compute the proven bound of the energy error.
    """
    problem, scene, exact = result.posed.problem, result.posed.scene, result.posed.exact
    domain = problem.space.mesh
    points: list[DetachmentPoint] = []
    zone = problem.zones[-1]
    one_sided = len(zone.obstacles) == 1 and not zone.in_domain
    if one_sided and scene.domain.dimension == 2:
        points = detachment_points(zone)  # type: ignore[arg-type]
        order = by_place([point.position for point in points], digits=ALIKE)
        points = [points[k] for k in order]  # whatever the error of the solve
    sizes = domain.comm.bcast([_sizes(boundary, points) for boundary in boundaries])
    contact_size, undecided_size, boundary_size = sizes[0]
    forces, body = forces_on(result.posed), _largest_values(result.posed, boundaries[0])
    proven = _bound(result) if bound else {}
    result.phases.lap("summary")
    errors = {} if exact is None else _errors(result.u, exact, scene.norms)
    result.phases.lap("errors")
    return Summary(
        cells=domain.topology.index_map(domain.topology.dim).size_global,
        unknowns=problem.unknowns,
        contact_size=contact_size,
        undecided_size=undecided_size,
        boundary_size=boundary_size,
        beside=sizes[1] if len(sizes) > 1 else None,
        detachment_points=tuple(point.position for point in points),
        uncertainties=tuple(point.uncertainty for point in points),
        forces=forces,
        imbalance=_imbalance(problem, [np.atleast_1d(force) for force in forces.values()]),
        natural_residual=result.solve.natural_residual,
        algebraic_share=result.solve.algebraic_share,
        body=body,
        infinite_stress="" if scene.elasticity is None else _where_stress_is_infinite(problem),
        errors=errors,
        bound=proven,
        choice={} if result.found is None else dict(found_lines(result.found)),
        seconds=result.seconds,
        phases=dict(result.phases.seconds),
    )


def _sizes(
    boundary: ContactBoundary | None, points: Sequence[DetachmentPoint]
) -> tuple[float, float, float] | None:
    """The sizes of what is in contact, of what is undecided, and of all, on rank 0."""
    if boundary is None:
        return None
    return *boundary.measured([p.position for p in points]), float(boundary.sizes.sum())


def lines(summary: Summary) -> list[tuple[str, str]]:
    """Return the numbers as pairs of name and text, for people to read."""
    s = summary
    rows = [
        ("unknowns", f"{s.unknowns} ({s.cells} cells)"),
        ("in contact", f"{s.contact_size:.4g} of {s.boundary_size:.4g}"),
    ]
    if s.undecided_size > 0.0:
        text = f"{s.undecided_size:.4g}: the gap there is too small for the mesh to tell"
        rows.append(("undecided", text))
    if s.beside is not None:
        touching, undecided, whole = s.beside
        text = f"{touching:.4g} of {whole:.4g} in contact"
        text += f", {undecided:.4g} undecided" if undecided > 0.0 else ""
        rows.append(("contact boundary", text))
    if s.detachment_points:
        both = zip(s.detachment_points, s.uncertainties, strict=True)
        rows.append(("detachment", listed([_place(*point) for point in both])))
    size = max((float(np.abs(force).max()) for force in s.forces.values()), default=0.0)
    rows += [(f"force of {name}", force_text(f, size)) for name, f in s.forces.items()]
    rows.append(("balance of forces", f"{s.imbalance:.1e} of their sizes"))
    rows.append(("natural residual", f"{s.natural_residual:.1e} of the data"))
    if s.algebraic_share is not None:
        text = f"{s.algebraic_share:.1e} of the discretisation error (estimate)"
        rows.append(("algebraic error", text))
    rows += [(name, f"{value + 0.0:.6g}") for name, value in s.body.items()]
    if s.infinite_stress:
        rows.append(("infinite stress", s.infinite_stress))
    rows += [(f"error {name}", f"{error:.4g}") for name, error in s.errors.items()]
    return [*s.choice.items(), *rows, *s.bound.items()]


def force_text(force: Force, size: float = 0.0) -> str:
    """Return a force in words, a number or the components without digits of rounding.

    Args:
        force: The force.
        size: The size of the largest of all forces.
    """
    if isinstance(force, int | float):
        return f"{force + 0.0:.6g}"  # no negative zero
    return f"({', '.join(f'{f if abs(f) > SOLVED * size else 0.0:.6g}' for f in force)})"


def force_columns(forces: Mapping[str, Force]) -> dict[str, float]:
    """Return forces as numbers: a force on a body has a name for each component."""
    found: dict[str, float] = {}
    for name, force in forces.items():
        if isinstance(force, int | float):
            found[f"force of {name}"] = force
        else:
            parts = zip(COORDINATES, force, strict=False)
            found |= {f"force of {name}, {axis}": part for axis, part in parts}
    return found


def time_line(phases: Mapping[str, float]) -> tuple[str, str]:
    """Return the seconds of everything and of the phases as a pair of name and text."""
    texts = {name: f"{seconds:.2f}" for name, seconds in phases.items()}
    parts = (f"{name} {text}" for name, text in texts.items() if text != "0.00")
    return "time", f"{sum(phases.values()):.2f} s: {', '.join(parts)}"


def listing(rows: Iterable[tuple[str, str]]) -> str:
    """Return pairs of name and text as lines for a terminal."""
    return "".join(f"  {name:<24} {text}\n" for name, text in rows)


def _place(point: Sequence[float], uncertainty: float) -> str:
    """Return coordinates with one digit more than is known, without digits of rounding."""
    size, digits = max(map(abs, point)), 4
    if 0.0 < uncertainty < size:
        digits = min(1 + math.ceil(math.log10(size / uncertainty)), MAX_DIGITS)
    return f"{point_text(point, digits)} +- {uncertainty:.1g}"


def _bound(result: SceneResult) -> dict[str, str]:
    """Return the bound of the energy error in words."""
    bound = bound_of_scene(result.posed)
    said = "proven, but for data that are only sampled" if bound.sampled else "proven"
    parts = ("flux", "data", "mean", "contact", "lifting")
    shares = (f"{name} {getattr(bound, name):.1e}" for name in parts)
    found = {"energy error": f"at most {bound.total:.3e}, {said}", "its parts": ", ".join(shares)}
    return found | {f"bound, note {k}": note for k, note in enumerate(bound.notes, start=1)}


def _errors(u: fem.Function, exact: Reference, norms: Sequence[str]) -> dict[str, float]:
    """Return norms of the error; infinity where the exact solution has no finite value."""
    try:
        return error_norms(u, exact, norms)
    except FloatingPointError:
        if len(norms) == 1:
            return {norms[0]: math.inf}
        return {norm: _errors(u, exact, [norm])[norm] for norm in norms}


def _imbalance(problem: BoundConstrainedProblem, forces: Sequence[Array]) -> float:
    """Return the size of the sum of forces over their sizes, without their squares; collective.

    The parts of a force may cancel, and the sum of sizes at dofs tells what rounding is small to.
    """
    owned = problem.space.dofmap.index_map.size_local * problem.space.dofmap.bs
    at_dofs = at_rest(problem.system)[1], problem.forces.x.array[:owned]
    whole = problem.comm.allreduce(float(sum(np.abs(part).sum() for part in at_dofs)))
    columns = np.array(forces)
    largest = max(float(np.abs(columns).max(initial=0.0)), whole)
    if largest == 0.0:
        return 0.0
    shares = columns / largest
    sizes = max(float(np.linalg.norm(shares, axis=1).sum()), whole / largest)
    return float(np.linalg.norm(shares.sum(axis=0)) / sizes)


def forces_on(posed: PosedScene) -> dict[str, Force]:
    """Return what acts on u: integrals of sources and reactions, and the forces of conditions.

    Args:
        posed: A solved scene; the call is collective.
    """
    problem, u, size = posed.problem, posed.problem.u, posed.scene.components

    def on_constants(form: ufl.Form) -> Array:
        (v,), domain = form.arguments(), problem.space.mesh
        units = np.eye(size).reshape(size, *v.ufl_shape)
        each = [ufl.replace(form, {v: fem.Constant(domain, unit)}) for unit in units]
        return np.array(list(map(compiled.integral, each)))

    forces: dict[str, Any] = {name: on_constants(form) for name, form in posed.sources.items()}
    for name, form in posed.reactions.items():
        forces[name] = forces.get(name, 0.0) - on_constants(ufl.action(form, u))
    residual = ufl.action(posed.a, u)
    if posed.sources:
        residual -= posed.L
    forces["contact"] = problem.zones[-1].force
    if len(problem.zones) > 1:
        forces["obstacle"] = problem.zones[0].force
    for kind in dict.fromkeys(type(condition) for condition in posed.scene.conditions):
        force = kind.force(problem, residual)
        if force is not None:
            forces[kind.force_name] = force
    numbers = {name: tuple(map(float, np.atleast_1d(force))) for name, force in forces.items()}
    return {name: force if size > 1 else force[0] for name, force in numbers.items()}


def _where_stress_is_infinite(problem: BoundConstrainedProblem) -> str:
    """Tell at which corners the stress grows like a power of the distance: no mesh has its largest.

    As theory has it, of solutions in general; collective.
    """
    dim, places = problem.space.mesh.topology.dim, dict[float, list[str]]()
    for point, exponent in places_below(problem, 1.0):
        places.setdefault(round(exponent - 1.0, 3), []).append(point_text(point[:dim]))
    if dim > 2:
        texts = [f"r^{power:.3g} along edges, such as at {at[0]}" for power, at in places.items()]
    else:
        texts = [f"r^{power:.3g} at {listed(at)}" for power, at in places.items()]
    return "; ".join(texts)


def _largest_values(posed: PosedScene, boundary: ContactBoundary | None) -> dict[str, float]:
    """Return the number of nodes in contact, and the largest values of a body, by name."""
    problem, material = posed.problem, posed.scene.elasticity
    if material is None:
        return {}
    found = None
    if boundary is not None:  # rank 0
        _, gap, pressure = boundary.values.T
        known = pressure[np.isfinite(pressure)]
        found = float(known.max(initial=0.0)), float(gap.min())
    pressure, gap = problem.comm.bcast(found)
    nodal = problem.gap.function_space
    moved = vectors_at_nodes(nodal, problem.u)
    size = highest(problem.comm, np.abs(moved))
    lengths = np.linalg.norm(moved / (size or 1.0), axis=1)
    stress = values_in_cells(nodal, material.stresses(problem.u)[1])
    return {
        "nodes in contact": problem.comm.allreduce(len(problem.active)),
        "largest pressure": pressure,
        "smallest gap": gap,
        "largest displacement": size * highest(problem.comm, lengths),
        "largest von Mises stress": highest(problem.comm, stress),
    }
