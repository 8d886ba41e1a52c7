# %% [markdown]
# # A load that grows: an elastic block is pressed onto a bump, step by step
#
# A block rests over a round bump, and its weight grows in fifty steps. Each step begins with the
# solution and the contact of the steps before: only a few nodes come into contact in a step, and
# one or two linear solves find them.
#
# Run it with `python3 demos/growing_load.py`, or on two processes with `mpirun -n 2`.

# %%
import dolfinx_signorini as ds
from dolfinx_signorini.pictures.picture import Picture

import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

comm, n, steps = MPI.COMM_WORLD, 48, 50
mesh = dolfinx.mesh.create_unit_square(comm, n, n)
V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)
top, bottom = (
    dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x, y=y: np.isclose(x[1], y))
    for y in (1.0, 0.0)
)

# %% [markdown]
# ## The problem is posed once
#
# The weight is a `Constant`: `solve` sees its present value. The upper side is held.

# %%
weight = fem.Constant(mesh, 0.0)
held = fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, top), V)
problem = ds.ContactProblem(
    ds.elasticity(u, v, young=200.0, poisson=0.3),
    -weight * v[1] * ufl.dx,
    contact=bottom,
    gap=0.2 * (x[0] - 0.45) ** 2,
    bcs=[held],
)

# %% [markdown]
# ## The loop

# %%
forces, widths, solves = [0.0], [0.0], []
along = V.tabulate_dof_coordinates()[:, 0]
for k in range(1, steps + 1):
    weight.value = 40.0 * k / steps
    problem.solve()
    forces.append(problem.force[1])
    touching = along[problem.active]
    low = comm.allreduce(touching.min(initial=np.inf), op=MPI.MIN)
    high = comm.allreduce(touching.max(initial=-np.inf), op=MPI.MAX)
    widths.append(max(high - low, 0.0))
    solves.append(problem.result.linear_solves)

if comm.rank == 0:
    print(f"{problem.unknowns} unknowns, {steps} steps, {sum(solves)} linear solves")
    print(f"the first step takes {solves[0]}, a step after the fifth {np.mean(solves[5:]):.2f}")
    print(f"force {forces[-1]:.3f}, contact {widths[-1]:.3f} wide")
    assert np.mean(solves[5:]) <= 2.0
    assert all(np.diff(forces) > 0.0) and all(np.diff(widths) >= 0.0)

# %% [markdown]
# ## Picture: force and width of the contact over the load
#
# The width grows like a root of the load, by cells of the mesh, and the force soon in proportion.

# %%
picture = Picture(figsize=(7.0, 3.2))
if comm.rank == 0:
    left = picture.subplots()
    loads = 40.0 * np.arange(steps + 1) / steps
    left.plot(loads, forces, color="#0072B2", label="force")
    left.set(xlabel="weight", ylabel="force")
    right = left.twinx()
    right.step(loads, widths, color="#D55E00", where="post", label="width")
    right.set(ylabel="width of the contact")
    picture.legend(frameon=False, loc="upper left", bbox_to_anchor=(0.12, 0.95))
    picture.savefig("growing_load.png")
    print("picture: growing_load.png")
problem.destroy()
picture
