"""Simple polygons, triangulated by gmsh."""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.tolerances import SIX_DIGITS, SOLVED, TINY, power_of_two
from dolfinx_signorini.meshes.sided_meshes import SidedMesh
from dolfinx_signorini.scenes.domains.domain import RefinedDomain
from dolfinx_signorini.scenes.domains.gmsh_meshes import with_gmsh
from dolfinx_signorini.scenes.files.toml_table import TomlTable

Corners = tuple[tuple[float, float], ...]

COARSE = 32  # triangles of gmsh across a polygon, at least
MAX_CORNERS = 500  # gmsh makes about 1/5 of the square of their number of triangles
MAX_COORDINATE = 1e6  # gmsh makes fewer triangles of a polygon far from the origin
MIN_SIZE = TINY**0.2  # of a polygon: the product of two areas is still a normal number


@dataclass(frozen=True)
class Polygon(RefinedDomain):
    """A simple polygon, triangulated by gmsh with few triangles, which are divided.

    The sides are "1", "2", ...: side k goes from vertex k to the next vertex:

        triangle = Polygon(((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)), width=0.1)

    Attributes:
        corners: The vertices in order; an angle of pi is allowed and splits a straight side.
        width: The mesh width, which is that of the triangles in the mean.
        refinements: How often the triangles of gmsh are divided into four: until these have the
            width, and as few of them are made as resolve the polygon and its edges.

    Raises:
        InputError: The vertices are those of no simple polygon, or the width makes no sense.
    """

    corners: Corners
    width: float
    refinements: int = field(init=False)
    side_names: tuple[str, ...] = field(init=False)
    vertices: int = field(init=False)
    shape = "polygon"
    width_key = "width"
    first_cells = 1
    dimension = 2

    def __post_init__(self) -> None:
        _check(self.corners)
        size = _size(self.corners)
        if not 0.0 < self.width <= size:
            raise InputError(
                f"must lie between 0 and the polygon's size {size:g}, not {self.width:g}", "width"
            )
        # As many as in a mesh of equilateral triangles.
        across = self.size / self.width
        count = min(across * across * 2.0 / math.sqrt(3.0), 1e18)
        vertices = math.ceil(count) + len(self.corners)
        coarsest = min(self.size / COARSE, _lengths(self.corners).min())
        times = max(0, math.floor(math.log2(min(coarsest / self.width, 1e18)) + SOLVED))
        object.__setattr__(self, "refinements", times)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "side_names", tuple(str(k + 1) for k in range(len(self.corners))))

    @classmethod
    def read(cls, table: TomlTable, folder: Path, comm: MPI.Comm, sized: bool) -> "Polygon":
        corners = table.items("vertices")
        if len(corners) > MAX_CORNERS:
            raise table.error("vertices", f"at most {MAX_CORNERS} are read")
        for corner in corners:
            if not isinstance(corner, list) or len(corner) != 2:
                raise table.error("vertices", "must be a list of [x, y]")
            if max(abs(table.finite("vertices", c)) for c in corner) > MAX_COORDINATE:
                raise table.error("vertices", f"a coordinate larger than {MAX_COORDINATE:g}")
        points = tuple((float(x), float(y)) for x, y in corners)
        width = table.real("width") if sized else _size(points)
        try:
            polygon = cls(points, width)
        except InputError as error:
            raise table.error(error.subject, error.message) from None
        return polygon if sized else polygon.at(cls.coarse_cells)

    @property
    def area(self) -> float:
        """The area."""
        return _area(self.corners)

    @property
    def size(self) -> float:
        # By rounding, the root of the area of a square may be longer than the side.
        return min(math.sqrt(self.area), _size(self.corners))

    @property
    def cells_across(self) -> int:
        return round(self.size / self.width)

    def at(self, n: int) -> "Polygon":
        return replace(self, width=self.size / n)

    def refined_less(self, times: int) -> "Polygon":
        return replace(self, width=self.width * 2**times)

    def make_coarsest(self, comm: MPI.Comm) -> SidedMesh:
        return _triangulation(comm, self.corners, self.width * 2**self.refinements)


def _size(corners: Corners) -> float:
    """Return the larger side of the box around a polygon."""
    return float(np.ptp(np.array(corners), axis=0).max()) if corners else 0.0


def _lengths(corners: Corners) -> Array:
    """Return the lengths of the edges of a polygon."""
    points = np.array(corners)
    return np.asarray(np.hypot(*(np.roll(points, -1, axis=0) - points).T))


def _area(corners: Corners) -> float:
    """Return the area of a polygon; far from the origin, products of coordinates would cancel."""
    points = np.array(corners) - np.array(corners[0])
    (x, y), (x1, y1) = points.T, np.roll(points, -1, axis=0).T
    return 0.5 * abs(float(x @ y1 - x1 @ y))


def _check(corners: Corners) -> None:
    """Refuse what is no simple polygon, with the subject "vertices"."""
    if len(corners) < 3:
        raise InputError(f"a polygon has at least three, not {len(corners)}", "vertices")
    size, lengths = _size(corners), _lengths(corners)
    if size < MIN_SIZE:
        raise InputError(f"a polygon smaller than {MIN_SIZE:g}", "vertices")
    if not lengths.min() > SIX_DIGITS * size:
        k = int(np.argmin(lengths)) + 1
        raise InputError(f"edge {k} of the polygon has (almost) no length", "vertices")
    if (crossing := _crossing(np.array(corners))) is not None:
        raise InputError("edges {} and {} of the polygon meet".format(*crossing), "vertices")
    if _area(corners) < SIX_DIGITS * size**2:
        raise InputError("the polygon has (almost) no area", "vertices")


def _triangulation(comm: MPI.Comm, corners: Corners, width: float) -> SidedMesh:
    """Return a triangulation by gmsh, with the edges as sides.

    The tolerances of gmsh are absolute: small polygons get no vertices inside. They are made larger
    by a power of two, which rounds nothing.
    """
    count, unit = len(corners), min(power_of_two(_size(corners)), 1.0)

    def build(gmsh: Any) -> None:
        geo = gmsh.model.geo
        points = [geo.addPoint(x / unit, y / unit, 0.0, width / unit) for x, y in corners]
        lines = [geo.addLine(points[k], points[(k + 1) % count]) for k in range(count)]
        geo.addPlaneSurface([geo.addCurveLoop(lines)], 1)
        geo.synchronize()
        for k, line in enumerate(lines):
            gmsh.model.addPhysicalGroup(1, [line], k + 1)
        gmsh.model.addPhysicalGroup(2, [1], 1)
        gmsh.option.setNumber("Mesh.MeshSizeMin", width / unit)
        gmsh.option.setNumber("Mesh.MeshSizeMax", width / unit)
        gmsh.model.mesh.generate(2)

    sided = with_gmsh(comm, build)
    sided.mesh.geometry.x[:] *= unit
    return sided


def _crossing(points: Array) -> tuple[int, int] | None:
    """Return the numbers of two edges that meet where they should not, if there are any."""
    ends, number = np.roll(points, -1, axis=0), np.arange(len(points))

    def side(a: Array, b: Array, c: Array) -> Array:
        ab, ac = b - a, c - a
        return np.sign(ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0])

    a, b, c, d = points[:, None], ends[:, None], points[None], ends[None]
    boxes = (np.maximum(a, b) >= np.minimum(c, d)) & (np.minimum(a, b) <= np.maximum(c, d))
    across = (side(a, b, c) * side(a, b, d) <= 0) & (side(c, d, a) * side(c, d, b) <= 0)
    ahead = (number - number[:, None]) % len(points)
    apart = (ahead > 1) & (ahead < len(points) - 1)
    # The next edge may run back along an edge.
    back = (side(a, b, d) == 0) & (((b - a) * (d - c)).sum(axis=2) < 0) & (ahead == 1)
    meet = np.argwhere((across & boxes.all(axis=2) & apart) | back)
    return (int(meet[0, 0]) + 1, int(meet[0, 1]) + 1) if len(meet) else None
