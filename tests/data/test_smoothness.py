"""Whether a formula for the load of a solution is known to have all of the load."""

import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI

from dolfinx_signorini.data.parsing import parse
from dolfinx_signorini.data.smoothness import load_is_a_function

# Where the load has a part on a curve, or at a pole.
KINKED = [
    ("abs(x - 0.37)", "1"),
    ("abs(x - 0.5)", "1"),
    ("y*max(x, 0.37)", "1"),
    ("where(x < 0.4, 0, x - 0.4)", "1"),
    ("hypot(x - 0.5, 2*x - 1)", "1"),
    ("sqrt((x - 0.3)^2)", "1"),
    ("asin(sin(9*x))", "1"),
    ("log(hypot(x - 0.51, y - 0.52))", "1"),
    ("sign(x - 0.3)^2*tanh(1/(y - 0.3))", "1"),
    ("hypot(x - 0.5, y - 0.3)^1.5*sin(1.5*atan2(y - 0.3, x - 0.5))", "1"),
    ("x", "where(x < 0.5, 1, 2)"),
]
SMOOTH = [
    ("sin(x)*exp(y)", "2 + abs(x - 0.4)"),
    ("abs(x + 1)", "where(x < 2, 1, 2)"),
    ("max(x - 0.37, 0)^2 + abs(y - 0.5)^1.5", "1"),
    ("hypot(x - 0.5, y - 0.5)^0.5", "1"),
    ("hypot(x - 0.5, y)^1.5*sin(1.5*atan2(y, x - 0.5))", "1"),
]


@pytest.mark.parametrize(("u", "A"), KINKED + SMOOTH)
def test_what_is_known_of_a_load(u, A):
    domain = mesh.create_unit_square(MPI.COMM_SELF, 4, 4)
    corners = domain.geometry.x[domain.geometry.dofmap][:, :, :2]
    found = load_is_a_function(parse(u), [parse(A)], np.asarray(corners))
    assert found == ((u, A) in SMOOTH)
