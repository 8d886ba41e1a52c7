"""The Ritz projection: its definition, Lemmas 3.2 and 3.3, supercloseness."""

import math
from dataclasses import asdict

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.accuracy.terms import assembled, difference
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.manufactured import ManufacturedSolution
from dolfinx_signorini.norms.references import interpolant
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.studies.paper.solution import PAPER_RULE
from dolfinx_signorini.studies.paper.theory import errors
from dolfinx_signorini.studies.paper.theory.discretisation import (
    THEORY_RTOL,
    Discretisation,
    near_cells,
)
from dolfinx_signorini.studies.paper.theory.errors import check_obstacle_problem, supercloseness
from dolfinx_signorini.studies.paper.theory.examples import Example, paper_example
from dolfinx_signorini.studies.paper.theory.measures import RITZ_NORMS
from dolfinx_signorini.studies.paper.theory.proven import supercloseness_order
from dolfinx_signorini.studies.paper.theory.statements import MEASURED


def order(coarse, fine, ratio):
    return math.log(coarse / fine) / math.log(ratio)


def perturbation(space):
    v = fem.Function(space)
    v.interpolate(lambda x: np.sin(5 * x[0] + 1) * np.cos(3 * x[1]))
    return v


def test_galerkin_orthogonality(discretisation):
    # Definition 3.1, for one function that stands for all.
    d = discretisation("paper", 31)
    v = perturbation(d.space)
    assert d.product(d.ritz, v) == pytest.approx(d.exact_product(v), rel=1e-9)


def test_best_approximation(discretisation):
    # R_h(u) is nearer to u than u_h and the interpolant in H^1.
    d = discretisation("paper", 31)
    functions = {"ritz": d.ritz, "u_h": d.u_h, "interpolant": interpolant(d.space, d.exact.u)}
    error = {name: error_norms(v, d.exact, ["H1"])["H1"] for name, v in functions.items()}
    assert error["ritz"] < error["u_h"]
    assert error["ritz"] < error["interpolant"]


@pytest.mark.parametrize(("scene", "p"), [("paper", 2), ("paper", 3), ("smooth", 4)])
def test_lemma_3_2(discretisation, scene, p):
    both = (discretisation(scene, n) for n in (25, 75))
    coarse, fine = (error_norms(d.ritz, d.exact, RITZ_NORMS) for d in both)
    gradient = "H1" if p == 2 else f"W1_{p}"
    for norm, proven in ((f"L{p}", 2.0), (gradient, 1.0), (f"L{p}_boundary", 2.0 - 1.0 / p)):
        assert order(coarse[norm], fine[norm], 3.0) >= proven - 0.05
    trace = "H1_2_boundary_spectral"
    assert order(coarse[trace], fine[trace], 3.0) >= 1.45


def pulled_example():
    """A function with du/dn = -1 on two sides and a load that is not its own."""

    def exact(domain):
        x = ufl.SpatialCoordinate(domain)
        grad = (1.0 - 2.0 * x[0], 0.0 * x[0])
        return ManufacturedSolution(domain, x[0] * (1.0 - x[0]), grad, ufl.sin(37.0 * x[1]))

    return Example(exact, singular=(), contact=())


def test_lemma_3_3_fails_for_a_function_that_solves_nothing():
    d = Discretisation(pulled_example(), friedrichs_keller(MPI.COMM_WORLD, 15))
    row = {"n": 15, "obstacle": asdict(check_obstacle_problem(d))}
    verdicts = [check.verdict({"paper": [row]}) for check in MEASURED["3.3"].checks[:2]]
    assert not any(verdict.holds for verdict in verdicts)
    d.destroy()


def distance_at_nodes(d):
    """The distance of R_h(u) from the solution whose obstacle is R_h(u) - u at the nodes."""
    u = interpolant(d.space, d.exact.u)
    problem = SignoriniProblem(d.a, d.L, contact=d.contact, obstacle=difference(d.ritz, u))
    solution = problem.solve(rtol=THEORY_RTOL)
    problem.destroy()
    return d.norm(difference(solution, d.ritz))


def test_lemma_3_3(discretisation):
    d = discretisation("paper", 31)
    check = check_obstacle_problem(d)
    assert check.identity < 0.01
    assert check.minimum > -1e-12 * d.norm(d.ritz)
    # At the nodes only the inequality fails, and R_h(u) is not the solution.
    assert check.minimum_nodes < -1e-6
    assert 0.0 < distance_at_nodes(d) <= supercloseness(d)


def test_lemma_3_3_without_contact(discretisation):
    # No flux: nothing is pressed, and every obstacle below the solution leaves it where it is.
    d = discretisation("smooth", 25)
    check = check_obstacle_problem(d)
    assert abs(check.minimum) < 1e-10
    assert abs(check.minimum_nodes) < 1e-10
    assert distance_at_nodes(d) < 1e-8


def test_without_contact_the_solution_is_the_projection(discretisation):
    d = discretisation("smooth", 25)
    assert supercloseness(d) < 1e-9 * d.norm(d.ritz)


@pytest.mark.parametrize("name", ["2.5", "3.5", "8", "paper"])
def test_theorem_3_6(discretisation, name):
    p = math.inf if name == "paper" else float(name)
    coarse, fine = (supercloseness(discretisation(name, n)) for n in (25, 75))
    assert order(coarse, fine, 3.0) >= supercloseness_order(p).value - 0.05
    error = error_norms(discretisation(name, 75).u_h, discretisation(name, 75).exact, ["H1"])["H1"]
    assert fine < 0.1 * error


def green_defect(d):
    """How far the load of a discretisation is from the paper's: the H^1 norm of its solution."""
    form = d.exact.load * ufl.TestFunction(d.space) * ufl.dx(metadata=PAPER_RULE.metadata)
    return d.norm(d.riesz(difference(assembled(form, d.space), d.load)))


def test_the_load_is_the_papers(discretisation):
    # Green's formula: the load by the paper's rule and the difference of two integrals agree, the
    # better the finer the mesh, and both are far below the error.
    coarse, fine = (green_defect(discretisation("paper", n)) for n in (25, 75))
    assert fine < 0.3 * coarse
    d = discretisation("paper", 75)
    assert fine < 1e-3 * error_norms(d.u_h, d.exact, ["H1"])["H1"]


def test_near_and_far_make_up_the_error(discretisation):
    d = discretisation("paper", 75)
    for norm in ("L16", "W1_16"):
        whole = error_norms(d.u_h, d.exact, [norm], PAPER_RULE)[norm]
        found = errors.near_and_far(d, [norm])
        assert (found["near"][norm] / whole) ** 16 + (found["far"][norm] / whole) ** 16 == (
            pytest.approx(1.0, abs=1e-11)
        )
    near = errors.near_and_far(d, ["H1"], difference(d.ritz, d.u_h))
    assert math.hypot(near["near"]["H1"], near["far"]["H1"]) == pytest.approx(
        supercloseness(d), rel=1e-4
    )


def test_signs_make_up_the_error(discretisation):
    d = discretisation("paper", 25)
    signed = errors.signed_parts(d)
    whole = error_norms(d.u_h, d.exact, ["L4"], PAPER_RULE)["L4"]
    assert signed["plus"] ** 4 + signed["minus"] ** 4 == pytest.approx(whole**4, rel=1e-12)


def test_near_cells_reach_three_cells():
    domain = friedrichs_keller(MPI.COMM_WORLD, 20)
    near = near_cells(domain, paper_example().singular)
    count = domain.comm.allreduce(len(near))
    half_disk = 0.5 * math.pi * (3.0 * math.sqrt(2.0)) ** 2 * 2.0  # in triangles
    assert half_disk <= count <= 2.5 * half_disk


def test_a_discretisation_finds_u_h_itself():
    d = Discretisation(paper_example(), friedrichs_keller(MPI.COMM_WORLD, 15))
    first = d.u_h
    assert first is d.u_h
    state = d.contact_state()
    before = first.copy()
    again = d.solve(coarse=state, rtol=THEORY_RTOL)
    assert d.norm(difference(before, again)) < 1e-9
    assert d.u_h is again
    d.destroy()
