"""Norms without a given rule are right to 1e-3, for every element, degree and exponent.

The truth is a dense composite rule in NumPy, with maps and derivatives of its own, or an integral
in polar coordinates.
"""

import math

import basix
import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI
from scipy.integrate import dblquad, quad

from dolfinx_signorini.norms import controlled
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.pointwise import ErrorAtPoints
from dolfinx_signorini.norms.references import Reference

COMM = MPI.COMM_WORLD
RIGHT = 1e-3
PLANE, SOLID = ("triangle", "quadrilateral"), ("tetrahedron", "hexahedron")
EXPONENTS = (1, 1.5, 2, 3, 4, 16)
CHUNK = 40_000  # points of the composite rule that are held at a time


class Wave:
    """A sum of sines and its gradient, for NumPy and for UFL."""

    def __init__(self, dim, seed, frequency):
        rng = np.random.default_rng(seed)
        self.k = frequency * rng.uniform(-1.0, 1.0, (3, dim))
        self.at, self.size = rng.uniform(0.0, 6.0, 3), rng.uniform(0.5, 1.0, 3)

    def phases(self, x):
        pairs = zip(self.k, self.at, strict=True)
        return [a + sum(k * c for k, c in zip(ks, x, strict=False)) for ks, a in pairs]

    def __call__(self, x, sin=np.sin):
        return sum(s * sin(phase) for s, phase in zip(self.size, self.phases(x), strict=True))

    def gradient(self, x, cos=np.cos):
        slopes = [s * cos(phase) for s, phase in zip(self.size, self.phases(x), strict=True)]
        return [sum(k * slope for k, slope in zip(ks, slopes, strict=True)) for ks in self.k.T]

    def reference(self, domain):
        x = ufl.SpatialCoordinate(domain)
        x = [x[i] for i in range(domain.geometry.dim)]
        return Reference(domain, self(x, ufl.sin), tuple(self.gradient(x, ufl.cos)))


def box(kind, n, comm=COMM):
    """Distorted cells of the unit square or cube."""
    cell = mesh.CellType[kind]
    if kind in PLANE:
        domain = mesh.create_unit_square(comm, n, n, cell)
    else:
        domain = mesh.create_unit_cube(comm, n, 1, 1, cell)
    x = domain.geometry.x
    x[:, 0] += 0.15 / n * np.sin(3.0 * x[:, 0] + 2.0 * x[:, 1]) * x[:, 1]
    x[:, 1] += 0.1 / n * np.cos(4.0 * x[:, 0])
    return domain


def approximation(wave, domain, degree, variant="gll_warped", noise=0.0):
    """The interpolant of a wave, with noise: a solution is no interpolant."""
    element = basix.ufl.element(
        "Lagrange",
        domain.topology.cell_name(),
        degree,
        lagrange_variant=basix.LagrangeVariant[variant],
    )
    u_h = fem.Function(fem.functionspace(domain, element))
    u_h.interpolate(wave)
    local = np.arange(len(u_h.x.array), dtype=np.int32)
    numbers = u_h.function_space.dofmap.index_map.local_to_global(local)
    u_h.x.array[:] += noise * np.sin(1e3 * numbers)
    return u_h


def composite(cell, pieces, points):
    """A rule on a reference cell: Gauss points in boxes, which are collapsed to simplices."""
    gauss, weights = np.polynomial.legendre.leggauss(points)
    line = ((np.arange(pieces)[:, None] + 0.5 + 0.5 * gauss) / pieces).ravel()
    weights = np.tile(0.5 * weights, pieces) / pieces
    corners, dim = basix.geometry(cell).shape
    x = np.stack(np.meshgrid(*[line] * dim, indexing="ij"), -1).reshape(-1, dim)
    w = math.prod(np.meshgrid(*[weights] * dim, indexing="ij")).ravel()
    left = np.ones(len(x))
    for i in range(dim if corners == dim + 1 else 0):
        x[:, i] *= left
        w *= left if i else 1.0
        left = left - x[:, i]
    return x, w


def cells_and_facets(domain, boundary):
    """Kinds of places: the origin and the axes in the reference cell, and the cells."""
    dim, cell = domain.topology.dim, basix.CellType[domain.topology.cell_name()]
    if not boundary:
        return [
            (np.zeros(dim), np.eye(dim), range(domain.topology.index_map(dim).size_local), cell)
        ]
    for pair in ((dim - 1, dim), (dim, dim - 1)):
        domain.topology.create_connectivity(*pair)
    facets, found = domain.topology.connectivity(dim, dim - 1), []
    outer = mesh.exterior_facet_indices(domain.topology)
    own = range(domain.topology.index_map(dim).size_local)
    for number, vertices in enumerate(basix.topology(cell)[dim - 1]):
        at = np.asarray(basix.geometry(cell))[vertices]
        cells = [c for c in own if facets.links(c)[number] in outer]
        kind = basix.cell.subentity_types(cell)[dim - 1][number]
        found.append((at[0], at[1:dim] - at[0], cells, kind))
    return found


def errors_at(u_h, wave, cell, points, axes, tables):
    """The error, its derivatives along the place, and the density of the place at points."""
    domain, dim = u_h.function_space.mesh, u_h.function_space.mesh.topology.dim
    nodes = domain.geometry.x[domain.geometry.dofmap[cell]][:, :dim]
    values = u_h.x.array[u_h.function_space.dofmap.list[cell]]
    maps, basis = tables
    # One Jacobian serves all points of a cell with a linear map.
    x, slopes_of_maps = (maps[0] @ nodes).T, maps[1:, :1] if len(nodes) == dim + 1 else maps[1:]
    jacobian = np.einsum("rqa,ad->qdr", slopes_of_maps, nodes)
    slopes = np.einsum("rq,qrd->qd", basis[1:] @ values, np.linalg.inv(jacobian))
    slopes -= np.stack(wave.gradient(x), -1)
    tangents = jacobian @ axes.T
    gram = np.swapaxes(tangents, 1, 2) @ tangents
    density = np.sqrt(np.linalg.det(gram))
    if len(axes) < dim:
        tangential = np.linalg.inv(gram) @ np.swapaxes(tangents, 1, 2)
        slopes = np.einsum("qdt,qt->qd", tangents, np.einsum("qtd,qd->qt", tangential, slopes))
    return [basis[0] @ values - wave(x), *slopes.T], density


def truth(u_h, wave, boundary, p, per_side):
    """The L^p and the W^{1,p} norm of u_h - wave from about so many points along each side.

    Powers without kinks take half of them.
    """
    element, domain = u_h.function_space.element.basix_element, u_h.function_space.mesh
    linear = basix.create_element(basix.ElementFamily.P, element.cell_type, 1)
    smooth, sums = p % 2 == 0, np.zeros(2)
    pieces, count = (-(-per_side // 32), 16) if smooth else (-(-per_side // 4), 4)
    for origin, axes, cells, kind in cells_and_facets(domain, boundary):
        points, weights = composite(kind, pieces, count)
        points = np.ascontiguousarray(origin + points @ axes)
        for start in range(0, len(points), CHUNK):
            part = slice(start, start + CHUNK)
            tables = [e.tabulate(1, points[part])[..., 0] for e in (linear, element)]
            for cell in cells:
                errors, density = errors_at(u_h, wave, cell, points[part], axes, tables)
                powers = [np.abs(e) ** p @ (density * weights[part]) for e in errors]
                sums += powers[0], sum(powers)
    return COMM.allreduce(sums) ** (1.0 / p)


def compared(u_h, wave, p, boundary, per_side):
    """How far off both norms are, relative to the truth."""
    end = "_boundary" if boundary else ""
    names = [f"L{p}{end}", f"W1_{p}{end}"]
    found = error_norms(u_h, wave.reference(u_h.function_space.mesh), names)
    want = truth(u_h, wave, boundary, p, per_side)
    return {name: found[name] / w - 1.0 for name, w in zip(names, want, strict=True)}


@pytest.mark.parametrize("cell", [basix.CellType[kind] for kind in (*PLANE, *SOLID)])
def test_the_composite_rule_is_one(cell):
    x, w = composite(cell, 3, 2)
    corners, dim = basix.geometry(cell).shape
    simplex = corners == dim + 1
    assert not simplex or (x.sum(axis=1) < 1.0).all()
    assert w.sum() == pytest.approx(1.0 / math.factorial(dim) if simplex else 1.0)
    assert x[:, -1] @ w == pytest.approx(1.0 / math.factorial(dim + 1) if simplex else 0.5)


# Each degree and each exponent in the default suite, all pairs of them in the slow one.
OFTEN = {(1, 1), (1, 1.5), (2, 3), (2, 16), (3, 1), (3, 2), (4, 4)}


def cases(kinds):
    return [
        pytest.param(kind, degree, p, marks=[pytest.mark.slow] * ((degree, p) not in OFTEN))
        for kind in kinds
        for degree in (1, 2, 3, 4)
        for p in EXPONENTS
    ]


@pytest.mark.parametrize("boundary", [False, True])
@pytest.mark.parametrize(("kind", "degree", "p"), cases(PLANE))
def test_plane_elements(kind, degree, p, boundary):
    for seed, (n, frequency, noise) in enumerate([(3, 6.0, 0.0), (2, 3.0, 1e-3)]):
        wave = Wave(2, seed, frequency)
        u_h = approximation(wave, box(kind, n), degree, noise=noise)
        for name, off in compared(u_h, wave, p, boundary, 800 if boundary else 160).items():
            assert abs(off) < RIGHT, (name, seed, off)


@pytest.mark.parametrize("boundary", [False, True])
@pytest.mark.parametrize(("kind", "degree", "p"), cases(SOLID))
def test_solid_elements(kind, degree, p, boundary):
    wave = Wave(3, degree, 3.0)
    u_h = approximation(wave, box(kind, 1), degree)
    for name, off in compared(u_h, wave, p, boundary, 160 if boundary else 64).items():
        assert abs(off) < RIGHT, (name, off)


@settings(max_examples=20 if COMM.size == 1 else 6)
@given(
    st.sampled_from(["triangle", "quadrilateral"]),
    st.integers(1, 3),
    st.integers(1, 4),
    st.sampled_from([1, 1.25, 3, 4, 7]),
    st.sampled_from([2.0, 10.0, 40.0]),
    st.booleans(),
    st.integers(0, 10**6),
)
def test_waves_of_any_frequency(kind, n, degree, p, frequency, bernstein, seed):
    wave, bernstein = Wave(2, seed, frequency), bernstein and kind == "triangle"
    variant = "bernstein" if bernstein else "gll_warped"
    u_h = approximation(wave, box(kind, n), degree, variant, noise=1e-3)
    for name, off in compared(u_h, wave, p, False, 200).items():
        assert abs(off) < RIGHT, (name, off)


def zero(kind, n, comm=COMM):
    sides, cell = (n, n, n)[: 2 + (kind in SOLID)], mesh.CellType[kind]
    create = mesh.create_unit_cube if kind in SOLID else mesh.create_unit_square
    domain = create(comm, *sides, cell)
    return fem.Function(fem.functionspace(domain, ("Lagrange", 1)))


def power_of_distance(domain, exponent):
    x = ufl.SpatialCoordinate(domain)
    u = ufl.sqrt(ufl.dot(x, x)) ** exponent
    return Reference(domain, u, tuple(ufl.grad(u)[i] for i in range(domain.geometry.dim)))


def polar_integral(exponent, power, dim):
    """The integral of r^exponent (x / r)^power over the unit square or cube, for each x alike.

    r^exponent is integrated along rays from the corner: a square has two triangles of rays, a cube
    three pyramids, in one of which x is the largest coordinate.
    """
    order = exponent + dim

    def ray(largest, *others):
        r = math.sqrt(1.0 + sum(c**2 for c in others))
        return r**exponent * (largest / r) ** power / order

    if dim == 2:
        return sum(
            quad(lambda t, f=f: f(t), 0, 1)[0]
            for f in (lambda t: ray(1, t), lambda t: ray(1, t) * t**power)
        )
    first = dblquad(lambda s, t: ray(1, s, t), 0, 1, 0, 1)[0]
    return first + 2 * dblquad(lambda s, t: ray(1, s, t) * s**power, 0, 1, 0, 1)[0]


@pytest.mark.parametrize(
    ("exponent", "p"), [(0.5, 1), (0.5, 3), (2 / 3, 2), (2 / 3, 4), (1.5, 1), (1.5, 16)]
)
@pytest.mark.parametrize("kind", [*PLANE, *SOLID])
def test_derivatives_without_bound_at_a_corner(kind, exponent, p):
    # The derivatives are like r^(exponent - 1): those of the square have an integrable power p.
    u_h, dim = zero(kind, 2), 2 if kind in PLANE else 3
    exact = power_of_distance(u_h.function_space.mesh, exponent)
    found = error_norms(u_h, exact, [f"L{p}", f"W1_{p}"])
    value = polar_integral(p * exponent, 0, dim)
    slope = exponent**p * polar_integral(p * (exponent - 1.0), p, dim)
    assert found[f"L{p}"] == pytest.approx(value ** (1 / p), rel=RIGHT)
    assert found[f"W1_{p}"] == pytest.approx((value + dim * slope) ** (1 / p), rel=RIGHT)


@pytest.mark.parametrize(("exponent", "p"), [(0.5, 4), (2 / 3, 6), (2 / 3, 16), (-0.5, 4)])
@pytest.mark.parametrize("kind", PLANE)
def test_infinite_norms_are_refused(kind, exponent, p):
    u_h = zero(kind, 3)
    exact = power_of_distance(u_h.function_space.mesh, exponent)
    name = f"L{p}" if exponent < 0 else f"W1_{p}"
    with pytest.raises(FloatingPointError, match=f"{name}: infinite"):
        error_norms(u_h, exact, [name])


@pytest.mark.parametrize("p", [1, 2, 4])
@pytest.mark.parametrize("kind", PLANE)
def test_jumps_and_kinks_of_the_solution_inside_cells(kind, p):
    u_h = zero(kind, 3)
    domain = u_h.function_space.mesh
    x = ufl.SpatialCoordinate(domain)
    # 1 on one side of a line, -3 on the other: a trapezium of the area 0.61 - 0.37 / 2.
    at = x[0] + 0.37 * x[1] - 0.61
    step = ufl.conditional(ufl.lt(at, 0.0), 1.0, -3.0)
    nothing = 0.0 * x[0]
    found = error_norms(u_h, Reference(domain, step, (nothing, nothing)), [f"L{p}"])[f"L{p}"]
    area = 0.61 - 0.37 / 2
    assert found == pytest.approx((area + 3.0**p * (1.0 - area)) ** (1 / p), rel=RIGHT)
    # |at|, whose powers are integrated along x and then along y.
    kink = Reference(domain, abs(at), (ufl.sign(at), 0.37 * ufl.sign(at)))
    found = error_norms(u_h, kink, [f"L{p}", f"W1_{p}"])
    ends = [[0.61 - 0.37 * y, 0.39 + 0.37 * y] for y in (0.0, 1.0)]
    (a, c), (b, d) = ends
    power = (a ** (p + 2) - b ** (p + 2) + d ** (p + 2) - c ** (p + 2)) / (0.37 * (p + 1) * (p + 2))
    assert found[f"L{p}"] == pytest.approx(power ** (1 / p), rel=RIGHT)
    assert found[f"W1_{p}"] == pytest.approx((power + 1.0 + 0.37**p) ** (1 / p), rel=RIGHT)


@pytest.mark.parametrize("kind", [*PLANE, *SOLID])
def test_the_same_on_any_number_of_ranks(kind):
    found = []
    wave = Wave(3 if kind in SOLID else 2, 3, 8.0)
    names = ["L1", "W1_3", "L4", "L1_boundary", "W1_4_boundary", "H1_2_boundary"]
    for comm in (COMM, MPI.COMM_SELF):
        domain = box(kind, 3, comm)
        found.append(error_norms(approximation(wave, domain, 2), wave.reference(domain), names))
    assert found[0] == pytest.approx(found[1], rel=1e-10)


def points_per_cell(monkeypatch, kind, n, degree, names, wave):
    counts, evaluate = [], ErrorAtPoints.__call__

    def counted(error, points):
        counts.append(points.x[0].size)
        return evaluate(error, points)

    domain = box(kind, n)
    u_h = approximation(wave, domain, degree)
    monkeypatch.setattr(ErrorAtPoints, "__call__", counted)
    error_norms(u_h, wave.reference(domain), names)
    monkeypatch.setattr(ErrorAtPoints, "__call__", evaluate)
    cells = domain.topology.index_map(domain.topology.dim).size_global
    return COMM.allreduce(sum(counts)) / cells


@pytest.mark.parametrize(("name", "most"), [("L2", 19), ("L4", 42), ("W1_4", 42)])
def test_smooth_errors_take_two_rules_and_no_division(monkeypatch, name, most):
    assert points_per_cell(monkeypatch, "triangle", 30, 1, [name], Wave(2, 1, 6.0)) < most


def test_errors_of_rounding_take_no_division(monkeypatch):
    domain = box("triangle", 30)
    x = ufl.SpatialCoordinate(domain)
    u_h = fem.Function(fem.functionspace(domain, ("Lagrange", 1)))
    u_h.interpolate(lambda x: 1.0 + x[0] / 3.0 - x[1] / 7.0)
    u = 1.0 + x[0] / 3.0 - x[1] / 7.0
    parts, divided = [], controlled.Parts.divided
    monkeypatch.setattr(
        controlled.Parts, "divided", lambda *args: parts.append(1) or divided(*args)
    )
    exact = Reference(domain, u, (1.0 / 3.0 + 0.0 * x[0], -1.0 / 7.0 + 0.0 * x[0]))
    found = error_norms(u_h, exact, ["L1", "W1_1"])
    assert all(value < 1e-12 for value in found.values())
    assert not parts


def test_what_takes_too_many_parts_is_told(monkeypatch, caplog):
    monkeypatch.setattr(controlled, "MOST", 10_000)
    monkeypatch.setattr(controlled, "MORE", 1)
    u_h = zero("triangle", 16)
    x = ufl.SpatialCoordinate(u_h.function_space.mesh)
    rough = ufl.sign(ufl.sin(90.0 * x[0]) * ufl.sin(71.0 * x[1])) + 1.0
    nothing = 0.0 * x[0]
    exact = Reference(u_h.function_space.mesh, rough, (nothing, nothing))
    found = error_norms(u_h, exact, ["L2"])["L2"]
    assert found == pytest.approx(math.sqrt(2.0), rel=0.1)
    if COMM.rank == 0:
        assert "L2: the quadrature may be off by" in caplog.text


@pytest.mark.parametrize("unit", [1e-30, 1.0])
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("cell", PLANE + SOLID)
def test_what_vanishes_on_the_boundary_has_norms_of_rounding_there(cell, degree, unit):
    """On facets the values of the dofs inside are rounded, and no quadrature finds their norms."""
    kind = mesh.CellType[cell]
    if cell in PLANE:
        domain = mesh.create_unit_square(COMM, 5, 4, kind)
    else:
        domain = mesh.create_unit_cube(COMM, 3, 2, 2, kind)
    dim = domain.topology.dim
    turned = np.array([[0.7, 0.3, 0.1], [0.2, 0.9, 0.13], [0.31, 0.2, 1.1]])[:dim, :dim]
    domain.geometry.x[:, :dim] = domain.geometry.x[:, :dim] @ turned
    space = fem.functionspace(domain, ("Lagrange", degree))
    u = fem.Function(space)
    u.interpolate(lambda x: unit * np.cos(40.0 * x[0] + 30.0 * x[1]))
    domain.topology.create_connectivity(dim - 1, dim)
    facets = mesh.exterior_facet_indices(domain.topology)
    u.x.array[fem.locate_dofs_topological(space, dim - 1, facets)] = 0.0
    names = ["L1_boundary", "L2_boundary", "H1_2_boundary", "W1_4_boundary", "Linf_boundary"]
    for norm in error_norms(u, None, names).values():
        assert norm <= 1e-11 * unit
