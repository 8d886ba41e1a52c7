"""Fluxes that carry what is left in cells to reactions at the least price."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini import SignoriniProblem, boundary_facets
from dolfinx_signorini.bounds import cell_pressure
from dolfinx_signorini.bounds import energy_bound as bounds
from dolfinx_signorini.bounds.flux_parts import least_flux
from dolfinx_signorini.bounds.frames import cell_frames
from dolfinx_signorini.bounds.transport import transported


@pytest.mark.parametrize("reaction", [1e-12, 1e-4, 1.0, 1e6])
def test_reactions_take_up_the_rest_at_nearly_the_least_price(reaction):
    """The price, of flows over facets and of what reactions take up, against a dense solve."""
    generator = np.random.default_rng(5)
    domain = mesh.create_unit_square(MPI.COMM_SELF, 8, 8)
    frames = cell_frames(domain)
    count, sides = frames.facets.shape
    wanted, sinks = generator.standard_normal(count), reaction * frames.volumes
    wanted -= wanted.mean()  # so that reactions have to take up next to nothing
    none, lowest = np.zeros((count, sides), dtype=bool), np.ones(count)
    fluxes, exact = transported(domain.comm, frames, lowest, wanted, none, sinks)
    assert exact
    price, dense = ((wanted - fluxes.sum(axis=1)) ** 2 / sinks).sum(), np.diag(sinks)
    resistance = frames.volumes[:, None] / frames.facet_sizes**2
    for facet in np.unique(frames.facets):
        (one, *other), place = np.nonzero(frames.facets == facet)
        if not other:
            assert fluxes[one, place[0]] == 0.0
            continue
        (two,) = other
        flow, back = fluxes[[one, two], place]
        assert flow == pytest.approx(-back, rel=1e-9, abs=1e-12)
        ease = 1.0 / resistance[[one, two], place].sum()
        price += flow**2 / ease
        dense[[one, two], [one, two]] += ease
        dense[[one, two], [two, one]] -= ease
    least = wanted @ np.linalg.solve(dense, wanted)
    assert least * (1.0 - 1e-3) <= price <= 1.02 * least


@pytest.mark.parametrize("left", [0.0, 1e-6, 1e-3, 1.0])
@pytest.mark.parametrize("degree", [1, 2])
def test_what_reactions_alone_take_up_makes_no_bound_larger(left, degree, monkeypatch):
    """The bound of a solution with an algebraic error, beside the one with all of it carried."""
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 12, 12)
    space, x = fem.functionspace(domain, ("Lagrange", degree)), ufl.SpatialCoordinate(domain)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    load = 40.0 * (0.35 - x[0] + 0.2 * x[1]) * v * ufl.dx
    problem = SignoriniProblem(a, load, contact=boundary_facets(domain), obstacle=0.0)
    problem.solve()
    error = fem.Function(space)
    error.interpolate(lambda x: left * np.cos(9.0 * x[0]) ** 2)
    problem.u.x.array[:] += error.x.array
    carried = []

    def counted(*args):
        carried.append(True)
        return transported(*args)

    def noted(*args):
        least.append(least_flux(*args))
        return least[0]

    least = []
    monkeypatch.setattr(cell_pressure, "transported", counted)
    monkeypatch.setattr(bounds, "least_flux", noted)
    bound = bounds.energy_bound(problem)
    assert bool(carried) == (left > 1e-6)
    if not carried:  # so few cells are all looked at
        assert 0.3 * bound.flux < least[0] <= (1.0 + 1e-12) * bound.flux
    monkeypatch.setattr(bounds, "least_flux", lambda *_: 0.0)
    assert bound.total <= (1.0 + 1e-3) * bounds.energy_bound(problem).total
    problem.destroy()
