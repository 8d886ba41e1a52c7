# %% [markdown]
# # All solvers side by side
#
# One problem, the paper's at N = 101, and every way this package has to solve it: the cascade, with
# and without a coarser solution, and the bound-constrained solvers of PETSc TAO from zero. All of
# them stop at the same natural residual relative to the data, so that their iterations, their
# linear solves and their solutions can be compared.
#
# Run it with `python3 demos/solvers.py`, or on two processes with `mpirun -n 2`.

# %%
import time
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

from dolfinx_signorini import (
    METHODS,
    SignoriniProblem,
    christof_haubner,
    error_norms,
    friedrichs_keller,
)
from dolfinx_signorini.base.tables import text_table
from dolfinx_signorini.studies.paper.solution import paper_problem

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import fem
from mpi4py import MPI

comm = MPI.COMM_WORLD
RTOL = 1e-8


def paper(n: int) -> SignoriniProblem:
    return paper_problem(christof_haubner(friedrichs_keller(comm, n)))


# %% [markdown]
# ## Solve
#
# First-order methods (bncg, bqnls, blmvm) need a thousand cheap iterations, more on finer meshes.
# Newton's methods (bntr, bnls, tron) need few iterations, each with linear solves. The cascade
# needs a linear solve or two if it nearly knows the contact set, for example from a mesh with a
# quarter of the cells per side. By default a second solve starts from the last solution; here every
# solve starts from nothing. All solves fill the same function, whose values are copied therefore.

# %%
problem, small = paper(101), paper(25)
small.solve()
coarse = small.contact_state()
small.destroy()
solutions, results, seconds = {}, {}, {}
for name in (*METHODS, "cascade from N = 25"):
    start = time.perf_counter()
    if name in METHODS:
        u = problem.solve(name, rtol=RTOL, warm_start=False)
    else:
        u = problem.solve(coarse=coarse, rtol=RTOL, warm_start=False)
    seconds[name] = time.perf_counter() - start
    solutions[name], results[name] = u.x.array.copy(), problem.result
problem.destroy()

# %% [markdown]
# ## Compare
#
# `linear its` are the iterations of conjugate gradients. The difference is the largest one from the
# solution of Newton's method (bntr), relative to the largest value.

# %%
difference = fem.Function(problem.space)


def largest(values: np.ndarray) -> float:
    """The largest absolute value on all ranks."""
    difference.x.array[:] = values
    return error_norms(difference, None, ["Linf"])["Linf"]


rows = []
for name, result in results.items():
    apart = largest(solutions[name] - solutions["bntr"]) / largest(solutions["bntr"])
    counts = (result.iterations, result.linear_solves, result.linear_iterations)
    rows.append((name, *counts, result.natural_residual, apart, seconds[name]))
if comm.rank == 0:
    heads = ("TAO its", "solves", "linear its", "residual", "difference", "seconds")
    print(text_table(("method", *heads), rows))

# %% [markdown]
# ## Picture: what each solver counts
#
# One matrix product per iteration is the least that each of them costs.

# %%
if comm.rank == 0:
    names = list(results)
    places = np.arange(len(names))
    figure, axes = plt.subplots(figsize=(7.2, 4.2))
    tao = [result.iterations for result in results.values()]
    linear = [result.linear_iterations for result in results.values()]
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
