# %% [markdown]
# # A time loop: a moving pump behind a wall that lets fluid in, but not out
#
# The pressure u of a fluid in porous ground obeys the heat equation. The lower edge is a
# semipermeable wall with pressure 0 behind it: fluid enters where u would fall below 0, and never
# leaves. So u >= 0 on the wall, the inflow is what `SignoriniProblem` calls the contact pressure,
# and the wall is open on the contact set. A pump moves to and fro in front of the wall, and the
# open part of the wall follows.
#
# Run it with `python3 demos/parabolic.py`, or on two processes with `mpirun -n 2`.
#
# Source: Duvaut and Lions, Inequalities in Mechanics and Physics (1976), chapter I.

# %%
import argparse
import time

from dolfinx_signorini import SignoriniProblem
from dolfinx_signorini.pictures.picture import Picture

import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

parser = argparse.ArgumentParser()
parser.add_argument("--cells", type=int, default=64, help="cells per side of the unit square")
cells = parser.parse_known_args()[0].cells  # a notebook has arguments of its own
comm, steps, dt = MPI.COMM_WORLD, 200, 0.01

# %% [markdown]
# ## One step of implicit Euler
#
# A step is a Signorini problem with the solution of the step before in its load. That solution is
# the function that the problem fills, given as `u`: each `solve` makes one step.

# %%
mesh = dolfinx.mesh.create_unit_square(comm, cells, cells)
space = fem.functionspace(mesh, ("Lagrange", 1))
wall = dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], 0.0))
dx = ufl.Measure("dx", mesh, metadata={"quadrature_degree": 4})

u = fem.Function(space)
trial, v = ufl.TrialFunction(space), ufl.TestFunction(space)
pump = fem.Constant(mesh, (0.0, 0.2))
distance = ufl.SpatialCoordinate(mesh) - pump
source = 5.0 - 100.0 * ufl.exp(-50.0 * ufl.inner(distance, distance))
a = (trial * v + dt * ufl.inner(ufl.grad(trial), ufl.grad(v))) * dx
problem = SignoriniProblem(a, (u + dt * source) * v * dx, contact=wall, u=u)

# %% [markdown]
# ## The loop
#
# Only the pump is moved by hand: `solve` sees the changed values in the load, starts from the last
# solution and its contact set, and uses the matrix and its multigrid set-up again. The force of the
# problem is what the wall lets in during the step, and the pressure the same per length.

# %%
content, gain = fem.form(u * dx), fem.form(dt * source * dx)
times = dt * np.arange(1, steps + 1)
path = 0.5 - 0.35 * np.cos(2.0 * np.pi * times)
is_open = np.zeros((steps, cells + 1), dtype=bool)
expected, solves, start = 0.0, 0, time.perf_counter()
for step in range(steps):
    pump.value[0] = path[step]
    problem.solve()
    solves += problem.result.linear_solves
    expected += comm.allreduce(fem.assemble_scalar(gain)) + problem.force
    along = space.tabulate_dof_coordinates()[problem.active, 0]
    is_open[step, np.rint(cells * along).astype(int)] = True
seconds = time.perf_counter() - start
comm.Allreduce(MPI.IN_PLACE, is_open, op=MPI.LOR)
problem.destroy()

# %% [markdown]
# ## No fluid is lost
#
# With the test function 1 the discrete problem says exactly that the ground holds what the source
# and the pump have left, and what the wall has let in. And the wall is always open where the pump
# is.

# %%
found = comm.allreduce(fem.assemble_scalar(content))
assert abs(found - expected) < 1e-5, (found, expected)
assert is_open[range(steps), np.rint(cells * path).astype(int)].all()
if comm.rank == 0:
    print(f"{steps} steps with {problem.unknowns} unknowns, {1e3 * seconds / steps:.1f} ms each")
    print(f"{solves / steps:.2f} linear solves per step")
    print(f"the ground holds {found:.6f}, the balance says {expected:.6f}")

# %% [markdown]
# ## Picture: the open part of the wall over time

# %%
picture = Picture(figsize=(7.2, 4.2))
axes = picture.subplots()
nodes = np.linspace(0.0, 1.0, cells + 1)
axes.contourf(times, nodes, is_open.T, levels=[0.5, 1.0], colors=["#56B4E9"])
axes.plot(times, path, color="#D55E00", label="position of the pump")
axes.fill_between([], [], color="#56B4E9", label="open part of the wall")
axes.set(xlabel="time", ylabel="position along the wall", ylim=(0.0, 1.0), xlim=(0.0, 2.0))
axes.legend(loc="lower center", ncols=2, bbox_to_anchor=(0.5, 1.0), frameon=False)
if comm.rank == 0:
    picture.savefig("parabolic.png")
picture
