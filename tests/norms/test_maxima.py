"""Sup norms are maxima: against dense lattices that are evaluated here, without the package."""

import math

import basix
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from hypothesis import given
from hypothesis import strategies as st
from mpi4py import MPI

from dolfinx_signorini.meshes import refinement
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, boundary_facets, owned_cells
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.maxima import _largest
from dolfinx_signorini.norms.references import Reference
from dolfinx_signorini.studies.paper.solution import christof_haubner, paper_problem

ENOUGH = 1.0 - 1e-6  # of the largest on a lattice: no sample is larger than the maximum
MOST = 1.05  # by so much a maximum between the points of a lattice may be larger
CELLS = {
    "triangle": mesh.CellType.triangle,
    "quadrilateral": mesh.CellType.quadrilateral,
    "tetrahedron": mesh.CellType.tetrahedron,
    "hexahedron": mesh.CellType.hexahedron,
}


class Solution:
    """A function and its gradient in NumPy and in UFL.

    Args:
        formula: Makes the function from coordinates, and a module with sin, exp and the like.
        gradient: The same for the list of derivatives.
        singular: Points with no derivative.
    """

    def __init__(self, formula, gradient, singular=()):
        self.formula, self.gradient, self.singular = formula, gradient, singular

    def reference(self, domain, known=True):
        x = ufl.SpatialCoordinate(domain)
        gradient = tuple(map(ufl.as_ufl, self.gradient(x, ufl)))
        singular = self.singular if known else ()
        return Reference(domain, self.formula(x, ufl), gradient, singular=singular)

    def interpolant(self, domain, degree):
        function = fem.Function(fem.functionspace(domain, ("Lagrange", degree)))
        function.interpolate(lambda x: self.formula(x, np))
        return function


def lattice_maxima(function, solution, steps):
    """The largest |u_h - u| and |d(u_h - u)/dx_i| on lattices of so many steps per edge."""
    domain = function.function_space.mesh
    cell = basix.CellType[domain.topology.cell_name()]
    tdim, gdim = domain.topology.dim, domain.geometry.dim
    lattice = basix.create_lattice(cell, steps, basix.LatticeType.equispaced, True)
    element = function.function_space.element.basix_element
    vertices = basix.create_element(basix.ElementFamily.P, cell, 1)
    basis, shape = (e.tabulate(1, lattice)[..., 0] for e in (element, vertices))
    shape[np.abs(shape) < 1e-12] = 0.0  # no point of a side lies outside of the domain
    largest = np.zeros(2)
    for c in range(domain.topology.index_map(tdim).size_local):
        corners = domain.geometry.x[domain.geometry.dofmap[c], :gdim]
        dofs = function.x.array[function.function_space.dofmap.list[c]]
        x = np.zeros((3, len(lattice)))
        x[:gdim] = (shape[0] @ corners).T
        # One Jacobian serves all points of a cell with a linear map.
        linear = len(corners) == tdim + 1
        jacobian = np.einsum("tqv,vg->qgt", shape[1:, : 1 if linear else None], corners)
        slopes = np.einsum("tqd,d->qt", basis[1:], dofs)
        slopes = np.linalg.solve(np.swapaxes(jacobian, 1, 2), slopes[:, :, None])[:, :, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            error = basis[0] @ dofs - solution.formula(x, np)
            exact = [np.broadcast_to(d, len(lattice)) for d in solution.gradient(x, np)]
            slopes = slopes - np.transpose(exact)
        largest[0] = max(largest[0], np.nanmax(np.abs(error)))
        largest[1] = max(largest[1], np.nanmax(np.abs(slopes)))
    return np.max(domain.comm.allgather(largest), axis=0)


def check(function, solution, steps=60, known=True):
    """Compare Linf and W1_inf with the lattice."""
    exact = solution.reference(function.function_space.mesh, known)
    found = error_norms(function, exact, ["Linf", "W1_inf"])
    values, slopes = lattice_maxima(function, solution, steps)
    for have, want in ((found["Linf"], values), (found["W1_inf"], max(values, slopes))):
        assert ENOUGH * want <= have <= MOST * want
    return found


def polar(x, m, point):
    dx, dy = x[0] - point[0], x[1] - point[1]
    r = m.sqrt(dx * dx + dy * dy)
    return dx, dy, r


def power(a, point):
    """r^a, whose gradient is 0/0 at the point."""

    def gradient(x, m):
        dx, dy, r = polar(x, m, point)
        return [a * r ** (a - 2.0) * dx, a * r ** (a - 2.0) * dy]

    return Solution(lambda x, m: polar(x, m, point)[2] ** a, gradient, (point,))


def ridge(k):
    """An oscillation along a front, as no polynomial."""
    return Solution(
        lambda x, m: m.sin(k * x[0] * x[1]) / (1.0 + x[0]),
        lambda x, m: [
            k * x[1] * m.cos(k * x[0] * x[1]) / (1.0 + x[0])
            - m.sin(k * x[0] * x[1]) / (1.0 + x[0]) ** 2,
            k * x[0] * m.cos(k * x[0] * x[1]) / (1.0 + x[0]),
        ],
    )


def bump(width, point=(0.37, 0.61)):
    def formula(x, m):
        return m.exp(-((x[0] - point[0]) ** 2 + (x[1] - point[1]) ** 2) / width**2)

    return Solution(
        formula,
        lambda x, m: [-2.0 * (x[i] - point[i]) / width**2 * formula(x, m) for i in (0, 1)],
    )


def papers():
    """The paper's solution in NumPy, polar coordinates and all."""

    def parts(x):
        dx, dy = x[0] - 0.5, x[1]
        r, angle = np.hypot(dx, dy), np.arctan2(dy, dx)
        t = np.minimum(r / 0.45, 1.0)
        psi = (1 - t) ** 5 * (1 + 5 * t + 15 * t**2 + 35 * t**3 + 70 * t**4)
        slope = -630 * t**4 * (1 - t) ** 4 / 0.45 / np.where(r > 0, r, 1.0)
        return dx, dy, r, angle, psi, slope

    def formula(x, m):
        _, _, r, angle, psi, _ = parts(x)
        return -10.0 * psi * r**1.5 * np.sin(1.5 * angle)

    def gradient(x, m):
        dx, dy, r, angle, psi, slope = parts(x)
        w = r**1.5 * np.sin(1.5 * angle)
        first = 1.5 * np.sqrt(r) * np.array([np.sin(0.5 * angle), np.cos(0.5 * angle)])
        return -10.0 * (psi * first + slope * w * np.array([dx, dy]))

    return Solution(formula, gradient)


class Paper(Solution):
    def reference(self, domain, known=True):
        return christof_haubner(domain)


PAPER = Paper(papers().formula, papers().gradient)


@pytest.mark.parametrize(("degree", "n", "least"), [(2, 13, (1.018e-2, 1.311)), (1, 26, (3e-2, 3))])
def test_the_papers_scene(comm, degree, n, least):
    problem = paper_problem(christof_haubner(friedrichs_keller(comm, n)), degree)
    found = check(problem.solve(rtol=1e-9), PAPER)
    problem.destroy()
    assert found["Linf"] >= least[0] and found["W1_inf"] >= least[1]


def test_the_papers_scene_at_26(comm):
    # The largest error of the gradient is at the detachment point, where grad u is 0.
    problem = paper_problem(christof_haubner(friedrichs_keller(comm, 26)), 2)
    found = check(problem.solve(rtol=1e-9), PAPER, steps=30)
    problem.destroy()
    assert found["Linf"] == pytest.approx(1.9405e-3, rel=1e-3)
    assert found["W1_inf"] == pytest.approx(1.24741, rel=1e-4)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_the_papers_solution_on_meshes_that_become_finer_towards_the_point(comm, degree):
    check(PAPER.interpolant(refined(friedrichs_keller(comm, 14), 1.8), degree), PAPER)
    check(PAPER.interpolant(refined(friedrichs_keller(comm, 9), 3.0), degree), PAPER)


def refined(domain, grading):
    """Squeeze a mesh towards (0.5, 0)."""
    x = domain.geometry.x
    across = 2.0 * x[:, 0] - 1.0
    x[:, 0] = 0.5 + 0.5 * np.sign(across) * np.abs(across) ** grading
    x[:, 1] **= grading
    return domain


def distorted(comm, kind, n):
    """Cells that are no images of each other, and no parallelograms."""
    make = mesh.create_unit_square if kind in ("triangle", "quadrilateral") else None
    if make is not None:
        domain = make(comm, n, n, cell_type=CELLS[kind])
    else:
        domain = mesh.create_unit_cube(comm, n, n, n, cell_type=CELLS[kind])
    x = domain.geometry.x
    x[:, 0] += 0.08 * np.sin(3.0 * x[:, 1] + 1.0)
    x[:, 1] += 0.06 * np.cos(4.0 * x[:, 0])
    return domain


SOLUTIONS = {
    "smooth": Solution(
        lambda x, m: m.exp(x[0]) * m.cos(2.0 * x[1]),
        lambda x, m: [m.exp(x[0]) * m.cos(2.0 * x[1]), -2.0 * m.exp(x[0]) * m.sin(2.0 * x[1])],
    ),
    "oscillating": ridge(31.0),
    "bump": bump(0.07),
    "power": power(1.3, (0.4, 0.3)),
}


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("name", SOLUTIONS)
@pytest.mark.parametrize("kind", ["triangle", "quadrilateral"])
def test_other_solutions_in_the_plane(comm, kind, name, degree):
    solution = SOLUTIONS[name]
    check(solution.interpolant(distorted(comm, kind, 7), degree), solution)
    if name == "power":  # whose singular point the reference need not know
        check(solution.interpolant(distorted(comm, kind, 5), degree), solution, known=False)


IN_SPACE = {
    "smooth": Solution(
        lambda x, m: m.sin(5.0 * x[0] + 2.0 * x[1]) * m.exp(x[2]),
        lambda x, m: [
            5.0 * m.cos(5.0 * x[0] + 2.0 * x[1]) * m.exp(x[2]),
            2.0 * m.cos(5.0 * x[0] + 2.0 * x[1]) * m.exp(x[2]),
            m.sin(5.0 * x[0] + 2.0 * x[1]) * m.exp(x[2]),
        ],
    ),
    # The distance to a line through the cube, to the power 3/2, whose gradient is 0/0 on the line.
    "power": Solution(
        lambda x, m: polar(x, m, (0.55, 0.5))[2] ** 1.5,
        lambda x, m: [*power(1.5, (0.55, 0.5)).gradient(x, m), 0.0],
    ),
}


@pytest.mark.parametrize(("degree", "steps"), [(1, 30), (2, 30), (3, 24), (4, 24)])
@pytest.mark.parametrize("name", IN_SPACE)
@pytest.mark.parametrize("kind", ["tetrahedron", "hexahedron"])
def test_solutions_in_space(comm, kind, name, degree, steps):
    if kind == "hexahedron" and (degree == 4 or name == "power"):
        pytest.skip("slow, and much like the others")
    solution, steps = IN_SPACE[name], steps if name == "smooth" else 50
    check(solution.interpolant(distorted(comm, kind, 2), degree), solution, steps)


def test_many_cells(comm):
    # 3,200 cells, of which few are looked at closely.
    solution = bump(0.04, (0.503, 0.499))
    check(solution.interpolant(friedrichs_keller(comm, 40), 1), solution, steps=24)


def boundary_maxima(function, solution, steps):
    """The same on the boundary of a plane mesh, with differences along edges."""
    domain = function.function_space.mesh
    degree = function.function_space.ufl_element().degree
    topology = domain.topology
    cell = basix.CellType[topology.cell_name()]
    edges, corners = basix.topology(cell)[1], np.asarray(basix.geometry(cell))
    element = basix.create_element(
        basix.ElementFamily.P, cell, degree, basix.LagrangeVariant.gll_warped
    )
    topology.create_connectivity(1, 2)
    topology.create_connectivity(2, 1)
    t = np.linspace(0.0, 1.0, steps + 1)[:, None]
    largest = np.zeros(2)
    for facet in boundary_facets(domain):
        c = topology.connectivity(1, 2).links(facet)[0]
        local = int(np.flatnonzero(topology.connectivity(2, 1).links(c) == facet)[0])
        a, b = edges[local]
        ends = domain.geometry.x[domain.geometry.dofmap[c, [a, b]]]
        x = ((1.0 - t) * ends[0] + t * ends[1]).T
        table = element.tabulate(1, (1.0 - t) * corners[a] + t * corners[b])[..., 0]
        dofs = function.x.array[function.function_space.dofmap.list[c]]
        length = np.linalg.norm(ends[1] - ends[0])
        along = (ends[1] - ends[0])[:2] / length
        slope = np.einsum("tqd,t,d->q", table[1:], corners[b] - corners[a], dofs) / length
        exact = np.array([np.broadcast_to(d, len(t)) for d in solution.gradient(x, np)])
        error = table[0] @ dofs - solution.formula(x, np)
        tangential = np.outer(along, slope - along @ exact)
        largest[0] = max(largest[0], np.abs(error).max())
        largest[1] = max(largest[1], np.abs(tangential).max())
    return np.max(domain.comm.allgather(largest), axis=0)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("kind", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("name", ["smooth", "oscillating"])
def test_maxima_on_the_boundary(comm, kind, name, degree):
    solution = SOLUTIONS[name]
    function = solution.interpolant(distorted(comm, kind, 6), degree)
    exact = solution.reference(function.function_space.mesh)
    found = error_norms(function, exact, ["Linf_boundary", "W1_inf_boundary"])
    values, slopes = boundary_maxima(function, solution, 400)
    assert found["Linf_boundary"] == pytest.approx(values, rel=1e-3)
    assert found["W1_inf_boundary"] == pytest.approx(max(values, slopes), rel=1e-3)


@pytest.mark.parametrize("kind", ["tetrahedron", "hexahedron"])
def test_maxima_on_faces(comm, kind):
    # On the faces of the cube the tangential gradient is largest at the edge x = y = 1.
    domain = mesh.create_unit_cube(comm, 2, 3, 2, cell_type=CELLS[kind])
    degree = 5 if kind == "tetrahedron" else 2
    function = fem.Function(fem.functionspace(domain, ("Lagrange", degree)))
    function.interpolate(lambda x: x[0] ** 2 * x[1] ** 2 * x[2] + 5.0 * x[2])
    norms = error_norms(function, None, ["Linf_boundary", "W1_inf_boundary", "W1_inf"])
    assert norms["Linf_boundary"] == pytest.approx(6.0, rel=1e-12)
    assert norms["W1_inf_boundary"] == pytest.approx(6.0, rel=1e-12)
    assert norms["W1_inf"] == pytest.approx(6.0, rel=1e-12)


def waves(coefficients, degree, kind="triangle"):
    domain = distorted(MPI.COMM_WORLD, kind, 3)
    function = fem.Function(fem.functionspace(domain, ("Lagrange", degree)))
    modes = [(1, 0), (0, 1), (2, 1), (3, 4), (7, 2)]
    function.interpolate(
        lambda x: sum(
            c * np.cos(math.pi * (k * x[0] + m * x[1]) + i)
            for i, (c, (k, m)) in enumerate(zip(coefficients, modes, strict=True))
        )
    )
    return function


amplitudes = st.lists(st.floats(-1.0, 1.0).map(lambda c: round(c, 3)), min_size=5, max_size=5)
EXPONENTS = (1, 1.5, 2, 3, 4, 7, 16, 100, 1000)


@given(
    amplitudes,
    st.integers(1, 4),
    st.sampled_from(["triangle", "quadrilateral"]),
    st.sampled_from(["", "_boundary"]),
)
def test_no_mean_is_larger_than_the_maximum(coefficients, degree, kind, where):
    function = waves(coefficients, degree, kind)
    one = fem.Function(function.function_space)
    one.x.array[:] = 1.0
    names = [f"{p}{where}" for p in EXPONENTS]
    norms = error_norms(
        function,
        None,
        [f"L{p}" for p in names] + [f"W1_{p}" for p in names] + [f"Linf{where}", f"W1_inf{where}"],
    )
    size = error_norms(one, None, [f"L1{where}"])[f"L1{where}"]
    for p in EXPONENTS:
        mean = norms[f"L{p}{where}"] * size ** (-1.0 / p)
        assert mean <= norms[f"Linf{where}"] * (1.0 + 1e-9)
        mean = norms[f"W1_{p}{where}"] * (3.0 * size) ** (-1.0 / p)
        assert mean <= norms[f"W1_inf{where}"] * (1.0 + 1e-9)


def test_the_same_on_any_number_of_ranks(comm):
    solution = SOLUTIONS["oscillating"]
    names = ["Linf", "W1_inf", "Linf_boundary", "W1_inf_boundary", "L1000", "W1_16"]
    found = []
    for group in (MPI.COMM_SELF, comm):
        function = solution.interpolant(friedrichs_keller(group, 12), 2)
        exact = solution.reference(function.function_space.mesh)
        found.append(error_norms(function, exact, names))
    assert found[1] == pytest.approx(found[0], rel=1e-9)


@pytest.mark.parametrize("point", [(0.0, 0.0), (0.5, 0.5), (0.52, 0.47)])
def test_norms_that_are_infinite_are_refused_by_name(comm, point):
    # r^{2/3} is bounded, and its gradient is not.
    solution = power(2 / 3, point)
    for known in (True, False):
        function = solution.interpolant(friedrichs_keller(comm, 8), 2)
        exact = solution.reference(function.function_space.mesh, known)
        assert error_norms(function, exact, ["Linf"])["Linf"] < 1.0
        with pytest.raises(FloatingPointError, match="W1_inf is infinite"):
            error_norms(function, exact, ["L2", "W1_inf"])


def test_a_logarithm_is_infinite_and_a_steep_root_is_not(comm):
    domain = friedrichs_keller(comm, 6)
    zero = fem.Function(fem.functionspace(domain, ("Lagrange", 1)))
    x = ufl.SpatialCoordinate(domain)
    log = Reference(domain, ufl.ln(x[0]), (1.0 / x[0], ufl.as_ufl(0.0)))
    with pytest.raises(FloatingPointError):
        error_norms(zero, log, ["Linf"])
    root = Reference(domain, x[0] ** 0.2, (0.2 * x[0] ** -0.8, ufl.as_ufl(0.0)))
    assert error_norms(zero, root, ["Linf"])["Linf"] == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("name", ["Linf", "W1_inf", "Linf_boundary"])
def test_an_error_that_is_no_number_is_raised(comm, name):
    domain = friedrichs_keller(comm, 8)
    x = ufl.SpatialCoordinate(domain)
    zero = fem.Function(fem.functionspace(domain, ("Lagrange", 1)))
    half = Reference(domain, ufl.sqrt(x[0] - 0.5), (0.5 / ufl.sqrt(x[0] - 0.5), ufl.as_ufl(0.0)))
    with pytest.raises(FloatingPointError):
        error_norms(zero, half, [name])


def test_derivatives_are_those_from_inside_of_each_cell(comm):
    # |x - 1/2| with a kink along edges, and a hat whose slopes differ from side to side.
    domain = friedrichs_keller(comm, 4)
    function = fem.Function(fem.functionspace(domain, ("Lagrange", 1)))
    function.interpolate(lambda x: np.maximum(0.0, x[0] - 0.5) * 3.0 - np.maximum(0.0, 0.5 - x[0]))
    assert error_norms(function, None, ["W1_inf"])["W1_inf"] == pytest.approx(3.0, rel=1e-13)
    function.x.array[:] *= -1.0
    assert error_norms(function, None, ["W1_inf"])["W1_inf"] == pytest.approx(3.0, rel=1e-13)
    jumping = fem.Function(fem.functionspace(domain, ("DG", 2)))
    right = mesh.locate_entities(domain, 2, lambda x: x[0] > 0.5 - 1e-9)
    jumping.interpolate(lambda x: x[0] ** 2, cells0=right)
    found = error_norms(jumping, None, ["Linf", "W1_inf"])
    assert found["W1_inf"] == pytest.approx(2.0, rel=1e-12)


def test_rounding_moves_no_point_out_of_the_box_around_its_cell(comm):
    # A formula such as atan2(y, x) jumps at y = 0, which may be the boundary.
    domain = refinement.refined(SidedMesh(friedrichs_keller(comm, 7), {})).sided.mesh
    t, zero = np.random.default_rng(1).random(1000), np.zeros(1000)
    for points in (np.column_stack(pair) for pair in ([t, 1.0 - t], [t, zero], [zero, t])):
        for x in Points(domain, owned_cells(domain), points).x:
            assert x.min(initial=0.0) >= 0.0
            assert x.max(initial=1.0) <= 1.0


@pytest.mark.parametrize("limit", [0, 1, 30, 200])
@pytest.mark.parametrize("spread", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("base", [0.0, 1e9])  # of values that differ by rounding, too
def test_the_largest_values_of_all_ranks_are_found_without_gathering(limit, spread, base):
    comm, draw = MPI.COMM_WORLD, np.random.default_rng(5)
    everywhere = draw.standard_normal(400) * 10.0 ** (spread * draw.standard_normal(400))
    everywhere = base + everywhere * (1e-6 if base else 1.0)
    everywhere[::7] = everywhere.min()  # several are the same
    mine = np.flatnonzero(draw.integers(0, comm.size + 1, 400) == comm.rank)  # an uneven share
    shared = np.sort(np.concatenate(comm.allgather(everywhere[mine])))
    found = everywhere[mine[_largest(comm, everywhere[mine], limit)]]
    found = np.sort(np.concatenate(comm.allgather(found)))
    expected = shared[max(0, len(shared) - limit) :] if limit else shared[:0]
    rounding = 1e-12 * float(np.abs(shared).max())
    if limit and len(shared) > limit:
        assert found.min() >= expected.min() - rounding
    assert (found[len(found) - len(expected) :] == expected).all()
