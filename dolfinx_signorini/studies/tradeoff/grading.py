"""Graded triangulations: small cells towards detachment points.

At a detachment point the solution behaves like r^{3/2} sin(3/2 theta), whatever the data. Elements
of degree k on cells whose size grows like

    h(r) = h (r / R)^{1 - mu},    h(0) = R (h / R)^{1/mu}        (r < R)

approximate this function as well as a smooth one, in a norm of s derivatives in L^p, if

    mu <= (3/2 - s + 2/p) / (k + 1 - s),

because the error is of the size h(r)^{k+1-s} r^{3/2-k-1} on a cell at distance r, and of the size
h(0)^{3/2-s} in the cells at the point. The number of cells grows by a constant factor only. Among
these norms W^{1,inf} asks for the strongest grading, mu = 1/(2k), which is used for all of them,
because it costs little more than a weaker one.

Sources: Babuska, Kellogg and Pitkaranta, Numer. Math. 33 (1979) 447-471, for the grading; Christof
and Haubner, Section 2.2, for the singularity.
"""

from collections.abc import Sequence

import numpy as np

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.errors import InputError
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
            sided = refined(sided, cells).sided
        if level:
            sided = refined(sided).sided
    return sided


def _radii(sided: SidedMesh, points: Sequence[DetachmentPoint]) -> list[float]:
    """The radius R of the grading towards each point: at most half the distance to the next one."""
    size = longest_side(sided.mesh.comm, sided.mesh.geometry.x)
    positions = np.array([point.position for point in points])
    radii = []
    for position in positions:
        distances = np.linalg.norm(positions - position, axis=1)
        others = distances[distances > 0.0]
        radii.append(min(RADIUS * size, 0.5 * float(others.min(initial=np.inf))))
    return radii


def _cells(sided: SidedMesh, parts: bool) -> tuple[Array, Array]:
    """Where the sizes of the owned cells are compared with the wanted ones, and the sizes.

    Args:
        sided: The mesh.
        parts: Whether a size is compared at the middles of the parts that the cell has after it is
            halved, and not at the middle of the cell. The finer mesh then needs no more cuts.

    Returns:
        The places, shape (cells, places of a cell, 2), and the sizes, shape (cells,).
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
