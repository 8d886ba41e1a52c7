"""Rules that data ask for: degrees of formulas, and solutions as accurate as with many points."""

from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem

from dolfinx_signorini.data import parsing
from dolfinx_signorini.data.interfaces import jumps, rules
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.quadrature import CELL_RULE, QuadratureRule
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.scenes import load_scene, solve_scene
from dolfinx_signorini.scenes.posing import pose

FINE = QuadratureRule("Gauss-Jacobi", 19)
DEGREES = {
    "x*y^2 + 3": 3,
    "(x - 2*y)^4/(1 + 1)": 4,
    "where(x < 0.5, x^2, 4)": 2,
    "max(x, y^3) - abs(x*y)": 3,
    "sin(2)*x": 1,
    "sign(sin(9*x))*y": 1,
    "7": 0,
    "1/(1 + x)": None,
    "x^1.5": None,
    "x^-1": None,
    "sqrt(x + 1)": None,
    "where(x < 0.5, sin(x), 4)": None,
    "hypot(x, y)^2": None,
}


@pytest.mark.parametrize("text", DEGREES)
def test_degrees_of_formulas(text):
    assert rules.polynomial_degree(parsing.parse(text).root) == DEGREES[text]


def test_the_degree_of_a_power_made_by_squares_takes_no_longer_than_its_squares():
    power = parsing.parse("x").root
    for _ in range(60):  # each square has the one before twice
        power = power * power
    assert rules.polynomial_degree(power) == 2**60


@pytest.mark.parametrize("text", ["x^3*y - 2*y^4", "where(x < 0.5, x^2, 4*y)", "x - 1"])
@pytest.mark.parametrize("degree", [1, 2])
def test_polynomials_are_integrated_exactly_by_few_points(text, degree, comm):
    domain = friedrichs_keller(comm, 4)
    formula = parsing.parse(text)
    (dx,) = rules.measures_for(domain, [([formula], degree)], degree)
    assert dx.metadata()["quadrature_degree"] < CELL_RULE.degree
    v = ufl.TestFunction(fem.functionspace(domain, ("Lagrange", degree)))
    load = jumps.integrable(formula, domain, degree)
    found, fine = (fem.assemble_vector(fem.form(load * v * m)) for m in (dx, ufl.dx(degree=12)))
    assert found.array == pytest.approx(fine.array, abs=1e-15)


SMOOTH = """
[domain]
shape = "square"
cells = 40
[equation]
diffusion = "1 + 0.5*sin(3*x)*cos(2*y)"
reaction = "exp(x*y)"
[contact]
sides = "bottom"
[[dirichlet]]
sides = ["left", "top"]
[solution]
u = "-y*(1 - y)*(2 + sin(4*x)) + 0.2*exp(-300*((x - 0.4)^2 + (y - 0.6)^2))"
manufactured = true
"""
PAPER = None  # the demo
ERRORS = ("L2", "H1", "Linf")


@pytest.mark.parametrize(
    ("text", "degree"),
    [(SMOOTH, 1), (SMOOTH, 2), (PAPER, 1)],
    ids=["smooth-1", "smooth-2", "paper-1"],
)
def test_errors_are_those_with_a_fine_rule_in_all_cells(
    text, degree, comm, demos, folder, monkeypatch
):
    path = demos / "paper.toml"
    if text is not None:
        path = folder / "scene.toml"
        if comm.rank == 0:
            path.write_text(text)
        comm.barrier()
    cells = 40 if degree == 1 else 24
    scene = load_scene(path, comm, [f"degree={degree}", f"domain.cells={cells}", "rtol=1e-10"])
    errors = []
    for many, rule in ((1, CELL_RULE), (10**9, FINE)):
        monkeypatch.setattr(rules, "MANY", many)
        monkeypatch.setattr(jumps, "MANY", many)
        monkeypatch.setattr(rules, "CELL_RULE", rule)
        result = solve_scene(scene, comm)
        errors.append(error_norms(result.u, result.posed.exact, ERRORS, FINE))
        result.destroy()
    for norm in ERRORS:
        assert errors[0][norm] == pytest.approx(errors[1][norm], rel=0.01), norm


def test_points_are_many_in_few_cells_and_a_load_of_rounding_is_none(comm, demos, monkeypatch):
    monkeypatch.setattr(rules, "MANY", 1)
    scene = load_scene(demos / "mixed.toml", comm, ["domain.cells=20"])
    assert "load" not in pose(scene, comm).sources
    sides = ["solution.manufactured=false", "dirichlet.1.value=0", "neumann.1.flux=0"]
    load = "equation.load=exp(-4000*((x - 0.3)^2 + (y - 0.7)^2))"
    posed = pose(load_scene(demos / "mixed.toml", comm, ["domain.cells=20", *sides, load]), comm)
    one, shares, volume = fem.Constant(posed.sided.mesh, 1.0), {}, 0.0
    for integral in posed.L.integrals_by_type("cell"):
        rule = integral.metadata()["quadrature_rule"]
        data = dict(integral.subdomain_data())[integral.subdomain_id()]
        shares[rule] = comm.allreduce(len(data)) / 800.0
        part = fem.form(ufl.Form([integral.reconstruct(integrand=one)]))
        volume += comm.allreduce(fem.assemble_scalar(part))
    assert shares["Gauss-Jacobi"] < 0.1 < 0.9 < shares["default"]
    assert volume == pytest.approx(1.0)
    assert list(posed.sources) == ["load"]
    assert posed.problem.total_load == pytest.approx(np.pi / 4000.0, rel=0.02)


def test_the_rough_cells_of_several_coefficients_are_one_part_of_the_cells(
    comm, parse, monkeypatch
):
    monkeypatch.setattr(rules, "MANY", 1)
    text = """
    [domain]
    shape = "square"
    cells = 40
    [equation]
    diffusion = "1 + exp(-4000*((x - 0.3)^2 + (y - 0.7)^2))"
    reaction = "1 + exp(-4000*((x - 0.6)^2 + (y - 0.7)^2))"
    load = 1
    [contact]
    sides = "bottom"
    """
    posed = pose(parse(text), comm)
    w = fem.Function(posed.problem.space)
    w.x.array[:] = 1.0
    a = fem.form(ufl.action(ufl.action(posed.a, w), w))
    total = comm.allreduce(fem.assemble_scalar(a))
    assert total == pytest.approx(1.0 + np.pi / 4000.0, rel=1e-6)
    assert len(posed.a.integrals()) == 4 and len(posed.L.integrals()) == 1
    posed.problem.destroy()


IN_LAYERS = """
[domain]
shape = "cube"
cells = 4
[equation]
reaction = "where(z < 0.5, 1, 1000)"
diffusion = "where(y < 0.25, 1, 9)"
load = "where(z < 0.5, 1, 1000)*(1 + z)"
[contact]
sides = "bottom"
bound = "upper"
obstacle = 1
[[neumann]]
sides = "top"
flux = "where(y < 0.25, 1, 9)"
[solution]
u = "1 + z"
"""


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_data_that_jump_on_facets_in_space_are_those_of_each_cell(degree, parse, comm):
    # The solution is in the space: what is left is what the linear solves leave.
    scene = replace(parse(IN_LAYERS), degree=degree, rtol=1e-11)
    result = solve_scene(scene, comm)
    u = result.posed.problem.u
    assert u.function_space.element.basix_element.degree == degree
    error = fem.Function(u.function_space)
    error.interpolate(lambda x: 1.0 + x[2])
    error.x.array[:] -= u.x.array
    assert error_norms(error, None, ["Linf"])["Linf"] < 1e-8
    result.destroy()
