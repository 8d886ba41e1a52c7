"""Domains of scenes: each with a mesh, meshes of other widths, and sides.

A side is a named part of the boundary that conditions can be put on. How solutions are drawn
follows from the dimension of the domain.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.meshes.curved_sides import CurvedSides, Projection
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh
from dolfinx_signorini.scenes.files.toml_table import TomlTable
from dolfinx_signorini.solvers.cascade import COARSEST, RATIO, coarse_levels

MAX_VERTICES = 20_000_000  # of a mesh that a scene may ask for


class Domain(ABC):
    """A domain with the mesh that a scene asks for, and with its meshes of other widths.

    A scene is posed on the mesh, or on the meshes of the cascade:

        domain = Square(101)
        coarse = domain.at(13).make(comm)
        facets = coarse.facets(("left", "right"))

    Attributes:
        shape: The name of the shape in scene files.
        width_key: The key of a scene file that says how fine the mesh is; "" for none.
        coarse_cells: The number of cells across the mesh where the table names no width.
        first_cells: The number of cells across the mesh that adapted meshes are refined from.
        dimension: The space dimension.
        side_names: The names of the sides.
        region_names: The names of the regions, for meshes that are made with them.
        vertices: The number of vertices of the mesh, which may be an estimate.
    """

    shape: ClassVar[str]
    width_key: ClassVar[str] = ""
    coarse_cells: ClassVar[int] = 20
    first_cells: ClassVar[int] = 4
    dimension: int
    side_names: tuple[str, ...]
    region_names: tuple[str, ...] = ()
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

    def make_after(self, coarser: "Domain", sided: SidedMesh) -> SidedMesh:
        """Make the mesh, by refinement of that of a coarser one of the `levels` where possible."""
        return self.make(sided.mesh.comm)

    @property
    def cells_across(self) -> int:
        """About the number of cells across the domain."""
        return round(self.vertices ** (1.0 / self.dimension)) - 1

    @property
    def size(self) -> float:
        """The side of a square, or cube, of about the size of the domain."""
        return 1.0

    @property
    def geometry(self) -> Mapping[str, Projection]:
        """For curved sides the projection onto the curve, see `CurvedSides`."""
        return {}

    def levels(self) -> list["Domain"]:
        """Return the domain with each mesh of the cascade, coarsest first; the last is this one."""
        coarse = coarse_levels(self.cells_across, self.dimension)
        return [*(self.at(n) for n in coarse), self]

    def first(self) -> "Domain":
        """Return the domain with the coarse mesh that adapted meshes are refined from."""
        return self.at(self.first_cells)

    def with_regions(self, comm: MPI.Comm) -> "Domain":
        """Return the domain with meshes whose cells belong to the regions of `region_names`.

        Raises:
            InputError: The cells have no names; the subject is "cells".
        """
        raise InputError("only a mesh from a file has cells with names", "cells")

    def record(self) -> dict[str, Any]:
        """Return what a record of a run needs to tell of the domain beside the scene file."""
        return {}


class RefinedDomain(Domain):
    """A domain whose meshes are refinements of one coarse mesh, which all cells are divided for.

    The meshes of the cascade are ancestors of the mesh, so that multigrid knows its coarser levels:

        coarse, fine = Polygon(corners, 0.01).levels()
        sided = coarse.make(comm)
        finer = fine.make_after(coarse, sided)

    Attributes:
        refinements: How often the cells of the coarse mesh are divided.
    """

    refinements: int

    @abstractmethod
    def refined_less(self, times: int) -> "RefinedDomain":
        """Return the domain with the mesh that is refined so many times less."""

    @abstractmethod
    def make_coarsest(self, comm: MPI.Comm) -> SidedMesh:
        """Make the mesh before refinement."""

    def make(self, comm: MPI.Comm) -> SidedMesh:
        coarsest = self.make_coarsest(comm)
        CurvedSides(self.geometry).check(coarsest)
        return self._refined(coarsest, self.refinements)

    def make_after(self, coarser: Domain, sided: SidedMesh) -> SidedMesh:
        assert isinstance(coarser, RefinedDomain)
        return self._refined(sided, self.refinements - coarser.refinements)

    def _refined(self, sided: SidedMesh, times: int) -> SidedMesh:
        for _ in range(times):
            sided = refined(sided).sided
            CurvedSides(self.geometry).fit(sided)
        return sided

    def levels(self) -> list[Domain]:
        level, levels = self, [self]
        step = round(math.log2(RATIO[self.dimension]))
        while level.refinements and level.cells_across > COARSEST[self.dimension]:
            level = level.refined_less(min(step, level.refinements))
            levels.insert(0, level)
        return [*levels]
