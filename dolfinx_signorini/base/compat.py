"""The differences between the versions of dolfinx that this package runs on, in one place."""

import importlib
from typing import Any

import basix
import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import cpp, fem, mesh
from ffcx.compiler import compile_ufl_objects
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices, Mask

ELEMENTS = {
    dim: basix.ufl.element("Lagrange", cell, 1, shape=(dim,))
    for dim, cell in ((2, "triangle"), (3, "tetrahedron"))
}  # of the geometry of straight-sided meshes


def c_code(item: Any, prefix: str, options: dict[str, Any]) -> str:
    """Return the code of FFCx for a form, or for an expression and its points.

    FFCx 0.9 returns the header and the source, 0.11 the two and the suffixes of their files.
    """
    made: Any = compile_ufl_objects([item], options, None, prefix)
    source: str = made[1] if isinstance(made[0], str) else made[0][1]
    return source


def interpolation_points(element: Any) -> Array:
    """Return the interpolation points of a finite element: a method in 0.9, later a property."""
    points = element.interpolation_points
    return np.asarray(points() if callable(points) else points)


def owners_of_points(data: Any) -> LocalIndices:
    """Return the ranks that own the points of interpolation data, -1 where no cell has a point.

    The attribute is a method in 0.9, later an array.
    """
    owners = data.src_owner
    return np.asarray(owners() if callable(owners) else owners, dtype=np.int32)


def exterior_facet_pairs(topology: mesh.Topology, facets: LocalIndices) -> LocalIndices:
    """Return boundary facets as (cell, local facet) pairs, flat; 0.11 takes no dimension.

    The topology must have the connectivities between cells and facets.
    """
    arguments: list[Any] = [fem.IntegralType.exterior_facet, topology, facets, topology.dim - 1]
    try:
        pairs = fem.compute_integration_domains(*arguments)
    except TypeError:
        pairs = fem.compute_integration_domains(*arguments[:-1])
    return np.asarray(pairs, dtype=np.int32).reshape(-1)


def gmsh_mesh(model: Any, comm: MPI.Comm, dimension: int) -> tuple[mesh.Mesh, Any, Any]:
    """Return the mesh of `gmsh.model` on rank 0, shared by a communicator, and its tags.

    dolfinx 0.9 has the module gmshio and returns a tuple; 0.10 has the module gmsh and returns an
    object.

    Returns:
        The mesh, its facet tags and its cell tags.
    """
    io: Any
    try:
        io = importlib.import_module("dolfinx.io.gmshio")
    except ImportError:
        io = importlib.import_module("dolfinx.io.gmsh")
    data = io.model_to_mesh(model, comm, 0, gdim=dimension)
    if hasattr(data, "facet_tags"):
        return data.mesh, data.facet_tags, data.cell_tags
    return data[0], data[2], data[1]


def evaluate(expression: fem.Expression, domain: mesh.Mesh, entities: LocalIndices) -> Array:
    """Evaluate an expression on cells, shape (n,), or (cell, local facet) pairs, shape (n, 2).

    dolfinx 0.9 takes pairs as a flat array and lays the points of a facet out from its first to its
    last vertex in the order of the cell; 0.11 takes pairs in two columns and goes by the global
    numbers of the vertices. The order of 0.11 is undone here for edges, whose points must be
    symmetric about 1/2.

    Args:
        expression: The expression.
        domain: The mesh.
        entities: The cells or pairs.

    Returns:
        Shape (n, points * components) or (n, points, components).
    """
    if not hasattr(expression, "value_shape"):
        return np.asarray(expression.eval(domain, entities.flatten()))
    values = np.asarray(expression.eval(domain, entities))
    if entities.ndim == 2 and domain.topology.dim == 2:
        turned = _descending(domain, entities)
        values[turned] = values[turned, ::-1]
    return values


def _descending(domain: mesh.Mesh, facets: LocalIndices) -> Mask:
    """Whether the first vertex of an edge, in the order of its cell, has the larger number."""
    corners, edges, _ = basix.topology(basix.CellType[domain.topology.cell_name()])
    ends = np.array(edges)[facets[:, 1]]
    vertices = domain.topology.connectivity(2, 0).array.reshape(-1, len(corners))
    local = np.take_along_axis(vertices[facets[:, 0]], ends, axis=1)
    numbers = domain.topology.index_map(0).local_to_global(local.ravel()).reshape(local.shape)
    return np.asarray(numbers[:, 0] > numbers[:, 1])


def simplicial_mesh(
    comm: MPI.Comm,
    vertices: Indices,
    cells: Indices,
    owners: LocalIndices,
    nodes: Indices,
    x: Array,
    surface: Indices,
) -> mesh.Mesh:
    """Return a mesh of triangles or tetrahedra whose cells are shared and in order already.

    Args:
        comm: The communicator.
        vertices: The nodes of the cells of this rank, of which ghosts come last.
        cells: The numbers of these cells among those of all ranks.
        owners: The ranks of the ghosts.
        nodes: The nodes of these cells, sorted.
        x: The coordinates of these nodes.
        surface: The nodes on facets of only one cell that this rank owns.
    """
    kind = mesh.to_type({2: "triangle", 3: "tetrahedron"}[x.shape[1]])
    flat = vertices.ravel()
    parts: list[Any] = [comm, [kind], [flat], [cells], [owners], surface]
    try:
        topology = cpp.mesh.create_topology(*parts)
    except TypeError:  # from 0.11 on with a number of threads
        topology = cpp.mesh.create_topology(*parts, 1)
    element = cpp.fem.CoordinateElement_float64(kind, 1)
    args = topology, [element], nodes, flat, x.ravel(), x.shape[1]
    made = cpp.mesh.Mesh_float64(comm, topology, cpp.mesh.create_geometry(*args))
    return mesh.Mesh(made, ufl.Mesh(ELEMENTS[x.shape[1]]))


def refine(
    domain: mesh.Mesh, edges: LocalIndices | None
) -> tuple[mesh.Mesh, LocalIndices, npt.NDArray[np.int8]]:
    """Bisect edges of a mesh, all of them by default; child cells stay on the rank of their parent.

    dolfinx numbers parent cells and facets by the cells before their reordering.

    Args:
        domain: A mesh of triangles or tetrahedra, with its edges.
        edges: Edges of this rank; None for all.

    Returns:
        The mesh, the parent of each owned cell, and for each facet of each owned cell the local
        facet of the parent, -1 for none, shape (cells, facets).
    """
    option = mesh.RefinementOption.parent_cell_and_facet
    fine, parents, facets = mesh.refine(domain, edges, partitioner=None, option=option)
    count = len(parents)
    offset = domain.comm.exscan(count) or 0  # None on rank 0
    order = np.asarray(fine.topology.original_cell_index[:count]) - offset
    return fine, parents[order], facets.reshape(count, domain.topology.dim + 1)[order]
