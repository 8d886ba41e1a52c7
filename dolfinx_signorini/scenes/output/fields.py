"""The fields of a solved scene for ParaView: u, gap and pressure, and where they are defined."""

import ctypes
import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import dolfinx
import numpy as np
from dolfinx import fem
from dolfinx.io import XDMFFile
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.base.ranks import largest, marked
from dolfinx_signorini.base.records import on_first
from dolfinx_signorini.data.node_values import (
    node_averages,
    values_in_cells,
    vectors_at_nodes,
)
from dolfinx_signorini.meshes.elements import (
    determined,
    lagrange_space,
    nodal_space,
    values_at_control_points,
)
from dolfinx_signorini.pictures.contact_boundary import Touching
from dolfinx_signorini.scenes.output.folder import reserve
from dolfinx_signorini.scenes.solving import SceneResult

BYTES = 1.5, 1_000_000  # what the files need: relative to their data, and more


def write_fields(result: SceneResult, folder: Path) -> None:
    """Write the fields of a scene for ParaView: VTX, or XDMF at the vertices without ADIOS2.

    Gap and pressure are defined where `contact_boundary` is 1, with an obstacle in the domain
    `has_obstacle`: at the nodes with an obstacle and a pressure that is known, see
    `Touching`. Elsewhere both are 0. Where `in_contact` is 1 the solution touches the
    obstacle. With obstacles in the domain and on the boundary these are for the cells, and
    `boundary_gap`, `boundary_pressure` and `boundary_in_contact` for the contact boundary.

    Args:
        result: The solved scene; the call is collective.
        folder: Where to write.

    Raises:
        InputError: The files do not fit on the disk.
    """
    fields, comm = fields_of(result), result.posed.problem.comm
    size = _size(fields)
    on_first(comm, folder.parent, lambda: reserve(folder, size))
    if dolfinx.has_adios2:
        _write_vtx(comm, folder, fields)
        return
    domain = result.posed.problem.space.mesh
    with XDMFFile(comm, str(folder / "fields.xdmf"), "w") as file:
        file.write_mesh(domain)
        for field in fields:
            linear = fem.functionspace(domain, ("Lagrange", 1, field.ufl_shape))
            values = fem.Function(linear, name=field.name)
            values.interpolate(field)
            file.write_function(values)


def fields_of(result: SceneResult) -> list[fem.Function]:
    """Return u, gap, pressure and masks as functions of their values at nodes; collective.

    A body has displacement, stress and von Mises stress in place of u. The stress, which jumps
    between cells, has the mean of the cells around each node.
    """
    u, material, space = result.u, result.posed.scene.elasticity, result.gap.function_space
    nodal, at_nodes = nodal_space(space), partial(values_at_control_points, space)
    marks = masks(result) | indicator(result)
    defined = next(iter(marks.values()))  # where gap and pressure are
    if material is None:
        values = {"u": at_nodes(u.x.array)}
    else:
        cells = [values_in_cells(nodal, stress) for stress in material.stresses(u)]
        tensor, scalar = (node_averages(nodal, each) for each in cells)
        moved = vectors_at_nodes(space, u)
        values = {"displacement": moved, "stress": tensor.reshape(*moved.shape, -1)}
        values["von_mises_stress"] = scalar[:, 0]
    for field in (result.gap, result.pressure):
        values[field.name] = at_nodes(field.x.array) * defined
    for zone in result.posed.problem.zones[1:]:  # the contact boundary beside the cells
        for field in (zone.gap, zone.pressure):
            known = marks["contact_boundary"]
            values[f"boundary_{field.name}"] = at_nodes(field.x.array) * known
    return [_function(nodal, name, found) for name, found in (values | marks).items()]


def _function(nodal: fem.FunctionSpace, name: str, values: Array) -> fem.Function:
    """Return the function with given values at nodes, shape (nodes, ...)."""
    space, shape = nodal, values.shape[1:]
    if shape:
        element = nodal.element.basix_element
        space = lagrange_space(nodal.mesh, element.degree, element.lagrange_variant, shape)
        assert np.array_equal(space.dofmap.list, nodal.dofmap.list)
    function = fem.Function(space, name=name)
    function.x.array[:] = values.ravel()
    return function


def masks(result: SceneResult) -> dict[str, Array]:
    """Return 1 at nodes with an obstacle and at those in contact, else 0, by name; collective.

    The nodes are the places of the dofs, see `determined`.
    """
    space, found = result.gap.function_space, {}
    for k, zone in enumerate(result.posed.problem.zones):
        known = Touching(zone.along_direction).known_pressure
        for name, nodes in (
            ("has_obstacle" if zone.in_domain else "contact_boundary", zone.obstacle_nodes),
            ("boundary_in_contact" if k else "in_contact", zone.active),
        ):
            found[name] = np.where(determined(space, marked(space, nodes)) & known, 1.0, 0.0)
    return found


def indicator(result: SceneResult) -> dict[str, Array]:
    """Return the estimated errors of cells at nodes, by name: at each the largest one around."""
    if result.found is None:
        return {}
    space, cells = result.gap.function_space, result.found.cells
    errors = largest(space.dofmap.index_map, space.dofmap.list[: len(cells)], cells[:, None])
    return {"error_indicator": errors}


def _size(fields: Sequence[fem.Function]) -> int:
    """Return the bytes that fields with their mesh need at most; the call is collective."""
    space = fields[0].function_space
    domain, dofmap = space.mesh, space.dofmap
    points = dofmap.index_map.size_local + dofmap.index_map.num_ghosts
    values = sum(field.function_space.dofmap.bs for field in fields)
    own = points * (3 + 2 + values) + dofmap.list.size + len(dofmap.list)
    factor, more = BYTES
    return int(factor * 8 * domain.comm.allreduce(own)) + more


def _write_vtx(comm: MPI.Comm, folder: Path, fields: Sequence[fem.Function]) -> None:
    from dolfinx.io import VTXWriter

    writer, message = None, ""
    try:
        writer = VTXWriter(comm, str(folder / "fields.bp"), list(fields))
        writer.write(0.0)
        writer.close()
    except RuntimeError as error:  # of ADIOS2: the disk is full
        reason = re.search(r"errno = \d+: ([\w ]+)", str(error))
        message = f"cannot be written: {reason[1] if reason else error}"
        if writer is not None:  # its destructor would fail again, and abort the process
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(writer._cpp_object))
    require(comm, not message, message, f"output folder {folder.parent}")
