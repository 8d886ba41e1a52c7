"""Domains of scenes: the unit square and cube, polygons, and meshes from files, with their sides.

A side is a named part of the boundary that conditions can be put on. A new shape is a subclass of
`Domain` in the list `DOMAINS`; how solutions are drawn follows from the dimension of the domain.
"""

import hashlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from dolfinx import mesh
from mpi4py import MPI

from dolfinx_signorini.errors import InputError
from dolfinx_signorini.meshes import SidedMesh, friedrichs_keller
from dolfinx_signorini.scenes.mesh_files import read_mesh
from dolfinx_signorini.scenes.polygons import (
    check_polygon,
    polygon_area,
    polygon_mesh,
    polygon_size,
)
from dolfinx_signorini.scenes.toml_table import TomlTable
from dolfinx_signorini.solvers.cascade import coarse_levels

MAX_VERTICES = 20_000_000  # of a mesh that a scene may ask for
SQUARE_SIDES: tuple[str, ...] = ("left", "right", "bottom", "top")
CUBE_SIDES: tuple[str, ...] = ("left", "right", "front", "back", "bottom", "top")
MAX_CORNERS = 500
MAX_COORDINATE = 1e6


class Domain(ABC):
    """A domain with the mesh that a scene asks for, and with its meshes of other widths.

    A scene is posed on the mesh, or on the meshes of the cascade:

        domain = Square(101)
        coarse = domain.at(13).make(comm)
        facets = coarse.facets(("left", "right"))

    Attributes:
        shape: The name of the shape in scene files.
        width_key: The key of a scene file that says how fine the mesh is; "" for none.
        coarse_cells: The number of cells across the first mesh where the table names no width.
        dimension: The space dimension.
        side_names: The names of the sides.
        vertices: The number of vertices of the mesh, which may be an estimate.
    """

    shape: ClassVar[str]
    width_key: ClassVar[str] = ""
    coarse_cells: ClassVar[int] = 20
    dimension: int
    side_names: tuple[str, ...]
    vertices: int

    @classmethod
    @abstractmethod
    def read(cls, table: TomlTable, folder: Path, comm: MPI.Comm, sized: bool) -> "Domain":
        """Return the domain that a table of a scene file describes.

        Args:
            table: The table [domain].
            folder: The folder of the scene file.
            comm: The communicator that will share the mesh.
            sized: Whether the table has the `width_key`; else the mesh has `coarse_cells` across.
        """

    @abstractmethod
    def at(self, n: int) -> "Domain":
        """Return the same domain with a mesh of about n cells across."""

    @abstractmethod
    def make(self, comm: MPI.Comm) -> SidedMesh:
        """Make the mesh, which the ranks of a communicator share."""

    @property
    def cells_across(self) -> int:
        """About the number of cells across the domain."""
        return round(self.vertices ** (1.0 / self.dimension)) - 1

    @property
    def size(self) -> float:
        """The side of a square, or cube, of about the size of the domain."""
        return 1.0

    def levels(self) -> list["Domain"]:
        """Return the domain with each mesh of the cascade, coarsest first; the last is this one."""
        coarse = coarse_levels(self.cells_across, self.dimension)
        return [*(self.at(n) for n in coarse), self]

    def record(self) -> dict[str, Any]:
        """Return what a record of a run needs to tell of the domain beside the scene file."""
        return {}


@dataclass(frozen=True)
class Square(Domain):
    """The unit square with the Friedrichs-Keller triangulation, for example `Square(cells=101)`.

    Attributes:
        cells: The number of cells per side.
    """

    cells: int
    vertices: int = field(init=False)
    shape = "square"
    width_key = "cells"
    dimension = 2
    side_names = SQUARE_SIDES

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", (self.cells + 1) ** self.dimension)

    @classmethod
    def read(cls, table: TomlTable, folder: Path, comm: MPI.Comm, sized: bool) -> "Square":
        limit = int(MAX_VERTICES ** (1.0 / cls.dimension)) - 1
        return cls(table.integer("cells", 1, limit) if sized else cls.coarse_cells)

    def at(self, n: int) -> "Square":
        return replace(self, cells=n)

    def make(self, comm: MPI.Comm) -> SidedMesh:
        return _with_sides(friedrichs_keller(comm, self.cells), self.side_names)


@dataclass(frozen=True)
class Cube(Square):
    """The unit cube in cells^3 cubes of six tetrahedra each, for example `Cube(cells=15)`."""

    shape = "cube"
    dimension = 3
    side_names = CUBE_SIDES
    coarse_cells = 5

    def make(self, comm: MPI.Comm) -> SidedMesh:
        n = self.cells
        return _with_sides(mesh.create_unit_cube(comm, n, n, n), self.side_names)


@dataclass(frozen=True)
class Polygon(Domain):
    """A simple polygon, triangulated by gmsh.

    The sides are "1", "2", ...: side k goes from vertex k to the next vertex:

        triangle = Polygon(((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)), width=0.1)

    Attributes:
        corners: The vertices in order; an angle of pi is allowed and splits a straight side.
        width: The mesh width.

    Raises:
        InputError: The vertices are those of no simple polygon, or the width makes no sense.
    """

    corners: tuple[tuple[float, float], ...]
    width: float
    side_names: tuple[str, ...] = field(init=False)
    vertices: int = field(init=False)
    shape = "polygon"
    width_key = "width"
    dimension = 2

    def __post_init__(self) -> None:
        check_polygon(self.corners)
        size = polygon_size(self.corners)
        if not 0.0 < self.width <= size:
            raise InputError(
                f"must lie between 0 and the polygon's size {size:g}, not {self.width:g}", "width"
            )
        # As many as in a mesh of equilateral triangles.
        vertices = math.ceil(self.area / self.width**2 * 2.0 / math.sqrt(3.0)) + len(self.corners)
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
        width = table.real("width") if sized else polygon_size(points)
        try:
            polygon = cls(points, width)
        except InputError as error:
            raise table.error(error.subject, error.message) from None
        return polygon if sized else polygon.at(cls.coarse_cells)

    @property
    def area(self) -> float:
        """The area."""
        return polygon_area(self.corners)

    @property
    def size(self) -> float:
        return math.sqrt(self.area)

    @property
    def cells_across(self) -> int:
        return round(self.size / self.width)

    def at(self, n: int) -> "Polygon":
        return replace(self, width=self.size / n)

    def make(self, comm: MPI.Comm) -> SidedMesh:
        return polygon_mesh(comm, self.corners, self.width)


@dataclass(frozen=True)
class MeshFile(Domain):
    """A domain given by the mesh in a file, which is the only mesh of the domain.

    The sides are the facet tags: their numbers and, in .msh files, the names of physical groups.
    The file is looked into first:

        plate = MeshFile.open(comm, Path("plate.msh"))
        print(plate.side_names)

    Attributes:
        path: The file.
        dimension: Space dimension.
        side_names: The facet tags.
        vertices: The number of vertices.
        grid, tags: For XDMF: the names of the mesh and of its facet tags.
    """

    path: Path
    dimension: int
    side_names: tuple[str, ...]
    vertices: int
    grid: str = "mesh"
    tags: str = "facet_tags"
    shape = "file"

    @classmethod
    def open(
        cls, comm: MPI.Comm, path: Path, grid: str = "mesh", tags: str = "facet_tags"
    ) -> "MeshFile":
        """Look into a mesh file.

        Args:
            comm: The communicator; the call is collective.
            path: A file that ends in .msh or .xdmf.
            grid: The name of the mesh in an XDMF file.
            tags: The name of the facet tags in an XDMF file.

        Raises:
            InputError: The file cannot be read, or is not a mesh of triangles or tetrahedra with
                facet tags on its boundary.
        """
        sided = read_mesh(comm, path, grid, tags)
        count = sided.mesh.topology.index_map(0).size_global
        return cls(path, sided.mesh.geometry.dim, tuple(sided.sides), count, grid, tags)

    @classmethod
    def read(cls, table: TomlTable, folder: Path, comm: MPI.Comm, sized: bool) -> "MeshFile":
        path = folder / table.text("file")
        names = {key: table.text(key) for key in ("grid", "tags") if table.has(key)}
        if not sized:
            raise table.error("file", "a mesh is used as it is: leave 'accuracy' out")
        try:
            return cls.open(comm, path, **names)
        except InputError as error:
            raise table.error("file", error.message) from None
        except ValueError as error:  # a name that no file can have
            raise table.error("file", str(error)) from None

    def at(self, n: int) -> "MeshFile":
        """Raise an error: the file has one mesh."""
        message = "a mesh from a file is used as it is; there is nothing to choose"
        raise InputError(message, "domain")

    def levels(self) -> list[Domain]:
        """Return the mesh of the file as the only level."""
        return [self]

    def make(self, comm: MPI.Comm) -> SidedMesh:
        return read_mesh(comm, self.path, self.grid, self.tags)

    def record(self) -> dict[str, Any]:
        """Return the name of the file and a digest of its bytes."""
        digest = hashlib.sha256(self.path.read_bytes()).hexdigest()
        return {"mesh_file": {"name": self.path.name, "sha256": digest}}


DOMAINS: dict[str, type[Domain]] = {d.shape: d for d in (Square, Cube, Polygon, MeshFile)}


def read_domain(table: TomlTable, folder: Path, comm: MPI.Comm, sized: bool) -> Domain:
    """Return the domain that a table describes.

    Args:
        table: The table [domain] of a scene file.
        folder: Where a mesh file is looked for.
        comm: The communicator that will share the mesh.
        sized: Whether the table says how fine the mesh is; else an accuracy decides on the meshes.

    Raises:
        InputError: The table describes no domain, or the mesh would be too large.
    """
    kind = DOMAINS[table.choice("shape", tuple(DOMAINS))]
    if not sized and kind.width_key and table.has(kind.width_key):
        raise table.error(kind.width_key, "follows from 'accuracy'; give one of the two")
    domain = kind.read(table, folder, comm, sized)
    if domain.vertices > MAX_VERTICES:
        raise table.error(None, f"a mesh of more than {MAX_VERTICES} vertices")
    table.finish()
    return domain


def _with_sides(domain: mesh.Mesh, names: Sequence[str]) -> SidedMesh:
    """Return a mesh of the unit square or cube with its sides: for each axis that at 0 and at 1."""

    def on(k: int) -> Callable[[Any], Any]:
        return lambda x: np.abs(x[k // 2] - k % 2) < 1e-12

    dim = domain.topology.dim - 1
    sides = {n: mesh.locate_entities_boundary(domain, dim, on(k)) for k, n in enumerate(names)}
    return SidedMesh(domain, sides)
