"""The H^{1/2} norm on closed curves: eigenfunctions, an independent series, interpolation."""

import math

import basix.ufl
import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from hypothesis import given
from hypothesis import strategies as st
from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.norms.boundary_edges import closed_curves
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.fractional import fractional_norm
from dolfinx_signorini.norms.references import Reference


def arc_length(x):
    """Arc length around the unit square, from the origin counterclockwise, on its boundary."""
    bottom, right, top = x[1] < 1e-12, x[0] > 1 - 1e-12, x[1] > 1 - 1e-12
    return np.where(bottom, x[0], np.where(right, 1 + x[1], np.where(top, 3 - x[0], 4 - x[1])))


def on_square(values, n, degree=1):
    space = fem.functionspace(friedrichs_keller(MPI.COMM_WORLD, n), ("Lagrange", degree))
    function = fem.Function(space)
    function.interpolate(lambda x: values(arc_length(x)))
    return function


@pytest.mark.parametrize("k", [0, 1, 2, 5])
@pytest.mark.parametrize("phase", [0.0, 1.0])
def test_eigenfunctions(k, phase):
    # cos(2 pi k s / L + phase): its norm squared is sqrt(1 + (2 pi k / L)^2) times that in L2.
    length = 4.0
    function = on_square(lambda s: np.cos(2 * np.pi * k * s / length + phase), 32, degree=2)
    mean_square = 0.5 if k else math.cos(phase) ** 2
    want = math.sqrt(length * mean_square * math.sqrt(1 + (2 * np.pi * k / length) ** 2))
    assert fractional_norm(function) == pytest.approx(want, rel=2e-4)


@pytest.mark.parametrize("seed", [1, 2])
def test_against_the_closed_form_of_the_series_of_a_broken_line(seed):
    # The Fourier coefficients of a continuous broken line are those of its slopes' jumps.
    n, length = 8, 4.0
    rng = np.random.default_rng(seed)
    nodal = rng.uniform(-1.0, 1.0, 4 * n)
    s = np.arange(4 * n) / n

    def values(position):
        return nodal[np.rint(position * n).astype(int) % (4 * n)]

    function = on_square(values, n)
    slopes = (np.roll(nodal, -1) - nodal) * n
    jumps = slopes - np.roll(slopes, 1)
    k = np.arange(1, 60_000)
    omega = 2 * np.pi * k / length
    table = np.exp(-2j * np.pi * np.outer(np.arange(4 * n), np.arange(4 * n)) / (4 * n))
    # exp(-i omega_k s_j) has period 4 n in k.
    coefficients = -(jumps @ table)[k % (4 * n)] / (length * omega**2)
    total = nodal.mean() ** 2 + 2 * (np.sqrt(1 + omega**2) * np.abs(coefficients) ** 2).sum()
    assert s[-1] < length
    assert fractional_norm(function) == pytest.approx(math.sqrt(length * total), rel=5e-4)


@given(st.integers(0, 1000))
def test_interpolation_inequality(seed):
    # ||e||_{1/2}^2 <= ||e||_L2 ||e||_H1, by the inequality of Cauchy and Schwarz for the series.
    rng = np.random.default_rng(seed)
    nodal = rng.normal(size=24) * 10.0 ** rng.uniform(-3, 3, size=24)
    function = on_square(lambda s: nodal[np.rint(s * 6).astype(int) % 24], 6)
    norms = error_norms(
        function, None, ("L2_boundary", "H1_boundary", "H1_2_boundary", "H1_2_boundary_spectral")
    )
    assert norms["H1_2_boundary_spectral"] <= norms["H1_2_boundary"] * (1 + 1e-3)
    # And no smaller than the L2 norm.
    assert norms["H1_2_boundary_spectral"] >= norms["L2_boundary"] * (1 - 1e-3)


def test_interpolation_is_sharp_for_one_frequency():
    function = on_square(lambda s: np.cos(np.pi * s), 64, degree=2)
    norms = error_norms(function, None, ("H1_2_boundary", "H1_2_boundary_spectral"))
    assert norms["H1_2_boundary_spectral"] == pytest.approx(norms["H1_2_boundary"], rel=1e-4)


def test_converges_as_the_mesh_of_one_function_is_refined():
    # x (1 - x) on the bottom edge, 0 elsewhere: the P1 interpolants tend to one norm.
    values = [
        fractional_norm(on_square(lambda s: np.where(s < 1, s * (1 - s), 0.0), n))
        for n in (8, 16, 32, 64)
    ]
    steps = np.abs(np.diff(values))
    assert steps[2] < steps[1] / 2 < steps[0] / 4


def test_two_boundary_curves_add_up(comm):
    # A square with a square hole: the function 1 has the length of both curves as norm squared.
    square = friedrichs_keller(comm, 9)
    outside = dolfinx.mesh.locate_entities(
        square,
        2,
        lambda x: (np.abs(x[0] - 0.5) > 1 / 6 - 1e-9) | (np.abs(x[1] - 0.5) > 1 / 6 - 1e-9),
    )
    middle = dolfinx.mesh.compute_midpoints(square, 2, outside)
    outside = outside[np.abs(middle[:, :2] - 0.5).max(axis=1) > 1 / 6]
    domain = dolfinx.mesh.create_submesh(square, 2, outside)[0]
    function = fem.Function(fem.functionspace(domain, ("Lagrange", 1)))
    function.x.array[:] = 1.0
    assert fractional_norm(function) ** 2 == pytest.approx(4 + 4 / 3, rel=1e-12)


def test_edges_are_chained_to_curves():
    # A triangle and a square, edges shuffled, some reversed.
    vertices = np.array([[7, 5], [10, 11], [5, 6], [13, 12], [7, 6], [11, 12], [10, 13]])
    curves = closed_curves(vertices)
    assert sorted(len(curve) for curve in curves) == [3, 4]
    for curve in curves:
        start = [vertices[e, r] for e, r in curve]
        end = [vertices[e, 1 - r] for e, r in curve]
        assert end == start[1:] + start[:1]


@pytest.mark.parametrize(
    "vertices", [[[0, 1], [1, 2]], [[0, 1], [1, 2], [2, 0], [0, 3], [3, 4], [4, 0]]]
)
def test_open_and_crossing_curves_are_refused(vertices):
    with pytest.raises(InputError, match=r"mesh: .*closed curves"):
        closed_curves(np.array(vertices))


def test_the_norm_is_the_same_for_every_numbering_of_the_mesh(comm):
    # An interpolation error, whose high frequencies the samples alias: where they begin matters.
    found = []
    for shared in (MPI.COMM_SELF, comm):
        for order in (1, -1):
            x, cells = np.mgrid[0:1:9j, 0:1:10j].reshape(2, -1).T, []
            for i in range(8):
                for j in range(9):
                    a, b = 10 * i + j, 10 * i + j + 10
                    cells += [(a, b, b + 1), (a, b + 1, a + 1)]
            numbers = np.array(cells, dtype=np.int64)
            if order < 0:
                numbers, x = len(x) - 1 - numbers, x[::-1].copy()
            element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
            if shared.rank:
                numbers, x = numbers[:0], x[:0]
            domain = dolfinx.mesh.create_mesh(shared, numbers, x=x, e=element)
            u = fem.Function(fem.functionspace(domain, ("Lagrange", 1)))
            u.interpolate(lambda x: np.sin(3.0 * x[0]) + x[1] ** 2)
            y = ufl.SpatialCoordinate(domain)
            exact = ufl.sin(3.0 * y[0]) + y[1] ** 2
            gradient = tuple(ufl.grad(exact)[k] for k in range(2))
            found.append(fractional_norm(u, Reference(domain, exact, gradient)))
    assert found == pytest.approx([found[0]] * 4, rel=1e-10)


def test_only_plane_domains(comm):
    cube = dolfinx.mesh.create_unit_cube(comm, 2, 2, 2)
    with pytest.raises(ValueError, match="plane"):
        fractional_norm(fem.Function(fem.functionspace(cube, ("Lagrange", 1))))


def test_quadrilaterals_have_the_norm_of_triangles():
    def function(cell):
        domain = dolfinx.mesh.create_unit_square(MPI.COMM_WORLD, 12, 12, cell)
        result = fem.Function(fem.functionspace(domain, ("Lagrange", 1)))
        result.interpolate(lambda x: np.sin(3.0 * x[0]) * (1.0 + x[1]) - x[1])
        return result

    found = [
        error_norms(function(cell), None, ["H1_2_boundary_spectral"])["H1_2_boundary_spectral"]
        for cell in (dolfinx.mesh.CellType.triangle, dolfinx.mesh.CellType.quadrilateral)
    ]
    assert found[1] == pytest.approx(found[0], rel=1e-10)
