"""The cells at the ends of the contact set, where a solution is like r^{3/2}, and at its kinks.

With an obstacle in the domain the contact set ends at curves in the plane and at surfaces in space,
where the second derivatives of the solution jump. A few meshes do not tell the rate at these cells,
but theory does: the discrete contact set ends at a dof, which is now nearer to the true end and now
farther away. In contact with a kink of an obstacle in the domain the solution has the same kink.

Sources: Christof and Haubner, Section 2.2, for the singularity; K. L. Johnson, Contact mechanics,
Cambridge (1985), Section 5.1, for the same of elastic bodies without friction; Caffarelli, The
obstacle problem revisited, J. Fourier Anal. Appl. 4 (1998) 383-402, for obstacles in the domain.
"""

import math

import numpy as np
from dolfinx import fem, mesh
from scipy.spatial import cKDTree

from dolfinx_signorini.accuracy.cells import volumes
from dolfinx_signorini.accuracy.targets import Target
from dolfinx_signorini.accuracy.terms import Dual, Solved
from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.ranks import averaged, marked, shared, summed
from dolfinx_signorini.data.interfaces.jumps import broken_cells
from dolfinx_signorini.data.reading import formula_of
from dolfinx_signorini.meshes.elements import control_points, facet_dofs, facet_pieces
from dolfinx_signorini.meshes.polynomials import equispaced
from dolfinx_signorini.meshes.sided_meshes import cell_corners, cells_with_dofs, facet_scale
from dolfinx_signorini.norms.orders import DETACHMENT_EXPONENT, FREE_BOUNDARY_EXPONENT
from dolfinx_signorini.norms.power_sums import total
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem, Contact

SAMPLES = 24  # on each edge of a facet
# Of what an end of contact leaves, derivatives times the width h over values: see `unknown_ends`.
SLOPE = 5.5


def rate_at_ends(target: Target, in_domain: bool = False) -> float:
    """Return the rate with which divisions towards an end of the contact set reduce the error.

    Args:
        target: What is to be accurate.
        in_domain: Whether the obstacle is in the domain.
    """
    # The dual solution has r^{1/2} for r^{3/2}, and in the domain the distance for its square.
    # The ends are points in the plane, and curves in space.
    exponent, dimension = (FREE_BOUNDARY_EXPONENT, 1) if in_domain else (DETACHMENT_EXPONENT, 2)
    return float(target.singular_order(exponent, exponent - 1.0, dimension))


def cells_at_contact_ends(zone: Contact, parents: LocalIndices, count: int) -> Mask:
    """Tell which cells have an end of the contact set; the call is collective.

    Args:
        zone: The solved problem, or a zone, on the mesh with every cell divided.
        parents: For each owned cell of this mesh the coarse cell around the cell.
        count: The number of owned coarse cells.

    Returns:
        For each owned coarse cell whether the cell is at a facet with dofs in contact and others,
        or is such a cell.
    """
    space = zone.space
    _, dofs, touching = contact_on_entities(zone)
    held = marked(space, zone.held_nodes)[dofs]
    ends = touching.any(axis=1) & ~(touching | held).all(axis=1)
    cells = cells_with_dofs(space, marked(space, dofs[ends].ravel()))
    result = np.zeros(count, dtype=bool)
    result[parents[cells[cells < len(parents)]]] = True
    return result


def places_of_ends(zone: Contact, domain: mesh.Mesh, cells: Mask) -> Array:
    """Return the nearest end of contact for each of some cells, shape (cells, 3); collective.

    On the boundary of a domain in the plane an end is between two nodes of which one is in contact,
    and taken to be in the middle. Elsewhere ends are curves and surfaces: infinity.

    Args:
        zone: The solved problem, or a zone.
        domain: The mesh of the cells.
        cells: Which owned cells are chosen.
    """
    space, comm = zone.space, domain.comm
    if zone.in_domain or domain.topology.dim > 2:
        return np.full((cells.sum(), 3), np.inf)
    pieces, _ = facet_pieces(space, zone.owned_entities)
    touching = marked(space, zone.active)[pieces]
    ends = pieces[touching.any(axis=1) & ~touching.all(axis=1)]
    places = np.concatenate(comm.allgather(control_points(space)[ends].mean(axis=1)))
    if not len(places):
        return np.full((cells.sum(), 3), np.inf)
    middles = cell_corners(domain)[cells].mean(axis=1)
    _, nearest = cKDTree(places[:, : domain.geometry.dim]).query(middles)
    return np.asarray(places[nearest])


def cells_at_kinks(problem: BoundConstrainedProblem, parents: LocalIndices, count: int) -> Mask:
    """Tell which cells lie on a kink of an obstacle in the domain; see `cells_at_contact_ends`.

    Where the kink is in a cell differs from mesh to mesh, and with it the error of the cell.
    """
    result = np.zeros(count, dtype=bool)
    zone = problem.zones[0]  # cells come first
    for side, obstacle in enumerate(zone.obstacles if zone.in_domain else ()):
        formula = formula_of(obstacle.data)
        if formula is not None and formula.constant is None:
            cells, _, touching = contact_on_entities(zone, side)
            broken = broken_cells([formula], problem.space.mesh)
            result[parents[np.intersect1d(cells[touching.any(axis=1)], broken)]] = True
    return result


def unknown_ends(solved: Solved, dual: Dual | None) -> Array:
    """Return what cells at the end of contact in the domain leave in the error, see `Term`.

    Where a pressure p holds the solution of -u'' = -p, the solution is p s^2 / 2 above the obstacle
    at the distance s from the end of contact. On a cell of the width h that has dofs in contact and
    others, two solutions may agree in an end that is off by h / 2, with an error of up to
    p h^2 / 8, a quarter of the gap across the cell. For the degree k of the elements about the
    share 1 / k is left: in 80 problems on an interval, with the end anywhere in a cell, the largest
    error was 0.125, 0.054, 0.029 and 0.019 p h^2 with k from 1 to 4 in the Bernstein basis. The
    derivative was off by up to 0.53, 0.31, 0.24 and 0.19 p h, SLOPE / h times the error of values.

    Where the end has moved with the division of a cell, the difference of both solutions shows the
    error, and where the end has stayed, the error is unseen. In a sup norm both count. Dual
    solutions weigh the ends by the forces that hold them, unless that is more than all of the
    difference they are made for: then the norms of what ends may be off count. Errors of
    functionals have signs, and cancel unless all ends stay, or all move, as along a line of the
    mesh.
    """
    norm, zone = solved.target.norm, solved.fine.zones[0]  # cells come first
    if not zone.in_domain:
        return np.zeros((2, solved.count))
    cells, dofs, touching = contact_on_entities(zone)
    ends = touching.any(axis=1) & ~touching.all(axis=1)
    across = _gaps_across(zone, cells, dofs, touching)[ends]
    off = across / (4.0 * zone.space.element.basix_element.degree)
    stayed, share = _stayed(solved, cells, touching)
    if norm is None:
        off *= abs(2.0 * share - 1.0)
    elif not math.isinf(norm.p):
        off *= stayed[ends]
    parts = np.zeros(len(solved.parents))
    if dual is not None:
        sizes = shared(zone.space.dofmap.index_map, dofs[ends], np.abs(dual.forces.x.array))
        parts[cells[ends]] = off * (sizes * touching[ends]).sum(axis=1)
        if norm is None or total(parts, 1.0, solved.fine.comm) <= solved.distance:
            return solved.on_parents(np.array([parts, parts]))
        # The difference is none of the ends, and its dual solution looks elsewhere.
    assert norm is not None  # a functional has a dual solution
    domain = zone.space.mesh
    dim, sizes = domain.topology.dim, volumes(domain)[cells[ends]]
    fall = 1.0 / norm.p - norm.derivatives / dim
    parts[cells[ends]] = SLOPE**norm.derivatives * off * sizes**fall
    return solved.in_norm(solved.unit * parts)


def _gaps_across(zone: Contact, cells: LocalIndices, dofs: LocalIndices, touching: Mask) -> Array:
    """The gap on the far side of cells in the domain, if contact ended on the near side.

    The root of the gap p s^2 / 2 is linear in the distance s from the end of contact: its step
    across a cell without contact tells p h^2 / 2. On a cell with the end inside, the step is less,
    and nothing where contact ends on the far side: the cells without contact around a vertex tell
    there, in the root of the mean of squares. The call is collective.

    Args:
        zone: The contact in the domain.
        cells, dofs, touching: See `contact_on_entities`.
    """
    domain, free = zone.space.mesh, ~touching.all(axis=1)
    roots = np.sqrt(np.maximum(zone.gap.x.array, 0.0))[dofs]
    steps = np.square(np.ptp(roots, axis=1))
    widths = volumes(domain)[cells] ** (1.0 / domain.topology.dim)
    vertices, squares = domain.geometry.dofmap[cells], ((steps / widths**2) ** 2)[:, None]
    means = averaged(domain.geometry.index_map(), vertices[free], squares[free])
    around = np.sqrt(means)[vertices]
    return np.asarray(np.maximum(steps, around.max(axis=1, initial=0.0) * widths**2))


def _stayed(solved: Solved, cells: LocalIndices, touching: Mask) -> tuple[Mask, float]:
    """Where no end of contact in the domain has moved with the division, and on which share.

    Ends that lie anywhere in cells move in half of the cells when all cells are divided. The call
    is collective.

    Args:
        solved: The two solutions.
        cells: The owned cells of the divided mesh that have an obstacle.
        touching: Whether their dofs are in contact.

    Returns:
        For each of these cells whether the undivided cell around it is in contact as its parts are,
        and the share of the undivided cells with an end in which no end has moved.
    """
    coarse, comm = solved.coarse.forces, solved.fine.comm
    held = coarse.x.array[coarse.function_space.dofmap.list[: solved.count]] != 0.0
    whole, moved = held.all(axis=1), np.zeros(solved.count, dtype=bool)
    parents = solved.parents[cells]
    moved[parents[touching.all(axis=1) != whole[parents]]] = True
    mixed = held.any(axis=1) & ~whole
    count, ends = comm.allreduce(np.array([moved.sum(), mixed.sum()]))
    return ~moved[parents], 1.0 - min(count / ends, 1.0) if ends else 1.0


def contact_on_entities(
    zone: Contact, side: int | None = None
) -> tuple[LocalIndices, LocalIndices, Mask]:
    """Return the owned facets or cells that have an obstacle, and which of their dofs touch one.

    Args:
        zone: The solved problem, or a zone; the call is collective.
        side: The number of the obstacle; by default any of them counts.

    Returns:
        The cells or the (cell, local facet) pairs, and two arrays of the shape (entities, nodes of
        one): the nodes, which are the dofs of scalars, and whether they are in contact.
    """
    space, entities = zone.space, zone.owned_entities
    dofs = space.dofmap.list[entities] if zone.in_domain else facet_dofs(space, entities)
    active = zone.active if side is None else zone.active_sides[side]
    return entities, dofs, marked(space, active)[dofs]


def shared_by_facets(space: fem.FunctionSpace, pairs: LocalIndices, values: Array) -> Array:
    """Return for each facet the sum of the values of its nodes, which facets share by their sizes.

    Args:
        space: A scalar space.
        pairs: The (cell, local facet) pairs of the owned facets; the call is collective.
        values: The values of all nodes of this rank.
    """
    dofs, sizes = facet_dofs(space, pairs), facet_scale(space.mesh, pairs)[:, None]
    around = summed(space.dofmap.index_map, dofs, np.broadcast_to(sizes, dofs.shape))
    shares = sizes / np.where(around > 0.0, around, 1.0)[dofs]
    return np.asarray((values[dofs] * shares).sum(axis=1))


def facet_lattice(space: fem.FunctionSpace) -> Array:
    """Return points of the reference facet, in order, from which functions on a facet are known.

    Args:
        space: A space on triangles, with SAMPLES parts of an edge, or on tetrahedra, with a third.
    """
    dim = space.mesh.topology.dim
    lattice = equispaced(dim - 1, SAMPLES if dim == 2 else SAMPLES // 3)
    return lattice[np.lexsort(lattice.T[::-1])]
