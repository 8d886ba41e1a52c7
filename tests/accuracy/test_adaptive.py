"""The adaptive loop on a user's own forms and meshes, for solutions that are known."""

from unittest import mock

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from scipy.integrate import quad
from ufl.domain import extract_unique_domain

from dolfinx_signorini import SignoriniProblem
from dolfinx_signorini.accuracy import adaptive, loop
from dolfinx_signorini.accuracy.adaptive import solve_adaptively
from dolfinx_signorini.accuracy.indicators import indicators
from dolfinx_signorini.accuracy.loop import _unknowns
from dolfinx_signorini.accuracy.targets import checked_target, target
from dolfinx_signorini.accuracy.terms import Solution, Solved, difference
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.tolerances import PRECISION, ROUNDING
from dolfinx_signorini.meshes.box_meshes import box_mesh, friedrichs_keller
from dolfinx_signorini.meshes.refinement import Transfer, refined
from dolfinx_signorini.meshes.sided_meshes import (
    SidedMesh,
    boundary_facets,
    longest_side,
    owned_cells,
)
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.references import Reference

POINT = 0.41337


def known(x, y):
    """The solution: -r^(3/2) sin(3t/2) around the point where contact ends."""
    x = x - POINT
    return -(np.hypot(x, y) ** 1.5) * np.sin(1.5 * np.arctan2(np.abs(y), x))


def known_in_ufl(domain):
    x, y = ufl.SpatialCoordinate(domain)
    r = ufl.sqrt((x - POINT) ** 2 + y**2)
    return -(r**1.5) * ufl.sin(1.5 * ufl.atan2(abs(y), x - POINT))


def square(comm, n=4):
    domain = friedrichs_keller(comm, n)
    bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    top = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 1.0))
    rest = mesh.locate_entities_boundary(
        domain, 1, lambda x: np.isclose(x[1], 1.0) | np.isclose(np.abs(x[0] - 0.5), 0.5)
    )
    return SidedMesh(domain, {"bottom": bottom, "top": top, "rest": rest})


def poser(degree=2, sign=1.0):
    """Pose -div grad u + u = f, with contact below and Dirichlet data elsewhere."""

    def pose(sided):
        space = fem.functionspace(sided.mesh, ("Lagrange", degree))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        data = fem.Function(space)
        data.interpolate(lambda x: sign * known(x[0], x[1]))
        dofs = fem.locate_dofs_topological(space, 1, sided.sides["rest"])
        dx = ufl.dx(metadata={"quadrature_degree": 2 * degree + 2})
        return SignoriniProblem(
            (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * dx,
            sign * known_in_ufl(sided.mesh) * v * dx,
            contact=sided.sides["bottom"],
            obstacle=0.0,
            bound="lower" if sign > 0.0 else "upper",
            bcs=[fem.dirichletbc(data, dofs)],
        )

    return pose


def true_error(found, norm, exact):
    """The norm of the error of the solution that was found, for an expression in coordinates."""
    u = found.problem.u
    reference = expression(u.function_space.mesh, exact)
    return error_norms(u, reference, [norm])[norm]


def expression(domain, exact):
    value = exact(domain)
    gradient = ufl.grad(value)
    return Reference(domain, value, tuple(gradient[k] for k in range(domain.geometry.dim)))


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize(
    ("norm", "accuracy"), [("L4", 1e-3), ("H1", 3e-2), ("Linf", 3e-3), ("L2_boundary", 2e-4)]
)
def test_the_accuracy_is_met_and_not_by_far(comm, degree, norm, accuracy):
    found = solve_adaptively(
        poser(degree), square(comm), norm=norm, accuracy=accuracy, max_unknowns=200_000
    )
    error = true_error(found, norm, known_in_ufl)
    assert found.reached and found.stopped == "the accuracy is reached"
    assert error <= found.estimate <= accuracy
    assert error >= 0.02 * accuracy
    # The loop ends at the first step whose estimate is small enough.
    assert all(step.estimate > accuracy for step in found.steps[:-1])
    assert found.problem.unknowns == found.steps[-1].unknowns
    found.problem.destroy()


def mean():
    """The mean of the known solution, by adaptive quadrature along each line."""
    inner = lambda y: quad(known, 0.0, 1.0, (y,), points=[POINT], epsabs=1e-12)[0]  # noqa: E731
    return quad(inner, 0.0, 1.0, epsabs=1e-10, limit=200)[0]


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("accuracy", [1e-3, 1e-5])
def test_a_functional_of_the_solution_is_met(comm, degree, accuracy):
    found = solve_adaptively(
        poser(degree), square(comm), norm=lambda v: v * ufl.dx, accuracy=accuracy
    )
    value = comm.allreduce(fem.assemble_scalar(fem.form(found.problem.u * ufl.dx)))
    assert found.reached
    assert abs(value - mean()) <= accuracy
    assert found.estimate <= accuracy
    found.problem.destroy()


@pytest.mark.parametrize("degree", [1, 2])
def test_an_upper_obstacle_is_a_lower_one_upside_down(comm, degree):
    lower, upper = (
        solve_adaptively(poser(degree, sign), square(comm), norm="L4", accuracy=1e-3)
        for sign in (1.0, -1.0)
    )
    steps = [[(s.unknowns, s.estimate) for s in f.steps] for f in (lower, upper)]
    assert [s[0] for s in steps[0]] == [s[0] for s in steps[1]]
    assert [s[1] for s in steps[0]] == pytest.approx([s[1] for s in steps[1]], rel=1e-4)
    assert true_error(upper, "L4", lambda domain: -known_in_ufl(domain)) <= 1e-3
    for found in (lower, upper):
        found.problem.destroy()


@pytest.mark.parametrize("limit", [400, 1500, 6000])
@pytest.mark.parametrize("degree", [1, 2])
def test_the_limit_on_unknowns_is_kept(comm, degree, limit):
    told = []
    found = solve_adaptively(
        poser(degree),
        square(comm),
        norm="H1",
        accuracy=1e-9,
        max_unknowns=limit,
        on_step=told.append,
    )
    assert not found.reached
    assert found.stopped == f"a finer mesh has more than {limit} unknowns"
    assert tuple(told) == found.steps
    assert all(step.unknowns <= limit for step in found.steps)
    assert found.problem.unknowns >= limit / 8
    found.problem.destroy()


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_first_mesh_that_is_too_large_is_refused(comm, degree):
    nodes = (degree * 8 + 1) ** 2
    with pytest.raises(InputError, match=f"need {nodes}, not {nodes - 1}"):
        solve_adaptively(poser(degree), square(comm), accuracy=1.0, max_unknowns=nodes - 1)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_unknowns_of_a_divided_mesh_are_known_before(comm, dim):
    sided = SidedMesh(box_mesh(comm, dim * [[0.0, 0.3, 1.0]]), {})
    for degree in range(1, 5):
        space = fem.functionspace(refined(sided).sided.mesh, ("Lagrange", degree))
        assert _unknowns(sided, space) == space.dofmap.index_map.size_global


def test_the_errors_of_cells_add_up_to_the_estimate(comm):
    found = solve_adaptively(poser(), square(comm), norm="H1", accuracy=0.05)
    assert len(found.cells) == len(owned_cells(found.problem.space.mesh))
    # Each division into four cells has the error of the cell four times.
    whole = np.sqrt(comm.allreduce((found.cells**2).sum()) / 4.0)
    assert whole == pytest.approx(found.estimate, rel=1e-9)
    found.problem.destroy()


def smooth_poser(width, degree=2):
    """Pose a problem whose solution, a bump of a width, is smooth; return the solution, too."""

    def value(domain):
        x, y = ufl.SpatialCoordinate(domain)
        return ufl.exp(-((x - 0.53) ** 2 + (y - 0.57) ** 2) / width**2)

    def pose(sided):
        space = fem.functionspace(sided.mesh, ("Lagrange", degree))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        exact = value(sided.mesh)
        load = exact - ufl.div(ufl.grad(exact))
        dx = ufl.dx(metadata={"quadrature_degree": 12})
        dofs = fem.locate_dofs_topological(space, 1, boundary_facets(sided.mesh))
        zero = fem.Function(space)
        zero.interpolate(lambda x: np.exp(-((x[0] - 0.53) ** 2 + (x[1] - 0.57) ** 2) / width**2))
        return SignoriniProblem(
            (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * dx,
            load * v * dx,
            contact=sided.sides["bottom"],
            obstacle=-1.0,
            bcs=[fem.dirichletbc(zero, dofs)],
        )

    return pose, value


def flux(v):
    """The flux through the side x = 1: the dual solution jumps there."""
    domain = extract_unique_domain(v)
    x, n = ufl.SpatialCoordinate(domain), ufl.FacetNormal(domain)
    on_side = ufl.conditional(ufl.gt(x[0], 1.0 - 1e-9), 1.0, 0.0)
    return on_side * ufl.inner(ufl.grad(v), n) * ufl.ds(metadata={"quadrature_degree": 12})


@pytest.mark.parametrize("asked", ["L2", "W1_4", "L2_boundary", lambda v: v * ufl.dx, flux])
@pytest.mark.parametrize("degree", [1, 2])
def test_smooth_solutions_converge_as_fast_as_a_target_says(comm, degree, asked):
    pose, exact = smooth_poser(0.4, degree)
    wanted, errors = target(asked), []
    for n in (16, 32):
        problem = pose(square(comm, n))
        u = problem.solve(rtol=1e-11)
        reference = expression(u.function_space.mesh, exact)
        wanted = checked_target(wanted, u.function_space)
        if wanted.norm is not None:
            errors.append(error_norms(u, reference, [asked])[asked])
        else:
            measured = asked if asked is flux else lambda v: v * ufl.dx(degree=12)
            form = fem.form(measured(u - reference.u))
            errors.append(abs(comm.allreduce(fem.assemble_scalar(form))))
        problem.destroy()
    assert np.log2(errors[0] / errors[1]) == pytest.approx(wanted.order(degree), abs=0.4)


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("accuracy", [1e-1, 1e-2, 1e-3])
def test_the_flux_through_a_side_is_met(comm, degree, accuracy):
    pose, exact = smooth_poser(0.4, degree)
    found = solve_adaptively(pose, square(comm), norm=flux, accuracy=accuracy, max_unknowns=200_000)
    u = found.problem.u
    form = fem.form(flux(u - exact(u.function_space.mesh)))
    error = abs(comm.allreduce(fem.assemble_scalar(form)))
    assert found.reached and error <= found.estimate <= accuracy
    found.problem.destroy()


@pytest.mark.parametrize(
    ("norm", "accuracy", "aimed"), [("H1", 1e-2, 0.8), ("L4", 1e-4, 0.8), ("Linf", 1e-3, 0.6)]
)
def test_estimates_of_smooth_solutions_are_safe_and_sharp(comm, norm, accuracy, aimed):
    pose, exact = smooth_poser(0.3)
    shares = []
    for each in accuracy * 2.0 ** (-0.5 * np.arange(6)):
        found = solve_adaptively(pose, square(comm), norm=norm, accuracy=each)
        assert 1.0 <= found.estimate / true_error(found, norm, exact) <= 4.0
        shares.append(found.estimate / each)
        found.problem.destroy()
    assert max(shares) <= 1.0
    assert np.mean(shares) >= aimed  # a step aims at the accuracy


@pytest.mark.parametrize(("norm", "accuracy"), [("H1", 1e-2), ("L4", 1e-4), ("Linf", 1e-3)])
def test_a_step_aims_at_the_accuracy(comm, norm, accuracy):
    pose, _exact = smooth_poser(0.3)
    found = solve_adaptively(pose, square(comm), norm=norm, accuracy=accuracy)
    assert 0.6 * accuracy <= found.estimate
    found.problem.destroy()


def test_a_bump_between_the_nodes_is_found(comm):
    pose, exact = smooth_poser(0.03)
    found = solve_adaptively(pose, square(comm), norm="L4", accuracy=1e-3)
    assert true_error(found, "L4", exact) <= found.estimate <= 1e-3
    found.problem.destroy()


def test_a_load_that_two_meshes_do_not_see_is_looked_for(comm):
    """The load acts on a small disc between the quadrature points of the first two meshes."""

    def pose(sided):
        space = fem.functionspace(sided.mesh, ("Lagrange", 1))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        x, y = ufl.SpatialCoordinate(sided.mesh)
        load = ufl.conditional((x - 0.404) ** 2 + (y - 0.308) ** 2 < 0.004**2, 1e3, 0.0)
        return SignoriniProblem(
            (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx,
            load * v * ufl.dx(degree=2),
            contact=sided.sides["bottom"],
            obstacle=0.0,
        )

    found = solve_adaptively(pose, square(comm, 3), norm="L2", accuracy=1e-2, read_data=False)
    assert found.steps[0].estimate == 0.0 and len(found.steps) > 1
    assert found.problem.unknowns > found.steps[0].unknowns
    found.problem.destroy()


@pytest.fixture
def two_solutions(comm):
    """The solution on a mesh, the solved problem on its division, and the parents."""
    sided = square(comm)
    division = refined(sided)
    problems = [poser()(sided), poser()(division.sided)]
    for problem in problems:
        problem.solve()
    yield Solution(problems[0].u, problems[0].forces), problems[1], division.parents
    for problem in problems:
        problem.destroy()


def test_indicators_follow_the_unit_of_a_functional(two_solutions):
    once, tenfold = (
        indicators(Solved(*two_solutions, target(lambda v, k=k: k * v * ufl.dx)))
        for k in (1.0, 10.0)
    )
    assert tenfold.difference == pytest.approx(10.0 * once.difference, rel=1e-9)
    assert tenfold.cells == pytest.approx(10.0 * once.cells, rel=1e-2)


def part(v, side):
    x = ufl.SpatialCoordinate(extract_unique_domain(v))
    return ufl.conditional(ufl.gt(side * (x[0] - 0.5), 0.0), 1.0, 0.0) * v * ufl.dx


@pytest.mark.parametrize(
    "asked",
    ["L2", "L4", "L2_boundary", lambda v: v * ufl.dx, lambda v: part(v, 1.0), lambda v: v * ufl.ds],
)
def test_weighted_indicators_make_up_the_difference(comm, two_solutions, asked):
    found = indicators(Solved(*two_solutions, target(asked)))
    # The bound of duality, but for the residual of the dual solution.
    assert comm.allreduce(found.cells.sum()) >= 0.999 * found.difference > 0.0


def test_a_functional_of_one_side_asks_for_cells_there(comm, two_solutions):
    domain = two_solutions[0].u.function_space.mesh
    x = mesh.compute_midpoints(domain, 2, owned_cells(domain))[:, 0]
    left, right = (
        indicators(Solved(*two_solutions, target(lambda v, s=s: part(v, s)))).cells
        for s in (-1.0, 1.0)
    )
    ratio = left / right
    inside = comm.allgather((ratio[x < 0.3].tolist(), ratio[x > 0.7].tolist()))
    lefts, rights = (np.concatenate([np.array(part[k]) for part in inside]) for k in (0, 1))
    assert np.median(lefts) > 3.0 * np.median(rights)


def test_sup_norm_indicators_are_local(two_solutions):
    coarse, fine, parents = two_solutions
    found = indicators(Solved(coarse, fine, parents, target("Linf")))
    transfer = Transfer(coarse.u.function_space, fine.space, parents)
    detail = difference(fine.u, transfer.prolong(transfer.restrict(fine.u)))
    nodes = np.abs(detail.x.array[fine.space.dofmap.list[: len(parents)]]).max(axis=1)
    largest = np.zeros(len(found.cells))
    np.maximum.at(largest, parents, nodes)
    assert (found.cells >= largest - 1e-14).all()
    assert (found.cells <= 3.0 * largest + 1e-12).all()


@pytest.mark.parametrize("kind", ["square", "cube"])
def test_a_mesh_of_ones_own_is_adapted(comm, kind):
    """A mesh without sides, and forms with a Robin condition in place of Dirichlet data."""

    def exact(domain):
        x = ufl.SpatialCoordinate(domain)
        return 1.0 + ufl.exp(-x[0] * x[1]) + x[1]

    domain = mesh.create_unit_cube(comm, 2, 2, 2) if kind == "cube" else friedrichs_keller(comm, 6)

    def pose(sided):
        space = fem.functionspace(sided.mesh, ("Lagrange", 2))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        value = exact(sided.mesh)
        n = ufl.FacetNormal(sided.mesh)
        dx = ufl.dx(metadata={"quadrature_degree": 8})
        ds = ufl.ds(metadata={"quadrature_degree": 8})
        return SignoriniProblem(
            ufl.inner(ufl.grad(u), ufl.grad(v)) * dx + u * v * ds,
            -ufl.div(ufl.grad(value)) * v * dx + (value + ufl.dot(ufl.grad(value), n)) * v * ds,
            contact=boundary_facets(sided.mesh),
            obstacle=0.0,
        )

    found = solve_adaptively(pose, SidedMesh(domain, {}), norm="H1", accuracy=2e-2)
    assert found.reached
    assert true_error(found, "H1", exact) <= found.estimate <= 2e-2
    found.problem.destroy()


@pytest.mark.parametrize("name", ["accuracy", "budget", "max_unknowns"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), "1"])
def test_limits_that_make_no_sense_are_refused(comm, name, value):
    given = {"accuracy": 1e-3} | {name: value}
    with pytest.raises(InputError) as refusal:
        solve_adaptively(poser(), square(comm), **given)
    assert refusal.value.subject == name


def test_problems_on_other_meshes_and_wrong_degrees_are_refused(comm):
    first = square(comm)
    quadrilaterals = mesh.create_unit_square(comm, 2, 2, mesh.CellType.quadrilateral)
    for pose, sided in (
        (lambda sided: poser()(first), first),
        ({"2": poser()}, first),
        (poser(), SidedMesh(quadrilaterals, {})),
    ):
        with pytest.raises(InputError) as refusal:
            solve_adaptively(pose, sided, accuracy=1e-3)
        assert refusal.value.subject == ("pose" if sided is first else "sided")


def test_a_functional_that_is_not_linear_is_refused(comm):
    with pytest.raises(InputError, match="linear") as refusal:
        solve_adaptively(poser(), square(comm), norm=lambda u: u**2 * ufl.dx, accuracy=1e-3)
    assert refusal.value.subject == "norm"


def place(v):
    return ufl.SpatialCoordinate(extract_unique_domain(v))


def half(v):
    domain, cells = v.ufl_function_space().mesh, np.arange(1, dtype=np.int32)
    tags = mesh.meshtags(domain, 2, cells, np.ones_like(cells))
    return v * ufl.dx + v * ufl.dx(1, domain=domain, subdomain_data=tags)


@pytest.mark.parametrize(
    ("functional", "word"),
    [
        (lambda v: 0 * v * ufl.dx, "no form: ValueError"),
        (lambda v: 0.0 * v**2 * ufl.dx, "no form: ValueError"),
        (lambda v: ufl.Form([]), "0 for all"),
        (lambda v: v * ufl.dx(7), "0 for all"),
        (lambda v: ufl.sqrt(-1.0 - place(v)[0] ** 2) * v * ufl.dx, "finite"),
        (half, "subdomain_data"),
        (lambda v: v.no_such_thing, "no form: AttributeError"),
    ],
)
def test_a_functional_that_tells_nothing_is_refused(comm, functional, word):
    with pytest.raises(InputError, match=word) as refusal:
        solve_adaptively(poser(), square(comm), norm=functional, accuracy=1e-3)
    assert refusal.value.subject == "norm"


def test_the_first_step_does_not_tell_the_seconds_of_the_next_one(comm):
    """The first step may have compiled forms: a second one follows, even if the time is over."""
    found = solve_adaptively(poser(), square(comm), norm="H1", budget=1e-6)
    assert len(found.steps) == 2 and "longer than the time that is left" in found.stopped
    found.problem.destroy()


def test_an_accuracy_or_a_budget_is_needed(comm):
    with pytest.raises(InputError, match="accuracy or a budget"):
        solve_adaptively(poser(), square(comm))


@pytest.mark.parametrize(
    ("norm", "lost"), [("W1_inf", 1.0), ("W1_4", 0.5), ("H1", 0.0), ("L4", 0.0)]
)
def test_smaller_cells_ask_for_smaller_residuals_where_derivatives_do(comm, norm, lost):
    """A difference over h^(1 - d/p): the residual of a solve is that of its own mesh."""
    loops = []

    class Watched(loop.Loop):
        def __init__(self, *args):
            super().__init__(*args)
            loops.append(self)

    with mock.patch.object(adaptive, "Loop", Watched):
        found = solve_adaptively(poser(2), square(comm), norm=norm, accuracy=0.3, rtol=1e-3)
    (used,), fine = loops, refined(refined(found.sided).sided).sided
    used.share = 1e-6
    rtol, finer = (used.keywords_on(part.mesh)["rtol"] for part in (found.sided, fine))
    assert rtol / finer == pytest.approx(4.0**lost, rel=1e-9)
    # Cells as small as that have rounding as large as what is asked for, and smaller ones more.
    smallest = used._smallest_size()
    assert (smallest > 0.0) == (lost > 0.0)
    if lost:
        rounded = ROUNDING * used.whole * (longest_side(found.sided.mesh) / smallest) ** lost
        assert rounded == pytest.approx(0.3, rel=1e-9)
    found.problem.destroy()


def test_a_loop_that_has_come_to_rounding_ends(comm):
    """The solution is a polynomial of the degree of the elements: all that is left is rounding."""

    def pose(sided):
        space = fem.functionspace(sided.mesh, ("Lagrange", 2))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        data = fem.Function(space)
        data.interpolate(lambda x: 1.0 + x[0] * x[1])
        dofs = fem.locate_dofs_topological(space, 1, boundary_facets(sided.mesh))
        zero = fem.Constant(sided.mesh, 0.0)
        return SignoriniProblem(
            ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
            zero * v * ufl.dx,
            contact=sided.sides["bottom"],
            obstacle=0.0,
            bcs=[fem.dirichletbc(data, dofs)],
        )

    found = solve_adaptively(pose, square(comm), norm="L2", accuracy=1e-40, max_unknowns=1_000_000)
    assert found.stopped == "rounding: the estimate does not fall any more"
    assert not found.reached and found.estimate < 1e-6
    # What is handed out is the solution with the least estimate, and its error is not larger.
    best = min(found.steps, key=lambda step: step.estimate)
    assert found.estimate == best.estimate
    assert found.problem.unknowns == found.steps[-1].unknowns == best.unknowns
    assert found.problem.space.mesh is found.sided.mesh
    assert len(found.cells) == len(owned_cells(found.sided.mesh))
    assert found.problem.result.natural_residual < 1e-12
    x = ufl.SpatialCoordinate(found.sided.mesh)
    error = true_error(found, "L2", lambda _: 1.0 + x[0] * x[1])
    assert error <= 10.0 * found.estimate
    # Rounding in a linear solve grows with the condition, and so with the number of unknowns.
    assert found.estimate < 4.0 * PRECISION * found.problem.unknowns
    found.problem.destroy()


@pytest.mark.parametrize(
    ("norm", "obstacle"),
    [
        ("L128", lambda x: -0.3 + x[0] ** 2),  # powers that are no floating-point numbers
        ("L600", lambda x: -0.3 + x[0] ** 2),
        ("H1", lambda x: -0.1),  # one value for all points
    ],
)
def test_callable_obstacles_and_high_powers(comm, norm, obstacle):
    def pose(sided):
        space = fem.functionspace(sided.mesh, ("Lagrange", 1))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
        return SignoriniProblem(a, -v * ufl.dx, contact=sided.sides["bottom"], obstacle=obstacle)

    found = solve_adaptively(pose, square(comm), norm=norm, accuracy=2e-2)
    assert found.reached and all(np.isfinite(step.estimate) for step in found.steps)
    found.problem.destroy()
