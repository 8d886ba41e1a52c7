"""How well errors are estimated: scenes with solutions that the adaptive loop is not told.

    python3 benchmarks/effectivity.py                 # the table of docs/accuracy.md, some minutes
    python3 benchmarks/effectivity.py --degree 1
    python3 benchmarks/effectivity.py --scenes corner,bump --norms L2,H1
    python3 benchmarks/effectivity.py --by-chance 50  # loads that jump across circles by chance

The effectivity is the estimate over the true error, which is evaluated by the code of the tests.
"""

import argparse
import sys
from itertools import islice
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[1] / "tests" / "accuracy")]

from known import SCENES, bent_by_chance, true_error  # noqa: E402
from mpi4py import MPI  # noqa: E402

from dolfinx_signorini.base.tables import markdown_table  # noqa: E402
from dolfinx_signorini.scenes import solve_scene  # noqa: E402
from dolfinx_signorini.scenes.files.reading import parse_scene  # noqa: E402

COLUMNS = ("scene", "norm", "asked", "unknowns", "estimate", "true error", "effectivity", "s")


def main() -> None:
    """Solve the scenes to their accuracies, and print the table on rank 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--degree", type=int, help="of the elements; the loop chooses by default")
    parser.add_argument("--scenes", default="", help="parts of their names, separated by commas")
    parser.add_argument("--norms", default="L2,L4,Linf,H1,W1_4,W1_inf")
    parser.add_argument("--by-chance", type=int, metavar="N", help="N scenes with circles instead")
    parser.add_argument("--seed", type=int, default=1, help="of these circles")
    parser.add_argument("--max-unknowns", type=int, default=300_000)
    args = parser.parse_args()
    comm, rows = MPI.COMM_WORLD, []
    scenes, chosen = SCENES, slice(1, 2)
    if args.by_chance:
        circles = islice(bent_by_chance(args.seed), args.by_chance)
        scenes, chosen = {f"circle {k}": known for k, known in enumerate(circles)}, slice(None)
    shares = []
    for name, known in scenes.items():
        if not any(part in name for part in args.scenes.split(",")):
            continue
        scene = parse_scene(known.text, Path(f"{name}.toml"), comm)
        for norm in args.norms.split(","):
            for accuracy in known.accuracies.get(norm, ())[chosen]:
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
                if found.reached:
                    shares.append(error / accuracy)
                estimate = f"{found.estimate:.1e}" + ("" if found.reached else ", not reached")
                last = found.steps[-1].unknowns, estimate, f"{error:.1e}"
                ratio, seconds = f"{found.estimate / error:.2f}", f"{found.seconds:.1f}"
                rows.append([name, norm, f"{accuracy:.0e}", *map(str, last), ratio, seconds])
                if comm.rank == 0:
                    print(*rows[-1], sep="  ", file=sys.stderr, flush=True)
    if comm.rank == 0:
        print(markdown_table(COLUMNS, rows))
        missed, middle = sum(share > 1.0 for share in shares), np.median(shares)
        print(f"{len(shares)} of {len(rows)} requests reached, by the estimate; {missed} of them")
        print(f"missed, the true error over asked at most {max(shares):.2f}, median {middle:.2f}.")


if __name__ == "__main__":
    main()
