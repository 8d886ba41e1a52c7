"""Meshes that gmsh makes or reads, with the facets of their physical groups as sides.

gmsh runs on rank 0, and an error of gmsh is raised on all ranks.
"""

import re
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx import mesh
from mpi4py import MPI

from dolfinx_signorini.base import compat
from dolfinx_signorini.base.arrays import Indices, LocalIndices
from dolfinx_signorini.base.errors import InputError, require
from dolfinx_signorini.meshes.mesh_defects import cell_defect
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, owned_cells


def with_gmsh(comm: MPI.Comm, build: Callable[[Any], None], regions: bool = False) -> SidedMesh:
    """Let gmsh make or read a mesh on rank 0, and share the mesh.

    Args:
        comm: The communicator that shares the mesh.
        build: Is given the module gmsh on rank 0; the physical groups of facets are the sides.
        regions: Whether the cells of the physical groups are wanted, too.

    Raises:
        InputError: gmsh is missing, or said what is wrong.
    """
    try:
        import gmsh  # only where it is needed
    except ImportError:
        gmsh = None
    message = "this mesh needs gmsh's Python module (package python3-gmsh)"
    require(comm, gmsh is not None, message, "domain")
    message, names, groups, dimension = "", {}, {}, 0
    if comm.rank == 0:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        try:
            gmsh.option.setNumber("General.Terminal", 0)
            gmsh.option.setNumber("General.AbortOnError", 0)
            build(gmsh)
            dimension = gmsh.model.getDimension()
            names = names_of_groups(gmsh, dimension - 1)
            groups = names_of_groups(gmsh, dimension) if regions else {}
        except Exception as error:  # gmsh raises this very class
            message = f"gmsh: {error}" if not isinstance(error, InputError) else str(error)
    try:
        message, names, groups, dimension = comm.bcast((message, names, groups, dimension))
        if message:
            raise InputError(message, "domain")
        domain, tags, cell_tags = compat.gmsh_mesh(gmsh.model, comm, dimension)
    finally:
        if comm.rank == 0:
            gmsh.finalize()
    return SidedMesh(domain, by_tag(tags, names), owned_by_tag(domain, cell_tags, groups))


def by_tag(tags: Any, names: dict[int, str]) -> dict[str, LocalIndices]:
    """Return the facets or cells of each tag, by its number and by its name."""
    found = {}
    for tag, name in names.items():
        found[name] = found[str(tag)] = tags.find(tag)
    return found


def owned_by_tag(domain: mesh.Mesh, tags: Any, names: dict[int, str]) -> dict[str, LocalIndices]:
    """Return the owned cells of each tag, see `by_tag`."""
    own = len(owned_cells(domain))
    return {name: cells[cells < own] for name, cells in by_tag(tags, names).items()}


def names_of_groups(gmsh: Any, dimension: int) -> dict[int, str]:
    """Return the names of the physical groups of a dimension by their tags; numbers for none."""
    groups = gmsh.model.getPhysicalGroups(dimension)
    return {tag: gmsh.model.getPhysicalName(d, tag) or str(tag) for d, tag in groups}


def read_msh(gmsh: Any, path: Path) -> None:
    """Open a .msh file.

    Args:
        gmsh: The module gmsh, initialized.
        path: The file.

    Raises:
        InputError: The file is not complete, or has no mesh with sides that is solved on.
    """
    announced = _announced(path)
    gmsh.open(str(path))
    mesh_of = gmsh.model.mesh
    found = {
        "Nodes": len(mesh_of.getNodes()[0]),
        "Elements": sum(map(len, mesh_of.getElements()[1])),
    }
    for name, count in announced.items():
        if found[name] != count:
            message = f"${name} announces {count}, of which {found[name]} were read"
            raise InputError(f"{message}: the file is damaged")
    dimension = gmsh.model.getDimension()
    kinds = set(mesh_of.getElementTypes(dimension))
    if dimension < 2 or not kinds:
        raise InputError(
            "there are no triangles of a plane mesh and no tetrahedra; gmsh writes the cells only "
            "where they have a physical group, as the sides have"
        )
    simplex = {2: "triangle", 3: "tetrahedron"}[dimension]
    if kinds != {mesh_of.getElementType(simplex, 1)}:
        raise InputError("only straight-sided triangles in the plane and tetrahedra are solved on")
    if not gmsh.model.getPhysicalGroups(dimension):
        raise InputError("the cells have no physical group")
    defect = _defect(gmsh, dimension)
    if defect:
        raise InputError(defect)
    if not gmsh.model.getPhysicalGroups(dimension - 1):
        raise InputError("no physical group on the boundary, so no side has a tag")


def _announced(path: Path) -> dict[str, int]:
    """Return how many nodes and elements a .msh file says that the file has."""
    content = path.read_bytes()
    sections: dict[str, bytes] = {}
    start = re.compile(rb"^\$(\w+)[ \t\r]*(?:\n|\Z)", re.MULTILINE)
    place = 0
    while match := start.search(content, place):
        name = match[1].decode(errors="replace")
        place = content.find(b"\n$End" + match[1], match.end() - 1)
        if place < 0:
            raise InputError(f"${name} has no end: the file is not complete")
        sections[name] = content[match.end() : match.end() + 80]
        place += len("\n$End") + len(match[1])
    missing = [name for name in ("MeshFormat", "Nodes", "Elements") if name not in sections]
    if missing:
        raise InputError(f"there is no ${missing[0]}: the file is not complete")
    try:
        return {name: _count(sections, name) for name in ("Nodes", "Elements")}
    except (ValueError, IndexError):
        message = "$Nodes or $Elements does not begin with the number of its entries"
        raise InputError(message) from None


def _count(sections: dict[str, bytes], name: str) -> int:
    """Return the number of entries that a section says it has, from the sections' first bytes."""
    version, binary, *_ = sections["MeshFormat"].split()
    if float(version) >= 4.0 and int(binary):
        order = "<" if b"\n\x01\0\0\0" in sections["MeshFormat"] else ">"
        return int(np.frombuffer(sections[name][:16], order + "i8")[1])
    return int(sections[name].split(maxsplit=2)[float(version) >= 4.0])


def _defect(gmsh: Any, dimension: int) -> str:
    """Return what is wrong with a mesh that gmsh has read; "" where nothing is."""
    nodes, x, _ = gmsh.model.mesh.getNodes()
    points = x.reshape(-1, 3)
    if not np.isfinite(points).all():
        return "a node has a coordinate that is not finite"
    if dimension == 2 and np.abs(points[:, 2]).max() > 0.0:
        return (
            "the triangles do not lie in the plane z = 0; the tetrahedra of a mesh in space need "
            "a physical group, as the sides have"
        )
    _, _, used = gmsh.model.mesh.getElements()
    if len(np.unique(nodes)) < len(nodes) or not all(np.isin(u, nodes).all() for u in used):
        return "an element has a node that there is not, or twice"
    order = np.argsort(nodes)
    cells, sides = (
        order[np.searchsorted(nodes[order], _elements(gmsh, d))] for d in (dimension, dimension - 1)
    )
    defect = cell_defect(cells, points[cells, :dimension])
    if defect:
        return defect
    corners = map(list, combinations(range(dimension + 1), dimension))
    facets = np.concatenate([np.sort(cells[:, k], axis=1) for k in corners])
    facets = np.unique(facets, axis=0)
    known = np.unique(np.concatenate((facets, np.sort(sides, axis=1))), axis=0)
    if len(known) > len(facets):
        return "a tag is on a facet that no cell has"
    gmsh.model.mesh.renumberNodes()  # without gaps, which dolfinx takes for granted
    return ""


def _elements(gmsh: Any, dimension: int) -> Indices:
    """Return the nodes of the elements in the physical groups of a dimension."""
    found = [
        nodes.reshape(-1, dimension + 1)
        for _, group in gmsh.model.getPhysicalGroups(dimension)
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, group)
        for nodes in gmsh.model.mesh.getElements(dimension, entity)[2]
    ]
    return np.concatenate([np.empty((0, dimension + 1), dtype=np.int64), *found]).astype(np.int64)
