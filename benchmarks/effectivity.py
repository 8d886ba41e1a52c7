"""How well errors are estimated: scenes with solutions that the adaptive loop is not told.

    python3 benchmarks/effectivity.py                 # the table of docs/accuracy.md, some minutes
    python3 benchmarks/effectivity.py --degree 1
    python3 benchmarks/effectivity.py --scenes corner,bump --norms L2,H1

The effectivity is the estimate over the true error, which is evaluated by the code of the tests.
"""

import argparse
import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[1] / "tests" / "accuracy")]

from known import SCENES, true_error  # noqa: E402
from mpi4py import MPI  # noqa: E402

from dolfinx_signorini.scenes import solve_scene  # noqa: E402
from dolfinx_signorini.scenes.reading import parse_scene  # noqa: E402
from dolfinx_signorini.tables import markdown_table  # noqa: E402

COLUMNS = ("scene", "norm", "asked", "unknowns", "estimate", "true error", "effectivity", "s")


def main() -> None:
    """Solve the scenes to their accuracies, and print the table on rank 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--degree", type=int, help="of the elements; the loop chooses by default")
    parser.add_argument("--scenes", default="", help="parts of their names, separated by commas")
    parser.add_argument("--norms", default="L2,L4,Linf,H1,W1_4")
    parser.add_argument("--max-unknowns", type=int, default=300_000)
    args = parser.parse_args()
    comm, rows = MPI.COMM_WORLD, []
    for name, known in SCENES.items():
        if not any(part in name for part in args.scenes.split(",")):
            continue
        scene = parse_scene(known.text, Path(f"{name}.toml"), comm)
        for norm in args.norms.split(","):
            for accuracy in known.accuracies.get(norm, ())[1:2]:
                result = solve_scene(
                    scene,
                    comm,
                    accuracy=accuracy,
                    norm=norm,
                    degree=args.degree,
                    max_unknowns=args.max_unknowns,
                )
                error, found = true_error(result.u, known, norm), result.found
                assert found is not None
                result.destroy()
                estimate = f"{found.estimate:.1e}" + ("" if found.reached else ", not reached")
                last = found.steps[-1].unknowns, estimate, f"{error:.1e}"
                ratio, seconds = f"{found.estimate / error:.2f}", f"{found.seconds:.1f}"
                rows.append([name, norm, f"{accuracy:.0e}", *map(str, last), ratio, seconds])
                if comm.rank == 0:
                    print(*rows[-1], sep="  ", file=sys.stderr, flush=True)
    if comm.rank == 0:
        print(markdown_table(COLUMNS, rows))


if __name__ == "__main__":
    main()
