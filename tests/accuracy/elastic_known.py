"""Elastic contact whose solution the tests alone know, and its errors at points of their own."""

import sys
from pathlib import Path

import basix
import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_signorini as ds

sys.path.append(str(Path(__file__).parents[1] / "problem"))
import hertz

COMM = MPI.COMM_WORLD
PARTS, CHUNK = 4, 1000  # of the edges of a cell, and cells at a time


def first_mesh(n=4, turn=None):
    """The block of tests/problem/hertz.py as a coarse mesh, in contact below."""
    domain = dolfinx.mesh.create_rectangle(COMM, [(-2.0, 0.0), (2.0, 2.0)], (2 * n, n))
    below = dolfinx.mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    others = np.setdiff1d(ds.boundary_facets(domain), below).astype(np.int32)
    if turn is not None:
        domain.geometry.x[:, :2] = domain.geometry.x[:, :2] @ turn.T
    return ds.SidedMesh(domain, {"below": below, "held": others})


def hertz_on(degree):
    """What poses Hertz's problem: the exact displacement holds the block on its other sides."""

    def pose(sided):
        V = fem.functionspace(sided.mesh, ("Lagrange", degree, (2,)))
        u, v, data = ufl.TrialFunction(V), ufl.TestFunction(V), fem.Function(V)
        data.interpolate(hertz.displacement)
        bc = fem.dirichletbc(data, fem.locate_dofs_topological(V, 1, sided.sides["held"]))
        a = ds.elasticity(u, v, hertz.E, hertz.NU)
        L = ufl.inner(fem.Constant(sided.mesh, (0.0, 0.0)), v) * ufl.dx
        below = sided.sides["below"]
        return ds.ContactProblem(a, L, contact=below, gap=hertz.gap, bcs=[bc])

    return pose


class Slanted:
    """Full contact on a slanted side, with smooth displacements u = Q w(Q' x), Q a turn.

    On the side y = 0 of the block w = (0.02 sin 2x, g - 0) with g = 0.02 cos 2x has no shear, as
    dw_1/dy = -g'; the pressure is that of the push, and positive.
    """

    angle = 0.7
    Q = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    @staticmethod
    def block(x, y, np=np):
        """w, and dw_1/dx, dw_1/dy, dw_2/dx, dw_2/dy."""
        sin, cos = np.sin, np.cos
        w = 0.04 * y * sin(2 * x) + 0.02 * sin(2 * x) * cos(y), 0.02 * cos(2 * x) - 0.2 * y
        slopes = (
            0.08 * y * cos(2 * x) + 0.04 * cos(2 * x) * cos(y),
            0.04 * sin(2 * x) - 0.02 * sin(2 * x) * sin(y),
            -0.04 * sin(2 * x),
            -0.2 + 0.0 * x,
        )
        return w, slopes

    def displacement(self, x):
        return self.Q @ np.stack(self.block(*(self.Q.T @ x[:2]))[0])

    def gradient(self, x):
        rows = np.stack(self.block(*(self.Q.T @ x[:2]))[1]).reshape(2, 2, -1)
        return np.einsum("ki,ijn,lj->kln", self.Q, rows, self.Q).reshape(4, -1)

    def on(self, degree):
        """What poses the problem, with the body force that belongs to the displacement."""

        def pose(sided):
            V = fem.functionspace(sided.mesh, ("Lagrange", degree, (2,)))
            u, v, data = ufl.TrialFunction(V), ufl.TestFunction(V), fem.Function(V)
            data.interpolate(self.displacement)
            bc = fem.dirichletbc(data, fem.locate_dofs_topological(V, 1, sided.sides["held"]))
            Q = ufl.as_matrix(self.Q)
            X = ufl.dot(ufl.transpose(Q), ufl.SpatialCoordinate(sided.mesh))
            exact = ufl.dot(Q, ufl.as_vector(self.block(X[0], X[1], ufl)[0]))
            load = -ufl.div(ds.stress(exact, hertz.E, hertz.NU))
            return ds.ContactProblem(
                ds.elasticity(u, v, hertz.E, hertz.NU),
                ufl.inner(load, v) * ufl.dx(metadata={"quadrature_degree": 8}),
                contact=sided.sides["below"],
                gap=lambda x: -0.02 * np.cos(2.0 * (self.Q.T @ x[:2])[0]),
                bcs=[bc],
            )

        return pose


QUANTITIES = {
    "energy": lambda u: ds.weighted_strain(u, hertz.E, hertz.NU),
    "stress": lambda u: ds.stress(u, hertz.E, hertz.NU),
    "largest stress": lambda u: ds.stress(u, hertz.E, hertz.NU),
}
LARGEST = "Linf", "largest stress"


def solve(pose, sided, what, accuracy, **given):
    """Ask for an accuracy in a norm, or in the norm of a quantity."""
    of = QUANTITIES.get(what)
    norm = what if of is None else "Linf" if what in LARGEST else "L2"
    return ds.solve_adaptively(pose, sided, norm=norm, of=of, accuracy=accuracy, **given)


def true_error(u, exact, what):
    """Return a norm of the error by a rule on parts of cells, or the largest one at its points.

    Args:
        u: The discrete solution.
        exact: What has the exact `displacement` and `gradient`.
        what: The name of the norm, or of a quantity.
    """
    count = u.function_space.mesh.topology.index_map(2).size_local
    found = [_powers(u, exact, what, k, min(k + CHUNK, count)) for k in range(0, count, CHUNK)]
    if what in LARGEST:
        return COMM.allreduce(max(found, default=0.0), op=MPI.MAX)
    return COMM.allreduce(sum(found)) ** (0.25 if what in ("L4", "W1_4") else 0.5)


def _powers(u, exact, what, first, last):
    space, domain = u.function_space, u.function_space.mesh
    points, weights = _rule()
    table = space.element.basix_element.tabulate(1, points)[:, :, :, 0]
    x = domain.geometry.x[domain.geometry.dofmap[first:last]][:, :, :2]
    edges = (x[:, 1:] - x[:, :1]).transpose(0, 2, 1)
    places = (x[:, :1] + np.einsum("cij,qj->cqi", edges, points)).reshape(-1, 2).T
    nodal = u.x.array.reshape(-1, 2)[space.dofmap.list[first:last]]
    many = len(nodal), len(points)
    powers = np.zeros(many)
    if what not in QUANTITIES:
        e = (table[0] @ nodal).transpose(2, 0, 1) - exact.displacement(places).reshape(2, *many)
        length, p = np.hypot(*e), 4.0 if what in ("L4", "W1_4") else 2.0
        if what == "Linf":
            return length.max()
        powers += length**p
    if what in QUANTITIES or what in ("H1", "W1_4"):
        slopes = (table[1:] @ nodal[:, None]).transpose(0, 2, 3, 1) @ np.linalg.inv(edges)[:, None]
        slopes = slopes.transpose(2, 3, 0, 1)
        with np.errstate(all="ignore"):
            slopes -= np.nan_to_num(exact.gradient(places)).reshape(2, 2, *many)
    if what in ("H1", "W1_4"):
        powers += (np.hypot(slopes[0], slopes[1]) ** p).sum(axis=0)
    elif what in QUANTITIES:
        strain = 0.5 * (slopes + slopes.swapaxes(0, 1))
        stress = 2.0 * hertz.MU * strain
        stress[[0, 1], [0, 1]] += hertz.LAMBDA * (strain[0, 0] + strain[1, 1])
        powers += (stress * (strain if what == "energy" else stress)).sum(axis=(0, 1))
        if what in LARGEST:
            return np.sqrt(powers.max())
    return (np.abs(np.linalg.det(edges))[:, None] * weights * powers).sum()


def _rule():
    points, weights = basix.make_quadrature(basix.CellType.triangle, 13)
    places = []
    for i in range(PARTS):
        for j in range(PARTS - i):
            places.append((points + np.array([i, j])) / PARTS)
            if i + j < PARTS - 1:
                places.append((np.array([i + 1, j + 1]) - points) / PARTS)
    return np.concatenate(places), np.tile(weights / PARTS**2, len(places))
