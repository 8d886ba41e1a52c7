"""The home page's "Why not SNES?", timed: the blocks of docs/index.md as they are printed there.

    ./with-dolfinx python3 benchmarks/beside_snes.py [--cells 256]

Each way runs in turns with the other one, from the forms to the solution; the seconds are the least
of all turns, in which compiled forms are in the cache.
"""

import re
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from common import parser

PAGE = Path(__file__).parent.parent / "docs" / "index.md"


def blocks() -> list[str]:
    """Return the problem, the lines with SNES, and those with this package."""
    section = PAGE.read_text().split("## Why not SNES?")[1].split("\n## ")[0]
    return re.findall("```python\n(.*?)```", section, re.DOTALL)


def seconds_of(code: str, names: dict[str, Any]) -> float:
    """Run a block and return its wall-clock seconds."""
    start = perf_counter()
    exec(code, names)
    return perf_counter() - start


def main() -> None:
    """Measure both ways and print."""
    args = parser(__doc__, 256).parse_args()
    problem, by_snes, here = blocks()
    names: dict[str, Any] = {}
    exec(problem.replace("256", str(args.cells)), names)
    turns = [(seconds_of(by_snes, names), seconds_of(here, names)) for _ in range(args.repeats + 1)]
    snes, own = np.min(turns, axis=0)
    count = names["V"].dofmap.index_map.size_local
    difference = np.abs(names["values"].array_r - names["u_h"].x.array[:count]).max()
    print(f"SNES {snes:.2f} s, here {own:.2f} s: {snes / own:.1f} times; apart by {difference:.0e}")


if __name__ == "__main__":
    main()
