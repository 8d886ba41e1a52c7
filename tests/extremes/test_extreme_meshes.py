"""Extremes of the mesh: size, shape of the cells, numbering, the smallest and the largest."""

import json
import subprocess
import sys
from pathlib import Path

import basix.ufl
import numpy as np
import pytest
import ufl
from cases import (
    Case,
    attained,
    digits_of,
    humps,
    reach,
    right_or_refused,
    square,
    stretched,
    waves,
    worst,
)
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini import InputError, SignoriniProblem
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.studies.paper.sampling import LINF

TIGHT = 1e-13


def sized(length, scaled=False, domain=None):
    """The model problem on a square of some size, with or without coefficients to match."""
    unit = length**2 if scaled else 1.0
    return Case(
        stretched(square() if domain is None else domain, length),
        1.0,
        1.0 / unit,
        load=lambda x: waves(x / length) / unit,
        obstacle=lambda x: humps(x / length),
    )


def agreement(domain, cases):
    """Solve cases on one mesh, changed in between, and return the digits that they agree in."""
    solutions = []
    for case in cases:
        problem = case.problem()
        solutions.append(problem.solve(rtol=TIGHT).x.array)
        problem.destroy()
    first, second = solutions
    local = np.abs([second - first, first]).max(axis=1, initial=0.0)
    error, size = np.max(domain.comm.allgather(local), axis=0)
    return digits_of(error, size)


@pytest.mark.parametrize("length", [1e-9, 1e9])
@pytest.mark.parametrize("scaled", [True, False])
def test_sizes(length, scaled, record):
    def attempt(size):
        return attained(sized(size, scaled=scaled), rtol=TIGHT)

    digits = attempt(length)
    assert digits >= 12
    sizes = [length**k for k in (1, 3, 6, 10, 14, 16, 17)]
    case = f"square of size {length:g}, " + (
        "u / L^2 and f / L^2 in place of u and f: the u of size 1"
        if scaled
        else "-div(grad u) + u = f as it is"
    )
    record("size", case, "50 digits, N = 4", digits, reach(sizes, attempt, 12))


@pytest.mark.parametrize("length", [1e-9, 1e9])
def test_sizes_are_a_matter_of_units(length, record):
    """The u of the square of size 1, at the same nodes."""
    domain = square()
    digits = agreement(domain, (sized(size, True, domain) for size in (1.0, length)))
    assert digits >= 13
    record("size", f"size {length:g} against size 1", "scaling of the domain", digits)


def test_tiny_domain_that_nothing_holds(record):
    """(u, v) is lost in rounding against (grad u, grad v) when the square has size 1e-9."""
    tiny = Case(
        stretched(square(), 1e-9), load=lambda x: 1.0 + 0 * x[0], obstacle=lambda x: -1.0 + 0 * x[0]
    )
    with pytest.raises(InputError, match="form a vanishes on constants") as caught:
        tiny.problem()
    case = "size 1e-9, a load that pulls off the obstacle: u = 1"
    record("size", case, "an `InputError` that says why", "refused", str(caught.value))


@pytest.mark.parametrize("shift", [1e3, 1e6])
def test_translation(shift, record):
    """Coordinates lose digits far from the origin; the solution loses no more than they do."""
    domain = square()
    digits = agreement(
        domain,
        (
            Case(
                stretched(domain, 1.0, offset),
                load=lambda x, o=offset: waves(x - o),
                obstacle=lambda x, o=offset: humps(x - o),
            )
            for offset in (0.0, shift)
        ),
    )
    assert digits >= 13 - np.log10(shift)
    record("size", f"square of size 1, {shift:g} away from the origin", "translation", digits)


def test_reflection_and_numbering(record):
    """Nodes in any order, cells in any order and orientation, left and right exchanged."""
    comm = MPI.COMM_WORLD
    values = []
    for mirrored in (False, True):
        n = 6
        grid = np.arange(n + 1) / n
        points = np.array([(x, y) for y in grid for x in grid])
        cells = np.array(
            [
                triangle
                for j in range(n)
                for k in range(j * (n + 1), j * (n + 1) + n)
                for triangle in ((k, k + 1, k + n + 2), (k, k + n + 2, k + n + 1))
            ]
        )
        if mirrored:
            order = np.random.default_rng(3).permutation(len(points))
            points = points[order] * (-1.0, 1.0) + (1.0, 0.0)
            cells = np.argsort(order)[cells][::-1, ::-1]
        if comm.rank > 0:
            points, cells = points[:0], cells[:0]
        element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
        domain = mesh.create_mesh(comm, cells, x=points, e=element)
        flip = (lambda x: np.array([1.0 - x[0], x[1]])) if mirrored else (lambda x: x)
        case = Case(
            domain, load=lambda x, f=flip: waves(f(x)), obstacle=lambda x, f=flip: humps(f(x))
        )
        problem = case.problem()
        u = problem.solve(rtol=1e-14)
        owned = problem.space.dofmap.index_map.size_local
        x = flip(problem.space.tabulate_dof_coordinates()[:owned].T)
        problem.destroy()
        found = np.concatenate(
            comm.allgather(np.column_stack((x[0], x[1], u.x.array[:owned])).reshape(-1, 3))
        )
        keys = np.rint(found[:, :2] * n)
        values.append(found[np.lexsort(keys.T), 2])
    digits = digits_of(np.abs(values[0] - values[1]).max(), np.abs(values[0]).max())
    assert digits >= 13
    case = "N = 6, nodes and cells in random order, mirrored, rtol 1e-14"
    record("shape", case, "reflection and permutation", digits)


def flattened(ratio):
    """Cells of ratio : 1 (or 1 : 1/ratio) on a rectangle."""
    return Case(
        stretched(square(), (1.0, ratio)),
        load=lambda x: waves(np.array([x[0], x[1] / ratio])),
        obstacle=lambda x: humps(np.array([x[0], x[1] / ratio])),
    )


@pytest.mark.parametrize("ratio", [1e-3, 1e-6, 1e3, 1e6])
def test_anisotropic_cells(ratio, record):
    digits = attained(flattened(ratio), rtol=TIGHT)
    assert digits >= 12
    case = f"rectangle of 1 x {ratio:g}, 4 x 4 cells"
    record("shape", case, "50 digits", digits)


def test_where_anisotropy_stops(record):
    def attempt(ratio):
        return attained(flattened(ratio), rtol=TIGHT)

    for name, step in (("flat", 0.1), ("long", 10.0)):
        stops = reach([step**k for k in (0, 3, 6, 7, 8, 9, 10, 12, 15, 20, 40)], attempt, 12)
        digits = worst((step**3, step**6), attempt)
        record("shape", f"{name} rectangles, aspect ratio to 1e6", "50 digits", digits, stops)


@pytest.mark.parametrize("ratio", [1e-3, 1e-6])
def test_anisotropic_cells_with_first_order_methods(ratio, record):
    text, stops = right_or_refused(flattened(ratio), "bqnls", 7)
    case = f"rectangle of 1 x {ratio:g}, BQNLS at its default rtol 1e-8"
    record("shape", case, "50 digits", text, stops)


def pinched(height):
    """A node of the square pulled down to a height over the bottom edge: slivers of that height."""
    domain = square()
    x = domain.geometry.x
    x[(np.abs(x[:, 0] - 0.25) < 1e-9) & (np.abs(x[:, 1] - 0.25) < 1e-9), 1] = height
    return Case(domain)


@pytest.mark.parametrize(
    "height,rtol,least", [(1e-3, TIGHT, 12), (1e-6, 1e-10, 9), (1e-9, 1e-8, 7)]
)
def test_slivers(height, rtol, least, record):
    """Rounding in the entries of the matrix, relative to the others', is all that is lost."""
    digits = attained(pinched(height), rtol=rtol)
    assert digits >= least
    heights = [10.0**-k for k in range(2, 16)]
    stops = reach(heights, lambda h: attained(pinched(h), rtol=rtol), least)
    case = f"sliver of height {height:g} on the contact boundary, N = 4, rtol {rtol:g}"
    record("shape", case, "50 digits", digits, stops)


@pytest.mark.parametrize("n", [1, 2])
def test_smallest_meshes(n, record):
    digits = min(attained(Case(square(n)), rtol=1e-14), 16.0)
    assert digits >= 13
    record("cells", f"N = {n}, rtol 1e-14", "50 digits", digits)


@pytest.mark.parametrize("degree", [1, 2])
def test_smallest_meshes_know_constants(degree, record):
    """f = 1 far above the obstacle: u = 1, on two cells, for both degrees."""
    domain = square(1)
    space = fem.functionspace(domain, ("Lagrange", degree))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    one = fem.Constant(domain, 1.0)
    problem = SignoriniProblem(a, one * v * ufl.dx, contact=boundary_facets(domain), obstacle=-9.0)
    values = problem.solve(rtol=TIGHT).x.array
    problem.destroy()
    error = domain.comm.allreduce(np.abs(values - 1.0).max(initial=0.0), op=MPI.MAX)
    digits = digits_of(error, 1.0)
    assert digits >= 13
    record("cells", f"N = 1, degree {degree}, f = 1 and no contact", "u = 1", digits)


@pytest.mark.slow
def test_four_million_unknowns(serial, record):
    """The paper's problem at N = 2001, against the order from the paper's N = 1001."""
    report = json.loads(_run([sys.executable, str(Path(__file__).with_name("largest.py"))]))
    paper = {"L4": 6.0007e-6, LINF: 6.7437e-5, "W1_4": 1.3395e-2}
    rates = {
        name: np.log(value / report["errors"][name]) / np.log(2001 / 1001)
        for name, value in paper.items()
    }
    assert rates["L4"] == pytest.approx(2.0, abs=0.02)
    assert rates[LINF] == pytest.approx(1.5, abs=0.05)
    assert rates["W1_4"] == pytest.approx(1.0, abs=0.01)
    assert report["natural_residual"] <= 1e-7
    orders = ", ".join(f"{name} {rate:.3f}" for name, rate in rates.items())
    record(
        "cells",
        f"N = 2001, {report['unknowns']} unknowns, cascade with rtol 1e-7",
        "order from the paper's errors at N = 1001",
        f"orders {orders}; {report['seconds']:.0f} s with mesh, load and these errors, "
        f"{report['solve']:.1f} s of it the solve; {report['gigabytes']:.1f} GB",
    )


RANKS = 5


def test_more_ranks_than_cells(serial, record):
    """Two cells on five ranks: three have no cell, and some no dof."""
    script = Path(__file__).with_name("few_cells.py")
    output = _run(["mpirun", "-n", RANKS, "--oversubscribe", sys.executable, script])
    report = json.loads(output)
    assert report["empty"] >= RANKS - 2
    assert report["norms"] == pytest.approx(report["known"], rel=1e-13)
    for method, digits in report["digits"].items():
        assert digits >= (13 if method == "cascade" else 7)
        case = f"2 cells on {RANKS} ranks, {report['empty']} of them without a cell, {method}"
        record("ranks", case, "50 digits; norms of u = 1", digits)


def _run(command):
    checkout = Path(__file__).parents[2]
    done = subprocess.run(
        list(map(str, command)), cwd=checkout, capture_output=True, text=True, timeout=500
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout.strip().splitlines()[-1]
