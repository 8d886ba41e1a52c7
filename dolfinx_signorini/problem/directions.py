"""Directions of an obstacle that vectors meet: at each contact node u.d <= g.

Without a direction of the user's own, d is the outward unit normal, averaged over the facets around
a node with their areas as weights. On straight sides this average is the normal; on a curved side
the averages converge to the normals of the side. Where the mesh has a corner, no average is meant:
the node is refused.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import basix
import numpy as np
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.changed_values import Watch
from dolfinx_signorini.base.errors import InputError, require
from dolfinx_signorini.base.ranks import anywhere, summed
from dolfinx_signorini.base.tolerances import ROUNDING, SOLVED
from dolfinx_signorini.meshes.elements import facet_dofs
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.sided_meshes import facet_cells, owned_facets
from dolfinx_signorini.problem.checks import place
from dolfinx_signorini.problem.values import Data, evaluator
from dolfinx_signorini.solvers.frames import Frame, turn_towards

Direction: TypeAlias = Sequence[float] | Expr | fem.Function | Callable[[Array], Array] | None

# The length of an averaged normal: cos(30 degrees), half of the turn between two sides of 60.
SHORTEST = 3.0**0.5 / 2.0


class Directions:
    """The directions at the contact nodes of a problem, and the bounds along them; collective.

    An obstacle at the gap g and Dirichlet data give upper bounds on the turned dofs:

        directions = Directions(space, nodal, facets, nodes, fixed, direction)
        bounds = directions.bounds(gaps, data, "gap", lambda: 1.0)

    Args:
        space: The vector space.
        nodal: The scalar space of one component, whose dofs are the nodes.
        facets: The contact facets that this rank knows.
        nodes: The owned contact nodes.
        fixed: The owned dofs of the vector space with Dirichlet data.
        direction: The direction, see `ContactProblem`.

    Attributes:
        parts: The components of the direction that is given, as data; () for the normals.
        units: The unit vector d at each of the nodes, shape (nodes, components).
        shares: The length of the part of d that Dirichlet data leave free.
        dofs: The dof of each node that has the bound, after the turn.
        frame: The turn of the nodes.

    Raises:
        InputError: A direction is zero or not finite, or an averaged normal is at a corner; the
            subject is "direction".
    """

    def __init__(
        self,
        space: fem.FunctionSpace,
        nodal: fem.FunctionSpace,
        facets: LocalIndices,
        nodes: LocalIndices,
        fixed: LocalIndices,
        direction: Direction,
    ):
        size, owned = space.dofmap.bs, nodal.dofmap.index_map.size_local
        self._fixed = fixed
        self.parts = () if direction is None else _parts(direction, size)
        self._watch = Watch(*([direction] if isinstance(direction, Expr) else []))
        if direction is None:
            vectors = _normals(nodal, facets)[nodes]
        else:
            given = [evaluator(nodal, part, nodes, "direction")() for part in self.parts]
            vectors = np.stack(given, axis=1)
        self.lengths = _checked_lengths(nodal, nodes, vectors, direction is None)
        units = vectors / self.lengths[:, None]
        units[np.abs(units) < ROUNDING] = 0.0  # along an axis, whatever rounding makes of a normal
        self.units = units / np.linalg.norm(units, axis=1)[:, None]
        if direction is None:
            self.lengths = np.ones(len(nodes))  # the gap is a distance along the normal
        held = np.zeros(owned * size, dtype=bool)
        held[fixed] = True
        self._held = held.reshape(owned, size)[nodes]
        turns, self.shares, rows = turn_towards(self.units, self._held)
        free = self.shares > SOLVED
        self.dofs = (nodes * size + rows).astype(np.int32)
        self._nodes = nodes
        self.frame = Frame(nodal, nodes[free], turns[free], free)

    def bounds(
        self, gaps: Array, data: Array, name: str, size_of_solution: Callable[[], float]
    ) -> Array:
        """Return the bounds on the turned dofs, one for each node.

        Args:
            gaps: The gap g at each node.
            data: The Dirichlet data at the fixed dofs; collective.
            name: The name of the argument that gave the gap.
            size_of_solution: Tells about the size of the solution; asked for only where data lie
                beyond.

        Raises:
            InputError: Dirichlet data alone lie beyond the obstacle, or a value in the direction
                has changed.
        """
        nodal, size = self.frame.nodal, self.units.shape[1]
        same = not self._watch.differs()
        message = "has changed values: a problem keeps the directions of its start; pose a new one"
        require(nodal.mesh.comm, same, message, "direction")
        values = np.zeros(nodal.dofmap.index_map.size_local * size)
        values[self._fixed] = data
        known = np.where(self._held, values.reshape(-1, size)[self._nodes], 0.0)
        scaled = gaps / self.lengths
        left = scaled - np.einsum("ni,ni->n", self.units, known)
        free = self.frame.free
        beyond, message = ~free & (left < 0.0), ""
        if anywhere(nodal.mesh.comm, beyond):
            beyond &= left < -ROUNDING * size_of_solution()
        for k in np.flatnonzero(beyond)[:1]:
            message = (
                f"{gaps[k]:.6g} lies below the Dirichlet data at {place(nodal, self._nodes[k])}"
            )
        require(nodal.mesh.comm, not message, message, name)
        return np.divide(left, self.shares, out=left.copy(), where=free)


def _parts(direction: Direction, size: int) -> tuple[Data, ...]:
    """The components of a direction that a user gives."""
    if isinstance(direction, Expr):
        if direction.ufl_shape != (size,):
            shape = direction.ufl_shape
            raise InputError(
                f"must be a vector of {size} components, has shape {shape}", "direction"
            )
        return tuple(direction[i] for i in range(size))
    if callable(direction):
        function: Any = direction

        def component(i: int, x: Array) -> Any:
            found = np.asarray(function(x))
            if len(found) != size:
                raise ValueError(f"{len(found)} components, not {size}")
            return found[i]

        return tuple(functools.partial(component, i) for i in range(size))
    try:
        constant = np.array(direction, dtype=np.float64)
    except (TypeError, ValueError):
        constant = np.empty(0)
    if constant.shape != (size,):
        raise InputError(f"must be a vector of {size} components", "direction")
    return tuple(map(float, constant))


def _normals(nodal: fem.FunctionSpace, facets: LocalIndices) -> Array:
    """The mean outward normal of the facets around each dof of this rank, weighted by area."""
    domain, index_map = nodal.mesh, nodal.dofmap.index_map
    pairs = facet_cells(domain, owned_facets(domain, facets))
    element = nodal.element.basix_element
    kinds = basix.cell.subentity_types(element.cell_type)[domain.topology.dim - 1]
    rule = basix.make_quadrature(kinds[0], 2 * domain.geometry.cmap.degree)
    at, weights = (np.asarray(part, dtype=np.float64) for part in rule)
    points = Points(domain, pairs, at)
    sizes: Array = np.broadcast_to(points.scale, (len(pairs), len(weights))) * weights
    dofs = facet_dofs(nodal, pairs)
    area = np.maximum(summed(index_map, dofs, sizes.sum(axis=1)[:, None]), np.finfo(float).tiny)
    integrals = [(sizes * normal).sum(axis=1)[:, None] for normal in points.normals]
    return np.stack([summed(index_map, dofs, each) / area for each in integrals], axis=1)


def _checked_lengths(
    nodal: fem.FunctionSpace, nodes: LocalIndices, vectors: Array, averaged: bool
) -> Array:
    """The lengths of directions, all of which have one."""
    lengths = np.linalg.norm(vectors, axis=1)
    least = SHORTEST if averaged else 0.0
    bad = ~np.isfinite(lengths) | (lengths <= least)
    message = ""
    for k in np.flatnonzero(bad)[:1]:
        where = place(nodal, nodes[k])
        message = f"{vectors[k].tolist()} at {where} is no direction"
        if averaged:
            message = (
                f"facets with normals far apart meet at {where}, whose average means none of them; "
                "give a direction, or leave the facets of one side out of the contact boundary"
            )
    require(nodal.mesh.comm, not message, message, "direction")
    return lengths


def scalar_space(space: fem.FunctionSpace) -> fem.FunctionSpace:
    """Return the scalar space of one component, whose dofs have the numbers of the nodes.

    Args:
        space: A space of vectors with Lagrange components.
    """
    nodal: fem.FunctionSpace | None = getattr(space, "_scalar", None)  # each component asks for it
    if nodal is None:
        nodal = fem.functionspace(space.mesh, space.ufl_element().sub_elements[0])
        assert np.array_equal(nodal.dofmap.list, space.dofmap.list)
        space._scalar = nodal  # type: ignore[attr-defined]
    return nodal
