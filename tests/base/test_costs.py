"""Costs: what a problem does not mention is not made, and what a problem holds is counted."""

import argparse
from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini import SignoriniProblem, error_norms, friedrichs_keller
from dolfinx_signorini.base.costs import cost_text, costs_of, describe
from dolfinx_signorini.commands import reproduce
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.norms.references import discrete
from dolfinx_signorini.problem import assembly

COMM = MPI.COMM_WORLD


def pose(reaction=False, dirichlet=False, flux=False, n=8):
    """A problem with some terms and conditions, or without them."""
    domain = friedrichs_keller(COMM, n)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    one = fem.Constant(domain, 1.0)
    a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    if reaction:
        a += one * u * v * ufl.dx
    L = -one * v * ufl.dx
    if flux:
        L += 0.1 * one * v * ufl.ds
    bcs = []
    if dirichlet:
        bcs = [fem.dirichletbc(1.0, _dofs(space, lambda x: x[1] > 1 - 1e-9), space)]
    contact = mesh.locate_entities_boundary(domain, 1, lambda x: x[1] < 1e-9)
    return SignoriniProblem(a, L, contact=contact, bcs=bcs)


def _dofs(space, where):
    return fem.locate_dofs_topological(
        space, 1, mesh.locate_entities_boundary(space.mesh, 1, where)
    )


def names(problem):
    return " ".join(f"{cost.kind} {cost.name};" for cost in problem.costs())


WORDS = {"reaction": "reaction on cells", "dirichlet": "fixed", "flux": "flux on the boundary"}


@pytest.mark.parametrize("wanted", [(), ("reaction",), ("dirichlet",), ("flux",), tuple(WORDS)])
def test_costs_name_what_the_problem_mentions_and_nothing_else(wanted):
    problem = pose(**{word: True for word in wanted})
    problem.solve()
    text = names(problem)
    for key, word in WORDS.items():
        assert (word in text) == (key in wanted), text
    assert "diffusion on cells" in text and "load on cells" in text
    assert "exact" not in text
    assert "array system layout entities" in text  # which the constraint holds, too
    problem.destroy()


def test_a_bare_problem_makes_none_of_what_it_does_not_need(monkeypatch):
    """Lifting, Dirichlet functions, obstacle functions and closed forms are not touched."""

    def forbidden(*args, **kwargs):
        raise AssertionError("made without need")

    class SolutionOnly(fem.Function):
        def __init__(self, space, name):
            assert name == "u", "made without need"
            super().__init__(space, name=name)

    monkeypatch.setattr(assembly.fem_petsc, "apply_lifting", forbidden)
    monkeypatch.setattr(assembly.fem, "Function", SolutionOnly)
    monkeypatch.setattr(assembly.fem, "Expression", forbidden)
    problem = pose()
    monkeypatch.undo()
    # Without a reaction the matrix has no mass in it: it vanishes on constants.
    ones, product = problem.A.createVecs()
    ones.set(1.0)
    problem.A.mult(ones, product)
    assert product.norm(PETSc.NormType.INFINITY) < 1e-13
    assert len(problem.fixed_dofs) == len(problem.system.fixed_values) == 0
    kinds = {(cost.kind, cost.name) for cost in problem.costs()}
    assert {name for kind, name in kinds if kind == "matrix"} == {"system A"}
    assert {name for kind, name in kinds if kind == "vector"} == {"system b"}
    sizes = {cost.name: cost.bytes for cost in problem.costs() if cost.kind == "array"}
    # Beside the solution with its ghosts, arrays over the contact boundary, and the constant that
    # only contact holds, with the number of the component of each dof.
    owned = problem.unknowns * np.dtype(PETSc.ScalarType).itemsize
    assert sizes.pop("u") >= owned
    assert sizes.pop("system loose numbers") >= 0 and sizes.pop("system loose rows") >= 0
    assert all(size <= 8 * COMM.size * 10 for size in sizes.values())
    for item in (ones, product):
        item.destroy()
    problem.destroy()


def test_the_guard_of_the_bare_problem_can_fail(monkeypatch):
    """With Dirichlet data the same guard is met."""

    def forbidden(*args, **kwargs):
        raise AssertionError("made without need")

    monkeypatch.setattr(assembly.fem_petsc, "apply_lifting", forbidden)
    with pytest.raises(AssertionError, match="made without need"):
        pose(dirichlet=True)


def test_norms_of_discrete_functions_compile_nothing(monkeypatch):
    """No closed form, no load: discrete functions are tabulated."""
    problem = pose(reaction=True)
    u = problem.solve()
    problem.destroy()
    finer = fem.Function(fem.functionspace(u.function_space.mesh, ("Lagrange", 3)))
    monkeypatch.delattr(fem, "Expression")
    names = ["L4", "W1_4", "Linf", "W1_inf", "H1_boundary", "Linf_boundary"]
    assert all(value > 0.0 for value in error_norms(u, None, names).values())
    assert error_norms(u, discrete(finer), names) == pytest.approx(error_norms(u, None, names))


def test_bytes_are_those_of_the_entries():
    problem = pose(dirichlet=True)
    costs = {cost.name: cost for cost in problem.costs()}
    rows = problem.unknowns
    number, index = np.dtype(PETSc.ScalarType).itemsize, np.dtype(PETSc.IntType).itemsize
    assert costs["system b"].bytes == rows * number
    entries = COMM.allreduce(len(problem.A.getValuesCSR()[1]))
    stored = costs["system A"].bytes - entries * (number + index)
    assert rows * index <= stored <= (rows + COMM.size) * index
    contact = COMM.allreduce(len(problem.contact_dofs))
    parts = ("system layout contact_dofs", "system obstacle", "system contact_diagonal")
    assert [costs[name].bytes for name in parts] == [contact * size for size in (4, 8, 8)]
    fixed = COMM.allreduce(len(problem.fixed_dofs))
    parts = ("system layout fixed_dofs", "system fixed_values")
    assert fixed == 9 and [costs[name].bytes for name in parts] == [fixed * 4, fixed * 8]
    problem.destroy()


def test_solving_again_does_not_pile_up():
    problem = pose(reaction=True)
    problem.solve()
    first = [replace(cost, seconds=0.0) for cost in problem.costs()]
    problem.solve(warm_start=False)
    assert [replace(cost, seconds=0.0) for cost in problem.costs()] == first
    problem.destroy()


@pytest.mark.skipif(COMM.size > 1, reason="Cholesky factors are those of one rank")
def test_factors_are_counted_until_they_are_freed():
    """The factors of a matrix have a diagonal entry for each row at the least."""
    problem = pose(reaction=True)
    problem.solve()
    (factors,) = (cost for cost in problem.costs() if cost.name == "solver linear factored")
    assert factors.bytes >= problem.unknowns * np.dtype(PETSc.ScalarType).itemsize
    problem.solve("bqnls", warm_start=False)
    assert "factored" not in names(problem)
    problem.destroy()


def test_the_cascade_has_no_matrix_of_its_own_with_tao_alone():
    problem = pose(reaction=True)
    problem.solve("bqnls")
    assert "solver linear matrix" not in names(problem)
    problem.solve(warm_start=False)
    assert "solver linear matrix" in names(problem)
    problem.destroy()


def test_ranks_are_added_up_and_the_slowest_counts():
    held = [np.zeros(COMM.rank + 1), [np.zeros(0), np.zeros(COMM.rank)]]
    array, phase = costs_of(COMM, held, {}, {"some": 1.0 + COMM.rank})
    assert array.bytes == 8 * COMM.size**2
    assert array.count == 3 and phase.seconds == COMM.size
    assert costs_of(COMM, [np.zeros(0)], {}, {}) == []


def test_terms_in_words():
    domain = friedrichs_keller(COMM, 2)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    ds = ufl.Measure("ds", domain, subdomain_data=[(1, boundary_facets(domain)[:0])])
    assert describe((ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx) == (
        "diffusion on cells, reaction on cells"
    )
    assert describe(u * v * ds(1)) == "reaction on the boundary"
    assert describe(v * ufl.dx + 2.0 * v * ufl.dx) == "load on cells"


def test_reproduce_prints_the_costs(folder, capsys):
    parser = argparse.ArgumentParser()
    reproduce.configure(parser)
    assert reproduce.run(parser.parse_args(["--max-n=101", f"--out={folder}", "--costs"])) == 0
    output = capsys.readouterr().out
    if COMM.rank == 0:
        for word in ("Costs of N = 101", "reaction on cells", "exact solution"):
            assert word in output
        assert "Dirichlet" not in output and "flux" not in output
    assert cost_text([]).splitlines()[-1].split() == ["all", "0.000"]
