"""Regularity and orders: what Corollaries 4.1 and 4.2 prove, and what is measured.

Run: python3 demos/theory_regularity.py [FOLDER]    (or under mpirun)

The solutions are r^{1/2-2/p} w for p < 4 and (1 + r^{1/2-2/p}) w for p > 4, w the paper's: like
r^{2-2/p} at the detachment point, so that they are in W^{2,q} for q < p only.
"""

import sys
from pathlib import Path

from mpi4py import MPI

from dolfinx_signorini.paper.theory.evidence import entry, orders
from dolfinx_signorini.paper.theory.experiments import ROUGH_EXPONENTS, compute_family, rough_name
from dolfinx_signorini.paper.theory.figures import draw_regularity
from dolfinx_signorini.paper.theory.proven import allowed_order, proven_order
from dolfinx_signorini.paper.theory.section4 import corollary_norms
from dolfinx_signorini.plotting import save
from dolfinx_signorini.tables import markdown_table

comm = MPI.COMM_WORLD
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "results/demos")

CELLS = (51, 101, 201)
rows = {rough_name(p): compute_family(comm, rough_name(p), CELLS) for p in ROUGH_EXPONENTS}
rows["paper"] = compute_family(comm, "paper", CELLS)

if comm.rank == 0:
    lines = []
    for p in ROUGH_EXPONENTS:
        for norm in corollary_norms(p):
            proven = proven_order(p, norm)
            allowed = allowed_order(p, norm)
            order = orders(rows[rough_name(p)], entry("errors", norm))[-1]
            cells = [f"{p:g}", norm, str(proven), f"{order:.3f}", f"{allowed:.3f}", proven.source]
            lines.append(cells)
    print(markdown_table(["p", "norm", "proven", "measured", "allowed", "source"], lines))
    print(f"Measured between N = {CELLS[-2]} and {CELLS[-1]}. 'Allowed' is the order of the")
    print(
        "interpolation error of r^{2-2/p} at one point. The corollaries hold for all functions of"
    )
    print("the same regularity; those with one singular point do better.")
    folder.mkdir(parents=True, exist_ok=True)
    save(draw_regularity(rows), folder / "theory_regularity")
    print(f"\npicture: {folder}/theory_regularity.png")
