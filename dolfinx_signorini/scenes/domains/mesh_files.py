"""Domains given by .msh files of gmsh and by XDMF files, with the facets of their tags as sides.

Only what begins like a .msh file is given to gmsh, because gmsh would run the commands of a script.
"""

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from dolfinx import mesh
from dolfinx.io import XDMFFile
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.errors import InputError, require
from dolfinx_signorini.base.tolerances import HALVINGS, ROUNDING
from dolfinx_signorini.data.formulas import Formula
from dolfinx_signorini.data.interfaces.interface import Interface
from dolfinx_signorini.data.parsing import suggestion
from dolfinx_signorini.meshes.curved_sides import Projection
from dolfinx_signorini.meshes.mesh_defects import cell_defect
from dolfinx_signorini.meshes.sided_meshes import (
    SidedMesh,
    boundary_facets,
    gathered_cells,
    is_straight,
    owned_facets,
)
from dolfinx_signorini.scenes.domains.domain import MAX_VERTICES, RefinedDomain
from dolfinx_signorini.scenes.domains.gmsh_meshes import (
    by_tag,
    owned_by_tag,
    read_msh,
    with_gmsh,
)
from dolfinx_signorini.scenes.files.toml_file import MAX_BYTES
from dolfinx_signorini.scenes.files.toml_table import TomlTable


@dataclass(frozen=True)
class MeshFile(RefinedDomain):
    """A domain given by the mesh in a file, which may be refined.

    The sides are the facet tags: their numbers and, in .msh files, the names of physical groups.
    The file is looked into first:

        plate = MeshFile.open(comm, Path("plate.msh"))
        print(plate.side_names)

    Attributes:
        path: The file.
        dimension: Space dimension.
        side_names: The facet tags.
        vertices: The number of vertices, which is an estimate where the mesh is refined.
        grid, tags, cell_tags: For XDMF: the names of the mesh, its facet tags and its cell tags.
        region_names: The cell tags, where they are asked for by `with_regions`.
        refinements: How often all cells are divided.
        curves: For curved sides a formula whose zeros are the side; new vertices go there.
    """

    path: Path
    dimension: int
    side_names: tuple[str, ...]
    vertices: int
    grid: str = "mesh"
    tags: str = "facet_tags"
    cell_tags: str = "cell_tags"
    region_names: tuple[str, ...] = ()
    refinements: int = 0
    curves: tuple[tuple[str, Formula], ...] = ()
    shape = "file"

    @classmethod
    def open(
        cls, comm: MPI.Comm, path: Path, grid: str = "mesh", tags: str = "facet_tags"
    ) -> "MeshFile":
        """Look into a mesh file.

        Args:
            comm: The communicator; the call is collective.
            path: A file that ends in .msh or .xdmf.
            grid, tags: The names of the mesh and of its facet tags in an XDMF file.

        Raises:
            InputError: The file cannot be read, or is not a mesh of triangles or tetrahedra with
                facet tags on its boundary.
        """
        sided = _read_mesh(comm, path, grid, tags, "")
        count = sided.mesh.topology.index_map(0).size_global
        return cls(path, sided.mesh.geometry.dim, tuple(sided.sides), count, grid, tags)

    @classmethod
    def read(cls, table: TomlTable, folder: Path, comm: MPI.Comm, sized: bool) -> "MeshFile":
        path = folder / table.text("file")
        names = table.text("grid", cls.grid), table.text("tags", cls.tags)
        times = table.integer("refinements", 0, MAX_VERTICES.bit_length(), 0)
        with table.naming("file"):
            found = cls.open(comm, path, *names)
        vertices = found.vertices << found.dimension * times
        cells, curves = table.text("cell_tags", cls.cell_tags), _read_curves(table, found)
        return replace(found, cell_tags=cells, refinements=times, vertices=vertices, curves=curves)

    @property
    def geometry(self) -> dict[str, Projection]:
        return {name: _projection(formula, self.dimension) for name, formula in self.curves}

    def at(self, n: int) -> "MeshFile":
        """Raise an error: the file has one mesh."""
        message = "a mesh from a file is used as it is; there is nothing to choose"
        raise InputError(message, "domain")

    def first(self) -> "MeshFile":
        return self

    def refined_less(self, times: int) -> "MeshFile":
        vertices = self.vertices >> self.dimension * times
        return replace(self, vertices=vertices, refinements=self.refinements - times)

    def make_coarsest(self, comm: MPI.Comm) -> SidedMesh:
        return self._read(comm, regions=len(self.region_names) > 0)

    def with_regions(self, comm: MPI.Comm) -> "MeshFile":
        return replace(self, region_names=tuple(self._read(comm, regions=True).regions))

    def _read(self, comm: MPI.Comm, regions: bool) -> SidedMesh:
        names = self.grid, self.tags, self.cell_tags if regions else ""
        return _read_mesh(comm, self.path, *names)

    def record(self) -> dict[str, Any]:
        """Return the name of the file and a digest of its bytes."""
        digest = hashlib.sha256(self.path.read_bytes()).hexdigest()
        return {"mesh_file": {"name": self.path.name, "sha256": digest}}


def _read_curves(table: TomlTable, domain: MeshFile) -> tuple[tuple[str, Formula], ...]:
    """Return the formulas for the curved sides of a domain."""
    curves, table.file.dimension = table.table("curves"), domain.dimension
    for name in curves.data:
        if name not in domain.side_names:
            raise curves.error(name, f"unknown side{suggestion(name, domain.side_names)}")
    return tuple((name, curves.formula(name)) for name in curves.data)


def _read_mesh(comm: MPI.Comm, path: Path, grid: str, tags: str, cell_tags: str) -> SidedMesh:
    """Read a mesh with its facet tags and, unless they are "", its cell tags.

    Raises:
        InputError: The file has no such mesh; the subject is "domain".
    """
    message = comm.bcast(_refusal(path) if comm.rank == 0 else None)
    if message:
        raise InputError(message, "domain")
    try:
        if path.suffix == ".msh":
            sided = with_gmsh(comm, lambda gmsh: read_msh(gmsh, path), regions=cell_tags != "")
        else:
            sided = _read_xdmf(comm, path, grid, tags, cell_tags)
        domain = sided.mesh
        exterior, sides = boundary_facets(domain), sided.sides.values()
        inner = any(not np.isin(owned_facets(domain, f), exterior).all() for f in sides)
        require(comm, not inner, "a facet tag is on facets inside the domain", "domain")
    except InputError as error:
        raise InputError(f"{path.name}: {error.message}", "domain") from None
    return sided


def _refusal(path: Path) -> str:
    """Return what is wrong with a file, as far as the beginning of the file tells."""
    if path.suffix not in (".msh", ".xdmf"):
        return f"{path.name}: a mesh file ends in .msh or .xdmf"
    try:
        if path.exists() and not path.is_file():  # a pipe would be waited for
            return f"{path.name}: not a file"
        with path.open("rb") as file:
            head = file.read(MAX_BYTES + 1)
    except OSError as error:
        return f"{path}: {error.strerror}"
    except ValueError as error:  # a name that no file can have
        return f"{str(path)!r}: {error}"
    if path.suffix == ".msh":
        return "" if head.startswith(b"$MeshFormat") else f"{path.name}: not a .msh file of gmsh"
    if len(head) > MAX_BYTES or b"<!ENTITY" in head:
        return f"{path.name}: not an XDMF file with its data in HDF5"
    try:
        items = ElementTree.fromstring(head).iter("DataItem")
        names = {str(i.text).split(":")[0].strip() for i in items if i.get("Format") == "HDF"}
    except (ElementTree.ParseError, LookupError, ValueError) as error:  # or an unknown encoding
        return f"{path.name}: not an XDMF file ({error})"
    for name in names:
        if "/" in name or "\\" in name or not path.with_name(name).is_file():
            return f"{path.name}: its data file {name!r} is not next to it"
    return ""


def _read_xdmf(comm: MPI.Comm, path: Path, grid: str, name: str, cell_name: str) -> SidedMesh:
    wanted = f"facet tags {name!r}" + (f" and cell tags {cell_name!r}" if cell_name else "")
    try:
        with XDMFFile(comm, str(path), "r") as file:
            domain = file.read_mesh(name=grid)
            tdim = domain.topology.dim
            domain.topology.create_connectivity(tdim - 1, tdim)
            tags = file.read_meshtags(domain, name=name)
            cell_tags = file.read_meshtags(domain, name=cell_name) if cell_name else None
    except RuntimeError as error:
        reason = (str(error).strip().splitlines() or [""])[-1]
        raise InputError(f"no mesh {grid!r} with {wanted} ({reason})") from None
    message = "only straight-sided triangles in the plane and tetrahedra with tags on their facets"
    solved_on = is_straight(domain) and tags.dim == tdim - 1
    require(comm, solved_on, f"{message} are solved on", "domain")
    ids, x = gathered_cells(domain)
    defect = comm.bcast(cell_defect(ids, x[ids]))
    if defect:
        raise InputError(defect)
    sides = by_tag(tags, _numbers(comm, tags))
    if cell_tags is None:
        return SidedMesh(domain, sides)
    require(comm, cell_tags.dim == tdim, f"the tags {cell_name!r} are none of cells", "domain")
    return SidedMesh(domain, sides, owned_by_tag(domain, cell_tags, _numbers(comm, cell_tags)))


def _numbers(comm: MPI.Comm, tags: mesh.MeshTags) -> dict[int, str]:
    """The numbers of tags on all ranks, with their texts."""
    values = sorted(set().union(*comm.allgather(set(tags.values.tolist()))))
    return {tag: str(tag) for tag in values}


def _projection(formula: Formula, dimension: int) -> Projection:
    """Newton's method along the gradient of a formula."""
    side = Interface(formula.root)

    def onto(points: Array) -> Array:
        x: Array = points[:dimension].T.copy()
        for _ in range(HALVINGS):
            values, slope = side.values(x), side.gradients(x)
            with np.errstate(all="ignore"):
                step = np.where(values, values / (slope**2).sum(axis=1), 0.0)[:, None] * slope
            x -= step
            if np.abs(step).max() <= ROUNDING * np.abs(points).max():
                return np.concatenate((x.T, points[dimension:]))
        raise ValueError(f"no zeros of {formula.text} are found near the side")

    return onto
