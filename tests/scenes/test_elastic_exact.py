"""Scenes of elastic bodies against closed forms on curved sides: Hertz's and Lame's solutions."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from dolfinx_signorini.scenes import solve_scene
from dolfinx_signorini.scenes.output.pictures import scene_boundaries
from dolfinx_signorini.scenes.output.summary import summarise

sys.path.append(str(Path(__file__).parents[1] / "problem"))
import hertz

COMM = MPI.COMM_WORLD
pytest.importorskip("gmsh")

# The block of demos/hertz.py: E = 200, nu = 0.3, R = 8, F = 10 in plane strain.
FORCE, HALF_WIDTH, PEAK = 10.0, 0.680778, 9.351351
HERTZ = "rtol = 1e-10" + hertz.SCENE.replace("[define]", "width = {width}\n[define]")


def figures(width, parse):
    result = solve_scene(parse(HERTZ.format(width=width)), COMM)
    summary = summarise(result, scene_boundaries(result))
    result.destroy()
    return summary


def test_hertz(parse):
    """Force, largest pressure and half-width: the Dirichlet data are those of the half-plane."""
    coarse, fine = (figures(width, parse) for width in (0.16, 0.08))
    for summary, tolerance in ((coarse, 1e-2), (fine, 2e-3)):
        x, y = summary.forces["contact"]
        assert y == pytest.approx(FORCE, rel=tolerance) and abs(x) <= 1e-6 * FORCE
        assert summary.body["largest pressure"] == pytest.approx(PEAK, rel=2.0 * tolerance)
    assert fine.contact_size == pytest.approx(2.0 * HALF_WIDTH, abs=2.0 * 0.08)
    # Below the contact the von Mises stress is about 0.56 p0, and nowhere larger (Johnson, 4.2).
    assert fine.body["largest von Mises stress"] == pytest.approx(0.557 * PEAK, rel=0.03)


# A quarter of a tube in a rigid, round hole, blown up by a pressure inside.
INNER, OUTER, GAP, PRESSURE, YOUNG, POISSON = 0.5, 1.0, 0.002, 2.0, 100.0, 0.3


def tube(count):
    """A polygon whose arcs have so many edges: inner ones first, then a cut, outer ones, a cut."""
    angles = np.linspace(0.0, np.pi / 2.0, count + 1)
    circle = np.column_stack((np.cos(angles), np.sin(angles)))
    vertices = np.concatenate((INNER * circle[::-1], OUTER * circle))
    inner, outer = list(range(1, count + 1)), list(range(count + 2, 2 * count + 2))
    return f"""
    rtol = 1e-10
    [domain]
    shape = "polygon"
    vertices = {json.dumps(vertices.tolist())}
    width = {0.8 / count}
    [elasticity]
    young = {YOUNG}
    poisson = {POISSON}
    [contact]
    sides = {outer}
    gap = {GAP}
    [[traction]]
    sides = {inner}
    pressure = {PRESSURE}
    [[dirichlet]]
    sides = {count + 1}
    components = "y"
    value = 0
    [[dirichlet]]
    sides = {2 * count + 2}
    components = "x"
    value = 0
    """


def lame():
    """The pressure outside, and the von Mises stress inside, by Lame's solution in plane strain."""
    a2, b2 = INNER**2, OUTER**2
    factor = (1.0 + POISSON) / YOUNG / (b2 - a2)

    def moved(q):  # of the outer side
        through = (1.0 - 2.0 * POISSON) * (PRESSURE * a2 - q * b2) * OUTER
        return factor * (through + (PRESSURE - q) * a2 * b2 / OUTER)

    q = (moved(0.0) - GAP) / (moved(0.0) - moved(1.0))
    mean = (PRESSURE * a2 - q * b2) / (b2 - a2)
    spread = (PRESSURE - q) * b2 / (b2 - a2)  # at the inner side
    radial, hoop, along = mean - spread, mean + spread, 2.0 * POISSON * mean
    parts = (radial - hoop) ** 2 + (hoop - along) ** 2 + (along - radial) ** 2
    return q, np.sqrt(0.5 * parts)


def test_a_tube_in_a_hole_has_the_pressure_of_lame(parse):
    """Contact along the normals of a round side, whose directions are averages at the vertices."""
    q, mises = lame()
    assert 0.3 < q < PRESSURE
    errors = []
    for count in (6, 12):
        result = solve_scene(parse(tube(count)), COMM)
        boundary = scene_boundaries(result)[0]
        summary = summarise(result, [boundary])
        result.destroy()
        x, y = summary.forces["contact"]
        assert x == pytest.approx(y, rel=1e-2)
        errors.append(abs(y / -q - 1.0))  # times the outer radius
        assert summary.contact_size == pytest.approx(np.pi / 2.0, rel=1e-2)
        assert summary.imbalance <= 1e-8
        x, y = summary.forces["traction"]
        assert (x, y) == pytest.approx((PRESSURE * INNER, PRESSURE * INNER), rel=1e-9)
        assert summary.body["largest von Mises stress"] == pytest.approx(mises, rel=0.6 / count)
    assert errors[1] <= 0.35 * errors[0] and errors[1] <= 6e-3
