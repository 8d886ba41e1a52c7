# %% [markdown]
# # Parallel and large
#
# Every line of these tutorials works on any number of processes, with the same answer:
#
#     mpirun -n 4 python3 demos/parallel_and_large.py --cells 1000
#
# For a large problem three things matter: start from a coarser mesh, say how much accuracy the
# algebra needs, and look at what was spent.

# %%
import argparse
import time

import dolfinx_signorini as ds

import ufl
from dolfinx import fem
from mpi4py import MPI

parser = argparse.ArgumentParser()
parser.add_argument("--cells", type=int, default=200, help="cells per side of the unit square")
cells = parser.parse_known_args()[0].cells  # a notebook has arguments of its own
comm = MPI.COMM_WORLD

# %% [markdown]
# ## From coarse to fine
#
# `ds.solve_cascade` poses the problem on coarser meshes first, and carries the contact set up. On
# the finest mesh about one linear solve is left. `ds.coarse_levels` tells which meshes to use.


# %%
def pose(n: int, coarser: ds.SignoriniProblem | None) -> ds.SignoriniProblem:
    """Return the problem on n cells per side."""
    mesh = ds.friedrichs_keller(comm, n)
    V = fem.functionspace(mesh, ("Lagrange", 1))
    u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    L = 20.0 * (x[0] - 0.6) * v * ufl.dx
    return ds.SignoriniProblem(a, L, contact=ds.boundary_facets(mesh), obstacle=0.0)


def tell(problem: ds.SignoriniProblem) -> None:
    """Say what a level took."""
    if comm.rank == 0:
        result = problem.result
        print(
            f"{problem.unknowns:8d} unknowns: {result.linear_solves} linear solves, "
            f"{result.linear_iterations} iterations of CG"
        )


start = time.perf_counter()
problem = ds.solve_cascade(pose, [*ds.coarse_levels(cells), cells], on_level=tell)
seconds = time.perf_counter() - start
if comm.rank == 0:
    print(f"{seconds:.1f} s on {comm.size} process{'es' if comm.size > 1 else ''}")

# %% [markdown]
# ## Which rank has what
#
# `problem.active` and `problem.contact_dofs` are the owned dofs of this rank. Sums are collective,
# and so are pictures: every rank calls `plot`, and rank 0 gets the figure.

# %%
touching = comm.allreduce(len(problem.active))
assert touching == problem.result.active_dofs
problem.plot()

# %% [markdown]
# ## What it cost
#
# `costs` lists forms, matrices and vectors with their bytes and seconds.

# %%
from dolfinx_signorini.base.costs import cost_text

costs = problem.costs()
if comm.rank == 0:
    print(cost_text(costs))

# %% [markdown]
# ## To go on tomorrow, on another number of ranks
#
# `write_checkpoint` writes functions with their coordinates, and `read_checkpoint` fills functions
# on the same mesh from the file, however the mesh is shared then.

# %%
from pathlib import Path

from dolfinx_signorini.meshes.checkpoints import read_checkpoint, write_checkpoint

path = Path("checkpoint.npz")
write_checkpoint(path, {"u": problem.u})
again = fem.Function(problem.space)
read_checkpoint(path, {"u": again})
difference = comm.allreduce(abs(again.x.array - problem.u.x.array).max(), op=MPI.MAX)
if comm.rank == 0:
    print(f"read again, with a difference of {difference:g}")
    path.unlink()
