"""Functions on disk, to be read again on any number of ranks.

A dof is found again by its place, because the numbers of dofs and cells depend on the
number of ranks. The file is one of NumPy's, so that a checkpoint needs nothing beside DOLFINx and
can be read without DOLFINx. Rank 0 gathers and reads the whole file: enough for some ten million
dofs.
"""

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scipy.spatial import cKDTree

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.errors import InputError, require
from dolfinx_signorini.base.kinds import FUNCTION, check, real
from dolfinx_signorini.base.ranks import at_nodes, gathered
from dolfinx_signorini.base.records import on_first, whole_file
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.meshes.elements import control_points
from dolfinx_signorini.meshes.sided_meshes import gathered_cells


def write_checkpoint(
    path: Path | str, functions: Mapping[str, fem.Function], **numbers: float
) -> None:
    """Write functions with their mesh; the call is collective.

    A time loop that can be stopped writes a checkpoint after some steps:

        write_checkpoint("step.npz", {"u": problem.u}, time=t)

    Args:
        path: The file, which is replaced when the new one is complete.
        functions: The functions by name, scalars or vectors in continuous elements on one mesh.
        numbers: What else the run needs to go on, such as the time.

    Raises:
        InputError: There is no function, the functions live on several meshes, a number is none,
            two nodes lie at the same place, or the file cannot be written.
    """
    _check_functions(functions)
    check(**{name: (number, real) for name, number in numbers.items()})
    path, spaces = Path(path), [f.function_space for f in functions.values()]
    one, comm = spaces[0].mesh, spaces[0].mesh.comm
    if any(space.mesh != one for space in spaces):
        raise InputError("live on several meshes; write a checkpoint of each", "functions")
    data: dict[str, Any] = {f"number {name}": value for name, value in numbers.items()}
    cells, nodes = gathered_cells(one)
    data |= {"cells": cells, "points": nodes, "kind": one.topology.cell_name()}
    for name, function in functions.items():
        space = function.function_space
        owned = space.dofmap.index_map.size_local
        own = control_points(space)[:owned], at_nodes(function)[:owned]
        points, values = gathered(comm, *own) or own
        data |= {f"points {name}": points, f"values {name}": values}
        data[f"basis {name}"] = _basis(space)

    def write() -> None:
        for name in functions:
            _check_places(data[f"points {name}"], name)
        with whole_file(path) as file:
            np.savez(file, **data)

    on_first(comm, path.parent, write)


def read_checkpoint(path: Path | str, functions: Mapping[str, fem.Function]) -> dict[str, float]:
    """Fill functions with what a checkpoint holds, and return its numbers; collective.

    The functions live on the mesh of the checkpoint, with the same elements, on any
    number of ranks:

        t = read_checkpoint("step.npz", {"u": problem.u})["time"]

    Args:
        path: The file.
        functions: The functions to be filled, by the names that they were written with.

    Raises:
        InputError: The file is no checkpoint or has no such function, or the mesh or the elements
            are others.
    """
    path = Path(path)
    _check_functions(functions)
    comm = next(iter(functions.values())).function_space.mesh.comm
    data = _read(path, comm)
    for name, function in functions.items():
        if f"values {name}" not in data:
            known = [key.removeprefix("values ") for key in data if key.startswith("values ")]
            raise InputError(f"has no function {name!r}, but {', '.join(known)}", str(path))
        points, values = data[f"points {name}"], data[f"values {name}"]
        places = control_points(function.function_space)
        extent = float(np.ptp(points, axis=0).max())
        distances, found = cKDTree(points).query(places)
        same = len(values) == function.function_space.dofmap.index_map.size_global
        same &= values.shape[1:] == at_nodes(function).shape[1:]
        same &= bool((distances <= SOLVED * extent).all())
        require(comm, same, f"{name!r} lives on another mesh, or in other elements", str(path))
        basis, wanted = str(data.get(f"basis {name}", "")), _basis(function.function_space)
        if basis and basis != wanted:  # files of version 0.1 do not tell
            raise InputError(f"{name!r} has the basis {basis}, not {wanted}", str(path))
        at_nodes(function)[:] = values[found]
    return {
        key.removeprefix("number "): float(value)
        for key, value in data.items()
        if key.startswith("number ")
    }


def read_mesh(path: Path | str, comm: MPI.Comm = MPI.COMM_WORLD) -> mesh.Mesh:
    """Return the mesh of a checkpoint, for example an adapted one.

    Args:
        path: The file.
        comm: The communicator that shares the mesh; the call is collective.

    Raises:
        InputError: The file is no checkpoint.
    """
    data = _read(Path(path), comm)
    cells, points, kind = data["cells"], data["points"], str(data["kind"])
    domain = ufl.Mesh(basix.ufl.element("Lagrange", kind, 1, shape=(points.shape[1],)))
    if comm.rank:
        cells, points = cells[:0], points[:0]
    # The order of the arguments depends on the version, and so they have names.
    return mesh.create_mesh(comm, cells, x=points, e=domain)


def _check_functions(functions: Mapping[str, fem.Function]) -> None:
    if not functions:
        raise InputError("names no function", "functions")
    for name, function in functions.items():
        check(functions=(function, FUNCTION))
        if function.function_space.mesh.geometry.cmap.degree > 1:
            raise InputError(f"{name!r} must live on a mesh with straight edges", "functions")


def _basis(space: fem.FunctionSpace) -> str:
    """The kind of basis functions, where dofs alone do not tell the function."""
    element = space.element.basix_element
    return "linear" if element.degree == 1 else str(element.lagrange_variant.name)


def _check_places(points: Array, name: str) -> None:
    """Refuse two nodes at the same place, which could not be told apart when they are read."""
    extent = float(np.ptp(points, axis=0).max())
    if len(cKDTree(points).query_pairs(SOLVED * extent)):
        raise InputError(f"{name!r} has two nodes at the same place", "functions")


def _read(path: Path, comm: MPI.Comm) -> dict[str, Any]:
    """Return the arrays of a checkpoint on all ranks; rank 0 reads the file."""

    def read() -> dict[str, Any]:
        try:
            with np.load(path, allow_pickle=False) as file:
                found = {key: file[key] for key in file.files}
            if not {"cells", "points", "kind"} <= found.keys():
                raise ValueError
        except OSError as error:
            raise InputError(error.strerror or str(error), str(path)) from None
        except (ValueError, zipfile.BadZipFile, EOFError, AttributeError):
            raise InputError("is no checkpoint", str(path)) from None
        return found

    return on_first(comm, path.parent, read)
