"""The place of the detachment point in its edge: on a node, at a quarter, in the middle.

Run: python3 demos/theory_placement.py [FOLDER]    (or under mpirun)

The paper keeps the detachment point off the nodes as the worst case. Here the same solution is
moved by a part of an edge, on meshes with an even number of cells per side.
"""

import sys
from pathlib import Path

from mpi4py import MPI

from dolfinx_signorini.paper.theory.examples import PLACES
from dolfinx_signorini.paper.theory.experiments import compute_family, placed_name
from dolfinx_signorini.paper.theory.figures import draw_placement
from dolfinx_signorini.paper.theory.section4 import placement, placement_tables
from dolfinx_signorini.plotting import save

comm = MPI.COMM_WORLD
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "results/demos")

rows = {placed_name(place): compute_family(comm, placed_name(place), (50, 100)) for place in PLACES}

if comm.rank == 0:
    for title, table in placement_tables(rows):
        print(f"{title}:\n{table}")
    print("The orders stay what they are, wherever the point lies:")
    for check in placement(rows):
        print(f"  {check.what}: {check.measured}")
    print(
        "Gradients suffer most from a point at a quarter of the edge; the error itself from one at"
    )
    print("three quarters, next to the first node in contact.")
    folder.mkdir(parents=True, exist_ok=True)
    save(draw_placement(rows), folder / "theory_placement")
    print(f"\npicture: {folder}/theory_placement.png")
