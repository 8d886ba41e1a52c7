"""Forms that are alike are read once, on whatever mesh, and again when a constant has changed."""

import pytest
import ufl
from dolfinx import fem, mesh

from dolfinx_signorini import friedrichs_keller
from dolfinx_signorini.data import readings
from dolfinx_signorini.data.readings import Reading


def load(domain, factor):
    x, v = ufl.SpatialCoordinate(domain), ufl.TestFunction(fem.functionspace(domain, ("P", 2)))
    chosen = fem.Constant(domain, factor) * ufl.conditional(x[0] + x[1] < 0.77, 1.0, x[0])
    return (chosen * v + x[1] * v.dx(0)) * ufl.dx


@pytest.fixture
def read(monkeypatch):
    """The number of expressions that have been read."""
    found = []
    monkeypatch.setattr(readings, "_known", {})
    original = readings.read
    monkeypatch.setattr(readings, "read", lambda *a: found.append(1) or original(*a))
    return found


def values(form):
    """The load and the component of the flux at a point, as sums over the summands."""
    reading = Reading(form)
    return [reading.total(reading.places(0), [k]).value((0.2, 0.3)) for k in (0, 1, 2)]


def test_a_form_is_read_once_on_all_meshes(comm, read):
    found = [values(load(friedrichs_keller(comm, n), 3.0)) for n in (3, 5)]
    assert found == [[pytest.approx(3.0), pytest.approx(0.3), 0.0]] * 2
    assert len(read) == 6  # two summands, three times


def test_a_form_is_read_again_when_a_constant_has_changed(comm, read):
    domain = friedrichs_keller(comm, 3)
    for factor in (3.0, 7.0, 3.0):
        assert values(load(domain, factor))[0] == pytest.approx(factor)
    assert len(read) == 18


def test_numbers_and_other_expressions_are_other_forms(comm, read):
    domain = mesh.create_unit_square(comm, 2, 2)
    v = ufl.TestFunction(fem.functionspace(domain, ("P", 1)))
    x = ufl.SpatialCoordinate(domain)
    for term, value in ((x[0], 0.2), (2.0 * x[0], 0.4), (x[1], 0.3), (2.5 * x[0], 0.5)):
        assert values(term * v * ufl.dx)[0] == pytest.approx(value)
