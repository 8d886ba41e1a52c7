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

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from dolfinx import mesh

from dolfinx_signorini.detachment import DetachmentPoint
from dolfinx_signorini.errors import InputError
from dolfinx_signorini.meshes import boundary_facets, facet_cells

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]

RADIUS = 0.125  # where the grading begins, relative to the size of the domain
RESOLUTION = 0.25  # smallest cell over uncertainty of a point: smaller cells would be misplaced
TOLERANCE = 1.5  # a cell is cut if its size is larger than this times the size wanted there
MAX_ROUNDS = 60


def graded_mesh(
    domain: mesh.Mesh,
    points: Sequence[DetachmentPoint],
    width: float,
    exponent: float,
    halvings: int = 0,
) -> mesh.Mesh:
    """Refine a triangulation towards points, until its cells have the sizes of the grading.

    Args:
        domain: A triangulation of cells of about the size 2^halvings `width`.
        points: The points; cells are not made much smaller than the uncertainty of a point.
        width: The cell size h away from the points: the root of twice the area of a cell.
        exponent: The grading exponent mu; 1 for no grading.
        halvings: How often to halve all cells on the way; the refinement before is then cheap.

    Raises:
        InputError: The mesh is no triangulation of a plane domain.
    """
    if domain.topology.cell_name() != "triangle" or domain.geometry.dim != 2:
        raise InputError("grading: only for triangulations of plane domains")
    for level in reversed(range(halvings + 1)):
        if exponent < 1.0 and points:
            domain = _refined(domain, points, width, exponent, 2.0**level)
        if level:
            domain.topology.create_entities(1)
            domain = mesh.refine(domain)[0]
    return domain


def transferred_sides(
    domain: mesh.Mesh, sides: Mapping[str, Indices], fine: mesh.Mesh
) -> dict[str, Indices]:
    """Return the facets of a refined mesh that lie on named sides of a mesh.

    Args:
        domain: The coarse mesh, a triangulation with straight sides.
        sides: The facets of each side of the coarse mesh that this rank knows.
        fine: A refinement of the coarse mesh, distributed in any way.

    Returns:
        The facets of each side of the fine mesh that this rank owns.
    """
    facets = boundary_facets(fine)
    middles = _ends(fine, facets).mean(axis=1)
    result = {}
    for name, coarse in sides.items():
        owned = np.intersect1d(coarse, boundary_facets(domain))
        ends = np.concatenate(domain.comm.allgather(_ends(domain, owned)))
        result[name] = facets[_on_segments(middles, ends)]
    return result


def _refined(
    domain: mesh.Mesh,
    points: Sequence[DetachmentPoint],
    width: float,
    exponent: float,
    factor: float,
) -> mesh.Mesh:
    """A mesh refined until the cells have the sizes of the grading, times a factor."""
    radii = _radii(domain, points)
    for _ in range(MAX_ROUNDS):
        middles, sizes = _cells(domain)
        wanted = np.full(len(sizes), width)
        for point, radius in zip(points, radii, strict=True):
            wanted = np.minimum(wanted, _wanted(middles, point, radius, width, exponent))
        cells = np.flatnonzero(sizes > TOLERANCE * factor * wanted).astype(np.int32)
        if not domain.comm.allreduce(len(cells)):
            break
        domain.topology.create_connectivity(2, 1)
        domain.topology.create_connectivity(1, 2)
        edges = mesh.compute_incident_entities(domain.topology, cells, 2, 1)
        domain = mesh.refine(domain, edges)[0]
    return domain


def _radii(domain: mesh.Mesh, points: Sequence[DetachmentPoint]) -> list[float]:
    """The radius R of the grading towards each point: at most half the distance to the next one."""
    x = domain.geometry.x[:, :2]
    ends = np.concatenate([x.max(axis=0, initial=-np.inf), (-x).max(axis=0, initial=-np.inf)])
    highest = np.max(domain.comm.allgather(ends), axis=0)
    size = float((highest[:2] + highest[2:]).max())
    positions = np.array([point.position for point in points])
    radii = []
    for position in positions:
        distances = np.linalg.norm(positions - position, axis=1)
        others = distances[distances > 0.0]
        radii.append(min(RADIUS * size, 0.5 * float(others.min(initial=np.inf))))
    return radii


def _wanted(
    middles: Array, point: DetachmentPoint, radius: float, width: float, exponent: float
) -> Array:
    """The cell sizes that the grading towards one point asks for."""
    distance = np.hypot(*(middles - point.position).T) - point.uncertainty
    smallest = max(radius * (width / radius) ** (1.0 / exponent), RESOLUTION * point.uncertainty)
    sizes = width * (np.maximum(distance, 0.0) / radius) ** (1.0 - exponent)
    return np.maximum(sizes, smallest)


def _cells(domain: mesh.Mesh) -> tuple[Array, Array]:
    """Midpoints and sizes of the owned cells."""
    count = domain.topology.index_map(2).size_local
    x = domain.geometry.x[domain.geometry.dofmap[:count], :2]
    (a, b), (c, d) = (x[:, 1] - x[:, 0]).T, (x[:, 2] - x[:, 0]).T
    return x.mean(axis=1), np.sqrt(np.abs(a * d - b * c))


def _ends(domain: mesh.Mesh, facets: Indices) -> Array:
    """The ends of boundary facets, shape (facets, 2, 2)."""
    pairs = facet_cells(domain, facets)
    corners = np.array([[1, 2], [0, 2], [0, 1]])
    nodes = domain.geometry.dofmap[pairs[:, 0, None], corners[pairs[:, 1]]]
    return np.asarray(domain.geometry.x[nodes][:, :, :2])


def _on_segments(points: Array, ends: Array) -> npt.NDArray[np.bool_]:
    """Whether each of some points lies on one of some segments."""
    result = np.zeros(len(points), dtype=bool)
    for start, end in ends:
        direction = end - start
        length = float(direction @ direction)
        offset = points - start
        along = offset @ direction / length
        across = offset[:, 0] * direction[1] - offset[:, 1] * direction[0]
        result |= (along > 0.0) & (along < 1.0) & (np.abs(across) < 1e-9 * length)
    return result
