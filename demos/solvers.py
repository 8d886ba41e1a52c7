# %% [markdown]
# # All solvers side by side
#
# One problem, the paper's at N = 101, and every way this package has to solve it: the cascade, with
# and without a coarser solution, and the bound-constrained solvers of PETSc TAO from zero. All of
# them stop on the same measure, the natural residual relative to the data, so that they can be
# compared: in iterations, in linear solves, and in how far their solutions lie apart.
#
# Run it with `python3 demos/solvers.py`, or on two processes with `mpirun -n 2`.

# %%
import time
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini import (
    SolveResult,
    christof_haubner,
    error_norms,
    friedrichs_keller,
    paper_problem,
)
from dolfinx_signorini.problem import METHODS, SignoriniProblem

comm = MPI.COMM_WORLD
RTOL = 1e-8


def paper(n: int) -> SignoriniProblem:
    return paper_problem(christof_haubner(friedrichs_keller(comm, n)))


# %% [markdown]
# ## Solve
#
# First-order methods (bncg, bqnls, blmvm) need a thousand cheap iterations, more on finer meshes.
# Newton's methods (bntr, bnls, tron) need few, each with linear solves. The cascade needs a linear
# solve or two once it knows the contact set nearly: from a mesh four times as coarse.

# %%
problem, small = paper(101), paper(25)
coarse = small.contact_state(small.solve().u)
small.destroy()
results: dict[str, tuple[SolveResult, float]] = {}
for name in (*METHODS, "cascade from N = 25"):
    start = time.perf_counter()
    if name in METHODS:
        result = problem.solve(name, rtol=RTOL)
    else:
        result = problem.solve(coarse=coarse, rtol=RTOL)
    results[name] = (result, time.perf_counter() - start)
problem.destroy()

# %% [markdown]
# ## Compare
#
# `linear its` are the iterations of conjugate gradients inside, and the difference is the largest
# one from Newton's solution (bntr), relative to the largest value.

# %%
reference = results["bntr"][0].u
largest = error_norms(reference, None, ["Linf"])["Linf"]
difference = fem.Function(reference.function_space)
table = []
for name, (result, seconds) in results.items():
    difference.x.array[:] = result.u.x.array - reference.x.array
    apart = error_norms(difference, None, ["Linf"])["Linf"] / largest
    table.append((name, result, seconds, apart))
if comm.rank == 0:
    print(f"{'method':>20} {'TAO its':>8} {'solves':>7} {'linear its':>11} {'residual':>9} "
          f"{'difference':>11} {'seconds':>8}")  # fmt: skip
    for name, result, seconds, apart in table:
        print(
            f"{name:>20} {result.iterations:8} {result.linear_solves:7} "
            f"{result.linear_iterations:11} {result.natural_residual:9.1e} {apart:11.1e} "
            f"{seconds:8.2f}"
        )

# %% [markdown]
# ## Picture: what each solver counts
#
# One matrix product per iteration is the least that each of them costs.

# %%
if comm.rank == 0:
    names = [row[0] for row in table]
    places = np.arange(len(names))
    figure, axes = plt.subplots(figsize=(7.2, 4.2))
    tao = [row[1].iterations for row in table]
    linear = [row[1].linear_iterations for row in table]
    bars = (("iterations of TAO", tao, "#0072B2"), ("iterations of CG with AMG", linear, "#E69F00"))
    for shift, (label, values, colour) in zip((-0.2, 0.2), bars, strict=True):
        drawn = axes.barh(places + shift, values, height=0.4, color=colour, label=label)
        axes.bar_label(drawn, padding=2, fontsize=8)
    axes.set_xscale("log")
    axes.set_xlim(0.5, 2.0 * max(tao))
    axes.set_yticks(places, names)
    axes.invert_yaxis()
    axes.set_xlabel(f"iterations to a relative natural residual of {RTOL:g}")
    axes.grid(alpha=0.3, axis="x")
    axes.legend(loc="lower center", ncols=2, bbox_to_anchor=(0.5, 1.0), frameon=False)
    figure.tight_layout()
    folder = Path("results")
    folder.mkdir(exist_ok=True)
    figure.savefig(folder / "demo_solvers.png", dpi=150)
    print(f"picture: {folder}/demo_solvers.png")
