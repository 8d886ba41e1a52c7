"""Better fluxes at the ends of contact sets, against what fluxes must fulfil."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from energy_cases import Case, detaching, left, sampled_bound, square
from mpi4py import MPI

from dolfinx_signorini.bounds import better_fluxes as module
from dolfinx_signorini.bounds.better_fluxes import improved
from dolfinx_signorini.bounds.condensation import DIRICHLET, INTERIOR, OPEN, CellData
from dolfinx_signorini.bounds.reference_flux import reference_flux
from dolfinx_signorini.meshes.polynomials import polynomials


def changed(monkeypatch, degree, end, comm):
    """The cells at the end of a contact set, with the moments before and after."""
    found = []

    def spy(comm, data, start, reference):
        after = improved(comm, data, start, reference)
        found.append((data, start.copy(), after[0], reference.degree))
        return after

    monkeypatch.setattr(module, "improved", spy)
    bound = bound_for(degree, end, comm)
    return found[0], bound


def bound_for(degree, end, comm):
    """The bound for a solution that detaches in a point."""
    domain = square(comm, 9)
    u = detaching(ufl.SpatialCoordinate(domain), fem.Constant(domain, end))
    case = Case(domain, u, degree, fixed=left)
    return sampled_bound(case.problem, case.terms)


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("end", [0.07, 0.36, 0.47, 0.98])
def test_fluxes_stay_in_equilibrium_and_press(degree, end, monkeypatch, comm):
    (data, before, after, order), _ = changed(monkeypatch, degree, end, comm)
    sums = (after - before)[:, :, 0].sum(axis=1)
    size = max(comm.allgather(float(np.abs(before).max(initial=0.0))))
    change = max(comm.allgather(float(np.abs(after - before).max(initial=0.0))))
    assert np.abs(sums).max(initial=0.0) < 1e-10 * size and change > 1e-4 * size
    # What leaves one cell enters the other one, and elsewhere only boundary fluxes may change.
    data_, before_, after_ = (comm.allgather(part) for part in (data, before, after))
    facets, kinds = (
        np.concatenate([getattr(d, name).ravel() for d in data_]) for name in ("facets", "kinds")
    )
    changes = np.concatenate(
        [(b - a).reshape(-1, order + 1) for a, b in zip(before_, after_, strict=True)]
    )
    total = np.zeros((facets.max() + 1, order + 1))
    np.add.at(total, facets, changes)
    fixed = (kinds == INTERIOR) | ((kinds != DIRICHLET) & (kinds < OPEN))
    assert np.abs(total[facets[fixed]]).max() < 1e-12 * size
    t = np.linspace(0.0, 1.0, 1001)[:, None]
    pressure = after[data.kinds >= OPEN] @ polynomials(1, order, t)
    assert (pressure >= 0.0).all()


def test_cells_that_no_facet_connects_to_a_contact_facet_stay_as_they_are(monkeypatch, comm):
    (data, before, _, order), _ = changed(monkeypatch, 2, 0.47, comm)
    inside = np.flatnonzero((data.kinds == INTERIOR).all(axis=1))[:1]
    some = CellData(*(values[inside] for values in vars(data).values()))
    after, *_ = improved(MPI.COMM_SELF, some, before[inside], reference_flux(2, order))
    assert (after == before[inside]).all()


@pytest.mark.parametrize("degree", [2, 3])
def test_better_fluxes_make_a_better_bound(degree, monkeypatch, comm):
    _, better = changed(monkeypatch, degree, 0.47, comm)
    monkeypatch.setattr(module, "MOST_ENTRIES", {2: 0})
    assert better.total < 0.9 * bound_for(degree, 0.47, comm).total
