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
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, owned_cells

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


DISC = "(x - 0.4)^2 + (y - 0.53)^2"


@pytest.mark.parametrize(("power", "share"), [(1, 0.6), (2, 0.1), (3, 0.1)])
def test_a_smoother_kink_asks_for_fewer_pieces(power, share, comm):
    """The integral of max(s - r^2, 0)^m over a disc is pi s^(m + 1) / (m + 1)."""
    domain, s = mesh.create_unit_square(comm, 8, 8), 0.11
    jump, kink = (
        parsing.parse(text)
        for text in (f"where({DISC} < {s}, 2, 0)", f"max({s} - ({DISC}), 0)^{power}")
    )
    counts = [comm.allreduce(len(jumps.cut_cells([f], domain, 2)[0])) for f in (jump, kink)]
    assert counts[1] < share * counts[0]
    form = fem.form(jumps.integrable(kink, domain, 2) * ufl.dx(metadata=CELL_RULE.metadata))
    found = comm.allreduce(fem.assemble_scalar(form))
    assert found == pytest.approx(np.pi * s ** (power + 1) / (power + 1), rel=5e-6)


def test_cells_that_no_jump_cuts_have_no_pieces(comm):
    """The part of the mesh far from the jump is refined: no pieces more, and the same integral."""
    formula = parsing.parse("where((x - 0.2)^2 + (y - 0.25)^2 < 0.017, 2, 0)")
    sided, found = SidedMesh(mesh.create_unit_square(comm, 10, 10), {}), []
    for _ in range(3):
        form = fem.form(jumps.integrable(formula, sided.mesh, 2) * ufl.dx(degree=4))
        total = comm.allreduce(fem.assemble_scalar(form))
        pieces, _ = jumps.cut_cells([formula], sided.mesh, 2)
        found.append((comm.allreduce(len(pieces)), pytest.approx(total, rel=1e-12)))
        corners = sided.mesh.geometry.x[sided.mesh.geometry.dofmap[owned_cells(sided.mesh)]]
        far = np.flatnonzero(corners.min(axis=1)[:, :2].max(axis=1) > 0.7)
        sided = refined(sided, far.astype(np.int32)).sided
    assert found[1:] == found[:1] * 2
    assert found[0] == (found[0][0], pytest.approx(2.0 * 0.017 * np.pi, rel=1e-6))


@pytest.mark.parametrize(("text", "power", "most"), [("{r}^4/{r}", 3, 8), ("{r}^-0.8", -0.8, 40)])
def test_a_pole_is_divided_as_far_as_the_integral_asks(text, power, most, comm, monkeypatch):
    """As div(r^n (x, y)) = (n + 2) r^n, integrals of r^n are integrals over the boundary."""
    a, b = 0.4, 0.61
    formula = parsing.parse(text.format(r=f"hypot(x - {a}, y - {b})"))
    looks, near = [], jumps.Projection._near
    monkeypatch.setattr(jumps.Projection, "_near", lambda *args: looks.append(1) or near(*args))
    domain = mesh.create_unit_square(comm, 4, 4)
    form = fem.form(jumps.integrable(formula, domain, 2) * ufl.dx(metadata=CELL_RULE.metadata))
    found = comm.allreduce(fem.assemble_scalar(form))
    t, weights = np.polynomial.legendre.leggauss(200)
    t, exact = 0.5 * (t + 1.0), 0.0
    for away, along in ((a, b), (1.0 - a, b), (b, a), (1.0 - b, a)):
        exact += 0.5 * away * weights @ np.hypot(away, t - along) ** power / (power + 2.0)
    assert found == pytest.approx(exact, rel=3e-5)
    assert len(looks) <= most
