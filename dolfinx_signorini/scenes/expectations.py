"""What to expect of a scene before it is solved: terms, orders of convergence, cost."""

import math
from dataclasses import dataclass

import numpy as np

from dolfinx_signorini.meshes import SidedMesh
from dolfinx_signorini.orders import DETACHMENT_EXPONENT, expected_orders
from dolfinx_signorini.scenes.expressions import Expression
from dolfinx_signorini.scenes.posing import facets_by_kind, violations
from dolfinx_signorini.scenes.regularity import largest_angle, singular_corners
from dolfinx_signorini.scenes.scene import Scene

# Per unknown, for (dimension, degree): bytes as measured, and the order of magnitude of seconds.
BYTES = {(2, 1): 1.3e3, (2, 2): 1.3e3, (3, 1): 2.8e3, (3, 2): 3.2e3}
SECONDS = {(2, 1): 1e-5, (2, 2): 2e-5, (3, 1): 3e-5, (3, 2): 6e-5}
PROGRAM_BYTES = 1.5e8


@dataclass(frozen=True)
class Expectation:
    """How accurate a scene can be expected to be on uniform meshes.

    Attributes:
        orders: The orders of convergence by norm.
        notes: What limits them, and which assumptions of the theory the scene does not satisfy.
    """

    orders: dict[str, float]
    notes: tuple[str, ...]


def expect(scene: Scene, sided: SidedMesh) -> Expectation:
    """Return what to expect of a scene, from any mesh of its domain; the call is collective."""
    notes: list[str] = []
    worst = DETACHMENT_EXPONENT
    if scene.domain.dimension == 2:
        corners = singular_corners(sided.mesh, facets_by_kind(scene, sided), _constant(scene))
        limiting = [c for c in corners if c.exponent < DETACHMENT_EXPONENT]
        angle = math.degrees(largest_angle(sided.mesh))
        if angle > 180.5:
            notes.append(
                f"the domain is not convex, its largest angle is {angle:.4g} degrees: the theory "
                "behind the orders assumes a convex polygon"
            )
        if limiting:
            worst = limiting[0].exponent
            listed = "; ".join(map(str, limiting[:4]))
            notes.append(
                "reduced orders: u may be less smooth than r^1.5, which it is at a detachment "
                f"point, near {listed}"
                + (f"; and {len(limiting) - 4} more such points" if len(limiting) > 4 else "")
            )
        if scene.diffusion is not None and _constant(scene) is None:
            notes.append("the exponents are those of constant diffusion")
    else:
        notes.append("the orders are those of plane problems without singular edges and corners")
    if not scene.manufactured:
        notes += [f"exact solution: {violation}" for violation in violations(scene, sided)]
    return Expectation(expected_orders(scene.degree, worst), tuple(notes))


def terms(scene: Scene) -> list[str]:
    """Return the terms that a scene needs assembled, in words."""
    k = scene.diffusion
    if k is None:
        found = ["stiffness"]
    elif isinstance(k, Expression):
        found = [f"stiffness with diffusion {k.text}"]
    else:
        rows = "; ".join(", ".join(entry.text for entry in row) for row in k)
        found = [f"stiffness with the diffusion tensor [{rows}]"]
    if scene.reaction is not None:
        found.append(f"reaction {scene.reaction.text}")
    if scene.manufactured:
        found.append("load and, on Neumann sides, flux of the manufactured solution")
    elif scene.load is not None:
        found.append(f"load {scene.load.text}")
    if not scene.manufactured:
        found += [f"flux {p.value.text} on {_names(p.sides)}" for p in scene.neumann if p.value]
    for part in scene.dirichlet:
        value = part.value.text if part.value is not None else "of the manufactured solution"
        found.append(f"Dirichlet data {value} on {_names(part.sides)}")
    obstacle = scene.contact.obstacle
    text = obstacle.text if obstacle is not None else "that the solution touches"
    bound = "upper" if scene.contact.upper else "lower"
    return [*found, f"{bound} obstacle {text} on {_names(scene.contact.sides)}"]


def unknowns(scene: Scene) -> int:
    """Return about how many unknowns a scene has: exactly where the mesh is no polygon's."""
    vertices = scene.domain.vertices
    if scene.degree == 1:
        return vertices
    return (4 if scene.domain.dimension == 2 else 8) * vertices


def cost(scene: Scene) -> tuple[float, float]:
    """Return about how many bytes of memory and seconds of one core a scene takes."""
    kind = scene.domain.dimension, scene.degree
    count = unknowns(scene)
    return PROGRAM_BYTES + BYTES[kind] * count, SECONDS[kind] * count


def _constant(scene: Scene) -> np.ndarray | None:
    """The diffusion tensor, if it is constant."""
    k = scene.diffusion
    if k is None or isinstance(k, Expression):
        return None if k is None or k.constant is None else k.constant * np.eye(2)
    values = [[entry.constant for entry in row] for row in k]
    if any(value is None for row in values for value in row):
        return None
    return np.array(values, dtype=np.float64)


def _names(sides: tuple[str, ...]) -> str:
    return ", ".join(sides)


def order_text(expectation: Expectation) -> str:
    """Return the expected orders in one line."""
    orders = (f"{name} {order:.3g}" for name, order in expectation.orders.items())
    return ", ".join(orders) + " (uniform meshes, up to logarithms)"
