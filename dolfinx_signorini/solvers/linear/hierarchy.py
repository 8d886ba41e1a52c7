"""Prolongations from degree to degree and from mesh to mesh, down to a coarsest mesh.

A space of degree k is followed by the spaces of degree 2 and 1 on the same mesh, then by the meshes
that the mesh was refined from, and last by the lattices behind a structured mesh.
"""

from collections.abc import Sequence

import numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.meshes.elements import lagrange_space
from dolfinx_signorini.meshes.parents import Parent, ends_of_edges, parent_mesh
from dolfinx_signorini.meshes.refinement import first_places
from dolfinx_signorini.solvers.linear.lattice import Lattice, coarsened, find_lattice
from dolfinx_signorini.solvers.linear.rows import Rows

# Cells that divide a lattice; functions that are linear on simplices serve squares and cubes, too.
LATTICES = ("interval", "triangle", "tetrahedron", "quadrilateral", "hexahedron")
SMALL = 1000  # nodes of a coarsest level that is factored
# Up to so many nodes, by dimension, no coarser level is looked for: BoomerAMG costs no more, nor do
# the direct solves of a wide active set that starts from nothing (the string and the ball).
LEAST = {1: 200, 2: SMALL, 3: SMALL}
FEW = {1: 20, 2: 200, 3: 200}  # nodes of a coarsest lattice, about: sweeps pass through a row
STEP = 0.6  # the nodes of a level over the nodes of the next finer one, at most
# The same for a refinement, by dimension: what is less of a step is left to BoomerAMG, whose set-up
# on a plane mesh costs less than all the levels of local refinements.
REFINEMENT = {2: 0.35, 3: 1.0}


def prolongations(space: fem.FunctionSpace) -> tuple[list[PETSc.Mat], list[PETSc.Mat]]:
    """Return the prolongations to a space: from lower degrees, and to degree 1 from coarser meshes.

    Args:
        space: A Lagrange space.

    Returns:
        Both lists with the finest first; a list is empty where no lower degree or no coarser mesh
        is known, or where the space is small.
    """
    if space.dofmap.index_map.size_global <= LEAST[space.mesh.topology.dim]:
        return [], []
    degrees, space = degree_prolongations(space)
    return degrees, mesh_prolongations(space) if space.mesh.geometry.cmap.degree == 1 else []


def degree_prolongations(space: fem.FunctionSpace) -> tuple[list[PETSc.Mat], fem.FunctionSpace]:
    """Return the prolongations to a space from degree 2 and degree 1, and the space of degree 1.

    With degree 2 in between CG takes about half as many iterations for nodal degrees 3 and 4.
    """
    element = space.element.basix_element
    made: list[PETSc.Mat] = []
    for degree in (2, 1):
        if degree < element.degree:
            coarse = lagrange_space(space.mesh, degree, element.lagrange_variant)
            made.append(_degree_prolongation(coarse, space))
            space = coarse
    return made, space


def _degree_prolongation(coarse: fem.FunctionSpace, fine: fem.FunctionSpace) -> PETSc.Mat:
    """Return the prolongation between spaces of two degrees with bases of one kind on a mesh.

    The dofs of Lagrange elements are the same in each cell around them: one of the cells serves.
    """
    low, high = coarse.element.basix_element, fine.element.basix_element
    shares = high.interpolation_matrix @ low.tabulate(0, high.points)[0, :, :, 0]
    for exact in (0.0, 1.0):  # a node that both spaces have is one for full multigrid, too
        shares[np.abs(shares - exact) < SOLVED] = exact
    owned, dofs = fine.dofmap.index_map.size_local, fine.dofmap.list
    cells, local = np.divmod(first_places(dofs.ravel())[1][:owned], dofs.shape[1])
    entries, columns = shares[local], coarse.dofmap.list[cells]
    kept = entries != 0.0
    starts = np.zeros(owned + 1, dtype=PETSc.IntType)
    np.cumsum(kept.sum(axis=1), out=starts[1:])
    index_map = coarse.dofmap.index_map
    numbers = index_map.local_to_global(columns[kept]).astype(PETSc.IntType)
    sizes = (owned, None), (index_map.size_local, None)
    return PETSc.Mat().createAIJ(sizes, csr=(starts, numbers, entries[kept]), comm=fine.mesh.comm)


def mesh_prolongations(space: fem.FunctionSpace) -> list[PETSc.Mat]:
    """Return the prolongations to a space of degree 1 from the parent meshes and from lattices."""
    domain, nodes, dim = space.mesh, nodes_of(space), space.mesh.topology.dim
    made: list[PETSc.Mat] = []
    while (parent := parent_mesh(domain)) is not None and _size(domain) > LEAST[dim]:
        if _size(parent.sided.mesh) > REFINEMENT[dim] * _size(domain):
            return _merged(made)
        made.append(refinement_prolongation(domain, nodes, parent))
        domain = parent.sided.mesh
        nodes = np.arange(domain.geometry.index_map().size_local, dtype=np.int32)
    made = _merged(made)
    if domain.topology.cell_name() not in LATTICES:
        return made
    if _size(domain) > LEAST[dim] and (lattice := find_lattice(domain, nodes)) is not None:
        made += lattice_prolongations(lattice)
    return made


def refinement_prolongation(fine: mesh.Mesh, nodes: LocalIndices, parent: Parent) -> PETSc.Mat:
    """Return the interpolation of nodes from the parent mesh, by nodes of its geometry.

    Args:
        fine: The refined mesh.
        nodes: The owned nodes of the refined mesh in the order of the rows.
        parent: The parent mesh.
    """
    owned = parent.sided.mesh.geometry.index_map().size_local
    return edge_prolongation(fine.comm, ends_of_edges(fine, parent)[:, nodes], owned)


def _merged(steps: list[PETSc.Mat]) -> list[PETSc.Mat]:
    """Return prolongations in which each level is much smaller than the next finer one."""
    made: list[PETSc.Mat] = []
    for step in steps:
        rows, columns = made[-1].getSize() if made else (0, 0)
        if columns > STEP * rows:
            product = made[-1].matMult(step)
            destroy(made.pop(), step)
            made.append(product)
        else:
            made.append(step)
    return made


def lattice_prolongations(lattice: Lattice) -> list[PETSc.Mat]:
    """Return the prolongations to a lattice, the finest first, from a coarsest lattice on."""
    made = []
    while lattice.size > FEW[len(lattice.lines)] and (step := coarsened(lattice)) is not None:
        coarse, parents, weights = step
        made.append(edge_prolongation(lattice.comm, parents, coarse.places.shape[1], weights))
        lattice = coarse
    return made


def edge_prolongation(
    comm: MPI.Comm, parents: Indices, owned: int, weights: Array | float = 0.5
) -> PETSc.Mat:
    """Return the interpolation of nodes from the ends of coarse edges.

    Args:
        comm: The communicator.
        parents: For each node of this rank the global numbers of the two ends of the edge on which
            the node lies, or the same number twice, shape (2, nodes).
        owned: The number of coarse nodes of this rank.
        weights: The weights of the second ends.
    """
    between = parents[0] != parents[1]
    starts = np.zeros(len(between) + 1, dtype=PETSc.IntType)
    np.cumsum(between, out=starts[1:])
    starts += np.arange(len(starts), dtype=PETSc.IntType)
    columns = np.empty(starts[-1], dtype=PETSc.IntType)
    columns[starts[:-1]] = parents[0]
    columns[starts[1:] - 1] = parents[1]
    values = np.ones(len(columns))
    second = np.where(between, weights, 1.0)
    values[starts[1:] - 1] = second
    values[starts[:-1][between]] = 1.0 - second[between]
    sizes = ((len(between), None), (owned, None))
    return PETSc.Mat().createAIJ(sizes, csr=(starts, columns, values), comm=comm)


def coarse_places(prolongations: Sequence[PETSc.Mat], places: Array) -> list[Array]:
    """Return the places of the nodes of all coarser levels, the finest of them first.

    A node of a coarser level is one of the next finer level, too, whose row has the entry 1 alone;
    where there is none, as in a lattice of other nodes or from degree 2 to 3, the place is a mean
    of places around.

    Args:
        prolongations: The prolongations of one component, the finest first; collective.
        places: The owned nodes of the finest level, shape (nodes, 3).
    """
    found = []
    for prolongation in prolongations:
        rows, (coarse, fine), sums = Rows(prolongation), prolongation.createVecs(), []
        for values in (np.ones(len(places)), *places.T):
            fine.array_w[:] = values
            prolongation.multTranspose(fine, coarse)
            sums.append(coarse.array_r.copy())
        destroy(fine, coarse)
        means = np.stack(sums[1:], axis=1) / np.where(sums[0] > 0.0, sums[0], 1.0)[:, None]
        same = np.stack([rows.injected(values, np.nan) for values in places.T], axis=1)
        places = np.where(np.isnan(same), means, same)
        found.append(places)
    return found


def _size(domain: mesh.Mesh) -> int:
    """The number of nodes of a mesh on all ranks."""
    return int(domain.geometry.index_map().size_global)


def nodes_of(space: fem.FunctionSpace) -> LocalIndices:
    """Return the nodes of the geometry at the owned dofs of a space of degree 1."""
    owned, dofs, nodes = space.dofmap.index_map.size_local, space.dofmap.list, space.mesh.geometry
    if np.array_equal(dofs, nodes.dofmap):
        return np.arange(owned, dtype=np.int32)
    found = np.empty(len(nodes.x), dtype=np.int32)
    found[dofs.ravel()] = nodes.dofmap.ravel()
    return found[:owned]
