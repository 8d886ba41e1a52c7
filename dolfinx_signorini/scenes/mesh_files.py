"""Meshes made and read by gmsh, and XDMF meshes, with the facets of their tags.

gmsh runs on rank 0; what it says is wrong there is raised on all ranks. Only what begins like a
.msh file is given to gmsh, because it would run the commands of a script.
"""

from collections.abc import Callable
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
from dolfinx_signorini.meshes import boundary_facets

Sides = dict[str, npt.NDArray[np.int32]]

TRIANGLE, TETRAHEDRON = 2, 4  # element types of gmsh
FLAT = 1e-10  # volume of a cell that is refused, relative to a cube of its size
MAX_XDMF = 1_000_000  # bytes of the XML part


def polygon_mesh(
    comm: MPI.Comm, corners: tuple[tuple[float, float], ...], width: float
) -> tuple[mesh.Mesh, Sides]:
    """Return a triangulation of a simple polygon, and its edges as sides "1", "2", ...

    Args:
        comm: The communicator that shares the mesh.
        corners: The vertices, in order.
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

    return _with_gmsh(comm, build)


def read_mesh(comm: MPI.Comm, path: Path, grid: str, tags: str) -> tuple[mesh.Mesh, Sides]:
    """Read a mesh with its facet tags from a .msh or .xdmf file.

    Args:
        comm: The communicator that shares the mesh.
        path: The file.
        grid: Name of the mesh in an XDMF file.
        tags: Name of the facet tags in an XDMF file.

    Raises:
        InputError: The file is missing, or not such a mesh.
    """
    message = comm.bcast(_refusal(path) if comm.rank == 0 else None)
    if message:
        raise InputError(message)
    if path.suffix == ".msh":
        domain, sides = _with_gmsh(comm, lambda gmsh: _open_msh(gmsh, path))
    else:
        domain, sides = _read_xdmf(comm, path, grid, tags)
    exterior = boundary_facets(domain)
    owned = domain.topology.index_map(domain.topology.dim - 1).size_local
    inner = any(not np.isin(facets[facets < owned], exterior).all() for facets in sides.values())
    require(comm, not inner, f"{path.name}: a facet tag is on facets inside the domain")
    return domain, sides


def _refusal(path: Path) -> str:
    """Say what is wrong with a file, as far as it can be told from its beginning."""
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


def _with_gmsh(comm: MPI.Comm, build: Callable[[Any], dict[int, str]]) -> tuple[mesh.Mesh, Sides]:
    """Let gmsh make or read a mesh on rank 0, and share it; `build` returns the names of tags."""
    try:
        import gmsh  # only where it is needed
    except ImportError:
        gmsh = None
    require(comm, gmsh is not None, "this mesh needs gmsh's Python module (package python3-gmsh)")
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
            raise InputError(message)
        domain, tags = compat.gmsh_mesh(gmsh.model, comm, dimension)
    finally:
        if comm.rank == 0:
            gmsh.finalize()
    return domain, _sides(tags, names)


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
    """Say what is wrong with a mesh that gmsh has read as it was written, if anything is."""
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
    """The nodes of the elements in the physical groups of a dimension."""
    found = [
        nodes.reshape(-1, dimension + 1)
        for _, group in gmsh.model.getPhysicalGroups(dimension)
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, group)
        for nodes in gmsh.model.mesh.getElements(dimension, entity)[2]
    ]
    return np.concatenate([np.empty((0, dimension + 1), dtype=np.int64), *found]).astype(np.int64)


def _sides(tags: Any, names: dict[int, str]) -> Sides:
    """The facets of each tag; a tag with a name is known by its number as well."""
    sides = {}
    for tag, name in names.items():
        sides[name] = tags.find(tag)
        sides[str(tag)] = sides[name]
    return sides


def _read_xdmf(comm: MPI.Comm, path: Path, grid: str, name: str) -> tuple[mesh.Mesh, Sides]:
    try:
        with XDMFFile(comm, str(path), "r") as file:
            domain = file.read_mesh(name=grid)
            tdim = domain.topology.dim
            domain.topology.create_connectivity(tdim - 1, tdim)
            tags = file.read_meshtags(domain, name=name)
    except RuntimeError as error:
        lines = str(error).strip().splitlines()
        raise InputError(
            f"{path.name}: no mesh {grid!r} with facet tags {name!r} ({lines[-1] if lines else ''})"
        ) from None
    kind = domain.topology.cell_name()
    straight = kind in ("triangle", "tetrahedron") and domain.geometry.cmap.degree == 1
    flat = domain.geometry.dim == tdim
    require(
        comm,
        straight and flat and tags.dim == tdim - 1,
        f"{path.name}: only straight-sided triangles in the plane and tetrahedra with tags "
        "on their facets are solved on",
    )
    values = sorted(set().union(*comm.allgather(set(tags.values.tolist()))))
    return domain, _sides(tags, {tag: str(tag) for tag in values})
