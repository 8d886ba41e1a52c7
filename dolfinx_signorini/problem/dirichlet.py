"""Dirichlet conditions whose data are known at every point of facets, and not at nodes alone."""

from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from dolfinx import fem

from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.errors import InputError, require
from dolfinx_signorini.base.kinds import check, indices, instance, integer, on_mesh, optional
from dolfinx_signorini.meshes.sided_meshes import facet_count
from dolfinx_signorini.problem.directions import scalar_space
from dolfinx_signorini.problem.values import Data, evaluator


@dataclass(frozen=True)
class DirichletData:
    """The data of a condition between the nodes:

        for known in map(data_of_condition, problem.bcs):
            print(known)

    Attributes:
        facets: The facets of the condition, local to the rank.
        value: The data: a number, a UFL expression, a function or a callable of the coordinates.
        component: The number of the component of u that has these data; 0 for a scalar u.
    """

    facets: LocalIndices
    value: Data
    component: int = 0


_known: WeakKeyDictionary[fem.DirichletBC, DirichletData] = WeakKeyDictionary()


def dirichlet(
    space: fem.FunctionSpace, facets: LocalIndices, value: Data, component: int | None = None
) -> fem.DirichletBC:
    """Return the Dirichlet condition u = value on facets; collective.

    The condition is one of DOLFINx for the nodes of the facets, and remembers the data, so that
    estimates of the error see what the data are between these nodes:

        bcs = [dirichlet(V, top, -0.1 - 0.2 * abs(x[0] - 0.3) ** 0.6, component=1)]

    The data are those at the time of the call: a loop over data makes a new condition each time.

    Args:
        space: A continuous Lagrange space.
        facets: Facets of the boundary, local to the rank.
        value: A number, a UFL expression, a function, or a callable of the coordinates, shape
            (3, n), which is called on the ranks that have points and must not communicate.
        component: The number of the component of u that has the value; of a scalar u None or 0.

    Raises:
        InputError: An argument makes no sense, or the data have several values at a node.
    """
    check(space=(space, instance(fem.FunctionSpace, "a function space")))
    domain, size = space.mesh, space.dofmap.bs
    check(
        value=(value, on_mesh(domain, callables=True)),
        component=(component, optional(integer(0, size - 1))),
    )
    known = facet_count(domain)
    wrong = indices(facets, "facets")
    if not wrong and len(facets) and not 0 <= np.min(facets) <= np.max(facets) < known:
        wrong = f"the mesh has {known} facets here"
    require(domain.comm, not wrong, wrong, "facets")
    if size > 1 and component is None:
        raise InputError("of a vector the number of one component is needed", "component")
    nodal, first = space if size == 1 else scalar_space(space), component or 0
    dim = domain.topology.dim
    domain.topology.create_connectivity(dim - 1, dim)
    nodes = fem.locate_dofs_topological(nodal, dim - 1, facets)
    owned = nodes[nodes < space.dofmap.index_map.size_local]
    values = fem.Function(space)
    values.x.array[owned * size + first] = evaluator(nodal, value, owned, "value")()
    values.x.scatter_forward()
    dofs = nodes * size + first
    if size == 1:
        condition = fem.dirichletbc(values, dofs)
    else:
        both: Any = [dofs, dofs]
        condition = fem.dirichletbc(values, both, space.sub(first))
    _known[condition] = DirichletData(facets, value, first)
    return condition


def data_of_condition(condition: fem.DirichletBC) -> DirichletData | None:
    """Return the data of a condition that `dirichlet` has made; None for other conditions."""
    return _known.get(condition)
