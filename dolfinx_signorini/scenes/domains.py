"""Domains of scenes: the unit square and cube, polygons, and meshes from files, with their sides.

A side is a named part of the boundary that conditions can be put on: "left" or "top" of the square
and the cube, the edges of a polygon by their number from 1 (edge k goes from vertex k to the next),
the facet tags of a mesh file by their number or, in .msh files, by the name of the physical group.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import mesh
from mpi4py import MPI

from dolfinx_signorini.errors import InputError
from dolfinx_signorini.meshes import SidedMesh, friedrichs_keller
from dolfinx_signorini.scenes import mesh_files

MAX_VERTICES = 20_000_000  # of a mesh that a scene may ask for
COARSE_CELLS = 20  # per side; coarser meshes are not worth a level of the cascade
COARSENING = 4  # between levels of the cascade
SQUARE_SIDES = {"left": (0, 0.0), "right": (0, 1.0), "bottom": (1, 0.0), "top": (1, 1.0)}
CUBE_SIDES = {
    "left": (0, 0.0),
    "right": (0, 1.0),
    "front": (1, 0.0),
    "back": (1, 1.0),
    "bottom": (2, 0.0),
    "top": (2, 1.0),
}


@dataclass(frozen=True)
class Square:
    """The unit square with its Friedrichs-Keller triangulation of `cells` cells per side."""

    cells: int
    dimension: int = field(default=2, init=False)

    @property
    def side_names(self) -> tuple[str, ...]:
        """The names of the sides."""
        return tuple(SQUARE_SIDES)

    @property
    def vertices(self) -> int:
        """The number of vertices of the mesh."""
        return (self.cells + 1) ** 2

    def levels(self) -> list["Square"]:
        """Return the square from the coarsest level of the cascade to this one."""
        return [Square(n) for n in _cell_levels(self.cells, COARSE_CELLS)]

    def make(self, comm: MPI.Comm) -> SidedMesh:
        """Make the mesh."""
        return _with_sides(friedrichs_keller(comm, self.cells), SQUARE_SIDES)


@dataclass(frozen=True)
class Cube:
    """The unit cube, each of its cells^3 cubes cut into six tetrahedra."""

    cells: int
    dimension: int = field(default=3, init=False)

    @property
    def side_names(self) -> tuple[str, ...]:
        """The names of the sides."""
        return tuple(CUBE_SIDES)

    @property
    def vertices(self) -> int:
        """The number of vertices of the mesh."""
        return (self.cells + 1) ** 3

    def levels(self) -> list["Cube"]:
        """Return the cube from the coarsest level of the cascade to this one."""
        return [Cube(n) for n in _cell_levels(self.cells, COARSE_CELLS // 4)]

    def make(self, comm: MPI.Comm) -> SidedMesh:
        """Make the mesh."""
        n = self.cells
        return _with_sides(mesh.create_unit_cube(comm, n, n, n), CUBE_SIDES)


@dataclass(frozen=True)
class Polygon:
    """A simple polygon, triangulated by gmsh.

    Attributes:
        corners: The vertices in order; an angle of pi is allowed and splits a straight side.
        width: The mesh width.

    Raises:
        InputError: It is no simple polygon, or the mesh would be too large.
    """

    corners: tuple[tuple[float, float], ...]
    width: float
    dimension: int = field(default=2, init=False)

    def __post_init__(self) -> None:
        points = np.array(self.corners)
        if len(points) < 3:
            raise InputError(f"vertices: a polygon has at least three, not {len(points)}")
        diameter = float(np.ptp(points, axis=0).max())
        lengths = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
        if not lengths.min() > 1e-6 * diameter:
            k = int(np.argmin(lengths)) + 1
            raise InputError(f"vertices: edge {k} of the polygon has (almost) no length")
        crossing = _crossing(points)
        if crossing is not None:
            raise InputError("vertices: edges {} and {} of the polygon meet".format(*crossing))
        if not 0.0 < self.width <= diameter:
            raise InputError(
                f"width: must lie between 0 and the polygon's size {diameter:g}, not {self.width:g}"
            )
        if self.area < 1e-6 * diameter**2:
            raise InputError("vertices: the polygon has (almost) no area")

    @property
    def area(self) -> float:
        """The area."""
        (x, y), (x1, y1) = np.array(self.corners).T, np.roll(self.corners, -1, axis=0).T
        return 0.5 * abs(float(x @ y1 - x1 @ y))

    @property
    def side_names(self) -> tuple[str, ...]:
        """The names of the sides."""
        return tuple(str(k + 1) for k in range(len(self.corners)))

    @property
    def vertices(self) -> int:
        """About the number of vertices of the mesh: that of equilateral triangles."""
        return math.ceil(self.area / self.width**2 * 2.0 / math.sqrt(3.0)) + len(self.corners)

    def levels(self) -> list["Polygon"]:
        """Return the polygon from the coarsest level of the cascade to this one."""
        levels: list[Polygon] = [self]
        while levels[0].vertices > COARSENING**2 * COARSE_CELLS**2:
            levels.insert(0, Polygon(self.corners, COARSENING * levels[0].width))
        return levels

    def make(self, comm: MPI.Comm) -> SidedMesh:
        """Make the mesh."""
        return SidedMesh(*mesh_files.polygon_mesh(comm, self.corners, self.width))


@dataclass(frozen=True)
class MeshFile:
    """A mesh from a .msh file of gmsh or an XDMF file.

    Attributes:
        path: The file.
        dimension: Its space dimension.
        side_names: The names of its facet tags.
        vertices: How many it has.
        grid, tags: For XDMF: the names of the mesh and of its facet tags.
    """

    path: Path
    dimension: int
    side_names: tuple[str, ...]
    vertices: int
    grid: str = "mesh"
    tags: str = "facet_tags"

    def levels(self) -> list["MeshFile"]:
        """Return the one level that there is."""
        return [self]

    def make(self, comm: MPI.Comm) -> SidedMesh:
        """Read the mesh."""
        return SidedMesh(*mesh_files.read_mesh(comm, self.path, self.grid, self.tags))


Domain = Square | Cube | Polygon | MeshFile


def coarse_polygon(corners: tuple[tuple[float, float], ...]) -> Polygon:
    """Return a polygon with the coarsest mesh that is worth a level of the cascade.

    Raises:
        InputError: It is no simple polygon.
    """
    size = float(np.ptp(np.array(corners), axis=0).max()) if len(corners) else 1.0
    polygon = Polygon(corners, size)
    return Polygon(corners, math.sqrt(polygon.area) / COARSE_CELLS)


def mesh_file(comm: MPI.Comm, path: Path, grid: str = "mesh", tags: str = "facet_tags") -> MeshFile:
    """Look into a mesh file.

    Args:
        comm: The communicator; the call is collective.
        path: A file that ends in .msh or .xdmf.
        grid: Name of the mesh in an XDMF file.
        tags: Name of the facet tags in an XDMF file.

    Raises:
        InputError: The file cannot be read, or is not a mesh of triangles or tetrahedra with facet
            tags on its boundary.
    """
    domain, sides = mesh_files.read_mesh(comm, path, grid, tags)
    count = domain.topology.index_map(0).size_global
    return MeshFile(path, domain.geometry.dim, tuple(sides), count, grid, tags)


def _with_sides(domain: mesh.Mesh, planes: Mapping[str, tuple[int, float]]) -> SidedMesh:
    def on(axis: int, value: float) -> Callable[[Any], Any]:
        return lambda x: np.abs(x[axis] - value) < 1e-12

    dim = domain.topology.dim - 1
    sides = {
        name: mesh.locate_entities_boundary(domain, dim, on(*plane))
        for name, plane in planes.items()
    }
    return SidedMesh(domain, sides)


def _cell_levels(cells: int, coarsest: int) -> list[int]:
    """Cells per side of the cascade: the parity stays, so that points on the grid stay there."""
    levels = [cells]
    while levels[0] > COARSENING * coarsest:
        n = round(levels[0] / COARSENING)
        levels.insert(0, n + (n - cells) % 2)
    return levels


def _crossing(points: npt.NDArray[np.float64]) -> tuple[int, int] | None:
    """The numbers of two edges that meet where they should not, if there are any."""
    ends = np.roll(points, -1, axis=0)
    count = len(points)

    def side(a: Any, b: Any, c: Any) -> Any:
        return np.sign(
            (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1])
            - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])
        )

    for i in range(count):
        a, b = points[i], ends[i]
        # A next edge that runs back along this one.
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
