"""Pieces of cells that are cut: their volumes against those of half-spaces, found otherwise."""

import math

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from hypothesis import given
from hypothesis import strategies as st

from dolfinx_signorini.data import parsing
from dolfinx_signorini.data.interfaces import jumps
from dolfinx_signorini.data.interfaces.pieces import cut
from dolfinx_signorini.meshes.quadrature import CELL_RULE

numbers = st.floats(-1.0, 1.0).filter(lambda s: s == 0.0 or abs(s) > 1e-6)


def volumes(pieces):
    return np.abs(np.linalg.det(pieces[:, 1:] - pieces[:, :1])) / math.factorial(
        pieces.shape[1] - 1
    )


def share_below_zero(values):
    """The share of a simplex where a linear function is negative, by divided differences.

    Source: Curry and Schoenberg: the function's values are distributed by a B-spline, whose knots
    are the values at the vertices, which must be distinct here.
    """
    d = len(values) - 1
    below = 0.0
    for k, s in enumerate(values):
        others = [s - t for j, t in enumerate(values) if j != k]
        below += max(-s, 0.0) ** d / math.prod(others) * (-1.0) ** d
    return below


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_shares_of_cut_pieces(dimension):
    rng = np.random.default_rng(7)
    unit = np.vstack((np.zeros(dimension), np.eye(dimension)))
    pieces = unit + 0.2 * rng.uniform(-1.0, 1.0, (200, dimension + 1, dimension))
    values = rng.uniform(-1.0, 1.0, (200, dimension + 1))
    parts, owners = cut(pieces, values)
    # A linear function by its values at the vertices: evaluated in the middles of the parts.
    frames = np.linalg.inv(pieces[:, 1:] - pieces[:, :1])[owners]
    shares = np.einsum("pi,pij->pj", parts.mean(axis=1) - pieces[owners, 0], frames)
    steps = (values[:, 1:] - values[:, :1])[owners]
    at = values[owners, 0] + (shares * steps).sum(axis=1)
    below = np.bincount(owners, volumes(parts) * (at < 0.0)) / volumes(pieces)
    assert below == pytest.approx([share_below_zero(v) for v in values], abs=1e-9)


@given(st.sampled_from([1, 2, 3]).flatmap(lambda d: st.tuples(*[numbers] * (d + 1))))
def test_parts_fill_the_piece_and_have_one_sign(values):
    """Zeros at vertices, and the same values at several vertices, included."""
    d = len(values) - 1
    unit = np.vstack((np.zeros(d), np.eye(d)))[None]
    parts, _ = cut(unit, np.array([values]))
    assert volumes(parts).sum() == pytest.approx(1.0 / math.factorial(d), rel=1e-12)
    shares = np.concatenate((1.0 - parts.sum(axis=2, keepdims=True), parts), axis=2)
    at = shares @ np.array(values)
    assert (np.minimum(at.max(axis=1), -at.min(axis=1)) <= 1e-12).all()


def test_integrals_do_not_feel_the_number_of_ranks(comm, monkeypatch):
    """The limit of pieces is one for all ranks: each rank of many would divide more often."""
    monkeypatch.setattr(jumps, "MOST_PIECES", 150)
    formula = parsing.parse("where((x - 0.4)^2 + (y - 0.53)^2 < 0.11, 2, 0)")
    found = []
    for ranks in (comm, comm.Split(comm.rank)):
        domain = mesh.create_unit_square(ranks, 12, 12)
        f = jumps.integrable(formula, domain, 1)
        form = fem.form(f * ufl.dx(metadata=CELL_RULE.metadata))
        found.append(ranks.allreduce(fem.assemble_scalar(form)))
    assert found[0] == pytest.approx(found[1], rel=1e-13)
    assert abs(found[0] - 0.22 * np.pi) > 1e-9  # the limit is felt


@pytest.mark.parametrize("depth", [0.004, 0.001, 1e-4])
def test_a_curve_between_the_points_of_a_cell_is_seen(depth, comm):
    """The top of a circle enters a cell between a vertex and the middle of an edge."""
    domain = mesh.create_unit_square(comm, 4, 4)
    x, y, r = 0.3125, 0.75 + depth - 0.26, 0.26
    formula = parsing.parse(f"where((x - {x!r})^2 + (y - {y!r})^2 < {r * r!r}, 1, 0)")
    form = fem.form(jumps.integrable(formula, domain, 1) * ufl.dx(metadata=CELL_RULE.metadata))
    found = comm.allreduce(fem.assemble_scalar(form))
    assert found == pytest.approx(np.pi * r * r, rel=1e-7)
