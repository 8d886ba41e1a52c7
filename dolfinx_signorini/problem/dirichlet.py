"""Dirichlet conditions whose data are known at every point of facets, and not at nodes alone."""

from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

from dolfinx import fem

from dolfinx_signorini.base.arrays import LocalIndices
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
    """

    facets: LocalIndices
    value: Data


_known: WeakKeyDictionary[fem.DirichletBC, DirichletData] = WeakKeyDictionary()


def dirichlet(
    space: fem.FunctionSpace, facets: LocalIndices, value: Data, component: int | None = None
) -> fem.DirichletBC:
    """Return the Dirichlet condition u = value on facets; collective.

    A condition of a scalar u remembers the data, see `data_of_condition`.

    Args:
        space: A Lagrange space.
        facets: Facets of the boundary, local to the rank.
        value: The data, see `evaluator`.
        component: The number of the component of u that has the value; None for a scalar u.
    """
    nodal, size = (space, 1) if component is None else (scalar_space(space), space.dofmap.bs)
    nodes = fem.locate_dofs_topological(nodal, space.mesh.topology.dim - 1, facets)
    owned = nodes[nodes < space.dofmap.index_map.size_local]
    values, first = fem.Function(space), component or 0
    values.x.array[owned * size + first] = evaluator(nodal, value, owned, "value")()
    values.x.scatter_forward()
    dofs = nodes * size + first
    if component is not None:
        both: Any = [dofs, dofs]
        return fem.dirichletbc(values, both, space.sub(component))
    condition = fem.dirichletbc(values, dofs)
    _known[condition] = DirichletData(facets, value)
    return condition


def data_of_condition(condition: fem.DirichletBC) -> DirichletData | None:
    """Return the data of a condition that `dirichlet` has made; None for other conditions."""
    return _known.get(condition)
