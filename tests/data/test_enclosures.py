"""Enclosures of formulas against their values at many points, also next to places of no value."""

import numpy as np
import pytest

from dolfinx_signorini.data.enclosures import (
    enclosed_both_ways,
    enclosed_gradients,
    enclosed_on_simplices,
)
from dolfinx_signorini.data.formulas import evaluated
from dolfinx_signorini.data.parsing import parse

pytestmark = pytest.mark.pure

FORMULAS = [
    "atan2(-x, y)",
    "atan2(-y, x - 0.5)*hypot(x - 0.5, y)^0.5",
    "hypot(x, y)^(2/3)*sin(2/3*atan2(-x, -y))",
    "sin(x - y)/(1.1 + x) + x*x - x",
    "max(x, y)*min(x, 0.5) - abs(x*y)",
    "where(x < y, x^3, y^-0.5) + (1.5 + x)^2.5",
    "tanh(5*x) + atan(1/(x + 0.25)) + sign(y - 0.25)",
    "log(hypot(x, y)) + acos(0.4*x)",
    "where(sqrt(x + y) < 9, 1, 2) + where(acos(x) > -1, 3, y)",
    "where(log(x) - y^0.5 < 7, x, y)",
]


@pytest.mark.parametrize("text", FORMULAS)
def test_all_values_are_inside(text):
    formula, rng = parse(text), np.random.default_rng(3)
    corners = 0.25 * rng.integers(-4, 5, size=(400, 3, 2))  # many on axes and at singular points
    edges = corners[:, 1:] - corners[:, :1]
    corners = corners[np.abs(np.linalg.det(edges)) > 0.0]
    shares = rng.dirichlet([0.4, 0.4, 0.4], size=200)
    points = np.einsum("qv,nvd->nqd", shares, corners)
    values = evaluated(formula.root, points)
    tiny = 1e-12 * (1.0 + np.abs(values))
    low, high = enclosed_on_simplices(formula, corners)[:, :, None]
    below, above = np.einsum("qv,evn->enq", shares, enclosed_both_ways(formula, corners)[1])
    known = np.isfinite(values)
    for ends in ((low, high), (below, above)):
        assert not (known & ((values < ends[0] - tiny) | (values > ends[1] + tiny))).any()
    # Differences of values are those of points times slopes.
    change, way = values[:, 1:] - values[:, :1], points[:, 1:] - points[:, :1]
    terms = enclosed_gradients(formula, corners)[:, :, None] * way
    known = np.isfinite(change)
    assert not (known & (change < terms.min(axis=0).sum(axis=2) - 1e-9)).any()
    assert not (known & (change > terms.max(axis=0).sum(axis=2) + 1e-9)).any()
