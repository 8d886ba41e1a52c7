"""Meshes fitted to the straight lines and planes where a coefficient of a scene jumps.

Where the diffusion jumps inside a cell, the solution has a kink there which no polynomial follows,
and cells of width h leave an error of h^(1/2) in H^1. With the jump on facets the solution is as
smooth in each cell as without a jump. So vertices near the jump are moved onto the jump, and the
edges that still cross it are split there. Refinement keeps straight lines and planes on facets.

Source of the order of the two: Labelle and Shewchuk, Isosurface stuffing, ACM Trans. Graph. 26
(2007) 57, who also move vertices first, and split afterwards.
"""

from collections.abc import Sequence

import basix.ufl
import numpy as np
from dolfinx import mesh

from dolfinx_signorini.meshes import SidedMesh, boundary_facets
from dolfinx_signorini.scenes.cutting import Simplices, fitted
from dolfinx_signorini.scenes.formulas import Formula
from dolfinx_signorini.scenes.jumps import switches
from dolfinx_signorini.scenes.mesh_defects import all_cells


def fitted_mesh(sided: SidedMesh, formulas: Sequence[Formula]) -> SidedMesh:
    """Return a mesh in which formulas jump across facets only, where jumps are straight.

    Args:
        sided: The mesh with its sides; the call is collective.
        formulas: The formulas.

    Returns:
        The mesh itself where no straight jump crosses a cell. Jumps along curves stay inside cells.
    """
    nodes = [node for formula in formulas for node in switches(formula)]
    if not nodes:
        return sided
    whole = before = _gathered(sided)
    if whole is not None:
        for node in reversed(nodes):  # what is inside of a formula comes first
            whole = fitted(whole, node)
    return _shared(sided, whole) if sided.mesh.comm.bcast(whole is not before) else sided


def _gathered(sided: SidedMesh) -> Simplices | None:
    """The whole mesh on rank 0."""
    domain = sided.mesh
    dim, comm = domain.topology.dim, domain.comm
    cells, corners = all_cells(domain)
    facets = boundary_facets(domain)
    sides = np.zeros(len(facets), dtype=np.int64)
    for k, on in enumerate(sided.sides.values()):
        sides |= np.isin(facets, on).astype(np.int64) << k
    domain.topology.create_connectivity(dim - 1, dim)
    nodes = mesh.entities_to_geometry(domain, dim - 1, facets)
    ids = domain.geometry.index_map().local_to_global(nodes.ravel()).reshape(nodes.shape)
    parts = comm.gather((ids.reshape(-1, dim), sides))
    if parts is None:
        return None
    x = np.empty((cells.max() + 1, dim))
    x[cells] = corners
    all_facets, all_sides = (np.concatenate(p) for p in zip(*parts, strict=True))
    return Simplices(x, cells, all_facets, all_sides, np.zeros(len(x), dtype=bool))


def _shared(sided: SidedMesh, whole: Simplices | None) -> SidedMesh:
    """A mesh that is whole on rank 0 as a mesh that the ranks share."""
    domain, comm = sided.mesh, sided.mesh.comm
    dim = domain.topology.dim
    x, cells = np.empty((0, dim)), np.empty((0, dim + 1), dtype=np.int64)
    if whole is not None:
        x, cells = whole.x, whole.cells
    element = basix.ufl.element("Lagrange", domain.basix_cell(), 1, shape=(dim,))
    new = mesh.create_mesh(comm, cells, x, element)
    tagged, sides = comm.bcast(whole and (np.sort(whole.facets, axis=1), whole.sides))
    order = np.lexsort(tagged.T)
    facets = boundary_facets(new)
    new.topology.create_connectivity(dim - 1, dim)
    nodes = mesh.entities_to_geometry(new, dim - 1, facets).reshape(-1, dim)
    mine = np.sort(new.geometry.input_global_indices[nodes], axis=1)
    _, place = np.unique(np.concatenate((tagged[order], mine)), axis=0, return_inverse=True)
    found = np.empty(place.max(initial=-1) + 1, dtype=np.int64)
    found[place.ravel()[: len(order)]] = sides[order]
    digits = found[place.ravel()[len(order) :]]
    named = {name: facets[(digits >> k) & 1 == 1] for k, name in enumerate(sided.sides)}
    return SidedMesh(new, named)
