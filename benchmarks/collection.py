"""The benchmark collection: scenes with an exact solution or a reference value, solved.

Run: python3 benchmarks/collection.py                  all scenes on their own meshes
     python3 benchmarks/collection.py --reference NAME the energy of a scene on ever finer meshes

Scenes are in benchmarks/collection, what they should give in references.json there.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini import SceneResult, load_scene, solve_scene
from dolfinx_signorini.base.tables import text_table
from dolfinx_signorini.norms.error_norms import error_norms

FOLDER = Path(__file__).parent / "collection"
NORMS = "L2", "Linf", "H1"


def energy(result: SceneResult) -> float:
    """Return a(u, u)/2 - L(u) of a solved scene."""
    posed, u = result.posed, result.u
    form = ufl.action(ufl.action(0.5 * posed.a, u), u)
    if posed.sources:
        form -= ufl.action(posed.L, u)
    comm = posed.problem.comm
    return float(comm.allreduce(fem.assemble_scalar(fem.form(form)), op=MPI.SUM))


def measure(name: str) -> dict[str, Any]:
    """Solve a scene of the collection on its own mesh; return what is tracked.

    Args:
        name: The name of its file, without the ending.
    """
    began = time.perf_counter()
    result = solve_scene(load_scene(FOLDER / f"{name}.toml"))
    seconds = time.perf_counter() - began
    row: dict[str, Any] = {
        "unknowns": result.posed.problem.unknowns,
        "linear_solves": sum(level.linear_solves for level in result.levels),
        "linear_iterations": sum(level.linear_iterations for level in result.levels),
    }
    if result.posed.exact is not None:
        row |= {
            f"error {k}": v for k, v in error_norms(result.u, result.posed.exact, NORMS).items()
        }
    else:
        row["energy"] = energy(result)
    row["seconds"] = seconds
    result.destroy()
    return row


def references() -> dict[str, Any]:
    """Return what the scenes should give, by name."""
    found: dict[str, Any] = json.loads((FOLDER / "references.json").read_text())
    return found


def converge(name: str, steps: int) -> None:
    """Print the energy of a scene on adapted meshes, each twice as accurate as the one before."""
    scene = load_scene(FOLDER / f"{name}.toml")
    for degree, first, count in ((2, 0.02, steps), (1, 0.08, steps // 2)):
        for step in range(count):
            accuracy = first * 0.5**step
            result = solve_scene(scene, accuracy=accuracy, norm="H1", degree=degree)
            unknowns, found = result.posed.problem.unknowns, energy(result)
            result.destroy()
            if MPI.COMM_WORLD.rank == 0:
                text = f"degree {degree}, H1 {accuracy:.1e}, {unknowns:8d} unknowns: {found:.12f}"
                print(text, flush=True)


def main() -> None:
    """Print the table, or the energies of one scene."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--reference", metavar="NAME", help="the scene whose energy is computed")
    parser.add_argument("--steps", type=int, default=7, help="of --reference (default %(default)s)")
    args = parser.parse_args()
    if args.reference:
        converge(args.reference, args.steps)
        return
    rows = []
    for name, known in references().items():
        row = measure(name)
        if "energy" in row:
            row["error energy"] = abs(row.pop("energy") - known["reference"])
        rows.append([name, *(row.get(key, "") for key in COLUMNS)])
    if MPI.COMM_WORLD.rank == 0:
        print(text_table(["scene", *COLUMNS], rows), end="")


COLUMNS = (
    "unknowns",
    "linear_solves",
    "linear_iterations",
    *(f"error {norm}" for norm in (*NORMS, "energy")),
    "seconds",
)

if __name__ == "__main__":
    main()
