"""The H^{1/2} norm on closed boundary curves, from the Fourier series in arc length.

The functions exp(2 pi i k s / length) are the eigenfunctions of the Laplace-Beltrami operator of
a closed curve of any shape, corners included, so the norm of the interpolation space between L^2
and H^1 is

    ||e||^2 = length * sum over k of (1 + (2 pi k / length)^2)^{1/2} |e_k|^2

with the Fourier coefficients e_k of e. The trace of a function on a triangle mesh is a curve of
O(N) values: each rank samples its own facets, one rank adds up the series.
"""

from typing import Any, TypeAlias

import basix
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, mesh
from scipy.interpolate import BarycentricInterpolator

from dolfinx_signorini import compat
from dolfinx_signorini.meshes import boundary_facets, edge_chains, facet_cells
from dolfinx_signorini.references import Reference

NODES = 9  # interpolation nodes per facet
SAMPLES = 64  # samples per facet: what lies above their frequency is 2e-4 of the norm

Array: TypeAlias = npt.NDArray[np.floating[Any]]


def fractional_norm(
    u_h: fem.Function,
    exact: Reference | None = None,
) -> float:
    """Return the H^{1/2} norm of u_h - u on the boundary of a plane domain.

    Args:
        u_h: The discrete solution, on a mesh of a plane domain.
        exact: The known solution; None for the norm of u_h itself.

    Raises:
        ValueError: The domain is not plane, or its boundary is not made of closed curves.
        FloatingPointError: The error is not a number at some point of evaluation.
    """
    domain = u_h.function_space.mesh
    if domain.topology.dim != 2 or domain.geometry.dim != 2:
        raise ValueError("the fractional norm is defined here on the boundary of plane domains")
    gathered = domain.comm.gather(_facet_samples(u_h, exact), root=0)
    result: tuple[float, str] = (0.0, "")
    if gathered is not None:
        vertices, ends, values = (np.concatenate(part) for part in zip(*gathered, strict=True))
        try:
            result = (_norm(vertices, ends, values), "")
        except ValueError as error:
            result = (0.0, str(error))
    norm, message = domain.comm.bcast(result, root=0)
    if message:
        raise ValueError(message)
    if not np.isfinite(norm):
        raise FloatingPointError(f"the error is {norm} at a point of evaluation")
    return norm


def closed_curves(vertices: npt.NDArray[np.int64]) -> list[npt.NDArray[np.int64]]:
    """Chain edges into closed curves.

    Args:
        vertices: The two vertices of every edge, shape (edges, 2).

    Returns:
        The curves, see `meshes.edge_chains`.

    Raises:
        ValueError: Some vertex does not belong to exactly two edges.
    """
    _, counts = np.unique(vertices, return_counts=True)
    if (counts != 2).any():
        raise ValueError("the boundary is not made of closed curves: a vertex has not two edges")
    return edge_chains(vertices)


def _facet_samples(
    u_h: fem.Function, exact: Reference | None
) -> tuple[npt.NDArray[np.int64], Array, Array]:
    """Vertices (facets, 2), their coordinates (facets, 2, 2), values (facets, NODES)."""
    domain = u_h.function_space.mesh
    facets = facet_cells(domain, boundary_facets(domain))
    error = u_h if exact is None else u_h - exact.u
    expression = fem.Expression(ufl.as_vector([error]), _nodes()[:, None], comm=domain.comm)
    values = compat.evaluate(expression, domain, facets)
    corners = np.array(basix.topology(basix.CellType[domain.topology.cell_name()])[1])
    dofs = domain.geometry.dofmap[facets[:, 0, None], corners[facets[:, 1]]]
    vertices = _global_indices(domain, dofs)
    return vertices, domain.geometry.x[dofs][:, :, :2], values.reshape(-1, NODES)


def _global_indices(domain: mesh.Mesh, dofs: npt.NDArray[np.int32]) -> npt.NDArray[np.int64]:
    return domain.geometry.index_map().local_to_global(dofs.ravel()).reshape(dofs.shape)


def _nodes() -> Array:
    return 0.5 - 0.5 * np.cos(np.pi * np.arange(NODES) / (NODES - 1))


def _norm(vertices: npt.NDArray[np.int64], ends: Array, values: Array) -> float:
    largest = float(np.abs(values).max(initial=0.0))
    if largest == 0.0 or not np.isfinite(largest):
        return largest
    total = 0.0
    for curve in closed_curves(vertices):
        edges, reverse = curve[:, 0], curve[:, 1] == 1
        lengths = np.linalg.norm(ends[edges, 1] - ends[edges, 0], axis=1)
        along = values[edges] / largest
        along[reverse] = along[reverse, ::-1]  # the nodes are symmetric
        total += _spectral_sum(lengths, along)
    return largest * float(np.sqrt(total))


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
