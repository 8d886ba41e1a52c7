"""Exchange between ranks of sums, maxima and marks of the dofs, vertices and facets they share."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import common, fem, la
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.tolerances import TINY, power_of_two


def summed(
    index_map: common.IndexMap, places: npt.NDArray[np.integer[Any]], values: npt.ArrayLike = 1.0
) -> Array:
    """Return for each place the sum of the values that all ranks have for the place; collective.

    Args:
        index_map: The places: dofs, vertices or facets.
        places: Places that this rank knows, ghosts included; a place may come more than once.
        values: One value for each of them, or one for all.
    """
    sums = la.vector(index_map)
    weights = np.broadcast_to(values, places.shape).ravel()
    sums.array[:] = np.bincount(places.ravel(), weights, len(sums.array))
    sums.scatter_reverse(la.InsertMode.add)
    sums.scatter_forward()
    return np.array(sums.array)


def averaged(
    index_map: common.IndexMap, places: npt.NDArray[np.integer[Any]], values: npt.ArrayLike
) -> Array:
    """Return for each place the mean of the values of all ranks, 0 for none; see `summed`."""
    sums, numbers = summed(index_map, places, values), summed(index_map, places)
    return np.asarray(sums / np.maximum(numbers, 1.0))


def shared(
    index_map: common.IndexMap, places: npt.NDArray[np.integer[Any]], values: Array
) -> Array:
    """Return for each entry of some places an even share of the value of its place; collective.

    Args:
        index_map, places: See `summed`.
        values: The value of each place that this rank knows.
    """
    return np.asarray((values / np.maximum(summed(index_map, places), 1.0))[places])


def largest(
    index_map: common.IndexMap, places: npt.NDArray[np.integer[Any]], values: npt.ArrayLike
) -> Array:
    """Return for each place the largest value, at least 0, that some rank has; see `summed`."""
    ghosts = index_map.ghosts.astype(PETSc.IntType)
    sizes = index_map.size_local, index_map.size_global
    vector = PETSc.Vec().createGhost(ghosts, sizes, comm=index_map.comm)
    with vector.localForm() as local:
        local.set(0.0)
        np.maximum.at(local.array_w, places, values)
    vector.ghostUpdate(PETSc.InsertMode.MAX, PETSc.ScatterMode.REVERSE)
    vector.ghostUpdate(PETSc.InsertMode.INSERT, PETSc.ScatterMode.FORWARD)
    with vector.localForm() as local:
        result = local.array_r.copy()
    vector.destroy()
    return np.asarray(result)


def highest(comm: MPI.Comm, values: npt.NDArray[np.floating[Any]]) -> float:
    """Return the largest value of all ranks, at least 0, of arrays of any shape; collective."""
    return float(comm.allreduce(float(values.max(initial=0.0)), op=MPI.MAX))


def parallel_norm(comm: MPI.Comm, values: Array) -> float:
    """Return the 2-norm over all ranks of an array, safe from overflow and underflow.

    Args:
        comm: The communicator; the call is collective.
        values: The part of this rank.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        square = float(comm.allreduce(float(values @ values)))
    if TINY < square < 1.0 / TINY:
        return math.sqrt(square)
    ends = max(values.max(initial=0.0), -values.min(initial=0.0))
    largest = float(comm.allreduce(float(ends), op=MPI.MAX))
    if largest == 0.0 or not np.isfinite(largest):
        return largest
    scale = power_of_two(largest)
    scaled = values / scale
    return scale * float(np.sqrt(comm.allreduce(float(scaled @ scaled))))


def gathered(comm: MPI.Comm, *arrays: npt.NDArray[Any]) -> list[npt.NDArray[Any]] | None:
    """Return arrays on rank 0, the rows of one rank after the other; None elsewhere; collective."""
    parts = comm.gather(arrays)
    return parts and [np.concatenate(part) for part in zip(*parts, strict=True)]


def anywhere(comm: MPI.Comm, marks: bool | np.bool_ | Mask) -> bool:
    """Return whether something holds on some rank: a truth, or one of many marks; collective."""
    return bool(comm.allreduce(bool(np.any(marks)), op=MPI.LOR))


def function_with(
    space: fem.FunctionSpace,
    nodes: npt.NDArray[np.integer[Any]],
    values: npt.ArrayLike,
    name: str | None = None,
) -> fem.Function:
    """Return the function with values at nodes of this rank, and 0 elsewhere; collective.

    Args:
        space: The space.
        nodes: Nodes, those that the rank owns among them; others get the values of their owners.
        values: A value for each of them, a row for each in a space of vectors, or one for all.
        name: The name of the function.
    """
    result = fem.Function(space, name=name)
    at_nodes(result)[nodes] = values
    result.x.scatter_forward()
    return result


def at_nodes(function: fem.Function) -> Array:
    """Return a view of the values of this rank: one for each node, or a row for vectors."""
    size, values = function.function_space.dofmap.bs, function.x.array
    return np.asarray(values if size == 1 else values.reshape(-1, size))


def marked(space: fem.FunctionSpace, dofs: npt.NDArray[np.integer[Any]]) -> Mask:
    """Return which dofs of this rank, ghosts included, some rank names; the call is collective."""
    return summed(space.dofmap.index_map, dofs) > 0.0
