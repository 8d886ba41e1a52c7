"""Fluxes that carry what is left in cells to reactions at the least price."""

import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI

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
