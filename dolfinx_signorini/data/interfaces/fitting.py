"""Meshes fitted to the straight lines and planes where a coefficient of a scene jumps.

Where the diffusion jumps inside a cell, the solution has a kink which no polynomial follows,
and cells of width h leave an error of h^(1/2) in H^1. With the jump on facets the solution is as
smooth in each cell as without a jump. So vertices near the jump are moved onto the jump, and the
edges that still cross the jump are split. Refinement keeps straight lines and planes on facets.

Where the load jumps, second derivatives of the solution do, and the error depends on how near the
jump is to a side of the cells. Along a mesh line all cells agree: divisions may help little for
some steps, and no comparison of solutions shows that. Such jumps get facets where they are
straight. Curves cut cells at all shares of their width, and comparisons tell.
"""

from collections.abc import Sequence

import numpy as np
from dolfinx import mesh

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.compat import ELEMENTS
from dolfinx_signorini.data.formulas import Formula
from dolfinx_signorini.data.interfaces.cutting import THIN, Simplices, fitted
from dolfinx_signorini.data.interfaces.interface import Interface, interfaces
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import (
    SidedMesh,
    boundary_facets,
    facet_nodes,
    gathered_cells,
    owned_cells,
)

ROUNDS = 8  # of refinements along curves
STRAIGHT = 0.01  # of a cell: what a line may cut off that counts as straight


def fitted_mesh(
    sided: SidedMesh,
    formulas: Sequence[Formula],
    max_cells: int,
    straight: Sequence[Formula] = (),
) -> SidedMesh:
    """Return a mesh in which formulas jump across facets only, or next to them along curves.

    Args:
        sided: The mesh with its sides; the call is collective.
        formulas: The formulas.
        max_cells: The limit on the number of cells where the mesh is refined along curves, or
            fitted to what follows.
        straight: More formulas, whose jumps count along straight lines and planes only.

    Returns:
        The mesh itself where nothing jumps inside of cells, or where cells belong to regions,
        whose boundaries stay. Where the mesh cannot be refined so far that the cells follow a
        curve, this curve is left inside of cells.
    """
    if sided.regions:
        return sided
    curves = interfaces(*formulas)[::-1]
    lines = interfaces(*straight)
    comm, best = sided.mesh.comm, sided
    parts = 2 ** (sided.mesh.topology.dim + 1)  # of a cell that is refined, with its neighbours
    for attempt in range(ROUNDS if curves or lines else 0):
        gathered, order = _gathered(sided)
        whole, marks = _fitted(gathered, curves, lines, max_cells)
        marks[order] = marks.copy()  # in the order of the cells of the ranks
        changed, marks = comm.bcast((whole is not None, marks))
        if attempt == 0 or not marks.any():
            best = _shared(sided, whole) if changed else sided
        if not marks.any() or len(marks) + parts * marks.sum() > max_cells:
            break
        count = len(owned_cells(sided.mesh))
        first = comm.exscan(count) or 0  # None on rank 0
        mine = np.flatnonzero(marks[first : first + count])
        sided = refined(sided, mine.astype(np.int32)).sided
    return best


def _fitted(
    gathered: Simplices | None, curves: list[Interface], lines: list[Interface], max_cells: int
) -> tuple[Simplices | None, Mask]:
    """Fit a mesh on rank 0: the mesh, None if unchanged, and the cells too large for a curve."""
    if gathered is None:
        return None, np.empty(0, dtype=bool)
    whole = gathered
    for curve in curves:  # what is inside of a formula comes first
        whole = fitted(whole, curve)
    corners, cells = whole.x[whole.cells], gathered.x[gathered.cells]
    marks = np.zeros(len(cells), dtype=bool)
    for curve in curves:
        if (curve.depths(corners) >= THIN).any():
            marks |= curve.depths(cells) > 0.0
    for line in lines:
        more = fitted(whole, line)
        straight = (line.depths(more.x[more.cells]) < STRAIGHT).all()
        if straight and len(more.cells) <= max_cells:
            whole = more
    return (None if whole is gathered else whole), marks


def _gathered(sided: SidedMesh) -> tuple[Simplices | None, Indices]:
    """The whole mesh on rank 0, with numbers that do not depend on the ranks, and its cells' order.

    The order has the number of each cell among those of all ranks, one rank after the other.
    """
    domain = sided.mesh
    dim, comm = domain.topology.dim, domain.comm
    cells, x = gathered_cells(domain)
    facets = boundary_facets(domain)
    _, sides = sided.combinations(facets)
    nodes = facet_nodes(domain, facets)
    ids = domain.geometry.index_map().local_to_global(nodes.ravel()).reshape(nodes.shape)
    parts = comm.gather((ids.reshape(-1, dim), sides))
    if parts is None:
        return None, np.empty(0, dtype=np.int64)
    all_facets, all_sides = (np.concatenate(p) for p in zip(*parts, strict=True))
    by_place = np.lexsort(x.T)
    number = np.empty(len(x), dtype=np.int64)
    number[by_place] = np.arange(len(x))
    cells = np.sort(number[cells], axis=1)
    order = np.lexsort(cells.T)
    known = x[by_place], cells[order], number[all_facets], all_sides
    return Simplices(*known, np.zeros(len(x), dtype=bool)), order


def _shared(sided: SidedMesh, whole: Simplices | None) -> SidedMesh:
    """A mesh that is whole on rank 0 as a mesh that the ranks share."""
    domain, comm = sided.mesh, sided.mesh.comm
    dim = domain.topology.dim
    x: Array = np.empty((0, dim))
    cells: Indices = np.empty((0, dim + 1), dtype=np.int64)
    if whole is not None:
        x, cells = whole.x, whole.cells
    new = mesh.create_mesh(comm, cells, x=x, e=ELEMENTS[dim])
    tagged, sides = comm.bcast(whole and (np.sort(whole.facets, axis=1), whole.sides))
    facets = boundary_facets(new)
    nodes = facet_nodes(new, facets)
    mine = np.sort(new.geometry.input_global_indices[nodes], axis=1)
    _, place = np.unique(np.concatenate((tagged, mine)), axis=0, return_inverse=True)
    found = np.empty(place.max(initial=-1) + 1, dtype=np.int64)
    found[place.ravel()[: len(tagged)]] = sides
    combinations, _ = sided.combinations(boundary_facets(domain))
    on = combinations[found[place.ravel()[len(tagged) :]]]
    named = {name: facets[on[:, k]] for k, name in enumerate(sided.sides)}
    return SidedMesh(new, named)
