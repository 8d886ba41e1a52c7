"""One-sided approximation: Lemmas 3.4 and 3.5, and problem (11).

With y = w_h - R_h(u) on the boundary the constraint R_h(u) - u <= w_h <= R_h(u) reads -u <= y <= 0,
so that problem (11) is a linear program for the nodal values of y:

    minimise sum y_i    subject to    y >= -u along the whole of every edge,  y <= 0.

The upper bound holds along an edge as soon as it holds at the nodes. The lower bound is set at
samples of every edge, for u lowered by what u may sag between two samples, so that it holds along
the whole edge: w_h is feasible, and at most a trifle larger than the solution of (11).

The infimum of Lemma 3.4 is attained by a discretely harmonic function, too, and is a quadratic
program for the values of y at the nodes where u is positive. As the nearest point of a polyhedron
the program is one of non-negative least squares.

Source: Lawson and Hanson, Solving Least Squares Problems (1974), Chapter 23.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from dolfinx import fem
from scipy.optimize import linprog, nnls
from scipy.sparse.linalg import splu

from dolfinx_signorini.accuracy.terms import difference
from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.errors import NotConvergedError
from dolfinx_signorini.base.tolerances import ROUNDING, SOLVED, TINY
from dolfinx_signorini.norms.fractional import SAMPLES
from dolfinx_signorini.studies.paper.theory.boundary import ends_of
from dolfinx_signorini.studies.paper.theory.discretisation import Discretisation


@dataclass(frozen=True)
class EdgeData:
    """A function u at samples of the boundary edges:

        data = edge_data(discretisation)
        excess = data.along(y) + data.u  # how far y is from -u

    Attributes:
        t: Positions of the samples along an edge, from 0 to 1.
        u: Values at the samples, shape (edges, samples).
        slope: The derivative along the curve at the samples.
        widths: Lengths of the edges.
    """

    t: Array
    u: Array
    slope: Array
    widths: Array

    @property
    def s(self) -> Array:
        """Arc length of the samples, shape (edges, samples)."""
        starts = np.concatenate(([0.0], np.cumsum(self.widths)[:-1]))
        return np.asarray(starts[:, None] + self.widths[:, None] * self.t)

    def lowered(self) -> "EdgeData":
        """Return the data with u lowered, but not below 0, by what u may sag between samples.

        Between two samples at a distance d, u lies no more than d/4 times the oscillation of u'
        below its chord. The oscillation is taken from the samples of the interval and of its two
        neighbours: right where u' is monotone, and safe where u' has one extremum that the samples
        resolve.
        """
        padded = np.pad(self.slope, ((0, 0), (1, 1)), mode="edge")
        window = np.lib.stride_tricks.sliding_window_view(padded, 4, axis=1)
        oscillation = window.max(axis=2) - window.min(axis=2)
        sag = 0.25 * (self.t[1] - self.t[0]) * self.widths[:, None] * oscillation
        sides = np.pad(sag, ((0, 0), (1, 1)))
        margin = SOLVED * float(self.u.max(initial=0.0))
        u = np.maximum(self.u - np.maximum(sides[:, :-1], sides[:, 1:]) - margin, 0.0)
        return replace(self, u=u)

    def along(self, nodal: Array) -> Array:
        """Return the samples of a piecewise linear function, given by its values at the nodes."""
        return np.asarray(self.matrix @ nodal).reshape(self.u.shape)

    @property
    def matrix(self) -> sp.csr_matrix:
        """From the nodal values of a piecewise linear function to its samples, edge by edge."""
        first, t = sp.identity(len(self.u), format="csr"), self.t[:, None]
        second = first[np.roll(np.arange(len(self.u)), -1)]
        return sp.csr_matrix(sp.kron(first, 1.0 - t) + sp.kron(second, t))


@dataclass(frozen=True)
class OneSided:
    """A solution of problem (11), extended to the domain:

        found = one_sided_approximation(discretisation)
        assert supercloseness(discretisation) <= found.norm

    Attributes:
        w_h: The function, harmonic in the discrete sense inside.
        norm: The H^1 norm of w_h.
        outside: How far w_h is below R_h(u) - u at a sample or above R_h(u) at a node: not at all.
        distance: The largest w_h - R_h(u) + u at a node, which (13) bounds.
        tested: ||R_h(u) - u_h||_H1^2 over (R_h(u) - u_h, w_h)_H1, at most 1 by the proof of (9).
        cases: The number of nodes of case 1, 2 and 3 of the paper's Fig. 1, and of none.
        data: u along the boundary edges.
        ritz: R_h(u) at the boundary nodes.
        y: w_h - R_h(u) at the boundary nodes.
    """

    w_h: fem.Function
    norm: float
    outside: float
    distance: float
    tested: float
    cases: tuple[int, int, int, int]
    data: EdgeData
    ritz: Array
    y: Array


def one_sided_approximation(discretisation: Discretisation) -> OneSided:
    """Solve problem (11) for the exact solution, and extend the result discretely harmonically.

    Raises:
        NotConvergedError: HiGHS did not find the optimum.
    """
    curve, exact = discretisation.curve, edge_data(discretisation)
    data = exact.lowered()
    y = solve_linear_program(data, np.ones(len(curve.s)))
    y = np.where(ends_of((data.u == 0.0).any(axis=1)), 0.0, np.minimum(y, 0.0))
    ritz = curve.values(discretisation.ritz)
    w_h = discretisation.harmonic(curve.function(ritz + y))
    apart = difference(discretisation.ritz, discretisation.u_h)
    return OneSided(
        w_h=w_h,
        norm=discretisation.norm(w_h),
        outside=float(max((-exact.u - exact.along(y)).max(), y.max(), 0.0)),
        distance=float((y + exact.u[:, 0]).max()),
        tested=discretisation.product(apart, apart) / discretisation.product(apart, w_h),
        cases=count_cases(data, y),
        data=data,
        ritz=ritz,
        y=y,
    )


def edge_data(discretisation: Discretisation) -> EdgeData:
    """Sample the exact solution and its tangential derivative along the boundary edges."""
    exact, curve = discretisation.exact, discretisation.curve
    t = np.linspace(0.0, 1.0, SAMPLES + 1, dtype=np.float64)
    values = curve.samples([exact.u, *exact.grad], t)
    tangents = (np.roll(curve.x, -1, axis=0) - curve.x) / curve.widths[:, None]
    slope = np.einsum("ikd,id->ik", values[:, :, 1:], tangents)
    u = np.where(values[:, :, 0] > ROUNDING * np.abs(values[:, :, 0]).max(), values[:, :, 0], 0.0)
    return EdgeData(t, u, slope, curve.widths)


def solve_linear_program(data: EdgeData, cost: Array, bounded: bool = True) -> Array:
    """Minimise cost . y over all y with y >= -u along the edges.

    Args:
        data: u along the edges, the same on all ranks, each of which solves.
        cost: One number per node.
        bounded: Whether y <= 0, too.

    Returns:
        y at the nodes.

    Raises:
        NotConvergedError: HiGHS did not find the optimum.
    """
    scale = float(data.u.max()) or 1.0
    # Edges on which u vanishes are held by their nodes alone.
    inner = np.zeros(data.u.shape, dtype=bool)
    inner[:, 1:-1] = (data.u > 0.0).any(axis=1, keepdims=True)
    high = np.full(len(data.u), 0.0 if bounded else np.inf)
    result = linprog(
        cost / max(float(np.abs(cost).max()), TINY),
        A_ub=-data.matrix[inner.ravel()],
        b_ub=data.u[inner] / scale,
        bounds=np.column_stack([-data.u[:, 0] / scale, high]),
        method="highs",
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )
    if result.status != 0:
        raise NotConvergedError(f"linear program: {result.message}", np.inf, str(result.message))
    return np.asarray(result.x * scale)


def node_cases(data: EdgeData, y: Array) -> npt.NDArray[np.int64]:
    """Return the case of Fig. 1 that each node belongs to, 0 for none.

    A node is of case 1 where w_h = R_h(u) - u at the node; of case 2 where instead w_h touches
    R_h(u) - u from above on the edge before the node, of case 3 where on the edge behind: w_h
    cannot be lowered in any case.
    """
    tolerance = SOLVED * float(data.u.max(initial=TINY))
    excess = data.along(y) + data.u
    # A touching point lies between samples: the LP touches the samples next to the point.
    inner = (excess[:, 1:-1] <= tolerance).any(axis=1)
    # Or the touching point is the far node of the edge, if u and its slope vanish there.
    highest = y >= -tolerance
    behind = inner | (highest & (data.u[:, -1] == 0.0))
    before = np.roll(inner | (np.roll(highest, -1) & (data.u[:, 0] == 0.0)), 1)
    return np.select([excess[:, 0] <= tolerance, before, behind], [1, 2, 3], 0)


def count_cases(data: EdgeData, y: Array) -> tuple[int, int, int, int]:
    """Count the nodes of the three cases of Fig. 1, and the nodes of none."""
    none, *cases = map(int, np.bincount(node_cases(data, y), minlength=4))
    return cases[0], cases[1], cases[2], none


def smallest_one_sided(discretisation: Discretisation) -> float:
    """Return the infimum of the right-hand side of (9)."""
    data, curve = edge_data(discretisation).lowered(), discretisation.curve
    energy, w = boundary_energy(discretisation), curve.values(discretisation.ritz)
    free = ~ends_of((data.u == 0.0).any(axis=1))
    if free.any():
        # y >= -u at the samples of the edges that have a free node, and y <= 0.
        some = np.repeat(free | np.roll(free, -1), len(data.t))
        samples = data.matrix[some][:, free].toarray()
        rows = np.vstack([-np.eye(samples.shape[1]), samples])
        lower = np.concatenate([np.zeros(samples.shape[1]), -data.u.ravel()[some]])
        w[free] += nearest(energy[free][:, free], (energy @ w)[free], rows, lower)
    return float(np.sqrt(max(float(w @ energy @ w), 0.0)))


def boundary_energy(discretisation: Discretisation) -> Array:
    """Return the H^1 products of the discretely harmonic functions of all nodes of the curve."""
    d, boundary = discretisation, discretisation.curve.dofs
    pointers, columns, values = d.A.getValuesCSR()
    shape = len(pointers) - 1, d.A.getSize()[1]
    local = sp.csr_matrix((values, columns, pointers), shape=shape)
    A = sp.vstack(d.comm.allgather(local)).tocsc()
    inner = np.setdiff1d(np.arange(shape[1]), boundary)
    between = A[inner][:, boundary].toarray()
    extended = splu(A[inner][:, inner]).solve(between)
    return np.asarray(A[boundary][:, boundary].toarray() - between.T @ extended)


def nearest(matrix: Array, vector: Array, rows: Array, lower: Array) -> Array:
    """Minimise y . matrix y / 2 + vector . y over all y with rows y >= lower.

    Args:
        matrix: Symmetric and positive definite, shape (n, n).
        vector: Shape (n,).
        rows: Shape (m, n).
        lower: Shape (m,).
    """
    L = np.linalg.cholesky(matrix)
    centre = np.linalg.solve(L, vector)  # y = L^-T (x - centre), and |x| is to be smallest
    turned = np.linalg.solve(L, rows.T)
    shifted = lower + turned.T @ centre
    scale = float(np.abs(shifted).max()) or 1.0
    system = np.vstack([turned, shifted / scale])
    target = np.zeros(len(system))
    target[-1] = 1.0
    weights, _ = nnls(system, target, maxiter=100 * system.shape[1])
    residual = target - system @ weights
    x = -scale * residual[:-1] / residual[-1]
    return np.asarray(np.linalg.solve(L.T, x - centre))
