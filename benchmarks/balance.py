"""Adapted meshes on several ranks: seconds on 1 and 2, cells of each rank, and memory.

    ./with-dolfinx python3 benchmarks/balance.py seconds [--repeats 5]
    ./with-dolfinx python3 benchmarks/balance.py cells    # on 2, 4, 8 and 16 ranks
    ./with-dolfinx python3 benchmarks/balance.py memory   # of large requests, on one rank

All scenes are refined at one place: at a front inside of a square, at an edge of a cube. The
seconds are those of the whole loop, when a first run has compiled the forms. The memory is the
largest resident set of a process; beside the loop stands a process that reads the last mesh, poses
the problem on it and solves from nothing. With mpirun of Open MPI 5 more ranks than cores need
`PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe`.
"""

import argparse
import json
import resource
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import basix.ufl
import numpy as np

sys.path[:0] = [str(Path(__file__).parents[1] / "tests" / "accuracy")]

from common import Row, child, report, timed  # noqa: E402
from dolfinx import mesh  # noqa: E402
from known import SCENES  # noqa: E402
from mpi4py import MPI  # noqa: E402

from dolfinx_signorini.meshes.sided_meshes import SidedMesh, owned_cells  # noqa: E402
from dolfinx_signorini.scenes import solve_scene  # noqa: E402
from dolfinx_signorini.scenes.files.reading import parse_scene  # noqa: E402
from dolfinx_signorini.scenes.posing import pose  # noqa: E402
from dolfinx_signorini.scenes.scene_data import Scene  # noqa: E402

COMM = MPI.COMM_WORLD
FRONT = """
[domain]
shape = "square"
cells = 4
[define]
w = "tanh((x - 0.3 + 0.1*y)/0.02)"
[equation]
reaction = 1
load = "w + 2*1.01/0.02^2*w*(1 - w^2)"
[contact]
sides = ["right"]
obstacle = "w"
[[dirichlet]]
sides = ["left", "top", "bottom"]
value = "w"
"""
EDGE = SCENES["edge of a cube"].text
NAMES = [("left", 0, 0.0), ("right", 0, 1.0), ("bottom", -1, 0.0), ("top", -1, 1.0)]
NAMES += [("front", 1, 0.0), ("back", 1, 1.0)]  # of a cube


@dataclass(frozen=True)
class Request:
    """What is asked for: keywords of `solve_scene`, and those of a run that compiles the forms."""

    text: str
    keywords: dict[str, Any]
    easy: float

    @property
    def scene(self) -> Scene:
        """The scene."""
        return parse_scene(self.text, Path("scene.toml"), COMM)


REQUESTS = {
    "front": Request(FRONT, {"norm": "L2", "accuracy": 1e-7}, 1e-3),
    "edge": Request(EDGE, {"norm": "Linf", "accuracy": 2e-2}, 1e-1),
}
LARGE = {
    "front": Request(
        FRONT, {"norm": "L2", "accuracy": 2e-8, "degree": 2, "max_unknowns": 4_000_000}, 1e-3
    ),
    "edge": Request(EDGE, {"norm": "Linf", "accuracy": 2.7e-3, "max_unknowns": 4_000_000}, 1e-1),
}


def gigabytes() -> float:
    """The largest resident set of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9


def adapt(name: str) -> dict[str, Any]:
    """Answer a request, and return its seconds, unknowns and cells of each rank."""
    request = REQUESTS[name]
    solve_scene(request.scene, COMM, **request.keywords | {"accuracy": request.easy}).destroy()
    seconds, result = timed(COMM, lambda: solve_scene(request.scene, COMM, **request.keywords))
    cells = COMM.allgather(len(owned_cells(result.found.sided.mesh)))
    return {"seconds": seconds, "unknowns": result.found.steps[-1].unknowns, "cells": cells}


def adapt_far(name: str, path: str) -> dict[str, Any]:
    """Answer a large request, return its memory, and write the last mesh."""
    request = LARGE[name]
    result = solve_scene(request.scene, COMM, **request.keywords)
    found = {"gigabytes": gigabytes(), "unknowns": result.found.steps[-1].unknowns}
    geometry, degree = result.found.sided.mesh.geometry, result.u.function_space.element
    np.savez(
        path,
        x=geometry.x[:, : geometry.dim],
        cells=geometry.dofmap,
        degree=degree.basix_element.degree,
    )
    return found


def last_alone(name: str, path: str) -> dict[str, Any]:
    """Pose and solve on the last mesh of a large request, and return the memory."""
    with np.load(path) as file:
        x, cells, degree = file["x"], file["cells"].astype(np.int64), int(file["degree"])
    dim = x.shape[1]
    element = basix.ufl.element("Lagrange", ("triangle", "tetrahedron")[dim - 2], 1, shape=(dim,))
    domain = mesh.create_mesh(COMM, cells, x=x, e=element)
    sides = {
        side: mesh.locate_entities_boundary(
            domain, dim - 1, lambda x, a=axis % dim, v=at: np.isclose(x[a], v)
        )
        for side, axis, at in NAMES[: 2 * dim]
    }
    del x, cells
    scene = replace(LARGE[name].scene, degree=degree)
    posed = pose(scene, COMM, SidedMesh(domain, sides))
    posed.problem.solve()
    return {"gigabytes": gigabytes(), "unknowns": posed.problem.unknowns}


MEASURES = {"adapt": adapt, "adapt_far": adapt_far, "last_alone": last_alone}


def run(ranks: int, *arguments: str) -> dict[str, Any]:
    """Measure in a process of its own, or in several."""
    found = child(str(Path(__file__)), "--measure", *arguments, ranks=ranks)
    assert found is not None
    return found


def seconds(repeats: int) -> Iterator[Row]:
    """The seconds of the loop on 1 and 2 ranks, in turn."""
    for name in REQUESTS:
        runs = [[run(ranks, "adapt", name) for ranks in (1, 2)] for _ in range(repeats)]
        one, two = (median(pair[k]["seconds"] for pair in runs) for k in (0, 1))
        speedup = median(pair[0]["seconds"] / pair[1]["seconds"] for pair in runs)
        last = runs[0][1]
        cells = " ".join(f"{count:,}" for count in last["cells"])
        yield [name, last["unknowns"], f"{one:.2f}", f"{two:.2f}", f"{speedup:.2f}", cells]


def cells(repeats: int) -> Iterator[Row]:
    """The cells of the ranks on the last mesh."""
    for name in REQUESTS:
        for ranks in (2, 4, 8, 16):
            found = run(ranks, "adapt", name)
            counts, mean = found["cells"], sum(found["cells"]) / ranks
            ends = min(counts), max(counts)
            yield [name, ranks, found["unknowns"], *ends, f"{max(counts) / mean:.3f}"]


def memory(repeats: int) -> Iterator[Row]:
    """The memory of large requests beside that of the last system."""
    for name in LARGE:
        with TemporaryDirectory() as folder:
            path = str(Path(folder) / "last.npz")
            whole, last = (run(0, what, name, path) for what in ("adapt_far", "last_alone"))
        ratio = f"{whole['gigabytes'] / last['gigabytes']:.2f}"
        gb = (f"{found['gigabytes']:.2f}" for found in (whole, last))
        yield [name, whole["unknowns"], *gb, ratio]


PARTS = {
    "seconds": (seconds, ["request", "unknowns", "1 rank s", "2 ranks s", "speed-up", "cells"]),
    "cells": (cells, ["request", "ranks", "unknowns", "least", "most", "most over mean"]),
    "memory": (memory, ["request", "unknowns", "loop GB", "last system GB", "ratio"]),
}


def main() -> None:
    """Measure and print."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("part", choices=PARTS, nargs="?")
    options.add_argument("--repeats", type=int, default=5)
    options.add_argument("--measure", nargs="+", help=argparse.SUPPRESS)
    args = options.parse_args()
    if args.measure:
        found = MEASURES[args.measure[0]](*args.measure[1:])
        if COMM.rank == 0:
            print(json.dumps(found))
        return
    make, columns = PARTS[args.part]
    rows = []
    for row in make(args.repeats):
        rows.append(row)
        print(*row, sep="  ", file=sys.stderr, flush=True)
    content = {"columns": columns, "rows": rows}
    report(COMM, f"balance_{args.part}", f"adapted meshes: {args.part}", columns, rows, content)


main()
