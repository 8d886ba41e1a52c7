"""Simple polygons: what makes one, and its triangulation by gmsh."""

from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinx_signorini.errors import InputError
from dolfinx_signorini.meshes import SidedMesh
from dolfinx_signorini.scenes.mesh_files import with_gmsh

Array = npt.NDArray[np.float64]
Corners = tuple[tuple[float, float], ...]

SHORTEST = 1e-6  # length of an edge, relative to the size of the polygon
SMALLEST = 1e-6  # area, relative to the square of this size


def polygon_size(corners: Corners) -> float:
    """Return the larger side of the box around a polygon."""
    return float(np.ptp(np.array(corners), axis=0).max()) if corners else 0.0


def polygon_area(corners: Corners) -> float:
    """Return the area of a polygon."""
    (x, y), (x1, y1) = np.array(corners).T, np.roll(corners, -1, axis=0).T
    return 0.5 * abs(float(x @ y1 - x1 @ y))


def check_polygon(corners: Corners) -> None:
    """Refuse what is no simple polygon.

    Args:
        corners: The vertices in order.

    Raises:
        InputError: The subject is "vertices".
    """
    if len(corners) < 3:
        raise InputError(f"a polygon has at least three, not {len(corners)}", "vertices")
    size = polygon_size(corners)
    points = np.array(corners)
    lengths = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
    if not lengths.min() > SHORTEST * size:
        k = int(np.argmin(lengths)) + 1
        raise InputError(f"edge {k} of the polygon has (almost) no length", "vertices")
    crossing = _crossing(points)
    if crossing is not None:
        raise InputError("edges {} and {} of the polygon meet".format(*crossing), "vertices")
    if polygon_area(corners) < SMALLEST * size**2:
        raise InputError("the polygon has (almost) no area", "vertices")


def polygon_mesh(comm: MPI.Comm, corners: Corners, width: float) -> SidedMesh:
    """Return a triangulation of a simple polygon, and its edges as sides "1", "2", ...

    Args:
        comm: The communicator that shares the mesh.
        corners: The vertices in order.
        width: The mesh width.

    Raises:
        InputError: gmsh is missing or cannot mesh the polygon.
    """
    count = len(corners)

    def build(gmsh: Any) -> dict[int, str]:
        geo = gmsh.model.geo
        points = [geo.addPoint(x, y, 0.0, width) for x, y in corners]
        lines = [geo.addLine(points[k], points[(k + 1) % count]) for k in range(count)]
        geo.addPlaneSurface([geo.addCurveLoop(lines)], 1)
        geo.synchronize()
        for k, line in enumerate(lines):
            gmsh.model.addPhysicalGroup(1, [line], k + 1)
        gmsh.model.addPhysicalGroup(2, [1], 1)
        gmsh.option.setNumber("Mesh.MeshSizeMin", width)
        gmsh.option.setNumber("Mesh.MeshSizeMax", width)
        gmsh.model.mesh.generate(2)
        return {k + 1: str(k + 1) for k in range(count)}

    return with_gmsh(comm, build)


def _crossing(points: Array) -> tuple[int, int] | None:
    """Return the numbers of two edges that meet where they should not, if there are any."""
    ends = np.roll(points, -1, axis=0)
    count = len(points)

    def side(a: Any, b: Any, c: Any) -> Any:
        return np.sign(
            (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1])
            - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])
        )

    for i in range(count):
        a, b = points[i], ends[i]
        # The next edge may run back along this one.
        following = ends[(i + 1) % count]
        if side(a, b, following) == 0 and (b - a) @ (following - b) < 0:
            return i + 1, (i + 1) % count + 1
        rest = [j for j in range(i + 2, count) if (j + 1) % count != i]
        c, d = points[rest], ends[rest]
        boxes = (np.maximum(a, b) >= np.minimum(c, d)) & (np.minimum(a, b) <= np.maximum(c, d))
        meet = (
            (side(a, b, c) * side(a, b, d) <= 0)
            & (side(c, d, a) * side(c, d, b) <= 0)
            & boxes.all(axis=1)
        )
        if meet.any():
            return i + 1, rest[int(np.argmax(meet))] + 1
    return None
