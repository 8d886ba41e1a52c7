"""Where in its cell the detachment point lies: the worst case of Section 7, compared."""

from collections.abc import Mapping, Sequence
from typing import Any

from dolfinx import mesh

from dolfinx_signorini.manufactured import ManufacturedSolution
from dolfinx_signorini.paper.solution import DETACHMENT, SUPPORT_RADIUS, christof_haubner
from dolfinx_signorini.paper.theory.scenes import Scene

PLACES = (0.0, 0.25, 0.5, 0.75)  # of a boundary edge: on its first node ... in the middle ...


def placed_scene(place: float, n: int) -> Scene:
    """Return the paper's solution with its detachment point at a place of a boundary edge.

    Args:
        place: Part of the edge that lies between its left node and the detachment point.
        n: Even number of cells per side, at least 20 so that the support stays in the square.

    Raises:
        ValueError: n is odd or too small, or the place is not between 0 and 1.
    """
    if n % 2 or n < 20 or not 0.0 <= place < 1.0:
        raise ValueError(f"no edge of {n} cells per side has the place {place} next to the middle")
    point = (DETACHMENT[0] + place / n, 0.0)

    def exact(domain: mesh.Mesh) -> ManufacturedSolution:
        return christof_haubner(domain, detachment=point)

    return Scene(
        exact=exact,
        singular=(point,),
        contact=((point[0], 4.0 + point[0] - SUPPORT_RADIUS),),
    )


def relative_errors(
    rows: Mapping[float, Sequence[Mapping[str, Any]]], norm: str
) -> dict[float, list[float]]:
    """Return the error of each place over that of the point on a node, mesh by mesh.

    Args:
        rows: Rows with "errors" by place, over the same meshes.
        norm: The norm.
    """
    on_node = [row["errors"][norm] for row in rows[0.0]]
    return {
        place: [row["errors"][norm] / error for row, error in zip(found, on_node, strict=True)]
        for place, found in rows.items()
    }
