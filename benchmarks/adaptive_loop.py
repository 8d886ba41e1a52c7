"""What the adaptive loop takes on scenes with solutions that the loop is not told.

    ./with-dolfinx python3 benchmarks/adaptive_loop.py unknowns  # beside those of the best meshes
    ./with-dolfinx python3 benchmarks/adaptive_loop.py orders    # slopes of the true error; minutes
    ./with-dolfinx python3 benchmarks/adaptive_loop.py seconds   # beside the last solve alone

The best meshes of a corner of 270 degrees and of a narrow bump were marked by the true error, with
another code, for elements of degree 2.
"""

import argparse
import math
import sys
import time
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[1] / "tests" / "accuracy")]

from common import write_json  # noqa: E402
from known import SCENES, Known, corner, true_error  # noqa: E402
from mpi4py import MPI  # noqa: E402

from dolfinx_signorini.scenes import solve_scene  # noqa: E402
from dolfinx_signorini.scenes.posing import pose  # noqa: E402
from dolfinx_signorini.scenes.reading import parse_scene  # noqa: E402
from dolfinx_signorini.scenes.solving import SceneResult  # noqa: E402
from dolfinx_signorini.tables import markdown_table  # noqa: E402

COMM = MPI.COMM_WORLD
CORNER, BUMP = "corner of 270 degrees", "narrow bump"
BEST = {
    (CORNER, "H1", 1e-2): 667,
    (CORNER, "H1", 1e-3): 6331,
    (CORNER, "Linf", 1e-3): 783,
    (CORNER, "Linf", 1e-4): 2419,
    (CORNER, "L2", 1e-4): 1393,
    (BUMP, "H1", 1e-2): 3773,
    (BUMP, "Linf", 1e-3): 2325,
    (BUMP, "Linf", 1e-4): 8169,
    (BUMP, "L2", 1e-4): 1393,
}
DEGREE = 2
ORDERS = {"H1": DEGREE / 2.0, "L2": (DEGREE + 1.0) / 2.0}  # in unknowns of the plane
FACTOR = 100.0  # of unknowns, over which the slopes are taken
SMALLEST = 500  # unknowns: fewer do not resolve the scenes
REPEATS = 3


def scene_of(name: str) -> Known:
    """Return a scene by its name."""
    return corner(270.0, {}) if name == CORNER else SCENES[name]


def solved(known: Known, norm: str, accuracy: float, degree: int | None) -> SceneResult:
    """Solve a scene to an accuracy."""
    scene = parse_scene(known.text, Path("scene.toml"), COMM)
    return solve_scene(scene, COMM, accuracy=accuracy, norm=norm, degree=degree)


def unknowns() -> list[list[object]]:
    """The unknowns of the loop beside those of the best meshes of the same degree."""
    rows: list[list[object]] = []
    for (name, norm, accuracy), best in BEST.items():
        known = scene_of(name)
        result = solved(known, norm, accuracy, DEGREE)
        assert result.found is not None
        count, error = result.found.steps[-1].unknowns, true_error(result.u, known, norm)
        result.destroy()
        share = f"{error / accuracy:.2f}"
        rows.append([name, norm, f"{accuracy:.0e}", count, best, f"{count / best:.2f}", share])
    return rows


def orders() -> list[list[object]]:
    """The slopes of the true error against the unknowns, with elements of degree 2."""
    rows: list[list[object]] = []
    for name, known in SCENES.items():
        if "cube" in name:
            continue
        for norm, order in ORDERS.items():
            accuracy, found = max(known.accuracies[norm]), []
            while not found or found[-1][0] < FACTOR * max(found[0][0], SMALLEST):
                result = solved(known, norm, accuracy, DEGREE)
                assert result.found is not None
                count = result.found.steps[-1].unknowns
                if count >= SMALLEST and (not found or count > 1.2 * found[-1][0]):
                    found.append((count, true_error(result.u, known, norm)))
                reached = result.found.reached
                result.destroy()
                if not reached:
                    break
                accuracy /= math.sqrt(10.0)
            counts, errors = np.array(found).T
            slope = np.polyfit(np.log(counts), np.log(errors), 1)[0]
            rows.append(
                [name, norm, int(counts[0]), int(counts[-1]), f"{slope:.2f}", f"{-order:.1f}"]
            )
            if COMM.rank == 0:
                print(*rows[-1], sep="  ", file=sys.stderr, flush=True)
    return rows


def seconds() -> list[list[object]]:
    """The seconds of the loop, from nothing, beside those of the last solve alone."""
    rows: list[list[object]] = []
    for name, norm, accuracy in BEST:
        known = scene_of(name)
        solved(known, norm, accuracy, None).destroy()  # compiles the forms
        whole, alone = [], []
        for _ in range(REPEATS):
            result = solved(known, norm, accuracy, None)
            whole.append(result.seconds)
            assert result.found is not None
            count = result.found.steps[-1].unknowns
            began = time.perf_counter()
            posed = pose(result.posed.scene, COMM, result.found.sided)
            posed.problem.solve()
            alone.append(COMM.allreduce(time.perf_counter() - began, op=MPI.MAX))
            posed.problem.destroy()
            result.destroy()
        loop, last = float(np.median(whole)), float(np.median(alone))
        limit = 4.0 * last + 0.3
        rows.append(
            [name, norm, f"{accuracy:.0e}", count, f"{loop:.3f}", f"{last:.3f}", f"{limit:.3f}"]
        )
    return rows


PARTS = {
    "unknowns": (
        unknowns,
        ["scene", "norm", "asked", "unknowns", "best mesh", "ratio", "true error over asked"],
    ),
    "orders": (orders, ["scene", "norm", "from", "to unknowns", "slope", "theory"]),
    "seconds": (
        seconds,
        ["scene", "norm", "asked", "unknowns", "loop s", "last solve s", "4 last + 0.3"],
    ),
}


def main() -> None:
    """Print the table of a part on rank 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", choices=PARTS)
    part = parser.parse_args().part
    make, columns = PARTS[part]
    rows = make()
    if COMM.rank == 0:
        print(markdown_table(columns, [list(map(str, row)) for row in rows]))
    write_json(COMM, f"adaptive_loop_{part}", {"columns": columns, "rows": rows})


if __name__ == "__main__":
    main()
