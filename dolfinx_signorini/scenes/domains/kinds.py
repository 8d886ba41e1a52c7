"""The domains of scenes: the unit square and the unit cube, and the list of all shapes.

A new shape is a subclass of `Domain` in the list `DOMAINS`.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfinx_signorini.base.tolerances import ROUNDING
from dolfinx_signorini.meshes.box_meshes import box_mesh
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, boundary_facets, entity_nodes
from dolfinx_signorini.scenes.domains.domain import MAX_VERTICES, Domain
from dolfinx_signorini.scenes.domains.mesh_files import MeshFile
from dolfinx_signorini.scenes.domains.polygons import Polygon
from dolfinx_signorini.scenes.files.toml_table import TomlTable, one_of

SQUARE_SIDES: tuple[str, ...] = ("left", "right", "bottom", "top")
CUBE_SIDES: tuple[str, ...] = ("left", "right", "front", "back", "bottom", "top")


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
        domain = box_mesh(comm, [np.linspace(0.0, 1.0, self.cells + 1)] * self.dimension)
        facets = boundary_facets(domain)
        x = domain.geometry.x[entity_nodes(domain, self.dimension - 1, facets)]
        sides = {}
        for k, name in enumerate(self.side_names):  # for each axis the side at 0 and that at 1
            there = (np.abs(x[:, :, k // 2] - k % 2) < ROUNDING).all(axis=1)
            sides[name] = facets[there]
        return SidedMesh(domain, sides)


@dataclass(frozen=True)
class Cube(Square):
    """The unit cube in cells^3 cubes of six tetrahedra each, for example `Cube(cells=15)`."""

    shape = "cube"
    dimension = 3
    side_names = CUBE_SIDES
    coarse_cells = 5
    first_cells = 2


DOMAINS: dict[str, type[Domain]] = {d.shape: d for d in (Square, Cube, Polygon, MeshFile)}


def read_domain(
    table: TomlTable, folder: Path, comm: MPI.Comm, sized: bool, adapted: bool
) -> Domain:
    """Return the domain that a table describes.

    Args:
        table: The table [domain] of a scene file.
        folder: Where a mesh file is looked for.
        comm: The communicator that will share the mesh.
        sized: Whether the table says how fine the mesh is; else an accuracy decides on the meshes.
        adapted: Whether the width may be left out, because the mesh will be adapted.

    Raises:
        InputError: The table describes no domain, or the mesh would be too large.
    """
    kind = DOMAINS[table.text("shape", check=one_of(DOMAINS))]
    if not sized and kind.width_key and table.has(kind.width_key):
        raise table.error(kind.width_key, "follows from 'accuracy'; give one of the two")
    sized = sized and not (adapted and kind.width_key and kind.width_key not in table.data)
    domain = kind.read(table, folder, comm, sized)
    if domain.vertices > MAX_VERTICES:
        raise table.error(None, f"a mesh of more than {MAX_VERTICES} vertices")
    table.finish()
    return domain
