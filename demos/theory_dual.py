"""The dual problems of Section 5: why the L^4 error is of order 2.

Run: python3 demos/theory_dual.py [FOLDER]    (or under mpirun)

Without Galerkin orthogonality the trick of Aubin and Nitsche needs two dual problems, one for each
sign of u - u_h. Their solutions z are only like r^{1/2} at the ends of the contact sets, and so the
proof needs the W^{1,4} error. Here the chains of inequalities are evaluated term by term, for the
load divided by the third power of the error, so that their left-hand side is the error itself.
"""

import sys
from pathlib import Path

from mpi4py import MPI

from dolfinx_signorini.paper.theory.experiments import compute_family
from dolfinx_signorini.paper.theory.figures import draw_dual
from dolfinx_signorini.paper.theory.section5 import (
    lemma_5_2_tables,
    proposition_5_4_tables,
    proposition_5_7_tables,
)
from dolfinx_signorini.plotting import save

comm = MPI.COMM_WORLD
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "results/demos")

# z is computed on a mesh four times as fine as that of u_h: on the same mesh it would be its own
# interpolant, and the term that decides would vanish.
rows = {"dual": compute_family(comm, "dual", (13, 25, 49))}

if comm.rank == 0:
    for title, table in lemma_5_2_tables(rows):
        print(f"Lemma 5.2. {title}:\n{table}")
    for title, table in proposition_5_4_tables(rows):
        print(f"(20), (21). {title}:\n{table}")
    print(
        "Two terms are as large as the error: the interpolation error of z, and the hat functions"
    )
    print("('bumps') at the ends of the contact cells. For the other sign no hat functions are")
    print("needed, and the chain holds with equality:\n")
    for title, table in proposition_5_7_tables(rows):
        print(f"(26). {title}:\n{table}")
    folder.mkdir(parents=True, exist_ok=True)
    save(draw_dual(rows), folder / "theory_dual")
    print(f"picture: {folder}/theory_dual.png")
