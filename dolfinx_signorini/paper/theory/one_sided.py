"""One-sided approximation: Lemmas 3.4 and 3.5, and problem (11).

With y = w_h - R_h(u) on the boundary the constraint R_h(u) - u <= w_h <= R_h(u) reads -u <= y <= 0,
so that problem (11) is a linear program for the nodal values of y:

    minimise sum y_i    subject to    y >= -u along the whole of every edge,  y <= 0.

The upper bound holds along an edge as soon as it holds at its nodes. The lower one is set at
samples of every edge; where u vanishes at a node also through the tangent there.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from dolfinx import fem
from mpi4py import MPI
from scipy.optimize import linprog

from dolfinx_signorini.errors import NotConvergedError
from dolfinx_signorini.paper.theory.discretisation import Discretisation

SAMPLES = 64  # intervals per edge
VANISHING = 1e-13  # of the largest u on the boundary: what counts as zero, above rounding
TOUCHING = 1e-9  # of the largest u on the boundary: what counts as touching; HiGHS' accuracy

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class OneSided:
    """A solution of problem (11), extended to the domain.

    Attributes:
        w_h: The function, harmonic in the discrete sense inside.
        norm: Its H^1 norm.
        sampling_error: A bound on how far w_h may lie below R_h(u) - u between two samples.
        upper_error: How far w_h lies above R_h(u) at a node: rounding.
        cases: The number of nodes of case 1, 2 and 3 of the paper's Fig. 1, and of none.
    """

    w_h: fem.Function
    norm: float
    sampling_error: float
    upper_error: float
    cases: tuple[int, int, int, int]


@dataclass(frozen=True)
class EdgeData:
    """u along the boundary edges.

    Attributes:
        t: Positions of the samples along an edge, from 0 to 1.
        u: Its values there, shape (edges, samples).
        slope: Its derivative along the curve there.
        widths: Lengths of the edges.
    """

    t: Array
    u: Array
    slope: Array
    widths: Array


def one_sided_approximation(discretisation: Discretisation) -> OneSided:
    """Solve problem (11) for the scene's solution, and extend the result discretely harmonically.

    Raises:
        NotConvergedError: HiGHS did not find the optimum.
    """
    curve = discretisation.curve
    data = edge_data(discretisation)
    y = solve_linear_program(curve.space.mesh.comm, data, np.ones(len(curve.s)))
    trace = y + curve.values(discretisation.ritz)
    w_h = discretisation.harmonic(curve.function(trace))
    return OneSided(
        w_h=w_h,
        norm=discretisation.norm(w_h),
        sampling_error=sampling_error(data, y),
        upper_error=float(max(y.max(), 0.0)),
        cases=count_cases(data, y),
    )


def edge_data(discretisation: Discretisation) -> EdgeData:
    """Sample the scene's solution and its tangential derivative along the boundary edges."""
    exact, curve = discretisation.exact, discretisation.curve
    t = np.linspace(0.0, 1.0, SAMPLES + 1, dtype=np.float64)
    values = curve.samples([exact.u, *exact.grad], t)
    tangents = (np.roll(curve.x, -1, axis=0) - curve.x) / curve.widths[:, None]
    slope = np.einsum("ikd,id->ik", values[:, :, 1:], tangents)
    u = np.where(values[:, :, 0] > VANISHING * np.abs(values[:, :, 0]).max(), values[:, :, 0], 0.0)
    return EdgeData(t, u, slope, curve.widths)


def solve_linear_program(
    comm: MPI.Comm, data: EdgeData, cost: Array, bounded: bool = True
) -> Array:
    """Minimise cost . y over all y with y >= -u along the edges.

    Args:
        comm: The communicator; its rank 0 solves.
        data: u along the edges.
        cost: One number per node.
        bounded: Whether y <= 0, too.

    Raises:
        NotConvergedError: HiGHS did not find the optimum.
    """
    solution: tuple[Array | None, str] = (None, "")
    if comm.rank == 0:
        solution = _solve(data, cost, bounded)
    y, message = comm.bcast(solution, root=0)
    if y is None:
        raise NotConvergedError(f"linear program: {message}", np.inf, message)
    return y


def _solve(data: EdgeData, cost: Array, bounded: bool) -> tuple[Array | None, str]:
    n, m = data.u.shape
    scale = float(data.u.max()) or 1.0
    i = np.arange(n)
    low = -data.u[:, 0] / scale
    # Edges on which u vanishes are held by their nodes alone.
    edges = np.flatnonzero((data.u[:, 1:-1] > 0.0).any(axis=1))
    rows = np.arange(len(edges) * (m - 2)).reshape(len(edges), m - 2)
    t = np.broadcast_to(data.t[1:-1], rows.shape)
    first = np.broadcast_to(i[edges, None], rows.shape)
    second = (first + 1) % n
    inner = sp.csr_matrix(
        (
            np.concatenate([(1.0 - t).ravel(), t.ravel()]),
            (np.tile(rows.ravel(), 2), np.concatenate([first.ravel(), second.ravel()])),
        ),
        shape=(rows.size, n),
    )
    # With y = 0 where u = 0 at the end of an edge, y >= -u near it is a bound on the slope of y.
    matrix, lower = _tangents(data, edges if bounded else edges[:0], n)
    result = linprog(
        cost / max(float(np.abs(cost).max()), 1e-300),
        A_ub=-sp.vstack([inner, matrix]),
        b_ub=np.concatenate([data.u[edges, 1:-1].ravel(), -lower]) / scale,
        bounds=np.column_stack([low, np.full(n, 0.0 if bounded else np.inf)]),
        method="highs",
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )
    if result.status != 0:
        return None, str(result.message)
    return np.asarray(result.x * scale), ""


def _tangents(data: EdgeData, edges: npt.NDArray[np.int64], n: int) -> tuple[sp.csr_matrix, Array]:
    """The rows y' >= -u' at the ends of edges where u vanishes."""
    at_start = edges[data.u[edges, 0] == 0.0]
    at_end = edges[data.u[edges, -1] == 0.0]
    nodes = np.concatenate([(at_start + 1) % n, at_end])
    slope = np.concatenate([data.slope[at_start, 0], -data.slope[at_end, -1]])
    width = np.concatenate([data.widths[at_start], data.widths[at_end]])
    rows = np.arange(len(nodes))
    matrix = sp.csr_matrix((np.ones(len(nodes)), (rows, nodes)), shape=(len(nodes), n))
    return matrix, -width * np.maximum(slope, 0.0)


def sampling_error(data: EdgeData, y: Array) -> float:
    """Bound how far y lies below -u between samples.

    Between two samples at a distance d, u lies no more than d/4 times the oscillation of u' below
    its chord. The oscillation is taken from the samples of the interval and of its two neighbours:
    right where u' is monotone, and safe where it has one extremum that the samples resolve.
    """
    chord = y[:, None] * (1.0 - data.t) + np.roll(y, -1)[:, None] * data.t + data.u
    low = np.minimum(chord[:, 1:], chord[:, :-1])
    slope = data.slope
    padded = np.concatenate([slope[:, :1], slope, slope[:, -1:]], axis=1)
    window = np.lib.stride_tricks.sliding_window_view(padded, 4, axis=1)
    oscillation = window.max(axis=2) - window.min(axis=2)
    sag = 0.25 * (data.t[1] - data.t[0]) * data.widths[:, None] * oscillation
    vanishing = (y == 0.0) & (np.roll(y, -1) == 0.0)  # -u <= 0 = y holds exactly
    violation = np.where(vanishing[:, None], 0.0, np.maximum(sag - low, 0.0))
    return float(violation.max())


def node_cases(data: EdgeData, y: Array) -> npt.NDArray[np.int64]:
    """Return the case of Fig. 1 that each node belongs to, 0 for none.

    A node is of case 1 where w_h = R_h(u) - u there; of case 2 where instead w_h touches
    R_h(u) - u from above on the edge before it, of case 3 where it does on the edge behind it: it
    cannot be lowered in any case.

    Args:
        data: u along the edges.
        y: w_h - R_h(u) at the nodes.
    """
    tolerance = TOUCHING * float(data.u.max(initial=1e-300))
    excess = y[:, None] * (1.0 - data.t) + np.roll(y, -1)[:, None] * data.t + data.u
    # A touching point lies between samples: the LP touches the samples next to it.
    inner = (excess[:, 1:-1] <= tolerance).any(axis=1)
    # Or it is the far node of the edge, if u vanishes there and with it the slope.
    highest = y >= -tolerance
    behind = inner | (highest & (data.u[:, -1] == 0.0))
    before = np.roll(inner | (np.roll(highest, -1) & (data.u[:, 0] == 0.0)), 1)
    cases = np.where(before, 2, np.where(behind, 3, 0))
    return np.where(excess[:, 0] <= tolerance, 1, cases)


def count_cases(data: EdgeData, y: Array) -> tuple[int, int, int, int]:
    """Count the nodes of the three cases of Fig. 1, and those of none."""
    one, two, three, none = (int((node_cases(data, y) == k).sum()) for k in (1, 2, 3, 0))
    return one, two, three, none
