"""Expectations of a scene before the solve: terms, orders of convergence, cost."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.ranks import anywhere
from dolfinx_signorini.base.tables import listed
from dolfinx_signorini.data.interfaces.facet_jumps import jumps_in_cells
from dolfinx_signorini.data.interfaces.integrability import fastest_growth
from dolfinx_signorini.data.interfaces.singular_sets import jumps
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, cell_corners
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.names import parse_norm
from dolfinx_signorini.norms.orders import (
    DETACHMENT_EXPONENT,
    FREE_BOUNDARY_EXPONENT,
    KINK_EXPONENT,
    expected_orders,
    is_finite,
)
from dolfinx_signorini.problem.checks import MOST_UNKNOWNS
from dolfinx_signorini.scenes.files.conditions import CONDITIONS
from dolfinx_signorini.scenes.files.elasticity import Elasticity
from dolfinx_signorini.scenes.files.scene import Scene
from dolfinx_signorini.scenes.posing import (
    PosedScene,
    boundary_parts,
    coefficients,
    facets_by_kind,
    violations,
)
from dolfinx_signorini.scenes.regularity import (
    Corner,
    dirichlet_jumps,
    known_corner,
    largest_angle,
    point_text,
    singular_corners,
)
from dolfinx_signorini.scenes.scene_data import data_of

# Per unknown, by dimension and degree: bytes as measured, and the order of magnitude of seconds.
BYTES = {2: (1.3e3, 1.4e3, 1.6e3, 2.1e3), 3: (2.8e3, 4.1e3, 7.0e3, 1.1e4)}
SECONDS = {2: (1e-5, 2e-5, 3e-5, 5e-5), 3: (3e-5, 6e-5, 1e-4, 2e-4)}
PROGRAM_BYTES = 1.5e8  # and of the program itself
# Poisson's ratio from which on degree 1 locks. A pressed block of 16, 32, 64 cells a side had 2.0,
# 0.7, 0.2 % too much force for 0.45, 7.1, 2.7, 0.9 % for 0.49, and 30, 13, 5 % for 0.499.
LOCKING = 0.49
CUT = (
    "the diffusion jumps inside of cells, and with it the slope of u: errors in H1 fall with "
    "h^(1/2) for any degree, until facets follow the jump"
)


@dataclass(frozen=True)
class Expectation:
    """How accurate a scene can be expected to be on uniform meshes.

    For example:

        expectation = expect(scene, scene.domain.make(comm))
        print(expectation.orders["L2"], *expectation.notes)

    Attributes:
        orders: The orders of convergence by norm.
        notes: What limits the orders, and which assumptions of the theory the scene does not meet.
        worst: The point where the solution is least smooth, if it is less smooth there than where
            contact ends; of an exact solution that is known, as its formula says.
    """

    orders: dict[str, float]
    notes: tuple[str, ...]
    worst: Corner | None = None

    def __str__(self) -> str:
        if not self.orders:
            return "not known for displacements"
        orders = (f"{name} {order:.3g}" for name, order in self.orders.items() if order > 0.0)
        rest = [name for name, order in self.orders.items() if order <= 0.0]
        infinite = [name for name in rest if self.infinite(name)]
        unknown = [name for name in rest if name not in infinite]
        text = (", ".join(orders) or "none") + " (uniform meshes, up to logarithms)"
        text += f"; {', '.join(unknown)} unknown" if unknown else ""
        return text + (f"; {', '.join(infinite)} of the solution infinite" if infinite else "")

    def infinite(self, norm: str) -> bool:
        """Return whether a norm of the solution is infinite, as far as is known."""
        return self.worst is not None and not is_finite(norm, self.worst.exponent)


def expect(scene: Scene, sided: SidedMesh) -> Expectation:
    """Return what to expect of a scene, by any mesh of its domain; the call is collective."""
    torn = dirichlet_jumps(scene, sided)
    notes: list[str] = []
    if torn:
        places = listed([point_text(point) for point in torn])
        notes.append(f"Dirichlet data jump at {places}: no solution has finite energy")
    poles = _notes_of_poles(scene, sided)
    if scene.elasticity is not None:
        return Expectation({}, (*notes, *poles, *_stiff(scene, scene.elasticity)))
    corners: list[Corner] = []
    if scene.domain.dimension == 2:
        corners = _note_corners(scene, sided, notes)
    else:
        notes.append("the orders are those of plane problems without singular edges and corners")
    if not scene.manufactured:
        notes += [f"exact solution: {violation}" for violation in violations(scene, sided)]
    formulas = [scene.solution, *scene.diffusion_entries]
    if scene.manufactured and any(formula is not None and jumps(formula) for formula in formulas):
        notes.append(
            "the load of the manufactured solution leaves out what kinks of the solution, or jumps "
            "of its flux, add on curves"
        )
    notes += poles
    exponent = 0.0 if torn else corners[0].exponent if corners else _contact_exponent(scene)
    if scene.solution is not None:
        corners = [known_corner(scene.solution, corner, sided.mesh) for corner in corners]
    cut = diffusion_is_cut(scene, sided)
    notes += [CUT] if cut else []
    # Near a jump u is like the angle around the point, of the power 0.
    corners += [Corner(point, math.pi, ("jump of Dirichlet data",), 0.0) for point in torn]
    worst = min(corners, key=lambda corner: corner.exponent, default=None)
    return Expectation(_orders(scene, exponent, cut), tuple(notes), worst)


def diffusion_is_cut(scene: Scene, sided: SidedMesh) -> bool:
    """Return whether the diffusion jumps inside of cells; the call is collective."""
    corners = cell_corners(sided.mesh)
    found = any(jumps_in_cells(entry, corners) for entry in scene.diffusion_entries)
    return anywhere(sided.mesh.comm, found)


def _notes_of_poles(scene: Scene, sided: SidedMesh) -> tuple[str, ...]:
    """Return notes on data that are infinite along curves, with an integral or without."""
    places = [(d.name, d.formula, d.corners) for d in data_of(scene, sided) if d.measure == "mass"]
    load = coefficients(scene).load if scene.manufactured else None
    if load is not None:
        places.append(("the load", load, cell_corners(sided.mesh)))
    notes: list[str] = []
    for name, formula, corners in places:
        every = sided.mesh.comm.allgather(fastest_growth(formula, corners))
        worst = min(filter(None, every), default=None)
        if worst is None:
            continue
        where = point_text(worst[1])
        if worst[0] <= -1.0:  # but for a logarithm
            notes.append(
                f"{name} grows like 1/distance or faster, for example towards {where}: the "
                "integral is infinite, and what the quadrature makes of it depends on the mesh"
            )
        elif corners.shape[1] > sided.mesh.topology.dim:
            notes.append(
                f"{name} is infinite along a curve, like the distance to the power {worst[0]:.2g}, "
                f"for example at {where}: next to the curve it is integrated roughly, and no "
                "estimate of errors shows that"
            )
    return tuple(dict.fromkeys(notes))


def _stiff(scene: Scene, material: Elasticity) -> tuple[str, ...]:
    """Return a note where elements of degree 1 lock: bodies seem stiffer than they are."""
    ratio = material.poisson.constant
    if scene.degree > 1 or ratio is None or ratio < LOCKING:
        return ()
    return (
        f"elements of degree 1 are too stiff for Poisson's ratio {ratio:g}, and forces too large: "
        "take degree 2",
    )


def _orders(scene: Scene, exponent: float, cut: bool) -> dict[str, float]:
    """The least of the orders for a solution like r^exponent at a point, and for other places.

    At the distance s of the end of contact in the domain the gap is like s^2. Where the diffusion
    jumps inside of cells the solution and any dual one have a kink.
    """
    limits = [expected_orders(scene.degree, exponent)]
    if scene.obstacle is not None:
        limits.append(expected_orders(scene.degree, FREE_BOUNDARY_EXPONENT, 1))
    if cut:
        kinked = expected_orders(scene.degree, KINK_EXPONENT, 1)
        limits.append({norm: min(order, 2.0 * kinked["H1"]) for norm, order in kinked.items()})
    return {norm: min(limit[norm] for limit in limits) for norm in limits[0]}


def check_norms(norms: Sequence[str], expectation: Expectation, subject: str) -> None:
    """Refuse norms that are infinite for the solution of a scene, where that is known.

    Args:
        norms: Names of norms.
        expectation: What is to be expected of the scene.
        subject: The subject of the error.

    Raises:
        InputError: A norm is infinite, or no norm.
    """
    for norm in norms if expectation.orders else ():
        parse_norm(norm, subject)
        if expectation.infinite(norm):
            raise InputError(
                f"{norm} of the solution is infinite near {expectation.worst}; only data made for "
                "a smoother solution avoid that, and the key solution says so",
                subject,
            )


def check_errors(posed: PosedScene, expectation: Expectation, norm: str | None = None) -> None:
    """Refuse errors that are to be measured or estimated where the solution has no finite values.

    Args:
        posed: A scene on a coarse mesh; collective. On a large mesh no error is measured.
        expectation: What is to be expected of the scene.
        norm: The norm of the error that an accuracy is asked for in.

    Raises:
        InputError: A norm is infinite, or the exact solution has no finite value at some point.
    """
    asked, measured = () if norm is None else (norm,), posed.scene.norms
    check_norms(asked, expectation, "norm")
    if posed.exact is None:
        return
    check_norms(measured, expectation, "norms")
    if posed.problem.unknowns > MOST_UNKNOWNS:
        return
    # Maxima look at vertices, where most poles are: integrals next to a pole take seconds.
    norms = dict.fromkeys([*asked, *measured])
    maxima = [name for name in norms if math.isinf(parse_norm(name).p)]
    try:
        for some in (maxima, [name for name in norms if name not in maxima]):
            error_norms(posed.problem.u, posed.exact, some)
    except FloatingPointError:
        message = "has no finite value at some point where its error is measured"
        raise InputError(message, "solution") from None


def terms(scene: Scene) -> list[str]:
    """Return the terms that a scene needs assembled, in words."""
    rows = [", ".join(entry.text for entry in row) for row in scene.diffusion]
    if scene.elasticity is not None:
        found = scene.elasticity.words()
    elif not rows:
        found = ["stiffness"]
    elif len(rows) == 1:
        found = [f"stiffness with diffusion {rows[0]}"]
    else:
        found = [f"stiffness with the diffusion tensor [{'; '.join(rows)}]"]
    if scene.reaction is not None:
        found.append(f"reaction {scene.reaction.text}")
    if scene.manufactured:
        found.append("load and, on Neumann sides, flux of the manufactured solution")
    elif scene.load is not None:
        found.append(f"load {scene.load.text}")
    words = [
        c.words() for kind in CONDITIONS[::-1] for c in scene.conditions if isinstance(c, kind)
    ]
    words += [] if scene.obstacle is None else scene.obstacle.words()
    return found + [text for text in words if text]


def unknowns(scene: Scene) -> int:
    """Return about how many unknowns a scene has: exactly where the mesh is no polygon's."""
    return int(scene.components * scene.degree**scene.domain.dimension * scene.domain.vertices)


def cost(scene: Scene) -> tuple[float, float]:
    """Return about how many bytes of memory and seconds of one core a scene takes."""
    dimension, kind, count = scene.domain.dimension, scene.degree - 1, unknowns(scene)
    return PROGRAM_BYTES + BYTES[dimension][kind] * count, SECONDS[dimension][kind] * count


def _contact_exponent(scene: Scene) -> float:
    """The power of the distance to the end of contact that the solution behaves like."""
    return FREE_BOUNDARY_EXPONENT if scene.contact is None else DETACHMENT_EXPONENT


def _note_corners(scene: Scene, sided: SidedMesh, notes: list[str]) -> list[Corner]:
    """Add what is to be said of the corners of a plane domain; return corners that limit orders."""
    facets, constant = facets_by_kind(boundary_parts(scene, sided)), scene.constant_diffusion
    corners = singular_corners(sided.mesh, facets, () if constant is None else scene.diffusion)
    exponent = _contact_exponent(scene)
    limiting = [c for c in corners if c.exponent < exponent]
    angle = math.degrees(largest_angle(sided.mesh))
    if angle > 180.5:
        notes.append(
            f"the domain is not convex, its largest angle is {angle:.4g} degrees: the theory "
            "behind the orders assumes a convex polygon"
        )
    if limiting:
        where = "where contact ends" if scene.contact is None else "at a detachment point"
        notes.append(
            f"reduced orders: u may be less smooth than r^{exponent:g}, which it is {where}, "
            f"near {listed([str(corner) for corner in limiting], '; ')}"
        )
    if scene.diffusion and constant is None:
        notes.append("the orders at corners are those of a constant diffusion")
    return limiting
