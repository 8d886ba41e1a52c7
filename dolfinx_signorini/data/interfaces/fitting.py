"""Meshes fitted to singular points of data, and to lines and planes where coefficients jump.

Where the diffusion jumps inside a cell, the solution has a kink which no polynomial follows,
and cells of width h leave an error of h^(1/2) in H^1. With the jump on facets the solution is as
smooth in each cell as without a jump. So vertices near the jump are moved onto the jump, and the
edges that still cross the jump are split. Refinement keeps straight lines and planes on facets.

Where the load jumps, second derivatives of the solution do, and the error depends on how near the
jump is to a side of the cells. Along a mesh line all cells agree: divisions may help little for
some steps, and no comparison of solutions shows that. Such jumps get facets where they are
straight. Curves cut cells at all shares of their width, and comparisons tell.

Where data make the solution like a power of the distance from a point, the point becomes a vertex:
cells are graded towards vertices as often as needed, and the errors of successive meshes differ
by their size alone. In the middle of cells the errors depend on where in its cell the point is.
"""

from collections.abc import Sequence

import numpy as np
from dolfinx import mesh

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.compat import ELEMENTS
from dolfinx_signorini.base.ranks import gathered
from dolfinx_signorini.data.formulas import Formula
from dolfinx_signorini.data.interfaces.cutting import THIN, Simplices, fitted, with_vertex
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
    points: Sequence[tuple[float, ...]] = (),
) -> SidedMesh:
    """Return a mesh in which formulas jump across facets only, or next to them along curves.

    Args:
        sided: The mesh with its sides; the call is collective.
        formulas: The formulas.
        max_cells: The limit on the number of cells where the mesh is refined along curves, or
            fitted to what follows.
        straight: More formulas, whose jumps count along straight lines and planes only.
        points: Points that are to be vertices, see `with_vertex`, as far as the limit allows.

    Returns:
        The mesh itself where nothing is to be changed. Where cells belong to regions, jumps inside
        of cells are left there. Where the mesh cannot be refined so far that the cells follow a
        curve, this curve is left inside of cells.
    """
    curves = [] if sided.regions else interfaces(*formulas)[::-1]
    lines = [] if sided.regions else interfaces(*straight)
    comm, best = sided.mesh.comm, sided
    parts = 2 ** (sided.mesh.topology.dim + 1)  # of a cell that is refined, with its neighbours
    for attempt in range(ROUNDS if curves or lines or points else 0):
        given, order = _gathered(sided)
        whole, marks = _fitted(given, curves, lines, max_cells, points)
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
    given: Simplices | None,
    curves: list[Interface],
    lines: list[Interface],
    max_cells: int,
    points: Sequence[tuple[float, ...]],
) -> tuple[Simplices | None, Mask]:
    """Fit a mesh on rank 0: the mesh, None if unchanged, and the cells too large for a curve."""
    if given is None:
        return None, np.empty(0, dtype=bool)
    whole = given
    for point in points:
        more = with_vertex(whole, np.array(point))
        if len(more.cells) <= max(max_cells, len(whole.cells)):
            whole = more
    for curve in curves:  # what is inside of a formula comes first
        whole = fitted(whole, curve)
    corners, cells = whole.x[whole.cells], given.x[given.cells]
    marks = np.zeros(len(cells), dtype=bool)
    for curve in curves:
        if (curve.depths(corners) >= THIN).any():
            marks |= curve.depths(cells) > 0.0
    for line in lines:
        more = fitted(whole, line)
        straight = (line.depths(more.x[more.cells]) < STRAIGHT).all()
        if straight and len(more.cells) <= max_cells:
            whole = more
    same = np.array_equal(whole.x, given.x)  # new vertices come with all other changes
    return (None if same else whole), marks


def _gathered(sided: SidedMesh) -> tuple[Simplices | None, Indices]:
    """The whole mesh on rank 0, with numbers that do not depend on the ranks, and its cells' order.

    The order has the number of each cell among those of all ranks, one rank after the other.
    """
    domain = sided.mesh
    dim, comm = domain.topology.dim, domain.comm
    cells, x = gathered_cells(domain)
    facets = boundary_facets(domain)
    _, sides = sided.combinations(facets)
    _, regions = sided.combinations_of_regions()
    nodes = facet_nodes(domain, facets)
    ids = domain.geometry.index_map().local_to_global(nodes.ravel()).reshape(nodes.shape)
    parts = gathered(comm, ids.reshape(-1, dim), sides, regions)
    if parts is None:
        return None, np.empty(0, dtype=np.int64)
    all_facets, all_sides, all_regions = parts
    by_place = np.lexsort(x.T)
    number = np.empty(len(x), dtype=np.int64)
    number[by_place] = np.arange(len(x))
    cells = np.sort(number[cells], axis=1)
    order = np.lexsort(cells.T)
    cells, all_regions = cells[order], all_regions[order]
    between, pairs = _between_regions(cells, all_regions)
    all_facets = np.concatenate((number[all_facets], between))
    all_sides = np.concatenate((all_sides, all_sides.max(initial=-1) + 1 + pairs))
    known = x[by_place], cells, all_facets, all_sides, all_regions
    return Simplices(*known, np.zeros(len(x), dtype=bool)), order


def _between_regions(cells: Indices, regions: Indices) -> tuple[Indices, Indices]:
    """The facets between cells of two regions, and a number for each pair of regions."""
    facets = np.concatenate([np.delete(cells, k, axis=1) for k in range(cells.shape[1])])
    both = np.tile(regions, cells.shape[1])
    order = np.lexsort((both, *facets.T))
    facets, both = facets[order], both[order]
    met = (facets[1:] == facets[:-1]).all(axis=1) & (both[1:] != both[:-1])
    low, high = both[:-1][met], both[1:][met]
    return facets[1:][met], low * (1 + regions.max(initial=0)) + high


def _shared(sided: SidedMesh, whole: Simplices | None) -> SidedMesh:
    """A mesh that is whole on rank 0 as a mesh that the ranks share."""
    domain, comm = sided.mesh, sided.mesh.comm
    dim = domain.topology.dim
    x: Array = np.empty((0, dim))
    cells: Indices = np.empty((0, dim + 1), dtype=np.int64)
    if whole is not None:
        x, cells = whole.x, whole.cells
    new = mesh.create_mesh(comm, cells, x=x, e=ELEMENTS[dim])
    known = whole and (np.sort(whole.facets, axis=1), whole.sides, whole.regions)
    tagged, sides, regions = comm.bcast(known)
    facets = boundary_facets(new)
    nodes = facet_nodes(new, facets)
    mine = np.sort(new.geometry.input_global_indices[nodes], axis=1)
    _, place = np.unique(np.concatenate((tagged, mine)), axis=0, return_inverse=True)
    found = np.empty(place.max(initial=-1) + 1, dtype=np.int64)
    found[place.ravel()[: len(tagged)]] = sides
    on, _ = sided.combinations(boundary_facets(domain))
    on = on[found[place.ravel()[len(tagged) :]]]
    within, _ = sided.combinations_of_regions()
    owned = owned_cells(new)
    within = within[regions[new.topology.original_cell_index[owned]]]
    return SidedMesh(
        new,
        {name: facets[on[:, k]] for k, name in enumerate(sided.sides)},
        {name: owned[within[:, k]] for k, name in enumerate(sided.regions)},
    )
