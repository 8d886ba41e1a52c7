"""Prolongations from mesh to mesh, down to a coarsest one: what multigrid needs of the meshes."""

import numpy as np
import numpy.typing as npt
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.solvers.lattice import Lattice, coarsened, find_lattice

Numbers = npt.NDArray[np.int64]

FEW = 200  # nodes of a coarsest lattice, about


def prolongations(space: fem.FunctionSpace) -> list[PETSc.Mat]:
    """Return the prolongations to a space, the finest first; none where no coarser mesh is known.

    Args:
        space: A Lagrange space.
    """
    if space.element.basix_element.degree > 1 or not _straight(space.mesh):
        return []
    lattice = find_lattice(space.mesh, _nodes(space))
    return [] if lattice is None else lattice_prolongations(lattice)


def lattice_prolongations(lattice: Lattice) -> list[PETSc.Mat]:
    """Return the prolongations to a lattice, the finest first, from a coarsest lattice on."""
    made = []
    while lattice.size > FEW and min(lattice.cells) > 1:
        coarse, parents = coarsened(lattice)
        made.append(edge_prolongation(lattice.comm, parents, coarse.places.shape[1]))
        lattice = coarse
    return made


def edge_prolongation(comm: MPI.Comm, parents: Numbers, owned: int) -> PETSc.Mat:
    """Return the interpolation of nodes from the ends of coarse edges.

    Args:
        comm: The communicator.
        parents: For each node of this rank the global numbers of the two ends of the edge in the
            middle of which the node lies, or the same number twice, shape (2, nodes).
        owned: The number of coarse nodes of this rank.
    """
    between = parents[0] != parents[1]
    starts = np.zeros(len(between) + 1, dtype=PETSc.IntType)
    np.cumsum(between, out=starts[1:])
    starts += np.arange(len(starts), dtype=PETSc.IntType)
    columns = np.empty(starts[-1], dtype=PETSc.IntType)
    columns[starts[:-1]] = parents[0]
    columns[starts[1:] - 1] = parents[1]
    values = np.full(len(columns), 0.5)
    values[starts[:-1][~between]] = 1.0
    sizes = ((len(between), None), (owned, None))
    return PETSc.Mat().createAIJ(sizes, csr=(starts, columns, values), comm=comm)


def _straight(domain: mesh.Mesh) -> bool:
    """Whether a mesh consists of straight-sided triangles or tetrahedra."""
    simplices = domain.topology.cell_name() in ("triangle", "tetrahedron")
    return simplices and domain.geometry.cmap.degree == 1


def _nodes(space: fem.FunctionSpace) -> npt.NDArray[np.int32]:
    """The nodes of the geometry at the owned dofs of a space of degree 1."""
    owned, dofs, nodes = space.dofmap.index_map.size_local, space.dofmap.list, space.mesh.geometry
    if np.array_equal(dofs, nodes.dofmap):
        return np.arange(owned, dtype=np.int32)
    found = np.empty(len(nodes.x), dtype=np.int32)
    found[dofs.ravel()] = nodes.dofmap.ravel()
    return found[:owned]
