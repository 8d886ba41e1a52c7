"""Norms cell by cell, against integrals of polynomials by hand."""

import math

import numpy as np
import pytest
from dolfinx import fem, mesh

from dolfinx_signorini.accuracy.cells import cell_norms, rule_of_powers, volumes
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import owned_cells
from dolfinx_signorini.norms.names import parse_norm
from dolfinx_signorini.norms.power_sums import collected, total


def function(domain, degree, values):
    f = fem.Function(fem.functionspace(domain, ("Lagrange", degree)))
    f.interpolate(values)
    return f


def norm_of(f, name):
    norm = parse_norm(name)
    return total(cell_norms(f, norm), norm.p, f.function_space.mesh.comm)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("L1", 1 / 6),
        ("L2", (1 / 15) ** (1 / 2)),
        ("L4", (1 / 45) ** (1 / 4)),
        ("L8", (1 / 153) ** (1 / 8)),
        ("H1", (1 / 15 + 4 / 9 + 1 / 5) ** (1 / 2)),
        ("W1_4", (1 / 45 + 16 / 25 + 1 / 9) ** (1 / 4)),
        ("Linf", 1.0),
        ("W1_inf", 2.0),
    ],
)
def test_norms_in_the_plane(comm, name, expected):
    f = function(friedrichs_keller(comm, 3), 3, lambda x: x[0] ** 2 * x[1])
    assert norm_of(f, name) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("L2", (1 / 45) ** (1 / 2)),
        ("L4", (1 / 225) ** (1 / 4)),
        ("H1", (1 / 45 + 4 / 27 + 1 / 15 + 1 / 15) ** (1 / 2)),
        ("W1_inf", 2.0),
    ],
)
def test_norms_in_space(comm, name, expected):
    domain = mesh.create_unit_cube(comm, 2, 3, 2)
    f = function(domain, 4, lambda x: x[0] ** 2 * x[1] * x[2])
    assert norm_of(f, name) == pytest.approx(expected, rel=1e-12)


def test_powers_have_positive_weights(comm):
    # Else a sum of powers that are no polynomials may be negative, and its root no number.
    for domain, dim in ((friedrichs_keller(comm, 2), 2), (mesh.create_unit_cube(comm, 2, 2, 2), 3)):
        for degree in range(1, 5):
            element = fem.functionspace(domain, ("Lagrange", degree)).element.basix_element
            for p in (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 8.0):
                points, weights = rule_of_powers(element, p).points(element.cell_type)
                assert (weights > 0.0).all() and (points > 0.0).all()
                assert (points.sum(axis=1) < 1.0).all()
                mean = weights @ points[:, 0] ** degree * math.factorial(dim)
                assert mean == pytest.approx(1.0 / math.comb(degree + dim, dim), rel=1e-12)


def test_each_cell_has_its_own_norm(comm):
    domain = friedrichs_keller(comm, 4)
    f = function(domain, 1, lambda x: x[0])
    x = domain.geometry.x[domain.geometry.dofmap[owned_cells(domain)], 0]
    mean_square = (x**2).sum(axis=1) / 12.0 + x.sum(axis=1) ** 2 / 12.0
    norms = cell_norms(f, parse_norm("L2"))
    assert norms == pytest.approx(np.sqrt(mean_square / 32.0), rel=1e-12)
    assert cell_norms(f, parse_norm("Linf")) == pytest.approx(x.max(axis=1), rel=1e-12)
    assert volumes(domain) == pytest.approx(np.full(len(x), 1.0 / 16.0), rel=1e-12)


def test_a_largest_value_between_the_nodes_is_seen(comm):
    f = function(friedrichs_keller(comm, 1), 2, lambda x: 1.0 - (x[0] - 1.0 / 3.0) ** 2)
    assert 0.995 <= norm_of(f, "Linf") <= 1.0 + 1e-12


@pytest.mark.parametrize("size", [1e-200, 1.0, 1e200])
@pytest.mark.parametrize("name", ["L4", "W1_4", "Linf"])
def test_norms_are_homogeneous(comm, name, size):
    domain = friedrichs_keller(comm, 3)
    f = function(domain, 2, lambda x: x[0] * x[1])
    scaled = function(domain, 2, lambda x: size * x[0] * x[1])
    assert norm_of(scaled, name) == pytest.approx(size * norm_of(f, name), rel=1e-12)


@pytest.mark.parametrize("power", [1.0, 2.0, 4.0, math.inf])
def test_values_of_cells_are_put_together(comm, power):
    values, owners = np.array([3.0, 4.0, 1e-200, 2.0]), np.array([0, 0, 1, 3], dtype=np.int32)
    expected = [np.linalg.norm([3.0, 4.0], power), 1e-200, 0.0, 2.0]
    together = collected(values, owners, 4, power)
    assert together[[0, 2, 3]] == pytest.approx(np.array(expected)[[0, 2, 3]], rel=1e-12)
    everything = np.linalg.norm(np.tile(values, comm.size), power)
    assert total(values, power, comm) == pytest.approx(everything, rel=1e-12)
    assert total(np.zeros(3), power, comm) == 0.0
