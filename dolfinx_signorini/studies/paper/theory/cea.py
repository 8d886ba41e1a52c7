"""The infimum of Lemma 3.4: the smallest w_h in V_h between R_h(u) - u and R_h(u) on the boundary.

The infimum is attained by a discretely harmonic function, and with y = w_h - R_h(u) on the boundary
it is a quadratic program for the values of y at the nodes where u is positive. As the nearest point
of a polyhedron the program is one of non-negative least squares.

Source: Lawson and Hanson, Solving Least Squares Problems (1974), Chapter 23.
"""

import numpy as np
import numpy.typing as npt
from scipy.optimize import nnls

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.studies.paper.theory.discretisation import Discretisation
from dolfinx_signorini.studies.paper.theory.one_sided import EdgeData, edge_data


def smallest_one_sided(discretisation: Discretisation) -> float:
    """Return the infimum of the right-hand side of (9)."""
    d, curve, data = discretisation, discretisation.curve, edge_data(discretisation).lowered()
    ritz = curve.values(d.ritz)
    touching = (data.u == 0.0).any(axis=1)
    free = np.flatnonzero(~(touching | np.roll(touching, 1)))
    functions = [d.harmonic(curve.function(ritz))]
    for node in free:
        unit = np.zeros(len(ritz))
        unit[node] = 1.0
        functions.append(d.harmonic(curve.function(unit)))
    gram = _gram(d, functions)
    square = float(gram[0, 0])
    if len(free):
        y = nearest(gram[1:, 1:], gram[1:, 0], *_constraints(data, free))
        square += float(y @ gram[1:, 1:] @ y + 2.0 * gram[1:, 0] @ y)
    return float(np.sqrt(max(square, 0.0)))


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


def _gram(d: Discretisation, functions: list) -> Array:  # type: ignore[type-arg]
    """The H^1 products of functions."""
    vectors = [d.system.vector_of(function) for function in functions]
    image, result = vectors[0].duplicate(), np.zeros((len(vectors), len(vectors)))
    for i, vector in enumerate(vectors):
        d.A.mult(vector, image)
        result[i] = image.mDot(vectors)
    for item in (*vectors, image):
        item.destroy()
    return 0.5 * (result + result.T)


def _constraints(data: EdgeData, free: npt.NDArray[np.int64]) -> tuple[Array, Array]:
    """The rows of y >= -u at the samples of the edges that have a free node, and of y <= 0."""
    samples = data.matrix[:, free]
    held = np.repeat(np.isin(np.arange(len(data.u)), np.concatenate([free, free - 1])), len(data.t))
    rows = np.vstack([-np.eye(len(free)), samples[held].toarray()])
    return rows, np.concatenate([np.zeros(len(free)), -data.u.ravel()[held]])
