"""Graded meshes: cells have the sizes of the grading, orders are those of the theory."""

import math

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini import (
    InputError,
    SignoriniProblem,
    christof_haubner,
    friedrichs_keller,
)
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, boundary_facets, facet_cells
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.names import parse_norm
from dolfinx_signorini.norms.orders import (
    DETACHMENT_EXPONENT,
    SMOOTH,
    approximation_order,
    expected_order,
    grading_exponent,
)
from dolfinx_signorini.problem.detachment import DetachmentPoint, detachment_points
from dolfinx_signorini.studies.paper.solution import paper_family, paper_problem
from dolfinx_signorini.studies.tradeoff.family import GRADED_P2, UNIFORM_P2, Kind
from dolfinx_signorini.studies.tradeoff.grading import RADIUS, graded_mesh
from dolfinx_signorini.studies.tradeoff.runs import Configuration, Run


def cells(domain: mesh.Mesh) -> np.ndarray:
    """Corners of all cells on all ranks, shape (cells, 3, 2)."""
    count = domain.topology.index_map(2).size_local
    corners = domain.geometry.x[domain.geometry.dofmap[:count], :2]
    return np.concatenate(domain.comm.allgather(corners))


def areas(corners: np.ndarray) -> np.ndarray:
    (a, b), (c, d) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    return 0.5 * np.abs(a * d - b * c)


def squares(comm: MPI.Comm, n: int) -> SidedMesh:
    return SidedMesh(friedrichs_keller(comm, n), {})


def solved(comm: MPI.Comm, n: int, degree: int, detachment: tuple[float, float]):
    exact = christof_haubner(friedrichs_keller(comm, n), detachment)
    problem = paper_problem(exact, degree)
    problem.solve()
    return problem


@pytest.mark.parametrize("halvings", [0, 1])
@pytest.mark.parametrize("exponent", [0.5, 0.25])
def test_cells_have_the_sizes_of_the_grading(
    comm: MPI.Comm, exponent: float, halvings: int
) -> None:
    n, place = 32, (0.47, 0.0)
    point = DetachmentPoint(place, uncertainty=1e-9, strength=1.0)
    fine = graded_mesh(squares(comm, n >> halvings), [point], 1.0 / n, exponent, halvings)
    corners = cells(fine.mesh)
    sizes = np.sqrt(2.0 * areas(corners))
    assert math.isclose(areas(corners).sum(), 1.0, rel_tol=1e-12)
    r = np.linalg.norm(corners.mean(axis=1) - place, axis=1)
    wanted = np.maximum(
        np.minimum((r / RADIUS) ** (1.0 - exponent), 1.0) / n,
        RADIUS * (1.0 / (n * RADIUS)) ** (1.0 / exponent),
    )
    assert (sizes <= 1.5 * wanted * (1.0 + 1e-9)).all()
    # Few cells are much smaller than they have to be, those of the closure among them.
    assert np.mean(sizes < 0.35 * wanted) < 0.05
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert (edges.max(axis=1) ** 2 <= 4.1 * 2.0 * areas(corners)).all()  # shapes stay good


def test_cells_are_not_smaller_than_a_point_is_certain(comm: MPI.Comm) -> None:
    point = DetachmentPoint((0.5, 0.0), uncertainty=0.02, strength=1.0)
    corners = cells(graded_mesh(squares(comm, 20), [point], 0.05, 0.25).mesh)
    assert np.sqrt(2.0 * areas(corners)).min() > 0.02 / 8


def test_an_exponent_of_one_and_no_points_leave_the_mesh(comm: MPI.Comm) -> None:
    sided = squares(comm, 6)
    point = DetachmentPoint((0.5, 0.0), 1e-3, 1.0)
    assert graded_mesh(sided, [point], 1.0 / 6, 1.0) is sided
    assert graded_mesh(sided, [], 1.0 / 6, 0.25) is sided


def test_only_triangulations_are_graded(comm: MPI.Comm) -> None:
    domain = mesh.create_unit_square(comm, 4, 4, mesh.CellType.quadrilateral)
    with pytest.raises(InputError, match="grading"):
        graded_mesh(SidedMesh(domain, {}), [], 0.25, 0.5)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("n", [9, 16, 41])
@pytest.mark.parametrize("place", [0.5, 0.47123, 0.53])
def test_the_detachment_point_is_found(comm: MPI.Comm, place: float, n: int, degree: int) -> None:
    problem = solved(comm, n, degree, (place, 0.0))
    points = detachment_points(problem)
    problem.destroy()
    # On 9 squares of degree 2 the contact set has a gap near the end of the support of u, too.
    assert [point.strength > 0.1 for point in points] == [True] + [False] * (len(points) - 1)
    assert len(points) == 1 or (degree, n) in ((2, 9), (2, 16))
    assert points[0].position[1] == 0.0
    assert abs(points[0].position[0] - place) <= points[0].uncertainty * 1.2
    assert points[0].uncertainty <= 1.0 / (n * degree) * (1.0 + 1e-9)


@pytest.mark.parametrize(("n", "degree"), [(64, 2), (100, 2), (201, 1)])
@pytest.mark.parametrize("place", [0.5, 0.47123, 0.53])
def test_the_detachment_point_is_extrapolated_within_an_edge(
    comm: MPI.Comm, place: float, n: int, degree: int
) -> None:
    problem = solved(comm, n, degree, (place, 0.0))
    (point,) = detachment_points(problem)
    problem.destroy()
    # In the Bernstein basis contact of degree 2 ends at a vertex, and so acts one cell farther.
    edge = 1.0 / n
    assert point.uncertainty <= 0.2 * edge
    assert abs(point.position[0] - place) <= point.uncertainty
    assert abs(point.position[0] - place) <= 0.06 * edge


def test_graded_meshes_know_the_point_far_better_than_to_an_edge(comm: MPI.Comm) -> None:
    run = Run(comm, paper_family((0.47123, 0.0)), Configuration(GRADED_P2, 96))
    (point,) = run.points
    run.destroy()
    assert abs(point.position[0] - 0.47123) <= 5e-6
    assert point.uncertainty <= 1e-5


@pytest.mark.parametrize("n", [20, 64])
def test_points_are_the_same_on_any_number_of_ranks(comm: MPI.Comm, n: int) -> None:
    problem = solved(comm, n, 2, (0.47123, 0.0))
    points = detachment_points(problem)
    problem.destroy()
    alone = solved(MPI.COMM_SELF, n, 2, (0.47123, 0.0))
    reference = detachment_points(alone)
    alone.destroy()
    assert comm.allgather(points) == [points] * comm.size
    assert np.allclose(points[0].position, reference[0].position, atol=1e-14 if n == 20 else 1e-7)


def test_without_a_gap_or_without_contact_there_is_no_point(comm: MPI.Comm) -> None:
    domain = friedrichs_keller(comm, 8)
    for sign in (1.0, -1.0):
        space = fem.functionspace(domain, ("Lagrange", 1))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
        load = fem.Constant(domain, sign) * v * ufl.dx
        problem = SignoriniProblem(a, load, contact=boundary_facets(domain))
        problem.solve()
        assert detachment_points(problem) == []
        problem.destroy()


def test_grading_exponents_balance_the_errors_of_the_singularity() -> None:
    # h(0)^{3/2 - s + 2/p} = h^{k+1-s} with h(0) = h^{1/mu}, for r^{3/2} in a norm of s derivatives.
    for name, s, inverse_p in (("W1_inf", 1, 0.0), ("W1_4", 1, 0.25), ("Linf", 0, 0.0)):
        for degree in (1, 2):
            mu = grading_exponent(degree, name)
            if mu < 1.0:
                assert math.isclose((1.5 - s + 2.0 * inverse_p) / mu, degree + 1 - s, rel_tol=1e-12)
            assert grading_exponent(degree) <= mu
    assert grading_exponent(1, "L4") == grading_exponent(1, "W1_4") == 1.0


def test_orders_are_those_of_the_theorems_for_p1() -> None:
    for name in ("L4", "Linf", "L16", "W1_4", "W1_16", "W1_inf"):
        assert approximation_order(name, 1, DETACHMENT_EXPONENT) == expected_order(name)
        for degree in (1, 2):
            full = degree + 1 - parse_norm(name).derivatives
            assert approximation_order(name, degree, SMOOTH) == full


@pytest.mark.parametrize("place", [0.5, 0.47123])
def test_p2_lies_below_the_obstacle_by_an_eighth_of_the_gap_at_most(
    comm: MPI.Comm, place: float
) -> None:
    problem = solved(comm, 16, 2, (place, 0.0))
    problem.destroy()
    space = problem.space
    facets = boundary_facets(space.mesh)
    pairs = facet_cells(space.mesh, facets)
    t = np.linspace(0.0, 1.0, 41)
    shapes = np.array([(1 - t) * (1 - 2 * t), t * (2 * t - 1), 4 * t * (1 - t)])
    lowest = [0.0]
    for cell, facet in pairs:
        dofs = space.dofmap.list[cell][space.dofmap.dof_layout.entity_closure_dofs(1, facet)]
        nodal = problem.u.x.array[dofs]
        values = nodal @ shapes
        assert values.min() >= -max(nodal[:2]) / 8.0 - 1e-15
        lowest.append(float(values.min()))
    assert min(comm.allgather(min(lowest))) < -1e-6  # it does happen


def test_sides_are_kept(comm: MPI.Comm) -> None:
    domain = friedrichs_keller(comm, 6)
    planes = {"left": (0, 0.0), "bottom": (1, 0.0), "nothing": (0, 5.0)}
    sides = {
        name: mesh.locate_entities_boundary(domain, 1, lambda x, p=plane: np.isclose(x[p[0]], p[1]))
        for name, plane in planes.items()
    }
    point = DetachmentPoint((0.4, 0.0), 1e-3, 1.0)
    sided = graded_mesh(SidedMesh(domain, sides), [point], 1.0 / 12, 0.25, halvings=1)
    fine = sided.mesh
    for name, (axis, value) in planes.items():
        fine.topology.create_connectivity(1, 2)
        expected = mesh.locate_entities_boundary(
            fine, 1, lambda x, axis=axis, value=value: np.isclose(x[axis], value)
        )
        owned = expected[expected < fine.topology.index_map(1).size_local]
        assert set(sided.sides[name]) == set(owned)


@pytest.mark.parametrize(
    ("degree", "norm", "order"),
    [(1, "W1_inf", 1.0), (2, "W1_inf", 2.0), (3, "W1_4", 3.0), (2, "L4", 3.0)],
)
def test_graded_meshes_have_the_full_orders(
    comm: MPI.Comm, degree: int, norm: str, order: float
) -> None:
    sizes = {1: (40, 80), 2: (48, 96), 3: (24, 48)}[degree]
    errors = []
    for n in sizes:
        run = Run(comm, paper_family((0.47123, 0.0)), Configuration(Kind("graded", degree), n))
        errors.append(error_norms(run.u, run.posed.exact, [norm])[norm])
        run.destroy()
    assert math.log2(errors[0] / errors[1]) > 0.93 * order


def test_uniform_meshes_do_not_have_the_full_order(comm: MPI.Comm) -> None:
    errors = []
    for n in (24, 48):
        run = Run(comm, paper_family(), Configuration(UNIFORM_P2, n))
        errors.append(error_norms(run.u, run.posed.exact, ["W1_inf"])["W1_inf"])
        run.destroy()
    assert math.log2(errors[0] / errors[1]) < 0.8
