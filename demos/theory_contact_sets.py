"""Contact sets: where u_h touches the obstacle, and the conditions (A) and (A_h) of the paper.

Run: python3 demos/theory_contact_sets.py [FOLDER]    (or under mpirun)

The boundary is a closed curve, and the contact set of u_h a union of its edges (and, in bad cases,
of single nodes). Its ends are found between two nodes, by the change of sign of gap less pressure.
"""

import sys
from pathlib import Path

from mpi4py import MPI

from dolfinx_signorini.paper.theory.contact_sets import (
    condition_a,
    condition_a_h,
    given_contact_set,
)
from dolfinx_signorini.paper.theory.experiments import compute_family
from dolfinx_signorini.paper.theory.figures import draw_contact_sets
from dolfinx_signorini.paper.theory.section5 import CORNERS, contact_set, definition_5_5_tables
from dolfinx_signorini.paper.theory.violations import LENGTH, ever_more_intervals, fat_cantor_set
from dolfinx_signorini.plotting import save

comm = MPI.COMM_WORLD
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "results/demos")

rows = {"paper": compute_family(comm, "paper", (15, 31, 51, 101, 201))}
found = [contact_set(row) for row in rows["paper"]]

if comm.rank == 0:
    print(
        "Condition (A) asks for a relative boundary of measure zero and finitely many components."
    )
    for name, verdict in (
        ("  the paper's contact set", condition_a([given_contact_set([(0.5, 4.05)], LENGTH)])),
        ("  a Cantor set of measure 1/2", condition_a(*fat_cantor_set(6))),
        ("  ever smaller intervals", condition_a(*ever_more_intervals(5))),
    ):
        print(f"{name}: {verdict}")
    print()
    for title, table in definition_5_5_tables(rows):
        print(f"{title}:\n{table}")
    print("Condition (A_h) asks for balls that hold one end each, for all small h.")
    for name, sets in (("  N >= 15", found), ("  N >= 31", found[1:])):
        verdict = condition_a_h(sets, CORNERS)
        print(f"{name}: {verdict}")
        for point, radius in zip(verdict.points, verdict.radii, strict=True):
            print(f"    a ball about s = {point:.4f} with radius {radius:.4f}")
    folder.mkdir(parents=True, exist_ok=True)
    save(draw_contact_sets(rows), folder / "theory_contact_sets")
    print(f"\npicture: {folder}/theory_contact_sets.png")
