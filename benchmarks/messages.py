"""What ranks tell each other, and whether that grows with the mesh.

    ./with-dolfinx python3 benchmarks/messages.py [--ranks 2 4 8] [--parts cascade adapted]

Each part runs on two sizes and on some numbers of ranks, which may be more than there are cores:
counted are messages, not seconds. A collective call of Python objects is known by the line of the
package that calls; its bytes are those that one rank has after the call. Messages of PETSc are
those of its own log (`-log_view`), on an average rank; DOLFINx's and hypre's are not among them.
"""

# isort: off
from counted_calls import calls  # before the package
# isort: on

import argparse
import json
import math
import os
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from common import child, report
from mpi4py import MPI

from dolfinx_signorini import EnergyTerms, ManufacturedSolution, energy_bound, error_norms
from dolfinx_signorini.scenes import load_scene
from dolfinx_signorini.studies.paper.solution import paper_family
from dolfinx_signorini.studies.tradeoff.family import UNIFORM_P1, Family, Kind, scene_family
from dolfinx_signorini.studies.tradeoff.runs import Configuration, Run

ROOT = Path(__file__).resolve().parents[1]
SMALL = 512  # bytes per rank: shorter calls are not shown
LOGGED = {
    "MPI Msg Count": "messages",
    "MPI Msg Len (bytes)": "bytes per message",
    "MPI Reductions": "reductions",
}
NORMS = ["L4", "Linf", "W1_4", "W1_inf"]


def cube() -> Family:
    """A scene in space."""
    scene = load_scene(ROOT / "demos" / "scenes" / "cube.toml", MPI.COMM_WORLD)
    return scene_family(scene)


def with_errors(run: Run) -> None:
    """Measure the errors, as the summary of a scene does."""
    assert run.posed.exact is not None
    error_norms(run.u, run.posed.exact, NORMS)


def with_bound(run: Run) -> None:
    """Prove a bound."""
    assert isinstance(run.posed.exact, ManufacturedSolution)
    energy_bound(run.posed.problem, EnergyTerms(reaction=1.0, load=run.posed.exact.load))


def adapted(degree: int, norm: str, size: int) -> Configuration:
    """The adaptive loop for as many unknowns as are allowed."""
    return Configuration(Kind("adapted", degree), 4, norm=norm, max_unknowns=size)


Part = tuple[Callable[[], Family], Callable[[int], Configuration], Callable[[Run], None], list[int]]
PARTS: dict[str, Part] = {
    "cascade": (paper_family, lambda n: Configuration(UNIFORM_P1, n), with_errors, [100, 200]),
    "graded": (
        paper_family,
        lambda n: Configuration(Kind("graded", 2), n),
        with_errors,
        [32, 64],
    ),
    "adapted": (paper_family, lambda n: adapted(2, "Linf", n), with_errors, [3000, 12000]),
    "bound": (paper_family, lambda n: Configuration(UNIFORM_P1, n), with_bound, [32, 64]),
    "cube": (cube, lambda n: Configuration(UNIFORM_P1, n), with_errors, [12, 24]),
}


def measure(part: str, size: int) -> None:
    """Run a part and print its unknowns and its collective calls."""
    make, configuration, more, _ = PARTS[part]
    run = Run(MPI.COMM_WORLD, make(), configuration(size))
    more(run)
    unknowns = run.unknowns
    run.destroy()
    told = MPI.COMM_WORLD.gather(calls)
    if told is not None:
        merged: dict[str, dict[str, int]] = {}
        for place, counts in (item for entry in told for item in entry.items()):
            old = merged.get(place, counts)
            merged[place] = {key: max(old[key], counts[key]) for key in counts}
        print(json.dumps({"unknowns": unknowns, "calls": merged}))


def logged(part: str, size: int, ranks: int) -> dict[str, Any]:
    """Run a part in processes of its own, with the log of PETSc."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log"
        os.environ["PETSC_OPTIONS"] = f"-log_view :{path}"
        run = child(str(Path(__file__)), "--measure", part, str(size), ranks=ranks)
        assert run is not None
        for line in path.read_text().splitlines():
            name, _, rest = line.partition(":")
            if name.strip() in LOGGED:
                maximum, *others = (float(value) for value in rest.split())
                run[LOGGED[name.strip()]] = others[1] if len(others) > 1 else maximum
    return run


def main() -> None:
    """Run all parts, and print what grows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ranks", type=int, nargs="+", default=[2, 4, 8])
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--measure", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.measure:
        measure(args.measure[0], int(args.measure[1]))
        return
    rows: list[list[Any]] = []
    results = []
    for part in args.parts:
        for ranks in args.ranks:
            runs = [logged(part, size, ranks) for size in PARTS[part][3]]
            results += [{"part": part, "ranks": ranks} | run for run in runs]
            rows += table(part, ranks, *runs)
            print(f"{part} on {ranks} ranks", file=sys.stderr, flush=True)
    columns = ["part", "ranks", "what", "times", "unknowns", "", "unknowns", "", "order"]
    report(
        MPI.COMM_WORLD,
        "messages",
        "messages of PETSc, and bytes of the longest collective call",
        columns,
        rows,
        {"results": results},
    )


def table(part: str, ranks: int, small: dict[str, Any], large: dict[str, Any]) -> list[list[Any]]:
    """The rows of a part: messages of PETSc, and each collective call that is not short."""
    sizes = small["unknowns"], large["unknowns"]
    ratio = math.log(sizes[1] / sizes[0])
    rows = []

    def add(what: str, times: int, first: float, second: float) -> None:
        order = f"{math.log(max(second, 1.0) / max(first, 1.0)) / ratio:.2f}"
        rows.append([part, ranks, what, times, sizes[0], first, sizes[1], second, order])

    for name in LOGGED.values():
        add(f"PETSc: {name}", 1, small[name], large[name])
    for place in sorted(large["calls"]):
        old = small["calls"].get(place, {"calls": 0, "bytes": 1})
        new = large["calls"][place]
        if new["bytes"] >= SMALL:
            add(place, new["calls"], old["bytes"], new["bytes"])
    return rows


main()
