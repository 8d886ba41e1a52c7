"""Comparisons in formulas, at equality too."""

import operator

import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.data.parsing import parse
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller

COMPARISONS = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}


@pytest.mark.parametrize("sign", COMPARISONS)
@pytest.mark.parametrize(("a", "b"), [(1, 2), (2, 2), (2, 1)])
def test_comparisons_are_those_of_python(sign, a, b):
    expected = 5.0 if COMPARISONS[sign](a, b) else 7.0
    domain = friedrichs_keller(MPI.COMM_SELF, 1)
    formula = parse(f"where({a} + 0*x {sign} {b}, 5, 7)")
    value = formula.ufl(ufl.SpatialCoordinate(domain))
    form = fem.form(value * ufl.dx(domain, metadata={"quadrature_degree": 0}))
    assert fem.assemble_scalar(form) == pytest.approx(expected)
