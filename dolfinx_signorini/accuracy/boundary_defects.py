"""Defects on the boundary: the distance of a solution from its data between the nodes of the mesh.

A solution meets the obstacle and Dirichlet data at nodes. Where an obstacle has a kink or a pin
between the nodes, or Dirichlet data are like a root there, no comparison of discrete solutions
shows the error, but the data themselves do: the trace of the error is at least what the solution
lies below the obstacle, the distance to the obstacle on facets in contact, and the distance to
Dirichlet data. In a norm of the boundary such a distance is the error itself. In the domain the
error falls with the distance y from the facet like exp(-y / l), where a distance like a wave has l
as the size of its antiderivative over its own, and a constant half of the facet; the mean of the
distance, and what lies beyond an obstacle, reach as far as a dual solution tells.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_signorini.accuracy.cells import cell_norms, over
from dolfinx_signorini.accuracy.contact_ends import (
    contact_on_entities,
    facet_lattice,
    shared_by_facets,
)
from dolfinx_signorini.accuracy.targets import size as size_of
from dolfinx_signorini.accuracy.terms import (
    Dual,
    Solved,
    assembled,
    product,
    shared_by_cells,
)
from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.ranks import anywhere, function_with, highest
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.meshes.elements import (
    HIGHEST_DEGREE,
    component_arrays,
    facet_dofs,
    is_bernstein,
    nodal_space,
    values_at_control_points,
)
from dolfinx_signorini.meshes.jacobians import inverses
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.sided_meshes import (
    boundary_facets,
    facet_cells,
    facet_scale,
    owned_cells,
)
from dolfinx_signorini.norms.names import Norm
from dolfinx_signorini.norms.pointwise import length
from dolfinx_signorini.norms.power_sums import collected, joined, p_norm, total
from dolfinx_signorini.problem.assembly import dofs_on_entities
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem, Contact
from dolfinx_signorini.problem.constraint import Obstacle
from dolfinx_signorini.problem.dirichlet import data_of_condition
from dolfinx_signorini.problem.values import datum, evaluator


@dataclass(frozen=True)
class Distances:
    """The distances of data from a solution, on facets that meet the data at their nodes:

        for distances in distances_from_data(problem):
            print(distances.off.max())

    Attributes:
        pairs: The facets, as (cell, local facet) pairs.
        off: The distances at the points of `_lattice`, shape (facets, points). On facets that are
            not in contact only what an obstacle has beyond the solution.
        held: Whether a facet is held at its data, by contact or by a condition.
        along: Returns what of a function of the space has these data: for each node the function
            itself, or of vectors a component.
    """

    pairs: LocalIndices
    off: Array
    held: Mask
    along: Callable[[fem.Function], Array]


def data_defects(solved: Solved, dual: Dual | None) -> Array:
    """Return what distances from data add to the error where they are, see `terms.Term`.

    The parts are zero for functionals. The norm of order 1/2 is the root of the product of two
    norms of the whole boundary: the square of a part is half of its share in both.
    """
    problem, norm = solved.fine, solved.target.norm
    if norm is None:
        return np.zeros((2, solved.count))
    values: Array = np.zeros(len(solved.parents))
    slopes: Array = np.zeros(len(solved.parents))
    _, weights = _lattice(problem.space)
    for distances in distances_from_data(problem):
        known = problem, distances, norm
        if norm.derivatives < 1:
            values = joined(values, _defects(*known, distances.off, weights), norm.p)
        if norm.derivatives:
            slopes = joined(slopes, _defects(*known, *_slopes(problem, distances)), norm.p)
    parts = slopes if norm.derivatives == 1 else values
    if norm.derivatives == 0.5:
        both = joined(values, slopes, norm.p)
        one, other = (total(part, norm.p, problem.comm) for part in (values, both))
        ratio = math.sqrt(other / one) if one > 0.0 else 1.0
        parts = joined(values * ratio, np.asarray(both / ratio), norm.p) * math.sqrt(0.5)
    for off in [] if norm.boundary else _distances_in_cells(problem):
        parts = joined(parts, cell_norms(off, norm), norm.p)
    return solved.in_norm(solved.unit * parts)


def data_between_nodes(solved: Solved, dual: Dual | None) -> Array:
    """Return what distances from data are in J(u - w).

    On a held facet, -G(u_D - w): the force that holds the dual solution there times the mean
    distance. Of a norm, -a(z, u_D - w), for J(u_D - w) is in `data_defects`. On a facet whose nodes
    are free the obstacle lifts the solution by the largest distance, with at most the force that
    does so at a dof of the facet, times the dual solution there. In cells, J itself. Of a norm the
    facets add up with their signs: the norm of the error is no less than J(u - w).
    """
    problem = solved.fine
    if dual is None:
        return np.zeros((2, solved.count))
    space = problem.system.layout.nodal
    result = np.zeros((2, len(owned_cells(space.mesh))))
    lifted = lifting_forces(problem, dual.z)
    forces = dual.forces if solved.target.norm is None else dual.action
    gap, (_, weights) = problem.gap.x.array, _lattice(problem.space)
    for distances in distances_from_data(problem):
        pairs, off, along = distances.pairs, distances.off, distances.along
        fixed = -shared_by_facets(space, pairs, along(forces)) * (off @ weights)
        dofs = facet_dofs(space, pairs)
        lift = along(lifted)[dofs].mean(axis=1) * (off.max(axis=1) + off.min(axis=1))  # one is 0
        touching = np.abs(gap[dofs]).max(axis=1) <= SOLVED * np.abs(off).max(axis=1)
        parts = np.where(distances.held, fixed, np.where(touching, 0.0, lift))
        for row, values in zip(result, (parts, np.abs(parts)), strict=True):
            np.add.at(row, pairs[:, 0], values)
    if solved.target.functional is not None:
        for off in _distances_in_cells(problem):
            finer = off.function_space
            J = assembled(solved.target.functional(ufl.TestFunction(finer)), finer)
            result += shared_by_cells(product(J, off))
    parts = solved.on_parents(result)
    if solved.target.norm is not None:
        signed, sizes = problem.comm.allreduce(parts.sum(axis=1))
        parts[1] *= abs(signed) / (sizes or 1.0)
    return parts


def forces_over_gaps(solved: Solved, dual: Dual | None) -> Array:
    """Return what forces of dofs in contact that lie above the obstacle leave in the error.

    In the Bernstein basis coefficients are in contact. Where one of them is and others on its facet
    are not, the solution lies above the obstacle at the place of the dof, and yet a force holds the
    solution there: complementarity fails, and two solutions that hold the same dofs do not show by
    how much. Released from these forces, and from contact at these dofs, the solution would move as
    the error does; cells have shares by the work of force and gap. See `terms.Term`.
    """
    problem, power, zone = solved.fine, solved.target.power, solved.fine.zones[-1]
    space, result = problem.space, np.zeros((2, solved.count))
    # For bodies the term made the loop take degree 2 where degree 3 is cheaper.
    if zone.in_domain or problem.vector_valued or not is_bernstein(space):
        return result
    nodes, gaps = _gaps_in_contact(zone)
    forces = zone.forces.x.array[nodes]
    work = np.abs(forces) * gaps
    over = work > 0.0
    if not anywhere(problem.comm, over):
        return result
    load = function_with(space, nodes[over], -problem.sense * forces[over])
    moved, _ = problem.solve_linearised(load, released=nodes[over])
    parts = solved.on_cells(function_with(space, nodes, work))[1]
    if math.isinf(power):
        parts /= highest(problem.comm, parts)
    else:
        parts = (parts / total(parts, 1.0, problem.comm)) ** (1.0 / power)
    return result + parts * size_of(moved, solved.target)


def _gaps_in_contact(zone: Contact) -> tuple[LocalIndices, Array]:
    """The owned dofs in contact, and by how much the solution is off the obstacle at each place.

    Collective; 0 where this is rounding.
    """
    values = values_at_control_points(zone.space, zone.u.x.array)
    least = SOLVED * highest(zone.space.mesh.comm, np.abs(values))
    nodes, gaps = [], []
    for obstacle, active in zip(zone.obstacles, zone.active_sides, strict=True):
        bound = evaluator(nodal_space(zone.space), obstacle.data, active)()
        gap = obstacle.sign * (values[active] - bound)
        nodes.append(active)
        gaps.append(np.where(gap > least, gap, 0.0))
    return np.concatenate(nodes), np.concatenate(gaps)


def lifting_forces(problem: BoundConstrainedProblem, z: fem.Function) -> fem.Function:
    """Return the force at each dof that moves this dof alone by z; the call is collective.

    The matrix has dofs of vectors in the directions of the contact nodes.
    """
    result, diagonal = fem.Function(problem.space), problem.A.getDiagonal()
    layout, owned = problem.system.layout, len(diagonal.array_r)
    forces = diagonal.array_r * layout.turned(z.x.array[:owned])
    result.x.array[:owned] = layout.turned_back(forces)
    result.x.scatter_forward()
    diagonal.destroy()
    return result


def distances_from_data(problem: BoundConstrainedProblem) -> Iterator[Distances]:
    """Yield the distances from obstacles and Dirichlet data on the boundary; collective.

    Args:
        problem: The solved problem.
    """
    yield from _from_obstacles(problem)
    yield from _from_conditions(problem)


def _from_obstacles(problem: BoundConstrainedProblem) -> Iterator[Distances]:
    for zone, side, obstacle in _varying_obstacles(problem):
        if zone.in_domain:
            continue
        entities, _, touching = contact_on_entities(zone, side)
        points = Points(problem.space.mesh, entities, _lattice(problem.space)[0])
        bound, d = (
            [datum(points.domain, part)(points) for part in data]
            for data in ([obstacle.data], problem.direction)
        )
        if d:
            values = zip(d, points.values(problem.u), strict=True)
            along = np.sum([component * u for component, u in values], axis=0)
            off = (bound[0] - along) / length(d)
        else:
            off = bound[0] - points.values(problem.along(problem.u))[0]
        held = np.asarray(touching.all(axis=1))
        beyond = obstacle.sign * np.maximum(obstacle.sign * off, 0.0)
        off = np.where(held[:, None], off, beyond)
        yield Distances(entities, off, held, lambda f: problem.along(f).x.array)


def _varying_obstacles(
    problem: BoundConstrainedProblem,
) -> Iterator[tuple[Contact, int, Obstacle]]:
    """The obstacles of each zone with their numbers, but for those that are met everywhere.

    A constant along a constant direction, or along normals, is, and nodes show what is beyond.
    """
    for zone in problem.zones:
        for side, obstacle in enumerate(zone.obstacles):
            data = obstacle.data, *problem.direction
            if not all(isinstance(each, int | float | np.number) for each in data):
                yield zone, side, obstacle


def _from_conditions(problem: BoundConstrainedProblem) -> Iterator[Distances]:
    domain, (lattice, _) = problem.space.mesh, _lattice(problem.space)
    boundary = boundary_facets(domain)
    for known in map(data_of_condition, problem.bcs):
        if known is None or isinstance(known.value, int | float | np.number):
            continue
        facets = np.intersect1d(known.facets, boundary).astype(np.int32)
        points = Points(domain, facet_cells(domain, facets), lattice)
        component, held = partial(_component, known.component), np.ones(len(facets), dtype=bool)
        value = datum(domain, known.value)(points)
        off = value - points.values(problem.u)[known.component]
        off = np.where(np.isfinite(off), off, 0.0)
        yield Distances(points.places, off, held, component)


def _component(k: int, f: fem.Function) -> Array:
    """The coefficients of the component k of a function."""
    return component_arrays(f)[k]


def _distances_in_cells(problem: BoundConstrainedProblem) -> Iterator[fem.Function]:
    for zone, side, obstacle in _varying_obstacles(problem):
        if zone.in_domain:
            _, _, touching = contact_on_entities(zone, side)
            yield _off_in_cells(zone, obstacle, touching)


def _off_in_cells(problem: Contact, obstacle: Obstacle, touching: Mask) -> fem.Function:
    """The distance to an obstacle in cells in contact, and what lies beyond it in all cells.

    The obstacle is interpolated by elements of a higher degree, at least of degree 4: at one of
    their nodes are at least four fifths of the largest distance to a kink.
    """
    space = problem.space
    degree = max(space.element.basix_element.degree + 1, HIGHEST_DEGREE)
    finer = fem.functionspace(space.mesh, ("Lagrange", degree))
    off, u = fem.Function(finer, name="off"), fem.Function(finer)
    u.interpolate(problem.u)
    dofs = dofs_on_entities(finer, space.mesh.topology.dim, problem.contact)
    gap = obstacle.sign * (u.x.array[dofs] - evaluator(finer, obstacle.data, dofs)())
    held = np.zeros(len(off.x.array), dtype=bool)
    held[finer.dofmap.list[problem.owned_entities[touching.all(axis=1)]]] = True
    off.x.array[dofs] = -obstacle.sign * np.where(held[dofs], gap, np.minimum(gap, 0.0))
    off.x.scatter_forward()
    return off


def _lattice(space: fem.FunctionSpace) -> tuple[Array, Array]:
    """Points of the reference facet, in order, and the weights of the mean of values there.

    Distances from data vanish at the nodes of the element. In the plane the points are those of
    Chebyshev between two nodes, so that a kink of data close to a node is between points, too, and
    as close to one another in the middle as those of `facet_lattice`.
    """
    lattice = facet_lattice(space)
    if lattice.shape[1] > 1:
        return lattice, np.full(len(lattice), 1.0 / len(lattice))
    parts = space.element.basix_element.degree
    count = math.ceil(0.5 * math.pi * len(lattice) / parts)
    near = 0.5 - 0.5 * np.cos(np.linspace(0.0, math.pi, count + 1))
    x = np.concatenate([(k + near[: None if k + 1 == parts else -1]) / parts for k in range(parts)])
    half = 0.5 * np.diff(x)
    return x[:, None], np.append(half, 0.0) + np.append(0.0, half)


def _volumes(problem: BoundConstrainedProblem, distances: Distances, norm: Norm) -> Array:
    """The sizes of what distances reach into: of facets, or of the domain near them.

    In space, where a facet has no antiderivative, a distance reaches half as far as the facet.
    """
    domain, dim = problem.space.mesh, problem.space.mesh.topology.dim
    scale = facet_scale(domain, distances.pairs)
    if norm.boundary:
        return scale
    half = 0.5 * scale ** (1.0 / (dim - 1.0))
    if dim > 2:
        return scale * half
    (lattice, weights), off = _lattice(problem.space), distances.off
    means = 0.5 * (off[:, 1:] + off[:, :-1]) * np.diff(lattice[:, 0])
    sums = np.pad(np.cumsum(means, axis=1), ((0, 0), (1, 0)))
    reach = scale * over(p_norm(sums, 2.0, weights), p_norm(off, 2.0, weights))
    return np.asarray(scale * np.minimum(reach, half))


def _defects(
    problem: BoundConstrainedProblem,
    distances: Distances,
    norm: Norm,
    values: Array,
    weights: Array,
) -> Array:
    """The L^p norms on each cell of values at points of facets, as far as distances reach."""
    volumes = _volumes(problem, distances, norm)
    parts = p_norm(values, norm.p, volumes[:, None] * weights)
    cells, count = distances.pairs[:, 0], len(owned_cells(problem.space.mesh))
    return np.asarray(collected(parts, cells, count, norm.p))


def _slopes(problem: BoundConstrainedProblem, distances: Distances) -> tuple[Array, Array]:
    """The sizes of the derivatives of distances along facets, between neighbours of the lattice.

    The weights of their mean come second.
    """
    (lattice, _), off = _lattice(problem.space), distances.off
    steps = np.stack([np.unique(x, return_inverse=True)[1] for x in lattice.T], axis=1)
    places = {tuple(step): k for k, step in enumerate(steps)}
    axes = np.eye(steps.shape[1], dtype=int)
    first = [k for k, step in enumerate(steps) if tuple(step + axes[0]) in places]
    after = [[places[tuple(steps[k] + axis)] for k in first] for axis in axes]
    widths = np.array([lattice[ends, k] - lattice[first, k] for k, ends in enumerate(after)])
    along = np.stack([off[:, ends] - off[:, first] for ends in after], axis=1) / widths
    tangents = Points(problem.space.mesh, distances.pairs, lattice).tangents[:, 0]
    sizes = length(np.einsum("fai,fan->ifn", inverses(tangents), along))
    return sizes, widths[0] / widths[0].sum()
