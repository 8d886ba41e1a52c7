"""One-sided approximation: a small function between R_h(u) - u and R_h(u) (Lemmas 3.4 and 3.5).

Run: python3 demos/theory_one_sided.py [FOLDER]    (or under mpirun)

Every w_h in V_h with R_h(u) - u <= w_h <= R_h(u) on the boundary bounds the distance of u_h from
R_h(u): ||R_h(u) - u_h||_H1 <= ||w_h||_H1. The paper takes the one with the smallest sum of its
boundary values, which is a linear program, and extends it into the domain.
"""

import sys
from pathlib import Path

from dolfinx_signorini.base.tables import markdown_table
from dolfinx_signorini.studies.paper.theory.checks import number
from dolfinx_signorini.studies.paper.theory.errors import supercloseness
from dolfinx_signorini.studies.paper.theory.examples import paper_example
from dolfinx_signorini.studies.paper.theory.families import discretise
from dolfinx_signorini.studies.paper.theory.figures import draw_one_sided
from dolfinx_signorini.studies.paper.theory.one_sided import one_sided_approximation

from mpi4py import MPI

comm = MPI.COMM_WORLD
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "results/demos")

lines, approximations = [], {}
for n in (15, 31, 63, 127):
    discretisation = discretise(comm, paper_example(), n)
    found = approximations[n] = one_sided_approximation(discretisation)
    distance = supercloseness(discretisation)
    discretisation.destroy()
    figures = [found.norm, distance, distance / found.norm, found.distance]
    lines.append([str(n), *map(str, found.cases), *map(number, figures)])

if comm.rank == 0:
    print("w_h cannot be lowered at any node: it touches R_h(u) - u there (case 1), on the edge")
    print("before the node (2) or on the one behind it (3).\n")
    columns = ["N", "case 1", "case 2", "case 3", "none"]
    columns += ["w_h in H1", "R_h(u) - u_h", "ratio", "w_h - R_h(u) + u"]
    print(markdown_table(columns, lines))
    print("The ratio is the inequality (9): never above 1. The last column is (13), of order 3/2.")
    folder.mkdir(parents=True, exist_ok=True)
    draw_one_sided(approximations[31]).save(folder / "theory_one_sided")
    print(f"\npicture: {folder}/theory_one_sided.png")
