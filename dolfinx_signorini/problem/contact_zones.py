"""Where obstacles act, and contact on one part of a problem that has obstacles on two.

Where there are obstacles in the domain and on the boundary, the pressure in the domain is a force
per area in the plane, and on the boundary a force per length. A dof on the boundary may have
obstacles of both kinds; its force is that of the tighter obstacle, or of the boundary where they
are equal.
"""

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from dolfinx import fem

from dolfinx_signorini.base.arrays import LocalIndices, union
from dolfinx_signorini.problem.constraint import Obstacle, Zone
from dolfinx_signorini.solvers.system import Layout

if TYPE_CHECKING:
    from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem


class OnContact(ABC):
    """Where obstacles act, and which dofs are in contact: what a problem and a part of one share.

    For example, the share of the dofs of a solved problem that are in contact:

        len(problem.active) / len(problem.obstacle_nodes)
    """

    space: fem.FunctionSpace
    sign: float  # -1 where all obstacles are upper ones, else 1

    @property
    @abstractmethod
    def _layout(self) -> Layout:
        """The layout of the problem, or of the part."""

    @property
    @abstractmethod
    def active_sides(self) -> tuple[LocalIndices, ...]:
        """For each obstacle the owned dofs in contact, of vectors nodes: where u is equal to it."""

    @property
    @abstractmethod
    def forces(self) -> fem.Function:
        """The contact forces on the dofs."""

    @property
    def active(self) -> LocalIndices:
        """The owned dofs in contact, of vectors nodes: where u is equal to an obstacle.

        Raises:
            InputError: The problem has not been solved.
        """
        return union(self.active_sides)

    @property
    def force(self) -> float:
        """The total contact force on u, positive upwards: so negative for an upper obstacle.

        The force is the integral of the pressure, with the sign of its direction, and takes part in
        the balance of all forces on u. The call is collective.

        Raises:
            InputError: The problem has not been solved.
        """
        owned = self.forces.x.array[self.obstacle_nodes]
        return self.sign * float(self.space.mesh.comm.allreduce(float(owned.sum())))

    @property
    def normal_forces(self) -> fem.Function:
        """The size of the contact force at each contact node, a scalar function: `forces`.

        Raises:
            InputError: The problem has not been solved.
        """
        return self.forces

    @property
    def along_direction(self) -> Any:
        """The contact as that of a scalar: the problem or the zone itself, if u is a scalar."""
        return self

    @property
    def in_domain(self) -> bool:
        """Whether the obstacles are in the domain, and not on the boundary alone."""
        return self._layout.in_domain

    @property
    def contact(self) -> LocalIndices:
        """The facets or cells with an obstacle that this rank knows."""
        return self._layout.entities

    @property
    def obstacle_nodes(self) -> LocalIndices:
        """The owned dofs with an obstacle, of vectors nodes, with or without Dirichlet data."""
        return self._layout.obstacle_nodes

    @property
    def held_nodes(self) -> LocalIndices:
        """The nodes with an obstacle that Dirichlet data hold, see `Layout`."""
        return self._layout.held_nodes

    @property
    def owned_entities(self) -> LocalIndices:
        """The owned cells with an obstacle, or the owned facets as (cell, local facet) pairs."""
        return self._layout.owned_entities

    @property
    def fixed_dofs(self) -> LocalIndices:
        """The owned dofs with Dirichlet data."""
        return self._layout.fixed_dofs


class ContactZone(OnContact):
    """The contact boundary, or the cells with an obstacle, of a problem that has both:

        boundary = problem.boundary
        print(boundary.force, len(boundary.active))

    The names are those of a problem. Each access refers to the last solve.

    Attributes:
        space, u: The function space and the solution of the problem.
        sign: -1 where all obstacles of the problem are upper ones, else 1, see `forces`.
        obstacles: The obstacles of the zone.
    """

    unknown = "u"

    def __init__(self, problem: "BoundConstrainedProblem", zone: Zone, number: int):
        self._problem, self._zone, self._number = problem, zone, number
        self._whole: Layout | None = None  # the layout of the problem that `_own` is made of
        self.space, self.u, self.sign = problem.space, problem.u, problem.sign
        self.obstacles: tuple[Obstacle, ...] = zone.obstacles

    @property
    def _layout(self) -> Layout:
        whole = self._problem.system.layout  # another one where the mesh has moved
        if whole is not self._whole:
            dim, entities = self._zone.dim, self._zone.entities
            dofs = self._problem.zone_dofs(self._number)
            self._own = replace(whole, dim=dim, entities=entities, obstacle_dofs=dofs)
            self._whole = whole
        return self._own

    @property
    def active_sides(self) -> tuple[LocalIndices, ...]:
        """For each obstacle of the zone the owned dofs in contact with this obstacle."""
        return self._problem.active_in(self._number)

    @property
    def gap(self) -> fem.Function:
        """The distance from u to the nearest obstacle of the zone at its dofs, 0 elsewhere."""
        signs = [each.sign for each in self.obstacles]
        bounds = zip(signs, self._problem.obstacle_values(self._number), strict=True)
        return self._problem.gap_at(self.obstacle_nodes, bounds)

    @property
    def forces(self) -> fem.Function:
        """The contact forces on the dofs whose tighter obstacle is of the zone, see the problem."""
        found = fem.Function(self.space, name="forces")
        every = self.sign * self._problem.forces.x.array
        for each, held in zip(self.obstacles, self.active_sides, strict=True):
            found.x.array[held] += each.sign * np.maximum(each.sign * every[held], 0.0)
        found.x.array[:] *= self.sign
        found.x.scatter_forward()
        return found

    @property
    def pressure(self) -> fem.Function:
        """The density of the forces on the facets or in the cells of the zone; collective."""
        return self._layout.density(self.forces)
