"""Domains of size 1e-3 and 1e-9 through the commands: the same as size 1 in other units."""

import csv
import json
import sys

import numpy as np
import pytest
from cases import digits_of
from dolfinx import mesh
from dolfinx.io import XDMFFile
from large_meshes import unit_square
from mpi4py import MPI

from dolfinx_signorini.commands import main as cli

SCENE = """
title = "A membrane of size {size:g}"
outputs = ["boundary"]
[domain]
{domain}
[equation]
load = "-(1 + 2*y/{size!r})/{size!r}/{size!r}"
[contact]
sides = 1
obstacle = "-0.2 + 0.05*sin(9*x/{size!r})"
[[dirichlet]]
sides = 2
value = 0
"""


@pytest.fixture(autouse=True)
def keep_stdout(monkeypatch):
    """The command line silences stdout of all ranks but one."""
    monkeypatch.setattr(sys, "stdout", sys.stdout)


def write_square(path, size):
    """The unit square with 64 cells per side in a size: side 1 at the bottom, side 2 on top."""
    domain = unit_square(64)
    domain.geometry.x[:] *= size
    parts = [
        mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.abs(x[1] / size - y) < 1e-9)
        for y in (0.0, 1.0)
    ]
    owned = domain.topology.index_map(1).size_local
    parts = [part[part < owned] for part in parts]
    facets, tags = np.concatenate(parts), np.repeat([1, 2], [len(part) for part in parts])
    order = np.argsort(facets)
    marked = mesh.meshtags(domain, 1, facets[order], tags[order].astype(np.int32))
    marked.name = "facet_tags"
    with XDMFFile(domain.comm, str(path), "w") as file:
        file.write_mesh(domain)
        domain.topology.create_connectivity(1, 2)
        file.write_meshtags(marked, domain.geometry)


def run(folder, comm, kind, size):
    """Check and solve the scene of a size; return the boundary's columns and the record."""
    if kind == "file":
        write_square(folder / f"square{size:g}.xdmf", size)
        domain = f'shape = "file"\nfile = "square{size:g}.xdmf"'
    else:
        corners = [[0, 0], [size, 0], [size, size], [0, size]]
        domain = f'shape = "polygon"\nvertices = {corners}\nwidth = {size / 50!r}'
    path, out = folder / f"scene{size:g}.toml", folder / f"results{size:g}"
    if comm.rank == 0:
        path.write_text(
            SCENE.format(size=size, domain=domain).replace(
                "sides = 2", "sides = 2" if kind == "file" else "sides = 3"
            )
        )
    comm.barrier()
    assert cli.main(("check", str(path))) == 0
    assert cli.main(("solve", str(path), "--out", str(out))) == 0
    comm.barrier()
    with (out / "boundary.csv").open() as file:
        rows = list(csv.DictReader(file))
    columns = {key: np.array([float(row[key]) for row in rows]) for key in ("x", "u", "pressure")}
    return columns, json.loads((out / "record.json").read_text())["summary"]


@pytest.mark.parametrize("size", [pytest.param(1e-3, marks=pytest.mark.slow), 1e-9])
@pytest.mark.parametrize("kind", ["file", "polygon"])
def test_commands_on_small_domains(kind, size, folder, record):
    if kind == "polygon":
        pytest.importorskip("gmsh")
    comm = MPI.COMM_WORLD
    (unit, first), (small, second) = (run(folder, comm, kind, s) for s in (1.0, size))
    assert second["contact_size"] / size == pytest.approx(first["contact_size"], rel=0.1)
    assert second["forces"] == pytest.approx(first["forces"], rel=1e-3)
    x = np.linspace(0.05, 0.95, 91)
    digits = []
    for key, unit_of in (("u", 1.0), ("pressure", size)):
        one, other = (
            np.interp(x, columns["x"][order] / s, columns[key][order])
            for columns, s in ((unit, 1.0), (small, size))
            for order in [np.argsort(columns["x"])]
        )
        error = np.abs(one - unit_of * other).max()
        digits.append(digits_of(error, np.abs(one).max()))
    assert min(digits) >= (6 if kind == "file" else 1.5)
    text = f"{digits[0]:.1f} digits in u and {digits[1]:.1f} in the pressure along the boundary"
    stops = "" if kind == "file" else "gmsh makes other cells"
    case = f"{kind} of size {size:g}, {second['unknowns']} unknowns: commands check and solve"
    record("size", case, "size 1 by the same commands", text, stops)
