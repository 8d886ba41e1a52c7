"""How far a solution is from the obstacle that the nodes of the mesh do not show.

A solution meets the obstacle at nodes. Where the obstacle has a kink or a pin between the nodes, no
comparison of discrete solutions shows the error, but the obstacle itself does: the error is not
smaller than what the solution lies below the obstacle, and on facets in contact not smaller than
the distance to the obstacle.
"""

import basix
import numpy as np
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_signorini.accuracy.cells import Array
from dolfinx_signorini.meshes import facet_cells, owned_cells
from dolfinx_signorini.points import FormulaAtPoints, Points
from dolfinx_signorini.problem import SignoriniProblem

SAMPLES = 24  # on each edge of a facet


def obstacle_misfits(problem: SignoriniProblem) -> Array:
    """Return for each owned cell the largest distance to the obstacle that must be an error.

    Args:
        problem: The solved problem; the call is collective.
    """
    domain, data = problem.space.mesh, problem.obstacle_data
    misfits = np.zeros(len(owned_cells(domain)))
    if isinstance(data, int | float | np.number):
        return misfits  # met everywhere, and below it the nodes show
    dim = domain.topology.dim
    owned = domain.topology.index_map(dim - 1).size_local
    pairs = facet_cells(domain, problem.contact[problem.contact < owned])
    cell = problem.space.element.basix_element.cell_type
    facet = basix.cell.subentity_types(cell)[dim - 1][0]
    kind = basix.LatticeType.equispaced
    lattice = basix.create_lattice(
        facet, SAMPLES if dim == 2 else SAMPLES // 3, kind, exterior=True
    )
    points = Points(domain, pairs, np.asarray(lattice, dtype=np.float64))
    (u,) = points.values(problem.u)
    gap = problem.sign * (u - _obstacle(problem, points))
    below = np.maximum(-gap, 0.0)
    distance = np.where(_touching(problem, pairs)[:, None], np.abs(gap), below)
    np.maximum.at(misfits, pairs[:, 0], distance.max(axis=1, initial=0.0))
    return misfits


def _obstacle(problem: SignoriniProblem, points: Points) -> Array:
    """The obstacle at the points, shape (facets, points)."""
    data = problem.obstacle_data
    if isinstance(data, fem.Function):
        return points.values(data)[0]
    if isinstance(data, Expr):
        return FormulaAtPoints(points.domain, [data])(points)[0]
    assert callable(data)
    shape = points.x[0].shape
    x = np.zeros((3, points.x[0].size))
    x[: len(points.x)] = [coordinate.ravel() for coordinate in points.x]
    return np.asarray(data(x), dtype=np.float64).reshape(shape)


def _touching(problem: SignoriniProblem, pairs: np.ndarray) -> np.ndarray:
    """Whether the solution touches the obstacle at all dofs of each facet."""
    space = problem.space
    active = fem.Function(space)
    active.x.array[problem.active] = 1.0
    active.x.scatter_forward()
    closures = np.array(
        space.element.basix_element.entity_closure_dofs[space.mesh.topology.dim - 1]
    )
    dofs = space.dofmap.list[pairs[:, 0, None], closures[pairs[:, 1]]]
    return np.asarray((active.x.array[dofs] > 0.5).all(axis=1))
