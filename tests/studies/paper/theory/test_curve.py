"""The boundary as a closed curve: order, arc length, values, samples, facets."""

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.studies.paper.theory.boundary import BoundaryCurve

N = 7


@pytest.fixture
def space():
    return fem.functionspace(friedrichs_keller(MPI.COMM_WORLD, N), ("Lagrange", 1))


@pytest.fixture
def curve(space):
    return BoundaryCurve(space)


def on_the_square(s):
    """The point of the unit square's boundary at an arc length from (0, 0)."""
    side, t = np.divmod(s, 1.0)
    x = np.select([side == 0, side == 1, side == 2], [t, 1.0, 1.0 - t], 0.0)
    y = np.select([side == 0, side == 1, side == 2], [0.0, t, 1.0], 1.0 - t)
    return np.column_stack([x, y])


def test_counterclockwise_from_the_origin(curve):
    s = np.arange(4 * N) / N
    assert np.allclose(curve.s, s, atol=1e-13)
    assert np.allclose(curve.x, on_the_square(s + 1e-14), atol=1e-12)
    assert curve.length == pytest.approx(4.0)
    assert np.allclose(curve.widths, 1.0 / N)
    assert np.allclose(curve.corners, [0.0, 1.0, 2.0, 3.0])


def test_values_and_back(space, curve):
    u = fem.Function(space)
    u.interpolate(lambda x: 1.0 + 3.0 * x[0] - 2.0 * x[1] ** 2)
    values = curve.values(u)
    assert np.allclose(values, 1.0 + 3.0 * curve.x[:, 0] - 2.0 * curve.x[:, 1] ** 2, atol=1e-13)
    again = curve.function(values)
    assert np.allclose(curve.values(again), values, atol=0.0)
    # Nothing inside.
    inside = again.x.array[: space.dofmap.index_map.size_local]
    total = space.mesh.comm.allreduce(float(np.abs(inside).sum()))
    assert total == pytest.approx(np.abs(values).sum())


def test_samples_follow_the_edges(curve):
    t = np.linspace(0.0, 1.0, 5)
    x = ufl.SpatialCoordinate(curve.space.mesh)
    found = curve.samples([x[0], x[1]], t)
    s = curve.s[:, None] + curve.widths[:, None] * t
    inner = (slice(None), slice(1, -1))
    assert np.allclose(found[inner].reshape(-1, 2), on_the_square(s[inner].ravel()), atol=1e-12)


def test_facets_between_marked_edges(curve):
    marked = (curve.s > 0.4) & (curve.s < 1.6)
    facets = curve.facets_between(marked)
    domain = curve.space.mesh
    middles = dolfinx.mesh.compute_midpoints(domain, 1, facets)[:, :2]
    found = np.concatenate(domain.comm.allgather(middles))
    want = on_the_square(curve.s[marked] + 0.5 / N)
    assert np.allclose(found[np.lexsort(found.T)], want[np.lexsort(want.T)])
    every = curve.facets_between(np.ones(4 * N, dtype=bool))
    assert (np.sort(every) == np.sort(boundary_facets(domain))).all()


def test_quadratic_elements_are_refused():
    space = fem.functionspace(friedrichs_keller(MPI.COMM_WORLD, 3), ("Lagrange", 2))
    with pytest.raises(InputError, match="degree 1"):
        BoundaryCurve(space)
