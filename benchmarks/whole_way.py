"""(l) What a user waits for: the command `solve` over mesh, matrix, load and one linear solve.

    ./with-dolfinx python3 benchmarks/whole_way.py [--scenes cube mixed ...] [--repeats 3]

The six scenes that show one kind of domain or datum each, scaled to at least 250,000 unknowns. In
turn, --repeats times, in one process with compiled forms: the command with its summary, errors
included where the solution is known, but without files; and the linear parts that no way to the
solution does without: the mesh of the scene, the matrix, the load by the smallest rule that is
exact for a load of the degree of the elements, and one CG solve with the tuned BoomerAMG. The
columns of phases are seconds of the command's last run.
"""

import contextlib
import io
import json
import re
from pathlib import Path
from typing import Any

import ufl
from common import linear_solve, report, spread, timed
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI

from dolfinx_signorini.base.timing import Phases
from dolfinx_signorini.commands import main as cli
from dolfinx_signorini.problem.signorini import DEFAULT_RTOL
from dolfinx_signorini.scenes.files.reading import load_scene
from dolfinx_signorini.scenes.posing import pose

SCENES_FOLDER = Path(__file__).parents[1] / "demos" / "scenes"
# For each scene: what makes the mesh fine, and a coarser mesh with the same forms.
SCALED = {
    "cube": ("domain.cells=62", "domain.cells=20"),
    "mixed": ("domain.cells=501", "domain.cells=101"),
    "obstacle": ("domain.cells=500", "domain.cells=100"),
    "paper": ("domain.cells=501", "domain.cells=101"),
    "plate": ("domain.refinements=5", "domain.refinements=3"),
    "polygon": ("domain.width=0.0035", "domain.width=0.02"),
}


def command(name: str, scaled: str) -> str:
    """Run the command without files, and return what the command printed."""
    path = str(SCENES_FOLDER / f"{name}.toml")
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        if cli.main(["solve", path, "--quiet", "--set", scaled, "--set", "outputs=[]"]):
            raise SystemExit(f"{name} failed")
    return printed.getvalue()


def linear_parts(name: str, scaled: str) -> tuple[dict[str, float], int]:
    """Return the seconds of the linear parts, and the number of unknowns."""
    comm, phases = MPI.COMM_WORLD, Phases(MPI.COMM_WORLD)
    scene = load_scene(SCENES_FOLDER / f"{name}.toml", comm, [scaled])
    with phases("mesh"):
        sided = scene.domain.make(comm)
    posed = pose(scene, comm, sided)
    with phases("matrix"):
        matrix = fem_petsc.assemble_matrix(fem.form(posed.a))
        matrix.assemble()
    exact = {"quadrature_degree": 2 * scene.degree, "quadrature_rule": "default"}
    parts = posed.problem.L.integrals()
    terms = [ufl.Form([part.reconstruct(metadata=exact)]) for part in parts]
    with phases("load"):
        for term in terms:
            fem_petsc.assemble_vector(fem.form(term)).destroy()
    with phases("solve"):
        linear_solve(posed.problem, DEFAULT_RTOL, tuned=True)
    matrix.destroy()
    unknowns = posed.problem.unknowns
    posed.problem.destroy()
    return phases.seconds, unknowns


def phases_told(printed: str) -> dict[str, float]:
    """Return the phases that the command told, by name."""
    text = re.search(r"^  time +[0-9.]+ s: (.*)$", printed, re.MULTILINE)
    parts = (part.rsplit(" ", 1) for part in text[1].split(", ")) if text else ()
    return {name: float(seconds) for name, seconds in parts}


def measure(name: str, repeats: int) -> dict[str, Any]:
    """Measure a scene, the command and the linear parts in turn."""
    comm, (fine, coarse) = MPI.COMM_WORLD, SCALED[name]
    command(name, coarse)
    linear_parts(name, coarse)
    whole, linear = [], []
    for _ in range(repeats):
        seconds, printed = timed(comm, command, name, fine)
        whole.append(seconds)
        parts, unknowns = linear_parts(name, fine)
        linear.append(parts)
    return {
        "scene": name,
        "unknowns": unknowns,
        "ratio": spread([w / sum(p.values()) for w, p in zip(whole, linear, strict=True)]),
        "command_seconds": spread(whole),
        "linear_seconds": spread([sum(parts.values()) for parts in linear]),
        "linear_parts": {part: spread([p[part] for p in linear]) for part in linear[0]},
        "phases": phases_told(printed),
    }


def main() -> None:
    """Measure and print."""
    import argparse

    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--scenes", nargs="+", default=list(SCALED), choices=list(SCALED))
    options.add_argument("--repeats", type=int, default=3)
    args = options.parse_args()
    rows, results = [], []
    for name in args.scenes:
        r = measure(name, args.repeats)
        results.append(r)
        ratio = f"{r['ratio']['min']:.2f}-{r['ratio']['max']:.2f}"
        seconds = (f"{r[f'{what}_seconds']['median']:.2f}" for what in ("command", "linear"))
        told = ", ".join(f"{phase} {value:g}" for phase, value in r["phases"].items())
        parts = ", ".join(f"{part} {s['median']:.2f}" for part, s in r["linear_parts"].items())
        rows.append((name, r["unknowns"], r["ratio"]["median"], ratio, *seconds, parts, told))
        if MPI.COMM_WORLD.rank == 0:
            print(json.dumps(rows[-1]), flush=True)
    columns = ("scene", "unknowns", "ratio", "range", "command s", "linear s", "of it", "phases")
    title = f"the whole way / its linear parts, medians of {args.repeats}"
    content = {"repeats": args.repeats, "results": results}
    report(MPI.COMM_WORLD, "whole_way", title, columns, rows, content)


main()
