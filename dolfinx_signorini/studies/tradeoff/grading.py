"""Graded triangulations: small cells towards detachment points.

Cells at the distance r < R of a point are of the size h(r) = h (r / R)^{1 - mu}, and those at the
point of the size R (h / R)^{1/mu}: see `norms.orders.grading_exponent` for mu, which is that of
W^{1,inf} for all norms, because the strongest grading costs little more than a weaker one.
"""

from collections.abc import Sequence

import numpy as np

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.meshes.balance import balanced
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, cell_edges, longest_side, owned_cells
from dolfinx_signorini.problem.detachment import DetachmentPoint

RADIUS = 0.125  # where the grading begins, relative to the size of the domain
RESOLUTION = 0.25  # smallest cell over uncertainty of a point: smaller cells would be misplaced
TOLERANCE = 1.5  # a cell is cut if its size over the wanted size is larger
MANY = 1500  # cells: from here on a few more of them cost less than to make a finer mesh again


def graded_mesh(
    sided: SidedMesh,
    points: Sequence[DetachmentPoint],
    width: float,
    exponent: float,
    halvings: int = 0,
) -> SidedMesh:
    """Refine a triangulation towards points, until its cells have the sizes of the grading.

    Args:
        sided: A triangulation of cells of about the size 2^halvings `width`.
        points: The points; cells are not made much smaller than the uncertainty of a point.
        width: The cell size h away from the points: the root of twice the area of a cell.
        exponent: The grading exponent mu; 1 for no grading.
        halvings: How often to halve all cells on the way; the refinement before is then cheap.

    Raises:
        InputError: The mesh is no triangulation of a plane domain.
    """
    domain = sided.mesh
    if domain.topology.cell_name() != "triangle" or domain.geometry.dim != 2:
        raise InputError("grading: only for triangulations of plane domains")
    radii, grading = _radii(sided, points), exponent < 1.0 and len(points) > 0
    for level in reversed(range(halvings + 1)):
        parts = level == 1 and sided.mesh.topology.index_map(2).size_global > MANY
        while grading:
            places, sizes = _cells(sided, parts)
            wanted = np.full(len(sizes), width)
            for point, radius in zip(points, radii, strict=True):
                wanted = np.minimum(wanted, _wanted(places, point, radius, width, exponent))
            cells = np.flatnonzero(sizes > TOLERANCE * 2.0**level * wanted).astype(np.int32)
            if not domain.comm.allreduce(len(cells)):
                break
            sided = balanced(refined(sided, cells)).sided
        if level:
            sided = refined(sided).sided
    return sided


def _radii(sided: SidedMesh, points: Sequence[DetachmentPoint]) -> list[float]:
    """The radius R of the grading towards each point: at most half the distance to the next one."""
    size = longest_side(sided.mesh)
    positions = np.array([point.position for point in points])
    radii = []
    for position in positions:
        distances = np.linalg.norm(positions - position, axis=1)
        others = distances[distances > 0.0]
        radii.append(min(RADIUS * size, 0.5 * float(others.min(initial=np.inf))))
    return radii


def _cells(sided: SidedMesh, parts: bool) -> tuple[Array, Array]:
    """Places, shape (cells, m, 2), at which the sizes of owned cells are compared, and the sizes.

    A place is the middle of the cell, or, with `parts`, the middle of each part that the cell has
    after it is halved: the finer mesh then needs no more cuts.
    """
    domain, cells = sided.mesh, owned_cells(sided.mesh)
    corners = domain.geometry.x[domain.geometry.dofmap[cells], :2]
    places = corners.mean(axis=1, keepdims=True)
    if parts:
        places = 0.5 * (corners + places)
    return places, np.sqrt(np.abs(np.linalg.det(cell_edges(domain, cells))))


def _wanted(
    places: Array, point: DetachmentPoint, radius: float, width: float, exponent: float
) -> Array:
    """The cell sizes that the grading towards one point asks for."""
    distances = np.linalg.norm(places - point.position, axis=2)
    distance = distances.min(axis=1) - point.uncertainty
    smallest = max(radius * (width / radius) ** (1.0 / exponent), RESOLUTION * point.uncertainty)
    sizes = width * (np.maximum(distance, 0.0) / radius) ** (1.0 - exponent)
    return np.maximum(sizes, smallest)
