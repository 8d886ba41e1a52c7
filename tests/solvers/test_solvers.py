"""Solvers: agreement with each other and with SciPy, optimality, exact scaling, honest failure."""

from contextlib import nullcontext

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from hypothesis import given
from hypothesis import strategies as st
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.errors import InputError, NotConvergedError
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.solvers import METHODS
from dolfinx_signorini.solvers.tao import FIRST_ORDER
from dolfinx_signorini.studies.paper.solution import PAPER_RULE, christof_haubner

COMM = MPI.COMM_WORLD
TIGHT = 1e-11


def paper(n, **arguments):
    """The paper's problem, its forms times a constant k, its load times another one."""
    exact = christof_haubner(friedrichs_keller(COMM, n))
    space = fem.functionspace(exact.mesh, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    k, size = (fem.Constant(exact.mesh, 1.0) for _ in range(2))
    a = k * (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    dx = ufl.Measure("dx", exact.mesh, subdomain_data=[(1, exact.support_cells())])
    load = size * k * exact.load * v * dx(1, metadata=PAPER_RULE.metadata)
    problem = SignoriniProblem(a, load, contact=boundary_facets(exact.mesh), **arguments)
    problem.k, problem.size = k, size
    return problem


def bumpy(n, factor=1.0, **arguments):
    """Contact and an obstacle at the bottom, data on top, a coefficient, load and data times k."""
    domain = friedrichs_keller(COMM, n)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    x = ufl.SpatialCoordinate(domain)
    k = fem.Constant(domain, factor)
    dx = ufl.Measure("dx", domain, metadata={"quadrature_degree": 2})
    a = (1.0 + x[0]) * ufl.inner(ufl.grad(u), ufl.grad(v)) * dx
    load = -k * (3.0 + 20.0 * (x[0] - 0.3) * (x[1] - 0.4)) * v * dx
    facets = boundary_facets(domain)
    middle = dolfinx.mesh.compute_midpoints(domain, 1, facets)
    top = fem.locate_dofs_topological(space, 1, facets[middle[:, 1] > 1 - 1e-9])
    data = fem.Function(space)
    data.x.array[:] = 0.25 * factor
    problem = SignoriniProblem(
        a,
        load,
        contact=facets[middle[:, 1] < 1e-9],
        obstacle=k * (-0.1 - 0.15 * ufl.cos(7.0 * x[0])),
        bcs=[fem.dirichletbc(data, top)],
        **arguments,
    )
    problem.size, problem.data = k, data
    return problem


@pytest.fixture(scope="module", params=["paper", "bumpy"])
def problem(request):
    problem = {"paper": paper, "bumpy": bumpy}[request.param](17)
    yield problem
    problem.destroy()


@pytest.fixture(scope="module")
def solution(problem):
    return owned(problem.solve(rtol=TIGHT))


def solved(problem, method="cascade", **arguments):
    """Solve from nothing, and return the owned values with the diagnostics."""
    u = problem.solve(method, warm_start=False, **arguments)
    return owned(u), problem.result


def owned(u):
    return u.x.array[: u.function_space.dofmap.index_map.size_local].copy()


def difference(values, others):
    """The largest difference on all ranks relative to the largest of the others."""
    parts = [float(np.abs(v).max(initial=0.0)) for v in (values - others, others)]
    top, bottom = np.max(COMM.allgather(parts), axis=0)
    return float(top / bottom)


@pytest.mark.parametrize(
    "n", [51 if COMM.size == 1 else 25, pytest.param(101, marks=pytest.mark.slow)]
)
def test_all_methods_and_scipy_agree_on_the_papers_problem(n, solve_with_scipy):
    problem = paper(n)
    reference = solve_with_scipy(problem)
    results = {m: solved(problem, m, rtol=TIGHT) for m in METHODS}
    problem.destroy()
    for method, (u, result) in results.items():
        assert difference(u, reference) <= 1e-8, method
        assert result.natural_residual <= TIGHT
    for method in ("bqnls", "bntr"):
        assert difference(results[method][0], results["bncg"][0]) <= 1e-8


@pytest.mark.parametrize("method", METHODS)
def test_default_tolerance_is_enough_for_six_digits(problem, method, solve_with_scipy):
    u, result = solved(problem, method)
    assert difference(u, solve_with_scipy(problem)) <= 1e-6
    assert result.method == method
    assert "TAO" in result.reason
    assert (result.linear_solves > 0) == (method == "cascade")
    assert (result.linear_iterations > 0) == (method not in FIRST_ORDER)


@pytest.mark.parametrize("method", METHODS)
def test_optimality_conditions(problem, method):
    u, result = solved(problem, method, rtol=TIGHT)
    x = problem.system.start(u)
    force = problem.system.multiplier(x)
    gap = u[problem.contact_dofs] - problem.obstacle
    scale = COMM.allreduce(float(np.abs(problem.b.array_r).sum()))
    assert (gap >= 0.0).all()
    assert (force >= -1e-9 * scale).all()
    assert (np.minimum(gap, force) <= 1e-9 * scale).all()
    # Both regimes are there, in numbers.
    counts = COMM.allreduce(np.array([(gap > 1e-6).sum(), (force > 1e-6 * scale).sum()]))
    assert counts.min() >= 3
    assert result.active_dofs == COMM.allreduce(int((gap == 0.0).sum()))
    # Equilibrium at all other dofs, and the Dirichlet data exactly.
    assert (u[problem.fixed_dofs] == problem.system.fixed_values).all()
    residual = problem.A.createVecLeft()
    problem.A.mult(x, residual)
    rest = residual.array_r - problem.b.array_r
    rest[problem.contact_dofs] = 0.0
    assert (np.abs(rest) <= 1e-9 * scale).all()
    x.destroy()
    residual.destroy()


@given(st.integers(0, 10**6), st.floats(-6.0, 1.0))
def test_no_feasible_vector_has_less_energy(problem, solution, seed, size):
    def energy(v):
        x, product = problem.A.createVecRight(), problem.A.createVecLeft()
        x.array_w[:] = v
        problem.A.mult(x, product)
        value = 0.5 * x.dot(product) - x.dot(problem.b)
        x.destroy()
        product.destroy()
        return value

    u = solution
    rng = np.random.default_rng([seed, COMM.rank])
    v = u + 10.0**size * rng.normal(size=len(u)) * (rng.random(len(u)) < 0.5)
    v[problem.contact_dofs] = np.maximum(v[problem.contact_dofs], problem.obstacle)
    v[problem.fixed_dofs] = problem.system.fixed_values
    least = energy(u)
    assert energy(v) >= least - 1e-12 * abs(least)


EXPONENTS = [-600, -300, -1, 1, 300, 600]


def scale_data(problem, factor):
    problem.size.value *= factor
    problem.data.x.array[:] *= factor


def assert_scaled(unit, scaled, k):
    assert np.array_equal(scaled[0], 2.0**k * unit[0])
    assert np.abs(unit[0]).max(initial=0.0) < 1.0
    for count in ("iterations", "linear_solves", "linear_iterations", "active_dofs"):
        assert getattr(scaled[1], count) == getattr(unit[1], count), count


@pytest.mark.parametrize("method", METHODS)
def test_data_times_a_power_of_two_scale_the_solution_bitwise(method):
    problem = bumpy(15)
    unit = solved(problem, method)
    for k in EXPONENTS:
        scale_data(problem, 2.0**k)
        assert_scaled(unit, solved(problem, method), k)
        scale_data(problem, 2.0**-k)
    problem.destroy()


def test_the_cascade_from_coarse_scales_bitwise():
    problems = bumpy(9), bumpy(31)

    def solve():
        problems[0].solve(warm_start=False)
        return solved(problems[1], coarse=problems[0].contact_state())

    unit = solve()
    for k in EXPONENTS:
        for problem in problems:
            scale_data(problem, 2.0**k)
        assert_scaled(unit, solve(), k)
        for problem in problems:
            scale_data(problem, 2.0**-k)
    for problem in problems:
        problem.destroy()


@pytest.mark.skipif(COMM.size > 1, reason="the order of additions to a shared entry may change")
@pytest.mark.parametrize("k", EXPONENTS)
@pytest.mark.parametrize("method", ["cascade", "bncg", "bqnls", "bntr"])
def test_forms_times_a_power_of_two_scale_the_solution_bitwise(method, k):
    results = []
    for factor in (1.0, 2.0**k):
        problem = bumpy(15, factor)
        results.append(solved(problem, method))
        problem.destroy()
    assert_scaled(*results, k)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("factor", [1e-200, 1e-12, 1e9])
def test_the_operators_size_does_not_matter(method, factor):
    problem = paper(11)
    reference, _ = solved(problem, method, rtol=TIGHT)
    problem.k.value = factor
    scaled, _ = solved(problem, method, rtol=TIGHT)
    problem.destroy()
    assert difference(scaled, reference) <= 1e-9


@pytest.mark.parametrize("method", METHODS)
def test_nothing_to_do_is_done_at_once(method):
    problem = paper(7)
    problem.size.value = 0.0
    u, result = solved(problem, method)
    problem.destroy()
    assert not u.any()
    assert result.natural_residual == 0.0
    assert result.active_dofs == 4 * 7


@pytest.mark.parametrize("method", ["bncg", "bqnls", "bntr"])
@pytest.mark.parametrize(
    ("limit", "word"), [("max_iterations", "iteration"), ("max_evaluations", "evaluation")]
)
def test_limits_raise_with_residual_and_reason(problem, method, limit, word):
    with pytest.raises(NotConvergedError, match=method) as caught:
        problem.solve(method, warm_start=False, **{limit: 3})
    assert word in caught.value.reason
    assert 1e-8 < caught.value.residual < 10.0
    assert f"{caught.value.residual:.3g}" in str(caught.value)


def test_an_accuracy_beyond_rounding_is_not_claimed(problem):
    for method in ("cascade", "bqnls", "bntr"):
        try:
            _, result = solved(problem, method, rtol=1e-18)
        except NotConvergedError as error:
            assert 1e-18 < error.residual < 1e-10
        else:
            assert result.natural_residual <= 1e-18


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("make", [paper, bumpy])
def test_options_act_and_do_not_leak(make, method):
    before = PETSc.Options().getAll()
    options = {
        "cascade": {"pc_type": "jacobi", "ksp_max_it": 150},
        "bncg": {"tao_bncg_type": "hs"},
        "bqnls": {"tao_bqnls_mat_lmvm_hist_size": 2, "tao_ls_type": "armijo"},
        "blmvm": {"tao_blmvm_mat_lmvm_hist_size": 2},
        "tron": {"pc_type": "jacobi"},
    }.get(method, {"tao_bnk_pc_type": "jacobi"})
    problems = make(17), make(17, petsc_options=options)
    (usual, r), (other, s) = (solved(problem, method) for problem in problems)
    for problem in problems:
        problem.destroy()
    assert PETSc.Options().getAll() == before
    assert difference(other, usual) <= 1e-6
    counts = [(r.iterations, r.linear_solves, r.linear_iterations) for r in (r, s)]
    assert counts[0] != counts[1]


@pytest.mark.parametrize("method", ["cascade", "bncg"])
def test_the_options_of_the_database_are_the_users(method):
    """What a user has set under the prefix acts, wins, and is there afterwards."""
    database, name = (
        PETSc.Options(),
        "mine_ksp_max_it" if method == "cascade" else "mine_tao_max_it",
    )
    option = name.removeprefix("mine_")
    database[name] = 1
    try:
        problem = paper(17, petsc_options_prefix="mine_", petsc_options={option: 77})
        with pytest.raises(NotConvergedError) if method == "bncg" else nullcontext():
            problem.solve(method)
        problem.destroy()
        assert database.getInt(name) == 1
    finally:
        database.delValue(name)


@pytest.mark.parametrize(
    ("method", "options"),
    [("bncg", {"tao_bncg_type": "nonsense"}), ("cascade", {"ksp_type": "nonsense"})],
)
def test_options_do_not_leak_from_a_failure(problem, method, options):
    before = PETSc.Options().getAll()
    wrong = paper(9, petsc_options=options)
    with pytest.raises(InputError, match="petsc_options: "):
        wrong.solve(method)
    assert PETSc.Options().getAll() == before
    problem.solve(method)


@pytest.mark.parametrize("method", ["bncg", "bqnls", "bntr"])
def test_a_start_is_used_and_lifted_and_not_overwritten(method):
    coarse, fine = paper(15), paper(31)
    start = fem.Function(fine.space)
    cells = np.arange(
        fine.space.mesh.topology.index_map(2).size_local
        + fine.space.mesh.topology.index_map(2).num_ghosts,
        dtype=np.int32,
    )
    data = fem.create_interpolation_data(fine.space, coarse.space, cells, padding=1e-6)
    start.interpolate_nonmatching(coarse.solve(), cells, data)
    start.x.scatter_forward()
    (u, _), warm = solved(fine, method), solved(fine, method, start=start)
    solution = fine.u.copy()
    solution.x.array[: len(u)] = u
    again = solved(fine, method, start=solution)
    kept = owned(start)
    start.x.array[:] -= 1.0  # below the obstacle: it is lifted
    below = solved(fine, method, start=start)
    for problem in (coarse, fine):
        problem.destroy()
    # From a coarse solution all of them can take as long: what is left is slow.
    assert again[1].iterations == 0
    for values, _ in (warm, again, below):
        assert difference(values, u) <= 1e-6
    assert np.array_equal(owned(start), kept - 1.0)  # the start is not overwritten


def test_wrong_arguments_are_named(problem):
    problem.solve()
    state = problem.contact_state()
    for method, arguments, name in (
        ("newton", {}, "method"),
        ("cascade", {"rtol": 0.0}, "rtol"),
        ("cascade", {"rtol": float("nan")}, "rtol"),
        ("bncg", {"rtol": 1.0}, "rtol"),
        ("bncg", {"rtol": -1e-8}, "rtol"),
        ("cascade", {"max_iterations": 3}, "max_iterations"),
        ("bqnls", {"coarse": state}, "coarse"),
    ):
        with pytest.raises(InputError, match=name):
            problem.solve(method, **arguments)


@pytest.mark.parametrize(
    ("method", "options", "name"),
    [
        ("cascade", {"ksp_typ": "cg"}, "'ksp_typ' is no option that the solver reads; did you"),
        ("cascade", {"nonsense": 1}, "'nonsense'"),
        ("bncg", {"tao_bncg_typ": "prp"}, "'tao_bncg_typ'"),
        ("bntr", {"tao_bnk_ksp_typ": "cg"}, "'tao_bnk_ksp_typ'"),
        ("tron", {"kps_type": "cg"}, "'kps_type'"),
    ],
)
def test_options_that_nobody_reads_are_warned_of_once(method, options, name, caplog):
    problem = bumpy(9, petsc_options=options)
    problem.solve(method)
    told = sum(name in message for message in caplog.messages)
    assert told == (COMM.rank == 0)
    problem.destroy()
    assert not PETSc.Options().hasName(next(iter(options)))


@pytest.mark.parametrize(
    "options",
    [
        {"pc_type": "bjacobi", "sub_pc_type": "ilu"},
        {"pc_type": "gamg", "mg_levels_ksp_type": "chebyshev", "mg_levels_ksp_max_it": 3},
        {"pc_type": "gamg", "mg_coarse_pc_type": "redundant"},
    ],
)
def test_options_of_what_exists_after_the_set_up_alone_are_read(options, caplog):
    problem = bumpy(33, petsc_options=options)
    problem.solve(rtol=1e-8)
    assert caplog.messages == []
    assert problem.result.natural_residual <= 1e-8
    problem.destroy()


@pytest.mark.parametrize(
    ("options", "name"),
    [({"ksp_rtol": "tight"}, "ksp_rtol"), ({"ksp_type": "nonsense"}, "ksp_type")],
)
def test_values_of_options_that_petsc_does_not_take_are_refused(options, name):
    problem = bumpy(9, petsc_options=options)
    with pytest.raises(InputError, match=name) as caught:
        problem.solve()
    assert caught.value.subject == "petsc_options"
    problem.destroy()
    assert not PETSc.Options().hasName(name)


@pytest.mark.parametrize("method", METHODS)
def test_options_may_be_for_several_methods(method):
    options = {
        "ksp_max_it": 300,
        "pc_hypre_boomeramg_strong_threshold": 0.4,
        "tao_max_it": 5000,
        "tao_bncg_type": "prp",
        "tao_bnk_ksp_max_it": 300,
    }
    problem = bumpy(9, petsc_options=options)
    problem.solve(method)
    problem.destroy()
