# %% [markdown]
# # The paper's experiment in one page
#
# Christof and Haubner (2020) solve a Signorini problem on the unit square whose solution is known
# in closed form: it rests on the obstacle 0 on one part of the boundary, and detaches from it in
# the middle of the bottom edge, where it is only as smooth as r^{3/2}. How fast do linear finite
# elements converge, not in the energy norm but in L^4, L^inf, W^{1,4}, and on the boundary?
#
# Run it with `python3 demos/paper.py`, or on two processes with `mpirun -n 2`.

# %%
from pathlib import Path

from dolfinx_signorini import (
    ManufacturedSolution,
    SignoriniProblem,
    christof_haubner,
    error_norms,
    friedrichs_keller,
    solve_cascade,
)
from dolfinx_signorini.norms.orders import eoc, expected_order
from dolfinx_signorini.studies.paper.pictures import (
    draw_bottom_edge,
    draw_convergence,
    paper_picture,
)
from dolfinx_signorini.studies.paper.solution import paper_problem

from mpi4py import MPI

comm = MPI.COMM_WORLD
CELLS = (25, 51, 101, 201)  # squares per side, each cut into two triangles
NORMS = ("L4", "Linf", "W1_4", "W1_inf", "H1_2_boundary")


def say(*words: object) -> None:
    if comm.rank == 0:
        print(*words, flush=True)


# %% [markdown]
# ## Solve on finer and finer meshes
#
# Each mesh gets the closed-form solution with its load, and the problem: (u, v)_H1 = (f, v) with
# u >= 0 on the whole boundary. The cascade solves from coarse to fine: the contact set of a mesh is
# predicted from the coarser solution, so that nearly always one linear solve is enough; PETSc TAO
# then accepts the result.

# %%
say(f"{'N':>4} {'linear solves':>14} {'in contact':>11}" + "".join(f"{m:>15}" for m in NORMS))
posed: list[tuple[int, ManufacturedSolution]] = []
rows: list[dict] = []


def pose(n: int, coarser: SignoriniProblem | None) -> SignoriniProblem:
    posed.append((n, christof_haubner(friedrichs_keller(comm, n))))
    return paper_problem(posed[-1][1])


def measure(problem: SignoriniProblem) -> None:
    (n, exact), result = posed[-1], problem.result
    errors = error_norms(problem.u, exact, NORMS)
    rows.append({"n": n, "errors": errors})
    figures = "".join(f"{errors[m]:15.4e}" for m in NORMS)
    say(f"{n:4} {result.linear_solves:14} {result.active_dofs:11}" + figures)


solve_cascade(pose, CELLS, on_level=measure).destroy()

# %% [markdown]
# ## Orders of convergence
#
# The errors are close to those of the paper's Table 1 (N = 101, 201): maxima are up to 6 % larger
# than the paper's samples of them, and the estimate of H^{1/2} is 1 % smaller than by the paper's
# rule. The command `reproduce` computes the paper's digits. The theorems promise the orders 2, 3/2,
# 1, 1/2 and 3/2, less any epsilon.

# %%
widths = [1.0 / n for n in CELLS]
for name in NORMS:
    orders = eoc(widths, [row["errors"][name] for row in rows])
    expected = expected_order(name)
    say(f"{name:>14}: orders", *(f"{order:.3f}" for order in orders), f" theory {expected}")

# %% [markdown]
# ## Pictures
#
# The errors against N, and the solution with its contact pressure along the bottom edge: to the
# right of the detachment point u = 0 and the obstacle pushes back.

# %%
folder = Path("results")
picture = paper_picture(comm, 101)
if picture is not None:
    folder.mkdir(exist_ok=True)
    draw_convergence(rows, NORMS).save(folder / "demo_paper_convergence")
    draw_bottom_edge(picture).save(folder / "demo_paper_bottom_edge")
    say(f"pictures: {folder}/demo_paper_*.png")
