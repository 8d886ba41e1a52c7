"""Norms: known values, exact scaling, the inequalities that norms obey, no overflow, no NaN."""

import itertools
import math

import basix
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from hypothesis import given
from hypothesis import strategies as st
from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.quadrature import QuadratureRule
from dolfinx_signorini.norms import controlled
from dolfinx_signorini.norms import error_norms as norms_module
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.names import Norm, parse_norm
from dolfinx_signorini.norms.pointwise import ErrorAtPoints
from dolfinx_signorini.norms.references import Reference, carried, discrete, interpolant
from dolfinx_signorini.studies.paper.solution import PAPER_RULE, christof_haubner

EXACT = QuadratureRule("default", 12)
VOLUME = ("L1", "L2", "L3", "L4", "L16", "Linf", "W1_1", "W1_2", "W1_4", "W1_16", "W1_inf")
BOUNDARY = ("L1_boundary", "L2_boundary", "L7_boundary", "Linf_boundary", "H1_boundary")
ALL = (*VOLUME, *BOUNDARY, "H1_2_boundary", "H1_2_boundary_spectral")


def field(values, degree=2, n=5):
    """A function on the unit square; `values` maps coordinates to values."""
    space = fem.functionspace(friedrichs_keller(MPI.COMM_WORLD, n), ("Lagrange", degree))
    function = fem.Function(space)
    function.interpolate(values)
    return function


def waves(coefficients, degree=1, n=6):
    """A sum of cosines: any coefficients, the same function on any number of ranks."""

    def values(x):
        modes = [(1, 0), (0, 1), (2, 1), (3, 4), (7, 2)]
        return sum(
            c * np.cos(np.pi * (k * x[0] + m * x[1]) + i)
            for i, (c, (k, m)) in enumerate(zip(coefficients, modes, strict=True))
        )

    return field(values, degree, n)


amplitudes = st.lists(st.floats(-1.0, 1.0).map(lambda c: round(c, 3)), min_size=5, max_size=5)


@pytest.mark.parametrize("value", [2.0, -0.375])
def test_constants(value):
    norms = error_norms(field(lambda x: 0 * x[0] + value), None, ALL)
    for name, norm in norms.items():
        p = parse_norm(name).p
        length = 4.0 if "boundary" in name else 1.0
        measure = 1.0 if math.isinf(p) else length ** (1.0 / p)
        assert norm == pytest.approx(abs(value) * measure, rel=1e-12), name


def test_polynomials_with_known_norms():
    square = field(lambda x: x[0] ** 2)
    norms = error_norms(
        square, None, ("L1", "L4", "H1", "Linf", "L2_boundary", "H1_boundary"), EXACT
    )
    assert norms["L1"] == pytest.approx(1 / 3, rel=1e-13)
    assert norms["L4"] == pytest.approx((1 / 9) ** (1 / 4), rel=1e-13)
    assert norms["H1"] == pytest.approx(math.sqrt(1 / 5 + 4 / 3), rel=1e-13)
    assert norms["Linf"] == pytest.approx(1.0, rel=1e-14)
    assert norms["L2_boundary"] == pytest.approx(math.sqrt(2 / 5 + 1), rel=1e-13)
    # Tangential derivatives: 2 x on two sides, none on the other two.
    assert norms["H1_boundary"] == pytest.approx(math.sqrt(7 / 5 + 8 / 3), rel=1e-13)
    # Componentwise, not the length of the gradient: |3|^4 + |4|^4, not 5^4.
    plane = field(lambda x: 3 * x[0] + 4 * x[1])
    norms = error_norms(plane, None, ("L4", "W1_4", "W1_inf"), EXACT)
    assert norms["W1_4"] == pytest.approx((norms["L4"] ** 4 + 3**4 + 4**4) ** 0.25, rel=1e-13)
    assert norms["W1_inf"] == pytest.approx(7.0, rel=1e-13)  # the value at (1, 1)


def test_boundary_estimate_is_the_geometric_mean():
    function = field(lambda x: x[0] ** 2 * x[1])
    norms = error_norms(
        function, None, ("L2_boundary", "H1_boundary", "H1_2_boundary", "W1_2_boundary")
    )
    mean = math.sqrt(norms["L2_boundary"] * norms["H1_boundary"])
    assert norms["H1_2_boundary"] == pytest.approx(mean, rel=1e-14)
    assert norms["W1_2_boundary"] == norms["H1_boundary"]


def test_error_against_a_closed_form_with_and_without_support():
    # u_h = x against u = x^2: the same as the norms of x - x^2.
    line = field(lambda x: x[0])
    domain = line.function_space.mesh
    x = ufl.SpatialCoordinate(domain)
    exact = Reference(domain, x[0] ** 2, (2 * x[0], 0 * x[0]))
    names = (*VOLUME, *BOUNDARY, "H1_2_boundary", "H1_2_boundary_spectral")
    have = error_norms(line, exact, names, EXACT)
    want = error_norms(field(lambda x: x[0] - x[0] ** 2), None, names, EXACT)
    for name in names:
        assert have[name] == pytest.approx(want[name], rel=1e-9 if "inf" in name else 1e-12), name
    # A support only saves work: the whole domain as support changes nothing.
    paper = christof_haubner(domain)
    everywhere = Reference(domain, paper.u, paper.grad)
    have, want = (error_norms(line, e, ALL) for e in (paper, everywhere))
    for name in ALL:
        assert have[name] == pytest.approx(want[name], rel=1e-9 if "inf" in name else 1e-13), name


@given(amplitudes, st.integers(-450, 450))
def test_scaling_by_powers_of_two_is_exact(coefficients, k):
    function = waves(coefficients)
    before = error_norms(function, None, ALL)
    function.x.array[:] *= 2.0**k
    after = error_norms(function, None, ALL)
    for name in ALL:
        if parse_norm(name).derivatives == 0.5:
            # The root of 2^k times the root of 2^k rounds for odd k, and so does the Fourier
            # transform, which depends on where its array lies in memory.
            assert after[name] == pytest.approx(2.0**k * before[name], rel=1e-14, abs=0.0)
        else:
            assert after[name] == 2.0**k * before[name], name


@given(amplitudes)
def test_norms_on_a_unit_square_grow_with_p(coefficients):
    names = [f"L{p}" for p in (1, 1.5, 2, 3, 4, 7, 16, 100, 1000)]
    norms = error_norms(waves(coefficients), None, names)
    values = [norms[name] for name in names]
    assert all(a <= b * (1 + 1e-13) for a, b in itertools.pairwise(values))


@given(amplitudes, amplitudes, st.sampled_from(ALL))
def test_triangle_inequality_and_homogeneity(first, second, name):
    if name == "H1_2_boundary":  # the interpolation estimate is no norm
        name = "L2"
    u, v = waves(first), waves(second)
    total = waves([a + b for a, b in zip(first, second, strict=True)])
    u_norm, v_norm, sum_norm = (error_norms(w, None, [name])[name] for w in (u, v, total))
    assert sum_norm <= (u_norm + v_norm) * (1 + 1e-12) + 1e-300
    u.x.array[:] *= -3.0
    assert error_norms(u, None, [name])[name] == pytest.approx(3 * u_norm, rel=1e-13, abs=0.0)


@given(amplitudes)
def test_p_1000_lies_between_its_bounds_next_to_p_inf(coefficients):
    n, function = 6, waves(coefficients)
    norms = error_norms(function, None, ("W1_1000", "W1_inf", "L1000", "Linf"))
    _, weights = PAPER_RULE.points(basix.CellType.triangle)
    share = (weights.min() / n**2) ** (1.0 / 1000)  # of one quadrature point
    largest = norms["W1_inf"]
    assert share * largest <= norms["W1_1000"] * (1 + 1e-12)
    assert norms["W1_1000"] <= 3 ** (1 / 1000) * largest * (1 + 1e-12)
    assert norms["L1000"] <= norms["Linf"] * (1 + 1e-12)
    assert norms["L1000"] >= 0.5 * norms["Linf"]


@pytest.mark.parametrize("size", [1e-20, 1e-200, 1e-300, 1e200])
def test_no_p_underflows_or_overflows(size):
    unit = error_norms(waves([1, -0.5, 0.25, 2, 0.1]), None, ("L16", "W1_16", "L1000", "W1_3"))
    small = error_norms(
        waves([c * size for c in (1, -0.5, 0.25, 2, 0.1)]), None, ("L16", "W1_16", "L1000", "W1_3")
    )
    for name, value in unit.items():
        assert small[name] == pytest.approx(size * value, rel=1e-12)
    assert unit["L16"] > 0.1


def test_zero_has_norm_zero():
    assert set(error_norms(field(lambda x: 0 * x[0]), None, ALL).values()) == {0.0}


@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("name", ["L4", "L1", "Linf", "W1_inf", "W1_16", "L2_boundary"])
@pytest.mark.parametrize("corner", [(0.0, 0.0), (0.5, 0.0), (1.0, 1.0)])
def test_not_a_number_is_raised_on_all_ranks(name, value, corner):
    # On one rank only, inside and outside of the support of the exact solution.
    function = field(lambda x: 0 * x[0], degree=1, n=40)
    at = np.abs(function.function_space.tabulate_dof_coordinates()[:, :2] - corner).max(axis=1)
    function.x.array[at < 1e-12] = value
    with pytest.raises(FloatingPointError):
        error_norms(function, christof_haubner(function.function_space.mesh), [name])


def test_not_a_number_is_raised_by_the_spectral_norm():
    function = field(lambda x: 0 * x[0], degree=1, n=4)
    function.x.array[:] = np.nan
    with pytest.raises(FloatingPointError):
        error_norms(function, None, ["H1_2_boundary_spectral"])


@pytest.mark.parametrize(
    "name", ["", "L", "L0", "L0.5", "W2_4", "H2", "Lnan", "l4", "L4 ", "L-4", "L1e400x", "H1_2"]
)
def test_unknown_norms_are_refused_by_name(name):
    with pytest.raises(ValueError, match="norm"):
        parse_norm(name)
    with pytest.raises(ValueError, match="norm"):
        error_norms(field(lambda x: x[0]), None, ["L2", name])


@pytest.mark.parametrize("name", [*ALL, "L2.5", "L1000_boundary", "W1_inf_boundary"])
def test_names_and_norms_are_one_to_one(name):
    norm = parse_norm(name)
    assert parse_norm(str(norm)) == norm
    assert str(norm) == name.replace("H1_boundary", "W1_2_boundary")
    assert Norm(0.0, 4.0) == parse_norm("L4")


def test_the_rule_is_named_and_matters():
    function = field(lambda x: x[0] ** 2)
    centroid = error_norms(function, None, ["L4"], QuadratureRule("default", 1))["L4"]
    assert abs(centroid - (1 / 9) ** 0.25) > 1e-4
    assert str(PAPER_RULE) == "Gauss-Jacobi rule of degree 7"
    assert len(PAPER_RULE.points(basix.CellType.triangle)[1]) == 16


@pytest.mark.parametrize("scheme", ["default", "Gauss-Jacobi"])
def test_rules_are_exact_to_their_degree_in_either_layout(scheme):
    for reverse in (False, True):
        points, weights = QuadratureRule(scheme, 7).points(basix.CellType.triangle, reverse)
        for i in range(8):
            for j in range(8 - i):
                want = math.factorial(i) * math.factorial(j) / math.factorial(i + j + 2)
                assert weights @ (points[:, 0] ** i * points[:, 1] ** j) == pytest.approx(want)


def test_independent_of_the_numbering_of_the_mesh(comm):
    # The same square from a permuted list of vertices and cells, each cell turned at random.
    n = 6
    domain = friedrichs_keller(MPI.COMM_SELF, n)
    rng = np.random.default_rng(7)
    cells = domain.geometry.dofmap.astype(np.int64)
    order = rng.permutation(len(domain.geometry.x))
    points = np.empty((len(order), 2))
    points[order] = domain.geometry.x[:, :2]
    cells = order[cells][rng.permutation(len(cells))]
    cells = np.array([np.roll(cell, rng.integers(3)) for cell in cells])
    cells[::2] = cells[::2, ::-1]
    mine = cells if comm.rank == 0 else np.empty((0, 3), dtype=np.int64)
    mine_points = points if comm.rank == 0 else np.empty((0, 2))
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    shuffled = mesh.create_mesh(comm, mine, x=mine_points, e=element)
    results = []
    for square in (friedrichs_keller(comm, n), shuffled):
        function = fem.Function(fem.functionspace(square, ("Lagrange", 1)))
        function.interpolate(lambda x: np.cos(3 * x[0]) * np.exp(x[1]))
        results.append(error_norms(function, christof_haubner(square), ALL, EXACT))
    for name in ALL:
        rel = 1e-7 if "inf" in name else 1e-11
        assert results[0][name] == pytest.approx(results[1][name], rel=rel), name


KINDS = {
    "triangle": mesh.CellType.triangle,
    "quadrilateral": mesh.CellType.quadrilateral,
    "tetrahedron": mesh.CellType.tetrahedron,
    "hexahedron": mesh.CellType.hexahedron,
}


def lagrange(kind, degree, values, n=3, distort=0.0):
    """A function on the unit square or cube, whose inner vertices may be moved."""
    comm, cell = MPI.COMM_WORLD, KINDS[kind]
    if kind in ("triangle", "quadrilateral"):
        domain = mesh.create_unit_square(comm, n, n, cell_type=cell)
    else:
        domain = mesh.create_unit_cube(comm, n, n, n, cell_type=cell)
    x = domain.geometry.x
    shift = distort * np.sin(np.pi * x[:, 0]) * np.sin(np.pi * x[:, 1])
    if kind in ("tetrahedron", "hexahedron"):
        shift *= np.sin(np.pi * x[:, 2])
    x[:, 0] += shift
    function = fem.Function(fem.functionspace(domain, ("Lagrange", degree)))
    function.interpolate(values)
    return function


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("kind", KINDS)
def test_norms_of_one_on_every_kind_of_cell(kind, degree):
    one = lagrange(kind, degree, lambda x: 1.0 + 0.0 * x[0], n=2, distort=0.05)
    sides = {"triangle": 4.0, "quadrilateral": 4.0, "tetrahedron": 6.0, "hexahedron": 6.0}[kind]
    norms = error_norms(
        one, None, ["L1", "L4", "H1", "Linf", "W1_inf", "L2_boundary", "L1_boundary", "H1_boundary"]
    )
    assert norms["L2_boundary"] == pytest.approx(math.sqrt(sides), rel=1e-13)
    assert norms["H1_boundary"] == pytest.approx(math.sqrt(sides), rel=1e-12)
    assert norms["L1_boundary"] == pytest.approx(sides, rel=1e-13)
    for name in ("L1", "L4", "H1", "Linf", "W1_inf"):
        assert norms[name] == pytest.approx(1.0, rel=1e-11), name


@pytest.mark.parametrize("degree", [3, 4])
@pytest.mark.parametrize("kind", KINDS)
def test_powers_with_known_norms(kind, degree):
    # x^k is in the space on straight cells of every kind.
    k, function = degree, lagrange(kind, degree, lambda x: x[0] ** degree, n=2)
    names = ["L1", "L2", "L4", "H1", "W1_4", "Linf", "W1_inf", "L2_boundary", "H1_boundary"]
    norms = error_norms(function, None, names)
    for p in (1, 2, 4):
        assert norms[f"L{p}"] == pytest.approx((1 / (p * k + 1)) ** (1 / p), rel=1e-11), p
    for p, name in ((2, "H1"), (4, "W1_4")):
        power = 1 / (p * k + 1) + k**p / (p * (k - 1) + 1)
        assert norms[name] == pytest.approx(power ** (1 / p), rel=1e-11), name
    assert norms["Linf"] == pytest.approx(1.0, rel=1e-12)
    assert norms["W1_inf"] == pytest.approx(k, rel=1e-11)
    # The side x = 1, and those on which x runs from 0 to 1: two of the square, four of the cube.
    along = 2 if kind in ("triangle", "quadrilateral") else 4
    square = 1.0 + along / (2 * k + 1)
    assert norms["L2_boundary"] == pytest.approx(math.sqrt(square), rel=1e-11)
    square += along * k**2 / (2 * k - 1)
    assert norms["H1_boundary"] == pytest.approx(math.sqrt(square), rel=1e-11)


@pytest.mark.parametrize("kind", ["quadrilateral", "hexahedron"])
def test_a_linear_function_on_cells_that_are_no_parallelograms(kind):
    function = lagrange(kind, 2, lambda x: 3.0 * x[0] - 4.0 * x[1], distort=0.08)
    norms = error_norms(function, None, ["L2", "W1_4", "W1_inf"])
    assert norms["L2"] == pytest.approx(math.sqrt(9 / 3 + 16 / 3 - 24 / 4), rel=1e-10)
    values = (3**6 + 4**6 - 1) / (12 * 30)  # the integral of (3 x - 4 y)^4
    assert norms["W1_4"] == pytest.approx((values + 3**4 + 4**4) ** 0.25, rel=1e-10)
    assert norms["W1_inf"] == pytest.approx(4.0, rel=1e-11)
    square = lagrange(kind, 2, lambda x: x[0] ** 2)
    assert error_norms(square, None, ["L4"])["L4"] == pytest.approx(9**-0.25, rel=1e-11)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("low", "high"), [(1, 2), (2, 1), (2, 4), (3, 1)])
def test_the_difference_of_discrete_functions_of_two_degrees(kind, low, high):
    one = lagrange(kind, low, lambda x: np.sin(3 * x[0]) * x[1], n=2)
    other = fem.Function(fem.functionspace(one.function_space.mesh, ("Lagrange", high)))
    other.interpolate(lambda x: np.exp(x[0] + x[1]))
    # Both are in the space of the larger degree, and so is their difference.
    larger = fem.functionspace(one.function_space.mesh, ("Lagrange", max(low, high)))
    both = [fem.Function(larger) for _ in range(2)]
    for function, source in zip(both, (one, other), strict=True):
        function.interpolate(source)
    both[0].x.array[:] -= both[1].x.array
    names = ("L2", "L3", "H1", "W1_4", "Linf", "W1_inf", "L2_boundary", "W1_inf_boundary")
    have, want = error_norms(one, discrete(other), names), error_norms(both[0], None, names)
    for name in names:
        assert have[name] == pytest.approx(want[name], rel=1e-9), name


def test_what_no_norm_is_known_of_is_refused():
    scalar = field(lambda x: x[0])
    domain = scalar.function_space.mesh
    names = ["L2", "Linf", "H1_boundary"]
    tensor = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2, 2))))
    curl = fem.Function(fem.functionspace(domain, ("N1curl", 1)))
    prism = mesh.create_unit_cube(MPI.COMM_WORLD, 1, 1, 1, cell_type=mesh.CellType.prism)
    x = ufl.SpatialCoordinate(domain)
    size = Reference(domain, ufl.CellDiameter(domain) * x[0], (x[0], x[1]))
    elsewhere = discrete(field(lambda x: x[0]))
    for name in names:
        for function in (tensor, curl, fem.Function(fem.functionspace(prism, ("Lagrange", 1)))):
            with pytest.raises(InputError):
                error_norms(function, None, [name])
        for exact in (size, elsewhere):
            with pytest.raises(InputError):
                error_norms(scalar, exact, [name])
    cube = lagrange("hexahedron", 1, lambda x: x[0])
    with pytest.raises(InputError, match="plane"):
        error_norms(cube, None, ["H1_2_boundary_spectral"])


SMOOTHNESS = {
    "smooth": lambda x, r: ufl.sin(3.0 * x[0]) * ufl.exp(x[1]),
    "singular": lambda x, r: r**0.3,
    "rough everywhere": lambda x, r: ufl.cos(60.0 * x[0]) * ufl.cos(47.0 * x[1]),
}


@pytest.mark.parametrize("kind", SMOOTHNESS)
def test_on_many_cells_a_smaller_rule_serves_where_it_is_good_enough(kind, monkeypatch):
    domain = friedrichs_keller(MPI.COMM_WORLD, 24)
    x = ufl.SpatialCoordinate(domain)
    u = SMOOTHNESS[kind](x, ufl.sqrt((x[0] - 0.503) ** 2 + (x[1] - 0.2) ** 2))
    exact = Reference(domain, u, tuple(ufl.grad(u)[i] for i in range(2)))
    u_h = interpolant(fem.functionspace(domain, ("Lagrange", 1)), u)
    names = ("L2", "H1", "Linf", "W1_inf") if kind != "singular" else ("L2", "H1", "Linf")
    on_few = error_norms(u_h, exact, names)
    counts = []
    evaluate = ErrorAtPoints.__call__

    def counted(error, points):
        counts.append(points.x[0].size)
        return evaluate(error, points)

    monkeypatch.setattr(norms_module, "MANY", 1)
    monkeypatch.setattr(norms_module, "SAMPLE", 100)
    monkeypatch.setattr(controlled, "FEWEST", 100)
    on_many = error_norms(u_h, exact, names)
    for name in names:
        assert on_many[name] == pytest.approx(on_few[name], rel=1e-3), name
    if kind != "singular":
        fine = error_norms(u_h, exact, ("L2", "H1"), QuadratureRule("Gauss-Jacobi", 21))
        for name, norm in fine.items():
            assert on_many[name] == pytest.approx(norm, rel=2e-3), name
    monkeypatch.setattr(ErrorAtPoints, "__call__", counted)
    assert error_norms(u_h, exact, ["L2"])["L2"] == pytest.approx(on_few["L2"], rel=1e-3)
    points = MPI.COMM_WORLD.allreduce(sum(counts)) / (2 * 24**2)
    assert points > 16.0 if kind == "rough everywhere" else points < 12.0


def test_a_rule_of_forms_alone_is_refused_for_norms():
    function = fem.Function(
        fem.functionspace(friedrichs_keller(MPI.COMM_WORLD, 2), ("Lagrange", 1))
    )
    with pytest.raises(InputError, match="rule: 'vertex' is known in forms only"):
        error_norms(function, None, ["L2"], rule=QuadratureRule("vertex", 1))


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e6])
@pytest.mark.parametrize(("fine", "coarse"), [(32, 7), (7, 32)])
def test_a_reference_reaches_as_far_as_a_mesh_of_a_disc(comm, fine, coarse, size):
    def disc(n):
        domain = mesh.create_rectangle(comm, [[-1, -1], [1, 1]], [n, n])
        x = domain.geometry.x
        radius = np.hypot(*x.T[:2])
        x *= size * (np.abs(x).max(axis=1) / np.where(radius > 0.0, radius, 1.0))[:, None]
        return domain

    def plane(n):
        u = fem.Function(fem.functionspace(disc(n), ("Lagrange", 1)))
        u.interpolate(lambda x: 1.0 + x[0] / size)
        return u

    # Some points of one polygon are outside of the other one; there the function goes on.
    u = plane(coarse)
    error = error_norms(u, carried(plane(fine), u.function_space.mesh), ["Linf"])["Linf"]
    assert error < 1e-9
