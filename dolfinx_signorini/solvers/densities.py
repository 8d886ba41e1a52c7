"""Densities on facets or cells: functions whose integrals are given forces.

A force on a dof is the integral of a density times the basis function of the dof. Where functions
b_j of the space have positive integrals w_j and the sum 1, and are not negative at the nodes x_i,
the forces f_i on the dofs are forces F_j = sum_i b_j(x_i) f_i on these functions, and

    the density  sum_j (F_j / w_j) b_j

has exactly the integral sum f_i, is not negative where no force is, and is a constant where the
forces are those of a constant. The b_j are the basis of the space itself, nodal or Bernstein, so
that F = f; but nodal functions on triangles may have integrals that are zero (at the vertices, of
degree 2) or negative (of degree 4). There the b_j are the Bernstein polynomials of the same degree,
with which the density is not negative between the nodes either.

Source: Derriennic, J. Approx. Theory 31 (1981) 325-343, for such densities of Bernstein
polynomials.
"""

import functools
from typing import Any

import basix
import numpy as np
import ufl
from dolfinx import fem

from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.base.ranks import shared, summed
from dolfinx_signorini.meshes.elements import bernstein_at_nodes, facet_dofs, is_bernstein


class Densities:
    """Turns forces on the dofs of some facets or cells into densities; making one is collective.

    Args:
        space: A scalar space of continuous elements.
        entities: Owned cells, shape (n,), or owned facets as (cell, local facet) pairs, shape
            (n, 2).

    Attributes:
        integrals: The integral of the basis function of each dof of this rank, ghosts included: the
            force of the density 1.
    """

    def __init__(self, space: fem.FunctionSpace, entities: LocalIndices):
        self._comm, self._map = space.mesh.comm, space.dofmap.index_map
        in_cells = entities.ndim == 1
        self._dofs = space.dofmap.list[entities] if in_cells else facet_dofs(space, entities)
        self._values: Array | None = None
        dim = space.mesh.topology.dim - (not in_cells)
        if _needs_bernstein(space, dim):
            count = self._map.size_local + self._map.num_ghosts
            self._shares = shared(self._map, self._dofs, np.ones(count))
            numbers = np.zeros_like(entities) if in_cells else entities[:, 1]
            self._values = bernstein_at_nodes(space, dim)[numbers]
        self.integrals: Array = _integrals(space, entities)

    def of(self, forces: Array) -> Array:
        """Return the dofs of the density of some forces; the call is collective.

        Args:
            forces: The forces on all dofs of this rank, ghosts included; 0 away from the facets.

        Raises:
            InputError: A basis function of intervals or quadrilaterals has no positive integral:
                nodes are at equal distances, and the degree is 8 or higher.
        """
        sizes, weights = (self._tested(item) for item in (forces, self.integrals))
        positive = bool((weights[self._dofs] > 0.0).all())
        message = "some of its functions have no positive integral; the nodes gll_warped have"
        require(self._comm, positive, message, "space")
        parts = np.divide(sizes, weights, out=np.zeros_like(sizes), where=weights > 0.0)
        if self._values is None:
            return parts
        values = np.einsum("fij,fj->fi", self._values, parts[self._dofs])
        return summed(self._map, self._dofs, self._shares * values)

    def _tested(self, forces: Array) -> Array:
        """The forces on the functions b_j: each force is shared out among the facets of its dof."""
        if self._values is None:
            return forces
        parts = self._shares * forces[self._dofs]
        return summed(self._map, self._dofs, np.einsum("fij,fi->fj", self._values, parts))


def _needs_bernstein(space: fem.FunctionSpace, dim: int) -> bool:
    """Whether a space is nodal on triangles or tetrahedra of a dimension, of degree 2 or higher."""
    element = space.element.basix_element
    entity = basix.cell.subentity_types(element.cell_type)[dim][0]
    simplex = entity in (basix.CellType.triangle, basix.CellType.tetrahedron)
    return bool(simplex and element.degree > 1 and not is_bernstein(space))


def _integrals(space: fem.FunctionSpace, entities: LocalIndices) -> Array:
    """The integrals of the basis functions over facets or cells, for all dofs of this rank."""
    coordinates = space.mesh.ufl_domain().ufl_coordinate_element()
    in_cells = entities.ndim == 1
    kind = fem.IntegralType.cell if in_cells else fem.IntegralType.exterior_facet
    integral = _integral(coordinates, space.ufl_element(), "dx" if in_cells else "ds")
    form = compiled.form_on(integral, [space], {kind: [(1, entities.flatten())]})
    return np.array(compiled.assembled(form, space).x.array)


@functools.cache
def _integral(coordinates: Any, element: Any, measure: str) -> ufl.Form:
    """The integrals of the basis functions over part 1 of the boundary, or of the domain."""
    domain = ufl.Mesh(coordinates)
    return ufl.TestFunction(ufl.FunctionSpace(domain, element)) * ufl.Measure(measure, domain)(1)
