"""The Ritz projection R_h(u): the part of the error that has nothing to do with contact.

Run: python3 demos/theory_projection.py [FOLDER]    (or under mpirun)

R_h(u) is the finite element function with the same H^1 products with all basis functions as u:
what the method would return if there were no constraint. Lemma 3.2 says how far it is from u.
"""

import sys
from pathlib import Path

from mpi4py import MPI

from dolfinx_signorini.paper.theory.experiments import compute_family
from dolfinx_signorini.paper.theory.figures import draw_projection
from dolfinx_signorini.paper.theory.section3 import lemma_3_2, lemma_3_2_tables
from dolfinx_signorini.plotting import save

comm = MPI.COMM_WORLD
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "results/demos")

# A row holds the norms of u - R_h(u) on one mesh. The integrals of u, whose gradient is like the
# root of the distance to the detachment point, use many quadrature points on the cells next to it.
rows = {name: compute_family(comm, name, (51, 101, 201)) for name in ("paper", "smooth")}

if comm.rank == 0:
    for title, table in lemma_3_2_tables(rows):
        print(f"{title}:\n{table}")
    print("The orders against those of Lemma 3.2:")
    for check in lemma_3_2(rows):
        print(f"  {check.what}: {check.measured}, proven {check.proven}. {check.reason}".rstrip())
    folder.mkdir(parents=True, exist_ok=True)
    save(draw_projection(rows), folder / "theory_projection")
    print(f"\npicture: {folder}/theory_projection.png")
