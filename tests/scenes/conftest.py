"""What the tests of scenes share: the streams, and a solver that shares nothing with them."""

import sys
from collections.abc import Callable

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import splu


@pytest.fixture(autouse=True)
def same_streams(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command line silences the other ranks for good; here only while a test runs."""
    monkeypatch.setattr(sys, "stdout", sys.stdout)


@pytest.fixture(scope="session")
def solve_with_numpy() -> Callable[..., np.ndarray]:
    """Linear elements and active sets in NumPy and SciPy alone."""
    return _solve_with_numpy


def _solve_with_numpy(points, cells, diffusion, reaction, load, fluxes, fixed, contact):
    """Return the nodal values of the solution.

    Args:
        points, cells: The mesh, shapes (n, 2) and (m, 3).
        diffusion, reaction, load: Functions of x and y; integrated with the edge midpoint rule,
            exactly up to degree 2.
        fluxes: Pairs of edges, shape (k, 2), and function; integrated with Simpson's rule.
        fixed: Vertices with Dirichlet data, and the data.
        contact: Vertices of the contact boundary, and the obstacle there.
    """
    n = len(points)
    x = points[cells]
    edges = x[:, [2, 0, 1]] - x[:, [1, 2, 0]]  # opposite each vertex
    area = 0.5 * np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
    middle = 0.5 * (x[:, [1, 2, 0]] + x[:, [2, 0, 1]])
    shape = 0.5 * (1.0 - np.eye(3))  # vertex function i at the midpoint opposite vertex q
    k, c, f = (
        np.broadcast_to(g(middle[..., 0], middle[..., 1]), middle.shape[:2])
        for g in (diffusion, reaction, load)
    )
    local = np.einsum("cik,cjk->cij", edges, edges) * (k.mean(axis=1) / (4.0 * area))[:, None, None]
    local += np.einsum("qi,qj,cq,c->cij", shape, shape, c, area / 3.0)
    i, j = np.repeat(cells, 3, axis=1).ravel(), np.tile(cells, 3).ravel()
    A = sp.coo_matrix((local.ravel(), (i, j)), shape=(n, n)).tocsr()
    b = np.zeros(n)
    np.add.at(b, cells, np.einsum("qi,cq,c->ci", shape, f, area / 3.0))
    for ends, flux in fluxes:
        a, e = points[ends[:, 0]], points[ends[:, 1]]
        length = np.hypot(*(e - a).T)
        at = [flux(*p.T) * np.ones(len(ends)) for p in (a, 0.5 * (a + e), e)]
        np.add.at(b, ends[:, 0], length / 6.0 * (at[0] + 2.0 * at[1]))
        np.add.at(b, ends[:, 1], length / 6.0 * (at[2] + 2.0 * at[1]))
    bound = np.full(n, -np.inf)
    bound[contact[0]] = contact[1]
    u = np.zeros(n)
    u[fixed[0]] = fixed[1]
    bound[fixed[0]] = -np.inf
    loose = np.setdiff1d(np.arange(n), fixed[0])
    active = np.isfinite(bound)
    for _ in range(50):
        free = loose[~active[loose]]
        u[active] = bound[active]
        rest = np.setdiff1d(np.arange(n), free)
        u[free] = splu(A[free][:, free].tocsc()).solve(b[free] - A[free][:, rest] @ u[rest])
        force = A @ u - b
        update = np.isfinite(bound) & (force - (u - bound) > 1e-12)
        if (update == active).all():
            return u
        active = update
    raise AssertionError("the reference solver does not settle")
