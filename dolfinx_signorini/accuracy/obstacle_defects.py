"""Defects of contact: the distance of a solution from the obstacle between the nodes of the mesh.

A solution meets the obstacle at nodes. Where the obstacle has a kink or a pin between the nodes, no
comparison of discrete solutions shows the error, but the obstacle itself does: the trace of the
error is at least what the solution lies below the obstacle, and on facets in contact the distance
to the obstacle. From the facet such an error reaches about half as far into the domain as the facet
is long.
"""

import math

import numpy as np
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_signorini.accuracy.contact_ends import SAMPLES, contact_on_facets, facet_lattice
from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.meshes.points import FormulaAtPoints, Points
from dolfinx_signorini.meshes.sided_meshes import facet_scale, owned_cells
from dolfinx_signorini.norms.names import Norm
from dolfinx_signorini.problem.assembly import called
from dolfinx_signorini.problem.signorini import SignoriniProblem


def obstacle_defects(problem: SignoriniProblem, norm: Norm) -> Array:
    """Return what the distance to the obstacle adds to the error on each owned cell.

    Args:
        problem: The solved problem; the call is collective.
        norm: An L^p or W^{1,p} norm of the domain. The parts of cells are zero for derivatives in
            space, where differences along a facet are not formed.
    """
    domain, data = problem.space.mesh, problem.obstacle_data
    defects, dim = np.zeros(len(owned_cells(domain))), domain.topology.dim
    if isinstance(data, int | float | np.number) or (norm.derivatives and dim > 2):
        return defects  # a number is met everywhere, and below it the nodes show
    pairs, _, touching = contact_on_facets(problem)
    points = Points(domain, pairs, facet_lattice(problem.space))
    (u,) = points.values(problem.u)
    gap = problem.sign * (u - _obstacle(problem, points))
    held = touching.all(axis=1).reshape(-1, 1)
    off: Array = np.where(held, gap, np.minimum(gap, 0.0))
    scale = facet_scale(domain, pairs)
    if norm.derivatives:
        off = np.diff(off, axis=1) * SAMPLES / scale[:, None]
    sizes: Array = np.abs(off)
    if math.isinf(norm.p):
        np.maximum.at(defects, pairs[:, 0], sizes.max(axis=1, initial=0.0))
        return defects
    volume = 0.5 * scale ** (dim / (dim - 1.0))  # of what is near the facet
    largest = float(sizes.max(initial=0.0)) or 1.0
    powers = ((sizes / largest) ** norm.p).mean(axis=1) * volume if sizes.size else volume
    np.add.at(defects, pairs[:, 0], powers)
    return np.asarray(largest * defects ** (1.0 / norm.p))


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
    return called(points.domain.comm, data, x).reshape(shape)
