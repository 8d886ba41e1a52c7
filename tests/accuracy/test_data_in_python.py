"""Problems that are posed in Python: what UFL expressions say of the data is not overlooked."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from known import Known, true_error, values_at
from mpi4py import MPI

from dolfinx_signorini import SignoriniProblem, solve_adaptively
from dolfinx_signorini.accuracy.first_mesh import resolved_mesh
from dolfinx_signorini.accuracy.problem_data import data_of
from dolfinx_signorini.data.interfaces.piecewise_forms import by_data, data_in_pieces
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, facet_cells, simplex_sizes
from dolfinx_signorini.problem.dirichlet import dirichlet
from dolfinx_signorini.scenes.domains.kinds import Cube, Square

PLACES = np.random.default_rng(7).uniform(0.15, 0.85, (8, 2))


def bump(place, width):
    """A narrow bump with the Python functions of its values and gradients."""

    def u(x, y):
        return np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / width**2)

    def gradient(x, y):
        e = -2.0 / width**2 * u(x, y)
        return e * (x - place[0]), e * (y - place[1])

    return Known("", u, gradient, {})


def posing(load, degree=2, reaction=1.0, obstacle=0.0, diffusion=1.0, flux=0.0, held=None):
    """Return a function that poses a problem with data that are functions of x.

    The argument `held` returns the Dirichlet condition on the facets on top; by default u = 0.
    """

    def given(datum, x):
        return datum(x) if callable(datum) else ufl.as_ufl(datum)

    def pose(sided):
        space = fem.functionspace(sided.mesh, ("Lagrange", degree))
        x = ufl.SpatialCoordinate(sided.mesh)
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        dx, ds = (ufl.Measure(kind, sided.mesh) for kind in ("dx", "ds"))
        a = given(diffusion, x) * ufl.inner(ufl.grad(u), ufl.grad(v)) * dx
        a += given(reaction, x) * u * v * dx
        L = given(load, x) * v * dx + given(flux, x) * v * ds
        on_top = sided.facets(("top",))
        top = fem.locate_dofs_topological(space, sided.mesh.topology.dim - 1, on_top)
        bcs = [fem.dirichletbc(0.0, top, space) if held is None else held(space, on_top)]
        contact = sided.facets(("bottom",))
        return SignoriniProblem(a, L, contact=contact, obstacle=given(obstacle, x), bcs=bcs)

    return pose


@pytest.mark.parametrize("place", PLACES[[0, 1, 6]])
@pytest.mark.parametrize(("norm", "accuracy"), [("L2", 2e-5), ("H1", 0.1)])
def test_a_narrow_load_in_ufl_is_resolved(comm, place, norm, accuracy):
    known, width = bump(place, 1e-3), 1e-3

    def load(x):
        w = ufl.exp(-((x[0] - place[0]) ** 2 + (x[1] - place[1]) ** 2) / width**2)
        return w - ufl.div(ufl.grad(w))

    found = solve_adaptively(posing(load), Square(8).make(comm), norm=norm, accuracy=accuracy)
    assert found.reached and not found.notes
    assert true_error(found.problem.u, known, norm) <= accuracy
    found.problem.destroy()


def diameter(sided, place):
    """The diameter of the smallest cell around a point."""
    domain = sided.mesh
    dim = domain.topology.dim
    x = domain.geometry.x[domain.geometry.dofmap][:, :, :dim]
    edges = x[:, 1:] - x[:, :1]
    inner = np.linalg.solve(edges.transpose(0, 2, 1), (place - x[:, 0])[:, :, None])[:, :, 0]
    around = (inner.min(axis=1) > -1e-9) & (inner.sum(axis=1) < 1.0 + 1e-9)
    widths = np.linalg.norm(edges, axis=2).max(axis=1)[around]
    return domain.comm.allreduce(float(widths.min(initial=np.inf)), op=MPI.MIN)


def first_mesh(comm, domain, **data):
    sided = domain.make(comm)
    problem = posing(**{"load": 1.0} | data)(sided)
    found = resolved_mesh(data_of(problem), sided)
    problem.destroy()
    return sided, found


def peak(x, place=(0.3719, 0.6113, 0.2819)):
    return ufl.exp(-1e6 * sum((x[k] - place[k]) ** 2 for k in range(len(x))))


@pytest.mark.parametrize(
    ("data", "place"),
    [
        ({"load": lambda x: 1 + 1e6 * peak(x)}, (0.3719, 0.6113)),
        ({"load": lambda x: ufl.conditional(ufl.gt(peak(x), 0.5), 1e6, 1)}, (0.3719, 0.6113)),
        ({"reaction": lambda x: 1 + 1e6 * peak(x)}, (0.3719, 0.6113)),
        ({"diffusion": lambda x: 1 + 1e6 * peak(x)}, (0.3719, 0.6113)),
        ({"diffusion": lambda x: 1 / (1 + 1e4 * peak(x))}, (0.3719, 0.6113)),
        ({"flux": lambda x: 1 + 1e4 * ufl.exp(-((1e4 * (x[1] - 0.7123)) ** 2))}, (1.0, 0.7123)),
        ({"obstacle": lambda x: ufl.exp(-((1e4 * (x[0] - 0.7123)) ** 2))}, (0.7123, 0.0)),
    ],
    ids=["load", "jump", "reaction", "diffusion", "no diffusion", "flux", "obstacle"],
)
def test_every_datum_in_ufl_is_looked_at(comm, data, place):
    _, found = first_mesh(comm, Square(8), **data)
    assert diameter(found.sided, np.array(place)) < 0.01
    assert found.notes == ()


def test_a_narrow_load_inside_a_cube_is_seen(comm):
    _, found = first_mesh(comm, Cube(4), load=lambda x: 1 + 1e9 * peak(x))
    assert diameter(found.sided, np.array([0.3719, 0.6113, 0.2819])) < 0.02


def test_the_first_mesh_stays_where_no_datum_is_narrow(comm):
    data = {"load": lambda x: ufl.sin(3 * x[0]) - x[1], "reaction": lambda x: 1 + x[0] ** 2}
    sided, found = first_mesh(comm, Square(8), **data)
    assert found.sided is sided and found.notes == ()


def test_loads_on_parts_of_the_mesh_and_of_its_boundary(comm):
    """Narrow data count on their parts alone: half the cells, one side, whatever names the part."""
    sided = Square(8).make(comm)
    domain, space = sided.mesh, fem.functionspace(sided.mesh, ("Lagrange", 2))
    x, v = ufl.SpatialCoordinate(domain), ufl.TestFunction(space)
    left = mesh.locate_entities(domain, 2, lambda x: x[0] < 0.5 + 1e-9)
    tags = mesh.meshtags(domain, 2, left, np.full(len(left), 7, dtype=np.int32))
    right = np.intersect1d(sided.facets(("right",)), boundary_facets(domain)).astype(np.int32)
    pairs = [(3, facet_cells(domain, right).ravel())]
    cells, facets = (
        ufl.Measure("dx", domain, subdomain_data=tags),
        ufl.Measure("ds", domain, subdomain_data=pairs),
    )
    problem = posing(1.0)(sided)
    problem.L = x[0] * v * cells(7) + ufl.inner(x, ufl.FacetNormal(domain)) * v * facets(3)
    load, *fluxes = data_of(problem)
    assert {flux.name for flux in fluxes} == {"the flux"}
    assert len(fluxes) == 2  # the components of x
    assert comm.allreduce(simplex_sizes(load.corners).sum()) == pytest.approx(0.5)
    for flux in fluxes:
        assert comm.allreduce(simplex_sizes(flux.corners).sum()) == pytest.approx(1.0)
        assert (flux.corners[..., 0] == 1.0).all()
    problem.destroy()


def test_functions_beside_ufl_data_are_left_out(comm):
    sided = Square(4).make(comm)
    space = fem.functionspace(sided.mesh, ("Lagrange", 1))
    x, v, w = ufl.SpatialCoordinate(sided.mesh), ufl.TestFunction(space), fem.Function(space)
    problem = posing(1.0, degree=1)(sided)
    problem.L = (w * v + ufl.inner(ufl.grad(w), ufl.grad(v)) + 3 * x[1] * v + v) * ufl.dx
    (load,) = data_of(problem)
    assert load.formula.value((0.3, 0.5)) == pytest.approx(2.5)
    problem.destroy()


@pytest.mark.parametrize("load", [lambda x: 1e6 * peak(x)], ids=["peak"])
def test_the_ranks_refine_like_one(comm, load):
    shared, alone = (
        first_mesh(c, Square(8), load=load)[1].sided.mesh for c in (comm, MPI.COMM_SELF)
    )
    counts = [m.topology.index_map(2).size_global for m in (shared, alone)]
    assert counts[0] == counts[1] > 130


def disc(place, radius):
    """max(r^2 - d^2, 0)^2 / r^4 inside of a circle: the second derivatives jump on the circle."""

    def inner(x, y):
        return np.maximum(radius**2 - (x - place[0]) ** 2 - (y - place[1]) ** 2, 0.0) / radius**4

    def gradient(x, y):
        return -4.0 * inner(x, y) * (x - place[0]), -4.0 * inner(x, y) * (y - place[1])

    def load(x):
        square = (x[0] - place[0]) ** 2 + (x[1] - place[1]) ** 2
        m = radius**2 - square
        return ufl.conditional(ufl.gt(m, 0), m**2 - 8 * square + 8 * m, 0) / radius**4

    return Known("", lambda x, y: inner(x, y) ** 2 * radius**4, gradient, {}), load


@pytest.mark.parametrize(("norm", "accuracy"), [("L2", 1e-5), ("H1", 1e-2), ("Linf", 1e-4)])
@pytest.mark.parametrize("seed", [3, 4])
def test_a_load_that_jumps_in_ufl_is_integrated_piece_by_piece(comm, seed, norm, accuracy):
    rng = np.random.default_rng(seed)
    known, load = disc(rng.uniform(0.35, 0.65, 2), rng.uniform(0.1, 0.3))
    sided = Square(8).make(comm)
    found = solve_adaptively(
        posing(load), sided, norm=norm, accuracy=accuracy, max_unknowns=100_000
    )
    assert found.reached
    assert true_error(found.problem.u, known, norm) <= accuracy
    found.problem.destroy()


@pytest.mark.parametrize(("norm", "accuracy"), [("L2", 1e-4), ("H1", 1e-3), ("Linf", 1e-4)])
def test_a_diffusion_that_jumps_in_ufl_is_followed(comm, norm, accuracy):
    """Layers without flux through the sides: u = (1 - y^2)/2k above the jump."""
    place, high = 0.4137, 1000.0

    def u(x, y):
        top = (1.0 - np.maximum(y, place) ** 2) / (2.0 * high)
        return top + np.maximum(place**2 - y**2, 0.0) / 2.0

    def gradient(x, y):
        return 0.0 * x, -y / np.where(y < place, 1.0, high)

    def diffusion(x):
        return ufl.conditional((x[1] - place) * (2 + x[0]) < 0, 1.0, high)

    pose = posing(1.0, reaction=0.0, diffusion=diffusion)
    sided = Square(8).make(comm)
    found = solve_adaptively(pose, sided, norm=norm, accuracy=accuracy, max_unknowns=20_000)
    assert found.reached
    assert true_error(found.problem.u, Known("", u, gradient, {}), norm) <= accuracy
    found.problem.destroy()


@pytest.mark.parametrize("degree", [1, 2, 4])
def test_integrals_of_data_that_jump(comm, degree):
    """Sums over all basis functions, which add up to 1: integrals that are known by hand."""
    sided, place, radius = Square(5).make(comm), (0.43, 0.52), 0.31

    def inside(x):
        return (x[0] - place[0]) ** 2 + (x[1] - place[1]) ** 2 < radius**2

    pose = posing(
        lambda x: ufl.conditional(inside(x), 3.0, 0.0) + x[0],
        degree,
        reaction=lambda x: ufl.conditional(x[0] + x[1] < 0.77, 5.0, 0.0),
        flux=lambda x: ufl.sign(x[1] - 0.3713),
    )
    with data_in_pieces():
        problem = pose(sided)
    total = 3.0 * np.pi * radius**2 + 0.5 + 2.0 * (1.0 - 2.0 * 0.3713)
    assert problem.total_load == pytest.approx(total, rel=1e-4)
    one = fem.Function(problem.space)
    one.x.array[:] = 1.0
    form = fem.form(ufl.action(ufl.action(by_data(problem.a, pieces=True), one), one))
    reaction = comm.allreduce(fem.assemble_scalar(form))
    assert reaction == pytest.approx(5.0 * 0.77**2 / 2.0, rel=1e-4)
    problem.destroy()


def test_forms_without_jumps_are_left_alone(comm):
    sided = Square(3).make(comm)
    problem = posing(lambda x: ufl.exp(x[0]), reaction=lambda x: 1 + x[1] ** 2)(sided)
    assert by_data(problem.a, pieces=True) is problem.a
    assert by_data(problem.L, pieces=True) is problem.L
    fitted = posing(lambda x: ufl.conditional(3 * x[0] < 1, 1.0, 2.0))(sided)  # along facets
    assert by_data(fitted.L, pieces=True) is fitted.L
    for made in (problem, fitted):
        made.destroy()


def test_data_that_change_after_the_loop_are_noticed(comm):
    sided, factor = Square(4).make(comm), []

    def load(x):
        factor.append(fem.Constant(sided.mesh, 3.0))
        return factor[0] * ufl.conditional(x[0] + x[1] < 0.77, 1.0, 0.0)

    with data_in_pieces():
        problem = posing(load)(sided)
    assert problem.total_load == pytest.approx(3.0 * 0.77**2 / 2.0, rel=1e-6)
    problem.solve()
    factor[0].value = 7.0
    problem.solve()
    assert problem.total_load == pytest.approx(7.0 * 0.77**2 / 2.0, rel=1e-6)
    assert problem.system.assembled == 1  # the load alone
    problem.destroy()


def at_nodes(space, facets):
    """A root on the top, as DOLFINx has Dirichlet data."""
    data = fem.Function(space)
    data.interpolate(lambda x: np.abs(x[0] - 0.3137) ** 0.6)
    return fem.dirichletbc(data, fem.locate_dofs_topological(space, 1, facets))


def everywhere(space, facets):
    """The same root, between the nodes, too."""
    x = ufl.SpatialCoordinate(space.mesh)
    return dirichlet(space, facets, abs(x[0] - 0.3137) ** 0.6, component=0)


def constant(space, facets):
    """A constant that DOLFINx has at nodes is known everywhere."""
    data = fem.Function(space)
    data.interpolate(lambda x: 0.7 + 0.0 * x[0])
    return fem.dirichletbc(data, fem.locate_dofs_topological(space, 1, facets))


@pytest.mark.parametrize("held", [at_nodes, everywhere, constant])
def test_dirichlet_data_between_the_nodes_count_or_are_told(held, comm):
    """On the top the error is the distance to the data."""
    found = solve_adaptively(
        posing(1.0, held=held), Square(8).make(comm), norm="Linf", accuracy=2e-3
    )
    assert bool(found.notes) == (held is at_nodes)
    if held is everywhere:
        near = np.geomspace(1e-9, 0.3, 2000)
        x = np.concatenate((0.3137 - near, 0.3137 + near))
        points = np.stack([x, 1.0 + 0.0 * x, 0.0 * x], axis=1)
        off = values_at(found.problem.u, points)[:, 0] - np.abs(x - 0.3137) ** 0.6
        assert np.abs(off).max() <= found.estimate <= 2e-3
    found.problem.destroy()
