"""Operations: one entry is enough for a new one, in text, UFL, enclosures, and derivatives."""

import math

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.data.analytic import discs
from dolfinx_signorini.data.derivatives import Derivative
from dolfinx_signorini.data.enclosures import enclosed_on_simplices
from dolfinx_signorini.data.formulas import evaluated
from dolfinx_signorini.data.intervals import increasing
from dolfinx_signorini.data.operations import FUNCTIONS, OPERATIONS, Operation, applied
from dolfinx_signorini.data.parsing import parse
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller

EXPM1 = Operation(
    math.expm1,
    lambda v, a, da: applied("exp", a) * da,
    ufl=lambda a: ufl.exp(a) - 1.0,
    numpy=np.expm1,
    interval=increasing(np.expm1),
)
CORNERS = np.array([[[0.1, 0.2], [0.6, 0.1], [0.3, 0.5]]])


@pytest.fixture
def formula(monkeypatch):
    monkeypatch.setitem(OPERATIONS, "expm1", EXPM1)
    monkeypatch.setitem(FUNCTIONS, "expm1", EXPM1)
    return parse("2*expm1(x*y) - y")


def test_a_new_operation_has_values(formula):
    assert formula.value((0.3, 0.5)) == pytest.approx(2.0 * math.expm1(0.15) - 0.5)
    domain = friedrichs_keller(MPI.COMM_SELF, 1)
    form = fem.form(formula.ufl(ufl.SpatialCoordinate(domain)) * ufl.dx)
    # The integral of exp(x y) over the square is the sum of 1/(k! (k + 1)^2).
    exact = 2.0 * sum(1.0 / (math.factorial(k) * (k + 1) ** 2) for k in range(1, 20)) - 0.5
    assert fem.assemble_scalar(form) == pytest.approx(exact, rel=1e-3)


def test_a_new_operation_is_enclosed(formula):
    shares = np.random.default_rng(5).dirichlet(np.ones(3), 300)
    values = evaluated(formula.root, shares @ CORNERS[0])
    (low,), (high,) = enclosed_on_simplices(formula, CORNERS)
    assert low <= values.min() and values.max() <= high
    assert high - low < 5.0 * np.ptp(values)
    centre, radius = discs(formula, CORNERS, 2.0)
    assert np.abs(values - centre).max() <= radius[0] < 20.0


def test_a_new_operation_has_derivatives(formula):
    point = np.array([[0.3, 0.5]])
    assert evaluated(Derivative(0)(formula.root), point) == pytest.approx(math.exp(0.15))
