"""The H^{1/2} norm on closed boundary curves, from the Fourier series in arc length.

The functions exp(2 pi i k s / length) are the eigenfunctions of the Laplace-Beltrami operator of
a closed curve of any shape, corners included, so the norm of the interpolation space between L^2
and H^1 is

    ||e||^2 = length * sum over k of (1 + (2 pi k / length)^2)^{1/2} |e_k|^2

with the Fourier coefficients e_k of e. The trace of a function on a triangle mesh is a curve of
O(N) values: each rank samples its own facets, and every rank adds up the series.
"""

import numpy as np
from dolfinx import fem
from scipy.interpolate import BarycentricInterpolator

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.meshes.elements import LARGEST_DEGREE
from dolfinx_signorini.norms.boundary_edges import BoundaryEdges
from dolfinx_signorini.norms.references import Reference

NODES = LARGEST_DEGREE + 1  # interpolation nodes per facet: elements of any degree are exact
SAMPLES = 64  # samples per facet: higher frequencies have 2e-4 of the norm


def fractional_norm(u_h: fem.Function, exact: Reference | None = None) -> float:
    """Return the H^{1/2} norm of u_h - u on the boundary of a plane domain.

    The square of the norm of a vector is the sum of those of its components.

    Args:
        u_h: The discrete solution, on a mesh of a plane domain.
        exact: The known solution; None for the norm of u_h itself.

    Raises:
        InputError: The domain is not plane, or its boundary is not made of closed curves.
        FloatingPointError: The error is not a number at some point of evaluation.
    """
    domain = u_h.function_space.mesh
    if domain.topology.dim != 2 or domain.geometry.dim != 2:
        raise InputError("known on the boundary of plane domains only", "H1_2_boundary_spectral")
    edges = BoundaryEdges(domain)
    values = edges.samples([u_h if exact is None else u_h - exact.u], _nodes())
    largest = float(np.abs(values).max(initial=0.0))
    if not np.isfinite(largest):
        raise FloatingPointError(f"the error is {largest} at a point of evaluation")
    if largest == 0.0:
        return 0.0
    total = 0.0
    for curve in edges.curves:
        # The samples begin at the leftmost vertex, whatever the numbering of the mesh.
        x, y = edges.x[curve[:, 0], curve[:, 1]].T
        curve = np.roll(curve, -int(np.lexsort((y, x))[0]), axis=0)
        rows, reverse = curve[:, 0], curve[:, 1] == 1
        along: Array = np.asarray(values[rows] / largest)
        along[reverse] = along[reverse, ::-1]  # the nodes are symmetric
        for component in np.moveaxis(along, 2, 0):
            total += _spectral_sum(edges.lengths[rows], component)
    # The last digit of a sum may differ between ranks, and so might a caller's decisions.
    return float(domain.comm.bcast(largest * float(np.sqrt(total))))


def _nodes() -> Array:
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.arange(NODES) / (NODES - 1)))


def _spectral_sum(lengths: Array, values: Array) -> float:
    """Sum the series of one curve: edge lengths (edges,), values at the nodes (edges, NODES)."""
    starts = np.concatenate(([0.0], np.cumsum(lengths)))
    length, count = starts[-1], SAMPLES * len(lengths)
    s = (np.arange(count) + 0.5) * (length / count)
    edge = np.clip(np.searchsorted(starts, s, side="right") - 1, 0, len(lengths) - 1)
    t = np.clip((s - starts[edge]) / lengths[edge], 0.0, 1.0)
    # The Lagrange basis at all samples: the interpolant of each unit vector of nodal values.
    basis = BarycentricInterpolator(_nodes(), np.eye(NODES))(t)
    coefficients = np.fft.rfft((basis * values[edge]).sum(axis=1)) / count
    weights = np.sqrt(1.0 + (2.0 * np.pi * np.arange(len(coefficients)) / length) ** 2)
    weights[1:] *= 2.0  # the coefficients of -k
    return float(length * (weights * np.abs(coefficients) ** 2).sum())
