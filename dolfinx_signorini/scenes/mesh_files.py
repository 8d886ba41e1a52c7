"""Meshes from gmsh and from XDMF files, with the facets of their tags as sides.

gmsh runs on rank 0, and an error there is raised on all ranks. Only what begins like a .msh file is
given to gmsh, because gmsh would run the commands of a script.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
from dolfinx import mesh
from dolfinx.io import XDMFFile
from mpi4py import MPI

from dolfinx_signorini import compat
from dolfinx_signorini.errors import InputError, require
from dolfinx_signorini.meshes import SidedMesh, boundary_facets
from dolfinx_signorini.scenes.domain import Domain
from dolfinx_signorini.scenes.toml_table import TomlTable

TRIANGLE, TETRAHEDRON = 2, 4  # element types of gmsh
FLAT = 1e-10  # volume of a cell that is refused, relative to a cube of its size
MAX_XDMF = 1_000_000  # bytes of the XML part


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
        sided = _read_mesh(comm, path, grid, tags)
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
        return _read_mesh(comm, self.path, self.grid, self.tags)

    def record(self) -> dict[str, Any]:
        """Return the name of the file and a digest of its bytes."""
        digest = hashlib.sha256(self.path.read_bytes()).hexdigest()
        return {"mesh_file": {"name": self.path.name, "sha256": digest}}


def _read_mesh(comm: MPI.Comm, path: Path, grid: str, tags: str) -> SidedMesh:
    """Read a mesh with its facet tags; refuse what is no such mesh, with the subject "domain"."""
    message = comm.bcast(_refusal(path) if comm.rank == 0 else None)
    if message:
        raise InputError(message, "domain")
    if path.suffix == ".msh":
        sided = with_gmsh(comm, lambda gmsh: _open_msh(gmsh, path))
    else:
        sided = _read_xdmf(comm, path, grid, tags)
    domain = sided.mesh
    exterior = boundary_facets(domain)
    owned = domain.topology.index_map(domain.topology.dim - 1).size_local
    inner = any(not np.isin(f[f < owned], exterior).all() for f in sided.sides.values())
    require(comm, not inner, f"{path.name}: a facet tag is on facets inside the domain", "domain")
    return sided


def _refusal(path: Path) -> str:
    """Return what is wrong with a file, as far as the beginning of the file tells."""
    if path.suffix not in (".msh", ".xdmf"):
        return f"{path.name}: a mesh file ends in .msh or .xdmf"
    try:
        with path.open("rb") as file:
            head = file.read(MAX_XDMF + 1)
    except OSError as error:
        return f"{path}: {error.strerror}"
    if path.suffix == ".msh":
        return "" if head.startswith(b"$MeshFormat") else f"{path.name}: not a .msh file of gmsh"
    if len(head) > MAX_XDMF or b"<!ENTITY" in head:
        return f"{path.name}: not an XDMF file with its data in HDF5"
    try:
        items = ElementTree.fromstring(head).iter("DataItem")
        names = {str(i.text).split(":")[0].strip() for i in items if i.get("Format") == "HDF"}
    except ElementTree.ParseError as error:
        return f"{path.name}: not an XDMF file ({error})"
    for name in names:
        if "/" in name or "\\" in name or not path.with_name(name).is_file():
            return f"{path.name}: its data file {name!r} is not next to it"
    return ""


def with_gmsh(comm: MPI.Comm, build: Callable[[Any], dict[int, str]]) -> SidedMesh:
    """Let gmsh make or read a mesh on rank 0, and share the mesh.

    Args:
        comm: The communicator that shares the mesh.
        build: Is given the module gmsh on rank 0, and returns the names of the facet tags.

    Raises:
        InputError: gmsh is missing, or said what is wrong.
    """
    try:
        import gmsh  # only where it is needed
    except ImportError:
        gmsh = None
    message = "this mesh needs gmsh's Python module (package python3-gmsh)"
    require(comm, gmsh is not None, message, "domain")
    message, names, dimension = "", {}, 0
    if comm.rank == 0:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        try:
            gmsh.option.setNumber("General.Terminal", 0)
            gmsh.option.setNumber("General.AbortOnError", 0)
            names = build(gmsh)
            dimension = gmsh.model.getDimension()
        except Exception as error:  # gmsh raises this very class
            message = f"gmsh: {error}" if not isinstance(error, InputError) else str(error)
    try:
        message, names, dimension = comm.bcast((message, names, dimension))
        if message:
            raise InputError(message, "domain")
        domain, tags = compat.gmsh_mesh(gmsh.model, comm, dimension)
    finally:
        if comm.rank == 0:
            gmsh.finalize()
    return _sided(domain, tags, names)


def _open_msh(gmsh: Any, path: Path) -> dict[int, str]:
    """Open a .msh file and return the names of its facet tags."""
    gmsh.open(str(path))
    dimension = gmsh.model.getDimension()
    kind = {2: TRIANGLE, 3: TETRAHEDRON}.get(dimension)
    if kind is None or set(gmsh.model.mesh.getElementTypes(dimension)) != {kind}:
        raise InputError(
            f"{path.name}: only straight-sided triangles in the plane and tetrahedra are solved on"
        )
    if not gmsh.model.getPhysicalGroups(dimension):
        raise InputError(f"{path.name}: the cells have no physical group")
    defect = _defect(gmsh, dimension)
    if defect:
        raise InputError(f"{path.name}: {defect}")
    groups = gmsh.model.getPhysicalGroups(dimension - 1)
    if not groups:
        raise InputError(f"{path.name}: no physical group on the boundary, so no side has a tag")
    return {tag: gmsh.model.getPhysicalName(dim, tag) or str(tag) for dim, tag in groups}


def _defect(gmsh: Any, dimension: int) -> str:
    """Return what is wrong with a mesh that gmsh has read; "" where nothing is."""
    nodes, x, _ = gmsh.model.mesh.getNodes()
    points = x.reshape(-1, 3)
    if not np.isfinite(points).all():
        return "a node has a coordinate that is not finite"
    if dimension == 2 and np.abs(points[:, 2]).max() > 0.0:
        return "the triangles do not lie in the plane z = 0"
    _, _, used = gmsh.model.mesh.getElements()
    if len(np.unique(nodes)) < len(nodes) or not all(np.isin(u, nodes).all() for u in used):
        return "an element has a node that there is not, or twice"
    order = np.argsort(nodes)
    cells, sides = (
        order[np.searchsorted(nodes[order], _elements(gmsh, d))] for d in (dimension, dimension - 1)
    )
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    volume = np.sqrt(np.abs(np.linalg.det(edges @ edges.transpose(0, 2, 1))))
    if not (volume > FLAT * np.linalg.norm(edges, axis=2).max(axis=1) ** dimension).all():
        return "a cell has (almost) no volume"
    corners = [[k for k in range(dimension + 1) if k != j] for j in range(dimension + 1)]
    facets = np.sort(np.concatenate([cells[:, c] for c in corners]), axis=1)
    facets, counts = np.unique(facets, axis=0, return_counts=True)
    if counts.max() > 2:
        return "more than two cells meet in a facet"
    known = np.unique(np.concatenate((facets, np.sort(sides, axis=1))), axis=0)
    if len(known) > len(facets):
        return "a tag is on a facet that no cell has"
    gmsh.model.mesh.renumberNodes()  # without gaps, which dolfinx takes for granted
    return ""


def _elements(gmsh: Any, dimension: int) -> npt.NDArray[np.int64]:
    """Return the nodes of the elements in the physical groups of a dimension."""
    found = [
        nodes.reshape(-1, dimension + 1)
        for _, group in gmsh.model.getPhysicalGroups(dimension)
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, group)
        for nodes in gmsh.model.mesh.getElements(dimension, entity)[2]
    ]
    return np.concatenate([np.empty((0, dimension + 1), dtype=np.int64), *found]).astype(np.int64)


def _sided(domain: mesh.Mesh, tags: Any, names: dict[int, str]) -> SidedMesh:
    """Return a mesh with the facets of each tag; a tag with a name has its number as well."""
    sides = {}
    for tag, name in names.items():
        sides[name] = sides[str(tag)] = tags.find(tag)
    return SidedMesh(domain, sides)


def _read_xdmf(comm: MPI.Comm, path: Path, grid: str, name: str) -> SidedMesh:
    try:
        with XDMFFile(comm, str(path), "r") as file:
            domain = file.read_mesh(name=grid)
            tdim = domain.topology.dim
            domain.topology.create_connectivity(tdim - 1, tdim)
            tags = file.read_meshtags(domain, name=name)
    except RuntimeError as error:
        reason = (str(error).strip().splitlines() or [""])[-1]
        message = f"{path.name}: no mesh {grid!r} with facet tags {name!r} ({reason})"
        raise InputError(message, "domain") from None
    kind = domain.topology.cell_name()
    straight = kind in ("triangle", "tetrahedron") and domain.geometry.cmap.degree == 1
    flat = domain.geometry.dim == tdim
    require(
        comm,
        straight and flat and tags.dim == tdim - 1,
        f"{path.name}: only straight-sided triangles in the plane and tetrahedra with tags "
        "on their facets are solved on",
        "domain",
    )
    values = sorted(set().union(*comm.allgather(set(tags.values.tolist()))))
    return _sided(domain, tags, {tag: str(tag) for tag in values})
