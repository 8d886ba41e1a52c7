"""The dual problems of Section 5: their solutions, and the chains (20), (21) and (26)."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.studies.paper.theory.boundary import edges_that_meet
from dolfinx_signorini.studies.paper.theory.discretisation import Discretisation
from dolfinx_signorini.studies.paper.theory.dual import (
    discrete_contact_cells,
    dual_chains,
    transfer,
)
from dolfinx_signorini.studies.paper.theory.errors import signed_parts
from dolfinx_signorini.studies.paper.theory.examples import paper_example, rough_example
from dolfinx_signorini.studies.paper.theory.families import discretise

COMM = MPI.COMM_WORLD
ROUNDING = 1e-9


def chains(scene, n, refinement=4):
    coarse = discretise(COMM, scene, n)
    fine = Discretisation(scene, friedrichs_keller(COMM, refinement * n))
    result = dual_chains(coarse, fine)
    fine.destroy()
    coarse.destroy()
    return result


@pytest.fixture(scope="module")
def found():
    """Chains of the paper's solution by cells per side."""
    return {n: chains(paper_example(), n) for n in (13, 25)}


def test_dual_solutions_are_not_positive(found):
    for pair in found.values():
        for chain in pair:
            assert chain.largest <= 1e-6  # nothing forces the sign in the discrete problem
            assert chain.contact <= 1e-6


def test_the_functions_tested_with_are_admissible(found):
    for pair in found.values():
        for chain in pair:
            assert chain.admissible >= -ROUNDING


def test_chains_hold_on_every_mesh(found):
    for plus, minus in found.values():
        assert plus.slack >= -ROUNDING
        # (26) is an equality: the dual pressure lives where u vanishes.
        assert abs(minus.slack) <= ROUNDING
        for chain in (plus, minus):
            assert chain.duality == pytest.approx(chain.interpolation + chain.sign, rel=1e-10)
            assert chain.sign <= ROUNDING * chain.error
            for epsilon, bound in chain.holder.items():
                assert chain.interpolation <= bound <= chain.holder_split[epsilon]
            assert abs(chain.remainder) < 0.1 * chain.error


def test_without_a_term_the_chain_breaks(found):
    # Each part of (26) is needed: the remainder is no rounding, and the sign is not 0.
    _, minus = found[25]
    assert minus.duality < minus.error
    assert minus.sign < -1e-3 * minus.error


def test_constants_do_not_grow(found):
    for part in (0, 1):
        first, last = (pair[part] for pair in found.values())
        for epsilon in last.stability:
            assert last.stability[epsilon] <= 1.05 * first.stability[epsilon]
            assert last.regularity[epsilon] <= 1.1 * first.regularity[epsilon]
        # Remark 5.3: no constant for an exponent above 4/3.
        assert last.regularity["none"] > 1.05 * first.regularity["none"]


def test_signed_errors_are_of_order_2(discretisation):
    coarse, fine = (signed_parts(discretisation("paper", n)) for n in (25, 75))
    for part, error in coarse.items():
        assert np.log(error / fine[part]) / np.log(3.0) == pytest.approx(2.0, abs=0.1)


def test_on_its_own_mesh_the_decisive_term_vanishes():
    # Why z needs a finer mesh: on that of u_h it is its own interpolant.
    plus, minus = chains(paper_example(), 13, refinement=1)
    for chain in (plus, minus):
        assert abs(chain.interpolation) <= 1e-8 * chain.error
        assert chain.slack >= -ROUNDING


def test_another_scene():
    plus, minus = chains(rough_example(3.0), 13)
    assert plus.slack >= -ROUNDING
    assert minus.slack >= -ROUNDING


def test_contact_cells(discretisation):
    d = discretisation("paper", 15)
    exact = edges_that_meet(d.curve, d.example.contact)
    # From the edge that holds the detachment point to the one that holds (0.05, 0).
    assert not exact[1:7].any()
    assert exact[7:].all()
    assert exact[0]
    discrete = discrete_contact_cells(d)
    assert (discrete <= exact).all()  # u_h is positive where u and its flux vanish
    u_h = d.curve.values(d.u_h)
    assert (u_h[discrete] == 0.0).all()
    assert (np.roll(u_h, -1)[discrete] == 0.0).all()


def test_contact_cells_meet_the_open_intervals_only():
    curve = Discretisation(paper_example(), friedrichs_keller(COMM, 10)).curve
    touching = edges_that_meet(curve, ((0.5, 0.7),))
    assert np.flatnonzero(touching).tolist() == [5, 6]
    around = edges_that_meet(curve, ((3.85, 4.05),))
    assert np.flatnonzero(around).tolist() == [0, 38, 39]


def test_transfer_between_nested_meshes():
    spaces = [fem.functionspace(friedrichs_keller(COMM, n), ("Lagrange", 1)) for n in (6, 24)]
    u = fem.Function(spaces[0])
    u.interpolate(lambda x: np.sin(4.0 * x[0]) + x[1] ** 3)
    there = transfer(u, spaces[1])
    back = transfer(there, spaces[0])
    difference = back.x.array - u.x.array
    assert COMM.allreduce(float(np.abs(difference).max(initial=0.0)), op=MPI.MAX) < 1e-13
    norms = []
    for v in (u, there):
        form = fem.form(v * v * ufl.dx(metadata={"quadrature_degree": 2}))
        norms.append(COMM.allreduce(fem.assemble_scalar(form)))
    assert norms[0] == pytest.approx(norms[1], rel=1e-12)  # the same function
