"""How fast a gap opens: the factors of r^{1/2} and r^{3/2} at a detachment point.

Run: python3 demos/theory_stress_intensity.py [FOLDER]    (or under mpirun)

At the end of a contact set the gap is a r^{1/2} - b r^{3/2} sin(3/2 theta) + ... with a = 0 and
b > 0, whatever the data. Nobody knows the solution of the problem below. The factor a that is
computed tells how far off the point is that the discrete contact set gives.
"""

import sys
from pathlib import Path

import dolfinx_signorini as ds
from dolfinx_signorini.base.tables import markdown_table
from dolfinx_signorini.studies.paper.theory.mixed import UnknownProblem

from mpi4py import MPI

comm = MPI.COMM_WORLD
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "results/demos")

lines, problem = [], None
for n in (25, 50, 100, 200):
    problem = UnknownProblem(ds.friedrichs_keller(comm, n))
    problem.solve()
    point = max(ds.detachment_points(problem), key=lambda p: p.position[1])
    found = ds.stress_intensity(problem, point, problem.terms)
    again = ds.stress_intensity(problem, found.corrected, problem.terms)
    figures = [point.position[0], found.half, found.corrected[0], again.half, again.three_halves]
    lines.append([str(n), *(f"{value:.5f}" for value in figures)])

if comm.rank == 0:
    print(markdown_table(["N", "point", "a", "corrected", "a there", "b"], lines))
    print("At the corrected point a is of order 2; b settles and is positive.")
    folder.mkdir(parents=True, exist_ok=True)
assert problem is not None
figure = problem.plot()
if figure is not None:
    figure.savefig(folder / "theory_stress_intensity.png", dpi=150)
    print(f"picture: {folder}/theory_stress_intensity.png")
