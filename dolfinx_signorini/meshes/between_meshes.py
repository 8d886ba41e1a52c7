"""Functions carried between meshes that need not be nested, whose cells DOLFINx searches for."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from dolfinx import fem, mesh

from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.compat import owners_of_points
from dolfinx_signorini.base.ranks import anywhere, highest
from dolfinx_signorini.base.tolerances import SOLVED, power_of_two
from dolfinx_signorini.meshes.sided_meshes import longest_side

Pairs = Sequence[tuple[fem.Function, fem.Function]]

PADDING = 0.1  # of the cell size: how far the boundary of one mesh may lie outside of the other one


def interpolate_between(pairs: Pairs, cells: LocalIndices) -> None:
    """Interpolate functions between two meshes, on some cells of the target mesh only.

    Between spaces on one mesh no cell is searched for.

    Args:
        pairs: Source and target functions; all sources have one mesh, and all targets have one
            mesh and one element, but for the number of components.
        cells: Cells of the target mesh.
    """
    source, target = (function.function_space for function in pairs[0])
    if source.mesh is target.mesh:
        for old, new in pairs:
            new.interpolate(old, cells0=cells, cells1=cells)
            new.x.scatter_forward()
        return
    with _of_size_one(source.mesh, target.mesh):
        # Boxes around cells that are padded by more than the cells are large cover many of them: so
        # points are looked for inside of the coarse mesh first.
        for padding in (SOLVED, PADDING):
            padding *= _coarse_size(source)
            data = fem.create_interpolation_data(target, source, cells, padding=padding)
            outside = bool((owners_of_points(data) < 0).any())
            if not anywhere(source.mesh.comm, outside):
                break
        for old, new in pairs:
            new.interpolate_nonmatching(old, cells, data)
            new.x.scatter_forward()


@contextmanager
def _of_size_one(*meshes: mesh.Mesh) -> Iterator[None]:
    """Give meshes a unit of length in which the first one has about the size 1; collective.

    DOLFINx finds no nearest points of cells whose coordinates are large numbers.
    """
    side = longest_side(meshes[0])
    unit = power_of_two(side)
    for each in meshes:
        each.geometry.x[:] /= unit
    try:
        yield
    finally:
        for each in meshes:
            each.geometry.x[:] *= unit


def _coarse_size(space: fem.FunctionSpace) -> float:
    """The size of the first cell of each rank, the largest of them."""
    topology = space.mesh.topology
    sample = np.arange(min(topology.index_map(topology.dim).size_local, 1), dtype=np.int32)
    return highest(space.mesh.comm, space.mesh.h(topology.dim, sample))
