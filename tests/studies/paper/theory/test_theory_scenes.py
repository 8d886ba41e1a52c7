"""The scenes of the theory solve Signorini's problem, with the regularity that they claim."""

import math

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.base import compat
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.orders import eoc
from dolfinx_signorini.studies.paper.theory.boundary import BoundaryCurve, edges_that_meet
from dolfinx_signorini.studies.paper.theory.examples import (
    COMPOSED,
    composed_example,
    paper_example,
    placed_example,
    rough_example,
    sharp_example,
    smooth_example,
)

COMM = MPI.COMM_WORLD
N = 12
SCENES = {
    "paper": paper_example(),
    "smooth": smooth_example(),
    "rough 2.5": rough_example(2.5),
    "rough 3.5": rough_example(3.5),
    "rough 8": rough_example(8.0),
    "placed": placed_example(0.25, 20),
    **{name: composed_example(name) for name in COMPOSED},
    "sharp": sharp_example(3.0, last=4),
}


def largest(values):
    return COMM.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX)


@pytest.mark.parametrize("name", SCENES)
def test_equation_and_gradient(name):
    domain = friedrichs_keller(COMM, N)
    exact = SCENES[name].exact(domain)
    points = np.array([[0.21, 0.13], [0.1, 0.72], [0.55, 0.37]])
    cells = np.arange(domain.topology.index_map(2).size_local, dtype=np.int32)
    # Not on the cells at the detachment point, where second derivatives are not bounded.
    x = domain.geometry.x[domain.geometry.dofmap[cells]]
    cells = cells[(np.hypot(x[:, :, 0] - 0.5, x[:, :, 1]) > 0.06).all(axis=1)]
    gradient = ufl.as_vector(exact.grad)
    defect = ufl.as_vector(
        [-ufl.div(gradient) + exact.u - exact.load, *(ufl.grad(exact.u) - gradient)]
    )
    found = fem.Expression(defect, points, comm=COMM).eval(domain, cells)
    scale = fem.Expression(ufl.as_vector([exact.load]), points, comm=COMM).eval(domain, cells)
    assert largest(found) < 1e-9 * largest(scale)


@pytest.mark.parametrize("name", SCENES)
def test_signorini_conditions(name):
    scene = SCENES[name]
    domain = friedrichs_keller(COMM, 96 if name == "sharp" else N)
    exact = scene.exact(domain)
    curve = BoundaryCurve(fem.functionspace(domain, ("Lagrange", 1)))
    t = np.linspace(0.05, 0.95, 7)
    values = curve.samples([exact.u, *exact.grad], t)
    edges = (np.roll(curve.x, -1, axis=0) - curve.x) / curve.widths[:, None]
    normal = np.column_stack([edges[:, 1], -edges[:, 0]])
    u = values[:, :, 0]
    flux = np.einsum("ikd,id->ik", values[:, :, 1:], normal)
    assert u.min() >= -1e-12
    assert flux.min() >= -1e-12
    assert np.abs(u * flux).max() < 1e-12
    # What the scene says about its contact set: nothing is in contact elsewhere.
    contact = edges_that_meet(curve, scene.contact)
    assert (u[~contact] > 0.0).all()
    inside = contact & np.roll(contact, 1) & np.roll(contact, -1)
    assert np.abs(u[inside]).max(initial=0.0) < 1e-12


@pytest.mark.parametrize("p", [2.5, 3.5])
def test_the_regularity_ends_at_p(p):
    # Like r^{2 - 2/p} on the line through the point: second derivatives like r^{-2/p} are in L^q
    # of the plane for q < p and not for q = p.
    domain = friedrichs_keller(MPI.COMM_SELF, 4)
    exact = rough_example(p).exact(domain)
    space = fem.functionspace(domain, ("DG", 0))
    x = ufl.SpatialCoordinate(domain)
    distances = np.array([1e-3, 1e-4, 1e-5, 1e-6])
    values = []
    for r in distances:
        place = ufl.replace(exact.u, {x: ufl.as_vector([0.5 - r, 1e-12])})
        f = fem.Function(space)
        f.interpolate(fem.Expression(place, compat.interpolation_points(space.element)))
        values.append(f.x.array[0])
    assert np.allclose(eoc(distances, values), 2.0 - 2.0 / p, atol=1e-3)


@pytest.mark.parametrize("p", [2.0, 4.0, 1.5, math.inf])
def test_exponents_that_are_refused(p):
    with pytest.raises(ValueError, match="p: must lie"):
        rough_example(p)


@pytest.mark.parametrize("place", [0.0, 0.25, 0.5, 0.75])
def test_place_in_the_edge(place):
    n = 20
    scene = placed_example(place, n)
    domain = friedrichs_keller(COMM, n)
    curve = BoundaryCurve(fem.functionspace(domain, ("Lagrange", 1)))
    ((x, y),) = scene.singular
    assert y == 0.0
    edge = int(np.searchsorted(curve.s, x + 1e-12) - 1)
    assert (x - curve.s[edge]) / curve.widths[edge] == pytest.approx(place, abs=1e-9)
    u = scene.exact(domain).u
    found = curve.samples([u], np.array([0.0, 0.5, 1.0]))[:, :, 0]
    assert (found[edge + 1] == 0.0).all()
    assert (found[edge - 1, 1] > 0.0).all()


@pytest.mark.parametrize(("place", "n"), [(0.5, 21), (0.5, 10), (1.0, 20), (-0.1, 20)])
def test_places_that_are_refused(place, n):
    with pytest.raises(ValueError, match="place"):
        placed_example(place, n)


def test_the_place_moves_the_error_by_a_factor():
    rows = {}
    for place in (0.0, 0.25):
        rows[place] = []
        for n in (20, 40):
            domain = friedrichs_keller(COMM, n)
            space = fem.functionspace(domain, ("Lagrange", 1))
            exact = placed_example(place, n).exact(domain)
            u = fem.Function(space)
            u.interpolate(fem.Expression(exact.u, compat.interpolation_points(space.element)))
            rows[place].append({"errors": error_norms(u, exact, ["W1_inf"])})
    first, second = (
        b["errors"]["W1_inf"] / a["errors"]["W1_inf"] for a, b in zip(*rows.values(), strict=True)
    )
    # The error is a function of the place times h^{1/2}, so its quotients do not depend on h.
    assert first == pytest.approx(second, rel=0.02)
    assert abs(second - 1.0) > 0.05
