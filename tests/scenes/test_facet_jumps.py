"""Fluxes that jump or have a kink inside facets are integrated piece by piece."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from dolfinx_signorini.data import parsing
from dolfinx_signorini.data.interfaces.facet_jumps import data_jumps, integrable_on_facets
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.quadrature import CELL_RULE, FACET_RULE
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.scenes import pose
from dolfinx_signorini.scenes.bounds import bound_of_scene
from dolfinx_signorini.scenes.expectations import expect
from dolfinx_signorini.scenes.solving import solve_scene

JUMP = 0.3713  # no mesh line


def moment(comm, text, domain, facets, degree, weight, rule):
    """The integral of a formula times a power of a coordinate over some facets."""
    dim = domain.topology.dim
    f = integrable_on_facets(parsing.parse(text, dim), domain, facets, degree)
    owned = facets[facets < domain.topology.index_map(dim - 1).size_local]
    tags = mesh.meshtags(domain, dim - 1, np.sort(owned), np.ones(len(owned), dtype=np.int32))
    ds = ufl.Measure("ds", domain, subdomain_data=tags, metadata=rule.metadata)
    x = ufl.SpatialCoordinate(domain)
    return comm.allreduce(fem.assemble_scalar(fem.form(f * weight(x) * ds(1))))


def on_side(domain, axis, place):
    dim = domain.topology.dim - 1
    return mesh.locate_entities_boundary(domain, dim, lambda x: np.isclose(x[axis], place))


@pytest.mark.parametrize(("degree", "cells"), [(1, 1), (1, 9), (2, 1), (2, 4), (3, 4), (4, 2)])
def test_a_jump_on_a_side_is_integrated(comm, degree, cells):
    domain = friedrichs_keller(comm, cells)
    for axis in (0, 1):
        name = "yx"[axis]
        for place in (0.0, 1.0):
            facets = on_side(domain, axis, place)
            for power in range(degree + 1):
                found = moment(
                    comm,
                    f"where({name} < {JUMP}, 3, 1)",
                    domain,
                    facets,
                    degree,
                    lambda x, a=axis, k=power: x[1 - a] ** k,
                    FACET_RULE,
                )
                exact = (1.0 + 2.0 * JUMP ** (power + 1)) / (power + 1)
                assert found == pytest.approx(exact, rel=1e-4)


@pytest.mark.parametrize("cells", [1, 3])
def test_two_jumps_in_the_cell_of_a_corner_are_integrated(comm, cells):
    """Both sides of a corner belong to one cell: each facet has a projection of its own."""
    domain = friedrichs_keller(comm, cells)
    reach = 0.3137 / cells
    for text, exact in (
        (f"where(x + y < {reach}, 1, 0)", 2.0 * reach),
        (f"where(x - y > {1.0 - reach}, 1, 0)", 2.0 * reach),  # the corner of one cell
    ):
        found = moment(comm, text, domain, boundary_facets(domain), 1, lambda x: 1.0, FACET_RULE)
        assert found == pytest.approx(exact, abs=4e-4)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_jump_on_a_side_of_the_cube_is_integrated(comm, axis):
    domain = mesh.create_unit_cube(comm, 3, 4, 5)
    a, b = (name for k, name in enumerate("xyz") if k != axis)
    for place in (0.0, 1.0):
        facets = on_side(domain, axis, place)
        for text, exact in (
            (f"where({a} < {JUMP}, 1, 0)", JUMP),
            (f"where({a} + {b} < {JUMP}, 1, 0)", 0.5 * JUMP**2),
            (f"abs({b} - {JUMP})", 0.5 * (JUMP**2 + (1.0 - JUMP) ** 2)),
        ):
            found = moment(comm, text, domain, facets, 1, lambda x: 1.0, CELL_RULE)
            assert found == pytest.approx(exact, abs=2e-3)


@pytest.mark.parametrize("formula", ["where(x < 0.5, 1, 0)", "sin(x)", "where(y < 0.1, 1, 0)"])
def test_what_is_smooth_on_the_facets_costs_nothing(comm, formula):
    domain = friedrichs_keller(comm, 8)
    f = integrable_on_facets(parsing.parse(formula), domain, on_side(domain, 1, 0.0), 1)
    assert not ufl.algorithms.extract_coefficients(f)


NEUMANN = """
degree = {degree}
[domain]
shape = "square"
cells = 5
[contact]
sides = "bottom"
obstacle = -10
[[dirichlet]]
sides = "left"
value = 0
[[neumann]]
sides = "top"
flux = "where(x < 0.3713, 3, 1)"
"""


def _work(comm, scene, values):
    """The work of the load and the fluxes of a scene on a function with given values."""
    posed = pose(scene, comm)
    w = fem.Function(posed.problem.space)
    w.interpolate(values)
    work = comm.allreduce(fem.assemble_scalar(fem.form(ufl.action(posed.L, w))))
    posed.problem.destroy()
    return work


@pytest.mark.parametrize("degree", [1, 2, 4])
def test_the_flux_of_a_scene_is_integrated_piece_by_piece(comm, parse, degree):
    work = _work(comm, parse(NEUMANN.format(degree=degree)), lambda x: x[0] ** degree)
    assert work == pytest.approx((1.0 + 2.0 * JUMP ** (degree + 1)) / (degree + 1), rel=1e-4)


@pytest.mark.parametrize(("kink", "told"), [("abs(x - 0.37)", True), ("x*x", False)])
def test_a_manufactured_solution_with_a_kink_is_named(comm, parse, kink, told):
    text = f"""
[domain]
shape = "square"
cells = 4
[contact]
sides = "bottom"
[[dirichlet]]
sides = ["left", "right", "top"]
[solution]
u = "1 + y^2*{kink}"
manufactured = true
"""
    scene = parse(text)
    notes = expect(scene, scene.domain.make(comm)).notes
    assert any("kinks of the solution" in note for note in notes) == told


def test_a_pole_on_a_side_is_integrated(comm):
    domain, degree = friedrichs_keller(comm, 5), 3
    text, facets = f"abs(x - {JUMP})^-0.5", on_side(domain, 1, 0.0)
    for power in range(degree + 1):
        found = moment(comm, text, domain, facets, degree, lambda x, k=power: x[0] ** k, FACET_RULE)
        nodes, weights = np.polynomial.legendre.leggauss(20)
        exact = 0.0
        for way in (-JUMP, 1.0 - JUMP):  # x = JUMP +- t^2
            reach = np.sqrt(abs(way))
            t = 0.5 * reach * (nodes + 1.0)
            exact += reach * weights @ (JUMP + np.sign(way) * t**2) ** power
        assert found == pytest.approx(exact, rel=1e-5)


CURRENT = """
degree = 2
[domain]
shape = "square"
cells = 5
[equation]
diffusion = "{diffusion}"
[contact]
sides = "bottom"
[[dirichlet]]
sides = "left"
[solution]
u = "{u}"
manufactured = true
"""


@pytest.mark.parametrize(
    ("diffusion", "u", "exact"),
    [
        (f"where(x < {JUMP}, 1, 5)", "1 - y", 0.5 * (4.0 * JUMP**2 - 5.0)),
        ("1", f"1 - y + max(x - {JUMP}, 0)^2", 0.5 * JUMP**2 - JUMP),  # with the load -2, x > JUMP
    ],
)
def test_the_data_of_a_manufactured_solution_are_integrated_piece_by_piece(
    comm, parse, diffusion, u, exact
):
    scene = parse(CURRENT.format(diffusion=diffusion, u=u))
    work = _work(comm, scene, lambda x: x[0] * x[1])
    assert work == pytest.approx(exact, abs=3e-4)


POLES = """
[domain]
shape = "square"
cells = 4
[equation]
load = "{load}"
[contact]
sides = "bottom"
[[dirichlet]]
sides = "top"
value = 0
[[neumann]]
sides = "right"
flux = "{flux}"
"""


@pytest.mark.parametrize(
    ("load", "power"),
    [
        ("abs(x - y - 0.1)^-0.5", "-0.5"),
        ("abs(x - 0.3)^-0.2 + abs(x - y - 0.1)^-0.7", "-0.7"),
        ("hypot(x - 0.3, y - 0.4)^-0.5", None),
        ("sin(x - 0.3)/(x - 0.3)", None),
    ],
)
def test_a_load_with_poles_along_a_line_is_named(comm, parse, load, power):
    scene = parse(POLES.format(load=load, flux="0"))
    notes = expect(scene, scene.domain.make(comm)).notes
    told = [note for note in notes if "infinite along a curve" in note]
    assert len(told) == (power is not None)
    assert all(f"to the power {power}," in note for note in told)


@pytest.mark.parametrize(
    ("load", "flux", "places"),
    [
        ("1/x", "0", ["the load grows"]),
        ("x^-0.9", "0", []),
        ("(x + 2*y)^-1.2", "0", []),  # infinite at a vertex alone
        ("1/(x - 0.3)^2 + 1/(x + 1)", "0", ["the load grows"]),
        ("abs(x - 0.3)^-0.5", "1/y", ["the flux of 'neumann' grows"]),
        ("1", "abs(y - 0.37)^-1.5", ["the flux of 'neumann' grows"]),
        ("1", "abs(y - 0.37)^-0.5 + log(y)", []),
        ("1", "1/(y + 1e-3)", []),
    ],
)
def test_data_without_an_integral_are_named(comm, parse, load, flux, places):
    scene = parse(POLES.format(load=load, flux=flux))
    notes = [n for n in expect(scene, scene.domain.make(comm)).notes if "is infinite, and" in n]
    assert len(notes) == len(places)
    assert all(note.startswith(place) for note, place in zip(notes, places, strict=True))


@pytest.mark.parametrize(("u", "told"), [("abs(x - 0.43)^1.5", True), ("abs(x - 0.43)^2.5", False)])
def test_poles_of_the_load_of_a_manufactured_solution_are_named(comm, parse, u, told):
    scene = parse(CURRENT.format(diffusion="1", u=f"{u} - y"))
    notes = expect(scene, scene.domain.make(comm)).notes
    assert any("infinite along a curve" in note for note in notes) == told


@pytest.mark.parametrize(
    ("data", "places"),
    [
        ("where(x < 0.3, 0, 1)", [0.3]),
        ("abs(x - 0.31)", []),
        ("tanh(1e6*(x - 0.31))", []),
        ("abs(x - 0.5)^0.2", []),
        ("where(x < 0.25, 0, 1e-3) + where(x < 0.8, x, 2)", [0.25, 0.8]),  # 0.25 is a vertex
        ("where(y < 0.5, 0, 1)", []),  # no jump on the side
        ("exp(-710 - 5000*(x - 0.4)^2)", []),  # from where numbers have no digits down to 0
    ],
)
def test_jumps_of_data_on_a_side_are_found(comm, data, places):
    domain = friedrichs_keller(comm, 4)
    top = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 1.0))
    found = data_jumps(domain, [(parsing.parse(data, 2), top)])
    assert [point[0] for point in found] == pytest.approx(places, abs=1e-9)
    assert all(point[1] == 1.0 for point in found)


def test_jumps_of_data_on_a_face_are_found(comm):
    domain = mesh.create_unit_cube(comm, 2, 2, 2)
    top = mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[2], 1.0))
    left = mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[0], 0.0))
    torn = data_jumps(domain, [(parsing.parse("where(x < 0.3, 0, 1)", 3), top)])
    assert torn and {point[0] for point in torn} == {0.3}
    both = [(parsing.parse(data, 3), on) for data, on in (("x", top), ("1 - z", left))]
    assert data_jumps(domain, both) == []
    met = data_jumps(domain, [both[0], (parsing.parse("y", 3), left)])
    # Where the sides meet, but at the vertex (0, 0, 1).
    assert met == [(0.0, 0.5, 1.0), (0.0, 1.0, 1.0)]


TORN = """
[domain]
shape = "square"
cells = 8
[equation]
load = -1
[contact]
sides = "bottom"
obstacle = "-0.1 - 0.05*x"
[[dirichlet]]
sides = "top"
value = "{top}"
[[dirichlet]]
sides = "left"
value = "{left}"
"""


@pytest.mark.parametrize(
    ("top", "left", "place"),
    [
        ("where(x < 0.3, 0, 0.1)", "0", "(0.3, 1)"),
        ("0.1*x", "1 - y", None),
        ("0", "0.2", "(0, 1)"),
        ("0.2", "0", "(0, 1)"),
    ],
)
def test_no_energy_is_finite_where_dirichlet_data_jump(comm, parse, top, left, place):
    scene = parse(TORN.format(top=top, left=left))
    found = expect(scene, scene.domain.make(comm))
    assert found.infinite("H1") == (place is not None)
    told = [note for note in found.notes if "Dirichlet data jump" in note]
    assert [f"at {place}:" in note for note in told] == ([] if place is None else [True])
    result = solve_scene(scene, comm)
    bound = bound_of_scene(result.posed)
    assert np.isinf(bound.total) == (place is not None)
    assert any("Dirichlet data jump" in note for note in bound.notes) == (place is not None)
    result.destroy()
