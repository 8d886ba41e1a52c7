# %% [markdown]
# # Damage that cannot heal: the last solution is the obstacle
#
# A material breaks where the stored energy is large, and does not heal when the load is taken away.
# The damage alpha, 0 where the material is sound and 1 where it is broken, minimises
#
#     integral of (1 - alpha)² s + G (alpha / l + l |grad alpha|²)
#
# with the stored energy s, the toughness G and a length l, over all alpha that are nowhere below
# the damage of the last step. So each step is an obstacle problem, and its obstacle is the last
# solution.
#
# Run it with `python3 demos/irreversible.py`, or on two processes with `mpirun -n 2`.
#
# Source: Marigo, Maurini and Pham, An overview of the modelling of fracture by gradient damage
# models, Meccanica 51 (2016). There a second equation gives s; here s is given.

# %%
import time

import dolfinx_signorini as ds
from dolfinx_signorini.pictures.picture import Picture

import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

comm, n, toughness, length = MPI.COMM_WORLD, 64, 1.0, 0.1

# %% [markdown]
# ## The problem
#
# The stored energy has its peak at a point that wanders through the square. The bound is a Function
# of the space, `last`: `solve` sees its values as they are at that time. For comparison a second
# problem has the obstacle 0 in place of the last solution: that material heals.

# %%
mesh = dolfinx.mesh.create_unit_square(comm, n, n)
V = fem.functionspace(mesh, ("Lagrange", 1))
trial, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)
load, place = fem.Constant(mesh, 0.0), fem.Constant(mesh, (0.0, 0.5))
stored = load * ufl.exp(-40.0 * ufl.inner(x - place, x - place))
dx = ufl.Measure("dx", mesh, metadata={"quadrature_degree": 4})
a = 2.0 * stored * trial * v * dx
a += 2.0 * toughness * length * ufl.inner(ufl.grad(trial), ufl.grad(v)) * dx
L = (2.0 * stored - toughness / length) * v * dx
last = fem.Function(V)
problem = ds.ObstacleProblem(a, L, lower=last)
healing = ds.ObstacleProblem(a, L, lower=0.0)

# %% [markdown]
# ## The loop
#
# The load grows and falls while its peak wanders. Before each step `last` gets the values of the
# solution, ghosts included. The pressure of the obstacle is what keeps the material from healing.

# %%
steps = 40
phase = np.linspace(0.0, 1.0, steps + 1)
loads = 60.0 * np.sin(np.pi * phase)
total = fem.form(problem.u * dx), fem.form(healing.u * dx)
damage, solves, early = np.zeros((steps + 1, 2)), 0, fem.Function(V)
seconds = 0.0
for step in range(1, steps + 1):
    load.value, place.value[0] = loads[step], 0.2 + 0.6 * phase[step]
    last.x.array[:] = problem.u.x.array
    start = time.perf_counter()
    problem.solve()
    seconds += time.perf_counter() - start
    solves += problem.result.linear_solves
    healing.solve()
    damage[step] = [comm.allreduce(fem.assemble_scalar(form)) for form in total]
    assert (problem.u.x.array >= last.x.array).all()  # nothing heals, nowhere
    if step == steps // 2:
        early.x.array[:] = problem.u.x.array
held = comm.allreduce(len(problem.active))
largest = comm.allreduce(problem.u.x.array.max(initial=0.0), MPI.MAX)
if comm.rank == 0:
    print(f"{1e3 * seconds / steps:.1f} ms and {solves / steps:.2f} linear solves per step")
    print(f"damage at the end: {damage[-1, 0]:.4f}, with healing {damage[-1, 1]:.4f}")
    print(f"largest damage {largest:.3f}; {held} of {problem.unknowns} dofs stay as they were")

# %% [markdown]
# ## What must be
#
# The damage only grows and stays below 1, though nobody says so: no energy is won beyond. Without
# load at the end, nothing changes any more, and the material that heals is as new.

# %%
assert (np.diff(damage[:, 0]) >= -1e-12).all() and largest < 1.0
assert held == problem.unknowns and abs(damage[-1, 1]) < 1e-9
assert damage[-1, 0] >= damage[:, 1].max() > 0.0

# %% [markdown]
# ## Picture: the damage at half time and at the end, and its integral over time

# %%
owned = V.dofmap.index_map.size_local
places = np.rint(n * V.tabulate_dof_coordinates()[:owned, :2]).astype(int)
parts = comm.gather((places, early.x.array[:owned], problem.u.x.array[:owned]))
picture = Picture(figsize=(11.0, 3.4))
if comm.rank == 0:
    fields, nodes = np.zeros((2, n + 1, n + 1)), np.linspace(0.0, 1.0, n + 1)
    for (column, row), *both in ((part[0].T, *part[1:]) for part in parts):
        fields[:, row, column] = both
    *maps, curves = picture.subplots(1, 3, width_ratios=(1, 1, 1.3))
    names = "damage at the largest load", "damage at the end"
    for axes, field, name in zip(maps, fields, names, strict=True):
        shown = axes.contourf(nodes, nodes, field, levels=np.linspace(0, 1, 21), cmap="magma_r")
        axes.set(aspect="equal", title=name, xticks=(0, 0.5, 1), yticks=(0, 0.5, 1))
    picture.colorbar(shown, ax=maps, ticks=(0, 0.5, 1), shrink=0.8)
    curves.plot(phase, damage[:, 0], color="#D55E00", label="damage, which cannot heal")
    curves.plot(phase, damage[:, 1], "--", color="#0072B2", label="the same with healing")
    scale = damage[:, 0].max() / loads.max()
    curves.plot(phase, scale * loads, ":", color="black", lw=0.8, label="load, scaled")
    curves.set(xlabel="time", ylabel="integral of the damage", xlim=(0.0, 1.0))
    curves.set(ylim=(0.0, 1.45 * damage[:, 0].max()))
    curves.legend(loc="upper left", frameon=False)
    picture.savefig("irreversible.png")
    print("picture: irreversible.png")
problem.destroy()
healing.destroy()
picture
