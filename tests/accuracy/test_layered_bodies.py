"""Bodies whose data jump or bend along straight lines, against closed forms."""

import elastic_known as known
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_signorini as ds
from dolfinx_signorini import InputError
from dolfinx_signorini.scenes import solve_scene

COMM = MPI.COMM_WORLD
NU, PUSH, AT = 0.3, 0.1, 0.337
STIFFENING = (1 - NU) / ((1 + NU) * (1 - 2 * NU))  # of a column whose sides stay where they are
SOFT, HARD = 10.0, 400.0

# A column that is pressed on the ground between smooth walls.
COLUMN = """
[domain]
shape = "square"
cells = 4
[elasticity]
young = "{young}"
poisson = 0.3
force = [0, "{force}"]
[contact]
sides = "bottom"
direction = [0, -1]
[[dirichlet]]
sides = ["left", "right"]
components = "x"
value = 0
[[dirichlet]]
sides = "top"
value = [0, -0.1]
"""


class Column:
    """The displacement along the column from (M u')' + f = 0, u(0) = 0 and u(1) = -PUSH."""

    def __init__(self, young, force=lambda y: 0.0 * y):
        points, weights = np.polynomial.legendre.leggauss(12)
        ends = np.unique([*np.linspace(0.0, 1.0, 41), AT])
        halves = 0.5 * np.diff(ends)[:, None]
        y = ends[:-1, None] + halves * (1 + points)
        self.ends = ends
        loads = [0.0, *np.cumsum((force(y) * weights * halves).sum(axis=1))]
        self.young, self.force_at, self.loads = young, force, np.array(loads)
        compliance = 1.0 / (STIFFENING * young(y))
        whole = (compliance * weights * halves).sum()
        loaded = (self.load(y) * compliance * weights * halves).sum()
        self.pressure = (PUSH - loaded) / whole  # -M u'(0)
        steps = (-(self.pressure + self.load(y)) * compliance * weights * halves).sum(axis=1)
        self.steps = np.array([0.0, *np.cumsum(steps)])

    def load(self, y):
        """The integral of the force from 0."""
        return self._from_knots(y, self.loads, self.force_at)

    def u(self, y):
        """The displacement along the column."""
        return self._from_knots(y, self.steps, self.slope)

    def displacement(self, x):
        """The displacement of the body at points."""
        return np.stack([0.0 * x[0], self.u(x[1])])

    def gradient(self, x):
        """The derivatives of the displacement, component by component."""
        return np.stack([*3 * [0.0 * x[0]], self.slope(x[1])])

    def slope(self, y):
        """The derivative of u."""
        return -(self.pressure + self.load(y)) / (STIFFENING * self.young(y))

    def _from_knots(self, y, at_knots, integrand):
        points, weights = np.polynomial.legendre.leggauss(12)
        k = np.clip(np.searchsorted(self.ends, y) - 1, 0, len(self.ends) - 2)
        half = 0.5 * (y - self.ends[k])
        places = self.ends[k][..., None] + half[..., None] * (1 + points)
        return at_knots[k] + half * (integrand(places) * weights).sum(axis=-1)


def layered(y):
    return np.where(y < AT, SOFT, HARD)


def uniform(y):
    return 100.0 + 0.0 * y


COLUMNS = {
    "layers": (f"where(y < {AT}, {SOFT}, {HARD})", "0", Column(layered)),
    "a force that jumps": (
        "100",
        f"where(y < {AT}, -20, 5*y)",
        Column(uniform, lambda y: np.where(y < AT, -20.0, 5.0 * y)),
    ),
    "a force that bends": (
        "100",
        f"-40*abs(y - {AT})",
        Column(uniform, lambda y: -40.0 * np.abs(y - AT)),
    ),
    "layers with a force": (
        f"where(y < {AT}, {SOFT}, {HARD})*(1 + y)",
        f"-max(y - {AT}, 0)",
        Column(lambda y: layered(y) * (1 + y), lambda y: -np.maximum(y - AT, 0.0)),
    ),
}


@pytest.mark.parametrize("what", COLUMNS)
@pytest.mark.parametrize(("norm", "accuracy"), [("L2", 1e-5), ("Linf", 2e-5), ("H1", 1e-3)])
def test_columns_to_an_accuracy(what, norm, accuracy, parse):
    young, force, column = COLUMNS[what]
    result = solve_scene(
        parse(COLUMN.format(young=young, force=force)), COMM, accuracy=accuracy, norm=norm
    )
    true = known.true_error(result.u, column, norm)
    assert result.found.reached
    assert true <= max(1.05 * result.found.estimate, 1e-8) <= 1.05 * accuracy, (true, result.found)
    assert result.posed.problem.force[1] == pytest.approx(column.pressure, rel=5e-3)
    result.destroy()


def test_layers_follow_facets(parse):
    """In each of two layers u is linear: on a fitted mesh the first solution is exact."""
    young, force, column = COLUMNS["layers"]
    result = solve_scene(
        parse(COLUMN.format(young=young, force=force)), COMM, accuracy=1e-4, norm="L2"
    )
    assert result.found.steps[0].estimate <= 1e-7
    assert known.true_error(result.u, column, "Linf") <= 1e-7
    problem = result.posed.problem
    pressure = problem.pressure.x.array[problem.contact_nodes]
    assert pressure == pytest.approx(np.full(len(pressure), column.pressure), rel=1e-5)
    result.destroy()


def held_and_below(sided, space, displacement):
    """The condition on the sides that are held, and the measure of the lower side."""
    data = fem.Function(space)
    data.interpolate(displacement)
    bc = fem.dirichletbc(data, fem.locate_dofs_topological(space, 1, sided.sides["held"]))
    facets = np.sort(sided.sides["below"])
    tags = mesh.meshtags(sided.mesh, 1, facets, np.ones(len(facets), dtype=np.int32))
    return bc, ufl.Measure("ds", sided.mesh, subdomain_data=tags)(1)


class Slanted:
    """Two materials on either side of a slanted line; u = A x, and A x + b d beyond the line.

    d is the distance to the line. The tractions of both sides agree on the line.
    """

    normal = np.array([0.8, 0.6])
    at = 0.613
    A = np.array([[0.02, 0.01], [0.03, -0.08]])
    young = 20.0, 300.0

    @classmethod
    def stress(cls, side, gradient):
        """The stress of a displacement gradient in plane strain."""
        mu = cls.young[side] / (2 * (1 + NU))
        first = cls.young[side] * NU / ((1 + NU) * (1 - 2 * NU))
        strain = 0.5 * (gradient + gradient.T)
        return 2 * mu * strain + first * np.trace(strain) * np.eye(2)

    def __init__(self):
        unit = [self.stress(1, np.outer(e, self.normal)) @ self.normal for e in np.eye(2)]
        jump = (self.stress(0, self.A) - self.stress(1, self.A)) @ self.normal
        self.b = np.linalg.solve(np.stack(unit, axis=1), jump)
        self.stresses = (
            self.stress(0, self.A),
            self.stress(1, self.A + np.outer(self.b, self.normal)),
        )

    def displacement(self, x):
        beyond = np.maximum(self.normal @ x[:2] - self.at, 0.0)
        return self.A @ x[:2] + self.b[:, None] * beyond

    def pose(self, sided):
        """All sides but the lower one are held; friction below is a given shear."""
        V = fem.functionspace(sided.mesh, ("Lagrange", 2, (2,)))
        u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(sided.mesh)
        far = self.normal[0] * x[0] + self.normal[1] * x[1] > self.at
        young = ufl.conditional(far, self.young[1], self.young[0])
        shear = ufl.conditional(far, -self.stresses[1][0, 1], -self.stresses[0][0, 1])
        bc, below = held_and_below(sided, V, self.displacement)
        return ds.ContactProblem(
            ds.elasticity(u, v, young, NU),
            shear * v[0] * below,
            contact=sided.sides["below"],
            gap=lambda x: -self.displacement(x)[1],
            direction=(0.0, -1.0),
            bcs=[bc],
        )


def square(n):
    """The unit square with a lower side and the others."""
    domain = mesh.create_unit_square(COMM, n, n)
    below = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    others = np.setdiff1d(ds.boundary_facets(domain), below).astype(np.int32)
    return ds.SidedMesh(domain, {"below": below, "held": others})


def test_a_slanted_line():
    """Stiffness and a traction jump along a line that no mesh line follows, in Python."""
    slanted = Slanted()
    assert all(stress[1, 1] < 0.0 for stress in slanted.stresses)  # the pressure presses
    found = ds.solve_adaptively(slanted.pose, square(5), norm="L2", accuracy=1e-4)
    u = found.problem.u
    exact = fem.Function(u.function_space)
    exact.interpolate(slanted.displacement)
    assert found.reached and found.steps[0].estimate <= 1e-7
    assert np.abs(u.x.array - exact.x.array).max(initial=0.0) <= 1e-7
    nodes, pressure = found.problem.contact_nodes, found.problem.pressure
    x = pressure.function_space.tabulate_dof_coordinates()[nodes]
    side = (x[:, 0] > slanted.at / slanted.normal[0]).astype(int)
    inner = (x[:, 0] > 0.1) & (x[:, 0] < 0.9)  # the weights of others reach held corners
    inner &= np.abs(x[:, 0] - slanted.at / slanted.normal[0]) > 0.1
    expected = -np.array(slanted.stresses)[side, 1, 1]
    assert pressure.x.array[nodes][inner] == pytest.approx(expected[inner], rel=1e-5)
    found.problem.destroy()


class Bubble:
    """A x, and c (1 - r^2 / R^2)^2 in a disc: the force jumps across the circle.

    The disc reaches beyond the lower side, where the traction has kinks.
    """

    middle, radius, c = np.array([0.45, 0.2]), 0.33, np.array([0.004, 0.006])

    def inside(self, x):
        ray = np.array([x[0] - self.middle[0], x[1] - self.middle[1]])
        return ray, np.maximum(1.0 - (ray**2).sum(axis=0) / self.radius**2, 0.0)

    def displacement(self, x):
        return np.einsum("ij,j...->i...", Slanted.A, np.array(x[:2])) + np.multiply.outer(
            self.c, self.inside(x)[1] ** 2
        )

    def gradient(self, x):
        ray, q = self.inside(x)
        slope = -4.0 * q * ray / self.radius**2
        return np.stack([Slanted.A[i, j] + self.c[i] * slope[j] for i in (0, 1) for j in (0, 1)])

    def pose(self, degree):
        def posed(sided):
            V = fem.functionspace(sided.mesh, ("Lagrange", degree, (2,)))
            u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(sided.mesh)
            q = 1.0 - sum((x[i] - self.middle[i]) ** 2 for i in (0, 1)) / self.radius**2
            bump = ufl.conditional(q > 0.0, q**2, 0.0)
            exact = ufl.as_vector([ufl.dot(ufl.as_vector(Slanted.A[i]), x) + self.c[i] * bump
                                   for i in (0, 1)])  # fmt: skip
            inner = ds.stress(exact, 100.0, NU)
            bc, below = held_and_below(sided, V, self.displacement)
            shear = ufl.dot(inner, ufl.FacetNormal(sided.mesh))[0]
            return ds.ContactProblem(
                ds.elasticity(u, v, 100.0, NU),
                ufl.inner(-ufl.div(inner), v) * ufl.dx + shear * v[0] * below,
                contact=sided.sides["below"],
                gap=lambda x: -self.displacement(x)[1],
                direction=(0.0, -1.0),
                bcs=[bc],
            )

        return posed


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize(("norm", "accuracy"), [("L2", 5e-5), ("Linf", 1e-4), ("H1", 2e-3)])
def test_a_force_that_jumps_across_a_circle(degree, norm, accuracy):
    """Loads of bodies are integrated piece by piece, as those of scalars are."""
    bubble, accuracy = Bubble(), accuracy / 30 ** (degree - 1)
    found = ds.solve_adaptively(bubble.pose(degree), square(4), norm=norm, accuracy=accuracy)
    true = known.true_error(found.problem.u, bubble, norm)
    assert found.reached
    assert true <= 1.05 * found.estimate <= 1.05 * accuracy, (true, found)
    found.problem.destroy()


def test_a_stiffness_that_jumps_along_a_curve_is_refused(parse):
    """Before any solve, with the name of the datum."""
    scene = parse(COLUMN.format(young="where(x^2 + y^2 < 0.31, 10, 400)", force="0"))
    with pytest.raises(InputError, match="young of displacements jumps inside of cells") as error:
        solve_scene(scene, COMM, accuracy=0.1)
    assert error.value.subject == "elasticity"
