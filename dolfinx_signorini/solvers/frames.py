"""Directions at contact nodes: one of them has the obstacle, the others are free.

The vector u at a contact node is w = R u in the directions of the rows of an orthogonal matrix R,
one of which is the direction d of the obstacle. With Q, which has the blocks R and is the identity
at other nodes, the system is

    (Q A Q') w = Q b,    and a bound on u.d is one on an entry of w.

Components that Dirichlet data fix stay as they are: R turns the free components alone, towards the
part of d among them. A turn changes no eigenvalue, and a prolongation P to the nodes becomes Q P.
"""

from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.petsc import destroy


@dataclass(frozen=True)
class Frame:
    """The directions of some owned nodes:

        frame = Frame(nodal, nodes, turns, free)
        w = frame.turned(u.x.array[:owned])

    Attributes:
        nodal: The scalar space of one component.
        nodes: The owned nodes that are turned, dofs of this space.
        turns: The matrix R of each of the nodes, shape (nodes, components, components).
        free: For each node with an obstacle whether its direction has a free part.
    """

    nodal: fem.FunctionSpace
    nodes: LocalIndices
    turns: Array
    free: Mask

    @property
    def along_axes(self) -> bool:
        """Whether each turn on this rank swaps components and changes signs, and no more."""
        return bool((np.abs(self.turns).sum(axis=2) == 1.0).all())

    def turned(self, values: Array, back: bool = False) -> Array:
        """Return the values of the owned dofs in the directions of the nodes, or back.

        Args:
            values: One value for each owned dof, those of a node one after the other.
            back: Whether the values are in these directions already, and are turned back.
        """
        found = values.copy()
        blocks = found.reshape(-1, self.turns.shape[1])
        way = "nji,nj->ni" if back else "nij,nj->ni"
        blocks[self.nodes] = np.einsum(way, self.turns, blocks[self.nodes])
        return found

    def matrix(self) -> PETSc.Mat:
        """Return Q as a matrix of PETSc."""
        index_map, size = self.nodal.dofmap.index_map, self.turns.shape[1]
        blocks = np.zeros((index_map.size_local, size, size))
        blocks[:] = np.eye(size)
        blocks[self.nodes] = self.turns
        kept = blocks != 0.0
        rows = np.zeros(index_map.size_local * size + 1, dtype=PETSc.IntType)
        np.cumsum(kept.sum(axis=2).ravel(), out=rows[1:])
        nodes = index_map.local_range[0] + np.arange(index_map.size_local)
        columns = np.broadcast_to((nodes[:, None] * size + np.arange(size))[:, None], kept.shape)
        csr = rows, columns[kept].astype(PETSc.IntType), blocks[kept]
        sizes = (index_map.size_local * size, None)
        return PETSc.Mat().createAIJ((sizes, sizes), csr=csr, comm=self.nodal.mesh.comm)

    def prolongation(self, scalar: PETSc.Mat, finest: bool) -> PETSc.Mat:
        """Return the prolongation of all components for one of scalar functions, which is used up.

        Args:
            scalar: The prolongation of one component.
            finest: Whether its rows are the nodes, and not those of a coarser level.
        """
        size = self.turns.shape[1]
        starts, columns, values = scalar.getValuesCSR()
        counts = np.diff(starts).repeat(size)
        rows = np.zeros(len(counts) + 1, dtype=PETSc.IntType)
        np.cumsum(counts, out=rows[1:])
        row = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        # The entries of a row come once for each component, with the columns of the component.
        place = np.tile(row, size) * size + np.arange(size).repeat(len(row))
        order = np.argsort(place, kind="stable")
        wide = (columns * size)[None] + np.arange(size)[:, None]
        wide_values = np.tile(values, size)[order]
        local = [tuple(n * size for n in pair) for pair in scalar.getSizes()]
        csr = rows, wide.ravel()[order].astype(PETSc.IntType), wide_values
        made = PETSc.Mat().createAIJ(local, csr=csr, comm=scalar.comm)
        made.setBlockSizes(size, size)  # for products, of which algebraic multigrid asks it
        scalar.destroy()
        if not finest:
            return made
        turn = self.matrix()
        product = turn.matMult(made)
        destroy(turn, made)
        return product


def turn_towards(directions: Array, fixed: Mask) -> tuple[Array, Array, LocalIndices]:
    """Return orthogonal matrices with a row along the free part of a direction.

    The matrix is a Householder reflection in the free components.

    Args:
        directions: The direction at each node, shape (nodes, components), of length 1.
        fixed: Which components Dirichlet data fix, of the same shape.

    Returns:
        The matrices, shape (nodes, components, components); the length of the free part of each
        direction; and the number of the row along this part, 0 where there is no free part.
    """
    count, size = directions.shape
    part = np.where(fixed, 0.0, directions)
    length = np.linalg.norm(part, axis=1)
    unit = np.divide(part, length[:, None], out=np.zeros_like(part), where=length[:, None] > 0.0)
    row = np.argmin(fixed, axis=1)
    target = np.zeros((count, size))
    target[np.arange(count), row] = 1.0
    # The reflection that takes the unit vector of the row to the direction, or to its opposite.
    side = np.where(np.einsum("ni,ni->n", unit, target) > 0.0, -1.0, 1.0)
    normal = unit - side[:, None] * target
    square = np.einsum("ni,ni->n", normal, normal)
    known = (length > 0.0) & (square > 0.0)
    scale = np.divide(2.0, square, out=np.zeros(count), where=known)
    turns = np.eye(size) - scale[:, None, None] * normal[:, :, None] * normal[:, None, :]
    turns[np.arange(count), row] *= side[:, None]
    return turns, length, row.astype(np.int32)
