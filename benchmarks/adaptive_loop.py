"""What the adaptive loop takes on scenes with solutions that the loop is not told.

    ./with-dolfinx python3 benchmarks/adaptive_loop.py unknowns  # beside those of best meshes
    ./with-dolfinx python3 benchmarks/adaptive_loop.py orders    # slopes of the error, degree 2
    ./with-dolfinx python3 benchmarks/adaptive_loop.py linear    # the same, degree 1
    ./with-dolfinx python3 benchmarks/adaptive_loop.py seconds   # beside the last solve alone

The best meshes of a corner of 270 degrees and of a narrow bump were marked by the true error, with
another code, for elements of degree 2.
"""

import math
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from unittest import mock

import numpy as np
import numpy.typing as npt

sys.path[:0] = [str(Path(__file__).parents[1] / "tests" / "accuracy")]

from common import Part, Row, run_part  # noqa: E402
from known import SCENES, Known, corner, true_error  # noqa: E402
from mpi4py import MPI  # noqa: E402

from dolfinx_signorini.accuracy import loop  # noqa: E402
from dolfinx_signorini.accuracy.estimates import Estimator  # noqa: E402
from dolfinx_signorini.accuracy.terms import Solved  # noqa: E402
from dolfinx_signorini.scenes import solve_scene  # noqa: E402
from dolfinx_signorini.scenes.files.reading import parse_scene  # noqa: E402
from dolfinx_signorini.scenes.posing import pose  # noqa: E402
from dolfinx_signorini.scenes.solving import SceneResult  # noqa: E402

COMM = MPI.COMM_WORLD
Array = npt.NDArray[np.float64]
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
REPEATS = 3

# The slopes are taken over a factor of unknowns. Fewer unknowns do not resolve the scenes, and what
# the loop decided on its first meshes shows.
FACTOR = 100.0
FIRST = {1: 1_000, 2: 4_000}
# Times as many: the loop begins without knowing the scene, and what its first meshes have in vain
# is felt until the meshes are many times larger.
LATER = {"layer": 50, "three detachment points": 16, "narrow bump": 7, "kink of the obstacle": 7}
MOST = 7_000_000  # unknowns, where less than the factor must do
EDGE = "edge of a cube"
EXPONENT = 0.6288  # of the distance to the edge
RADII = np.geomspace(1e-7, 0.25, 1000)  # of the smallest cells at the edge


def scene_of(name: str) -> Known:
    """Return a scene by its name."""
    return corner(270.0, {}) if name == CORNER else SCENES[name]


def solved(known: Known, norm: str, accuracy: float, degree: int | None) -> SceneResult:
    """Solve a scene to an accuracy."""
    scene = parse_scene(known.text, Path("scene.toml"), COMM)
    return solve_scene(scene, COMM, accuracy=accuracy, norm=norm, degree=degree)


def unknowns() -> Iterator[Row]:
    """The unknowns of the loop beside those of the best meshes of the same degree."""
    for (name, norm, accuracy), best in BEST.items():
        known = scene_of(name)
        result = solved(known, norm, accuracy, DEGREE)
        assert result.found is not None
        count, error = result.found.steps[-1].unknowns, true_error(result.u, known, norm)
        result.destroy()
        share = f"{error / accuracy:.2f}"
        yield [name, norm, f"{accuracy:.0e}", count, best, f"{count / best:.2f}", share]


def orders(degree: int) -> Iterator[Row]:
    """The slopes of the true error against the unknowns, by least squares."""
    for name, known in SCENES.items():
        for norm in ("H1", "L2"):
            points = np.array(
                errors_of_steps(known, norm, degree, FIRST[degree] * LATER.get(name, 1))
            )
            middle = len(points) // 2
            parts = points, points[: middle + 1], points[middle:]
            slopes = (np.polyfit(*np.log(part).T, 1)[0] for part in parts)
            ends = [int(points[end, 0]) for end in (0, -1)]
            order = order_at_an_edge if name == EDGE else order_in_the_plane
            yield [
                name,
                norm,
                *ends,
                *(f"{slope:.2f}" for slope in slopes),
                f"{order(norm, degree, *ends):.2f}",
            ]


def order_in_the_plane(norm: str, degree: int, first: int, last: int) -> float:
    """Return the slope of the best errors in the plane, which singular points do not change."""
    return -(degree + (norm == "L2")) / 2.0


def order_at_an_edge(norm: str, degree: int, first: int, last: int) -> float:
    """Return the slope of the best errors in space with cells that are as long as wide.

    The widths h of the cells at the distance r from the edge, where u is like r to the power of
    `EXPONENT`, minimise the integral of h^m r^-k for a given number of cells. In H1 the integral is
    the square of the interpolation error, in L2 the error by duality.

    Args:
        norm: "H1" or "L2".
        degree: The degree of the elements.
        first: The unknowns from which on the slope is taken.
        last: The last unknowns.
    """
    if norm == "H1":
        m, k, root = 2.0 * degree, 2.0 * (degree + 1.0 - EXPONENT), 2.0
    else:
        m, k, root = degree + 1.0, degree + 3.0 - 2.0 * EXPONENT, 1.0
    steep = k / (m + 3.0)  # h = c r^steep, from a radius on at which h is the radius
    c = RADII ** (1.0 - steep)
    counts = degree**3 * math.pi * (0.5 * c**-3 * moments(1.0 - 3.0 * steep) + 0.25 / RADII)
    errors = c**m * moments(1.0 - k + m * steep) + RADII ** (m - k + 2.0) / (m - k + 2.0)
    x, y = np.log(counts[::-1]), np.log(errors[::-1]) / root
    low, high = np.interp(np.log((first, last)), x, y)
    return float((high - low) / np.log(last / first))


def moments(power: float) -> Array:
    """Return the integrals of a power, which is not -1, from each of `RADII` to 1."""
    return (1.0 - RADII ** (power + 1.0)) / (power + 1.0)


def errors_of_steps(known: Known, norm: str, degree: int, first: int) -> list[tuple[int, float]]:
    """Return unknowns and true errors of the steps of one run of the loop.

    Args:
        known: The scene.
        norm: The norm of the error.
        degree: The degree of the elements.
        first: The unknowns from which on steps count; the run ends with `FACTOR` times as many.
    """
    points: list[tuple[int, float]] = []

    class Watched(Estimator):
        def compare(self, solved: Solved) -> None:
            super().compare(solved)
            count = solved.fine.unknowns
            if count >= first:
                points.append((count, true_error(solved.fine.u, known, norm)))
            if points and count >= FACTOR * points[0][0]:
                self.estimate = 0.0  # so that the loop ends

    scene = parse_scene(known.text, Path("scene.toml"), COMM)
    with mock.patch.object(loop, "Estimator", Watched):
        solve_scene(
            scene, COMM, accuracy=1e-14, norm=norm, degree=degree, max_unknowns=MOST
        ).destroy()
    return points


def seconds() -> Iterator[Row]:
    """The seconds of the loop, from nothing, beside those of the last solve alone."""
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
        yield [name, norm, f"{accuracy:.0e}", count, f"{loop:.3f}", f"{last:.3f}", f"{limit:.3f}"]


SLOPES = ["scene", "norm", "from", "to unknowns", "slope", "first half", "second half", "theory"]
PARTS: dict[str, Part] = {
    "unknowns": (
        unknowns,
        ["scene", "norm", "asked", "unknowns", "best mesh", "ratio", "true error over asked"],
    ),
    "orders": (partial(orders, DEGREE), SLOPES),
    "linear": (partial(orders, 1), SLOPES),
    "seconds": (
        seconds,
        ["scene", "norm", "asked", "unknowns", "loop s", "last solve s", "4 last + 0.3"],
    ),
}

if __name__ == "__main__":
    run_part(COMM, "adaptive_loop", __doc__, PARTS)
