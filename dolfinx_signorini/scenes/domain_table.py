"""Reading the domain of a scene file."""

from pathlib import Path

from mpi4py import MPI

from dolfinx_signorini.errors import InputError
from dolfinx_signorini.scenes.domains import (
    COARSE_CELLS,
    MAX_VERTICES,
    Cube,
    Domain,
    MeshFile,
    Polygon,
    Square,
    coarse_polygon,
    mesh_file,
)
from dolfinx_signorini.scenes.toml import Table

SHAPES = ("square", "cube", "polygon", "file")
MAX_CORNERS = 500
MAX_COORDINATE = 1e6


def read_domain(table: Table, folder: Path, comm: MPI.Comm, accuracy: float | None) -> Domain:
    """Return the domain that a table describes.

    Args:
        table: The table [domain] of a scene file.
        folder: Where its mesh file is looked for.
        comm: The communicator that will share the mesh.
        accuracy: Where there is one it decides on the mesh width, and the mesh is a coarse one.

    Raises:
        InputError: It is no domain, or its mesh would be too large.
    """
    shape = table.choice("shape", SHAPES)
    key = {"square": "cells", "cube": "cells", "polygon": "width"}.get(shape, "")
    if accuracy is not None and table.has(key):
        raise table.error(key, "follows from 'accuracy'; give one of the two")
    domain: Domain
    if shape == "file":
        domain = _mesh_file(table, folder, comm)
        if accuracy is not None:
            raise table.error("file", "a mesh is used as it is: leave 'accuracy' out")
    elif shape == "polygon":
        corners = _corners(table)
        width = table.real("width") if accuracy is None else None
        try:
            domain = Polygon(corners, width) if width is not None else coarse_polygon(corners)
        except InputError as error:
            raise table.error(None, str(error)) from None
    else:
        kind, power, coarse = (
            (Square, 2, COARSE_CELLS) if shape == "square" else (Cube, 3, COARSE_CELLS // 4)
        )
        limit = int(MAX_VERTICES ** (1.0 / power)) - 1
        domain = kind(table.integer("cells", 1, limit) if accuracy is None else coarse)
    if domain.vertices > MAX_VERTICES:
        raise table.error(None, f"a mesh of more than {MAX_VERTICES} vertices")
    table.finish()
    return domain


def _mesh_file(table: Table, folder: Path, comm: MPI.Comm) -> MeshFile:
    name = table.text("file")
    names = {key: table.text(key) for key in ("grid", "tags") if table.has(key)}
    try:
        return mesh_file(comm, folder / name, **names)
    except (InputError, ValueError) as error:
        raise table.error("file", str(error)) from None


def _corners(table: Table) -> tuple[tuple[float, float], ...]:
    corners = table.items("vertices")
    if len(corners) > MAX_CORNERS:
        raise table.error("vertices", f"at most {MAX_CORNERS} are read")
    result = []
    for corner in corners:
        if not isinstance(corner, list) or len(corner) != 2:
            raise table.error("vertices", "must be a list of [x, y]")
        x, y = (table.finite("vertices", c) for c in corner)
        if max(abs(x), abs(y)) > MAX_COORDINATE:
            raise table.error("vertices", f"a coordinate larger than {MAX_COORDINATE:g}")
        result.append((x, y))
    return tuple(result)
