# %% [markdown]
# # A membrane between a hill and a ceiling: obstacles in the domain, from below and from above
#
# A membrane is held at its rim, a rectangle. On the left the wind presses it down onto a hill, and
# on the right the wind lifts it against a ceiling that bulges downwards. Both obstacles are in the
# domain: the sets of contact have areas, and their edges, the free boundaries, belong to the
# answer.
#
# Run it with `python3 demos/membrane.py`, or on two processes with `mpirun -n 2`.

# %%
import dolfinx_signorini as ds
from dolfinx_signorini.pictures.picture import Picture

import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

comm, n = MPI.COMM_WORLD, 96

# %% [markdown]
# ## The problem
#
# `ObstacleProblem` takes a lower obstacle, an upper one, or both, as UFL expressions here. The
# membrane has the forms of a linear problem; nothing in them knows of the obstacles.

# %%
mesh = dolfinx.mesh.create_rectangle(comm, [(0.0, 0.0), (2.0, 1.0)], (2 * n, n))
V = fem.functionspace(mesh, ("Lagrange", 1))
u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)
rim = fem.locate_dofs_topological(V, 1, ds.boundary_facets(mesh))
hill = 0.2 - 2.0 * ((x[0] - 0.5) ** 2 + (x[1] - 0.5) ** 2)
ceiling = 0.15 + 2.0 * ((x[0] - 1.5) ** 2 + (x[1] - 0.5) ** 2)
wind = 20.0 * (x[0] - 1.0)
problem = ds.ObstacleProblem(
    ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
    wind * v * ufl.dx,
    lower=hill,
    upper=ceiling,
    bcs=[fem.dirichletbc(0.0, rim, V)],
)
u_h = problem.solve()

# %% [markdown]
# ## Gap, pressure and contact
#
# `problem.gap` is the distance to the nearest obstacle and `problem.pressure` the density of the
# force with which the obstacles hold the membrane: positive on the hill, which pushes up, and
# negative at the ceiling, which pushes down. `problem.active_sides` are the dofs in contact with
# each of the two. The area of contact is the integral of the function that is 1 at the dofs in
# contact and 0 at the others.

# %%
pressure, gap = problem.pressure, problem.gap
areas, forces = [], []
for active in problem.active_sides:
    touching = fem.Function(V)
    touching.x.array[active] = 1.0
    touching.x.scatter_forward()
    areas.append(comm.allreduce(fem.assemble_scalar(fem.form(touching * ufl.dx))))
    forces.append(comm.allreduce(fem.assemble_scalar(fem.form(touching * pressure * ufl.dx))))
force, widest = problem.force, comm.allreduce(gap.x.array.max(initial=0.0), MPI.MAX)
if comm.rank == 0:
    print(f"{problem.unknowns} unknowns, {problem.result.linear_solves} linear solves")
    print(f"on the hill: area {areas[0]:.4f}, force {forces[0]:.3f}")
    print(f"at the ceiling: area {areas[1]:.4f}, force {forces[1]:.3f}")
    print(f"both forces together {force:.3f}; the widest gap is {widest:.3f}")

# %% [markdown]
# ## The pressure is known in closed form
#
# Where the membrane lies on the hill, u is the hill, and the pressure is what the equation
# -Δu = wind + pressure leaves: 8 - wind on the hill, and -8 - wind at the ceiling. The computed
# density has these values at every dof whose neighbours are in contact, too. At the edge of the
# contact a dof carries the force of a part of its cells alone.

# %%
x_active, values = V.tabulate_dof_coordinates()[problem.active], pressure.x.array[problem.active]
exact = np.where(values > 0.0, 8.0, -8.0) - 20.0 * (x_active[:, 0] - 1.0)
as_exact = comm.allreduce(int((np.abs(values - exact) < 1e-4 * np.abs(exact)).sum()))
share = as_exact / problem.result.active_dofs
assert share > 0.9, share
if comm.rank == 0:
    print(f"the pressure is the exact one at {100 * share:.0f} % of the dofs in contact")

# %% [markdown]
# ## Picture: the membrane from above, and cut along the middle
#
# `problem.plot()` draws the solution with the contact regions in one line. This is one with colours
# of its own.

# %%
along, across = np.linspace(0.0, 2.0, 2 * n + 1), np.linspace(0.0, 1.0, n + 1)
owned = V.dofmap.index_map.size_local
places = np.rint(n * V.tabulate_dof_coordinates()[:owned, :2]).astype(int)
parts = comm.gather((places, u_h.x.array[:owned], pressure.x.array[:owned]))
picture = Picture(figsize=(8.0, 7.0))
if comm.rank == 0:
    height, force = np.zeros((2, n + 1, 2 * n + 1))
    for (column, row), *both in ((part[0].T, *part[1:]) for part in parts):
        height[row, column], force[row, column] = both
    top, cut = picture.subplots(2, 1, height_ratios=(5, 3), sharex=True)
    levels = np.arange(-0.2, 0.36, 0.02)
    filled = top.contourf(along, across, height, levels=levels, cmap="Greys_r")
    top.contour(along, across, height, levels=levels[::2], colors="white", linewidths=0.4)
    middle = height[n // 2]
    for sign, name, colour in ((1.0, "hill", "#0072B2"), (-1.0, "ceiling", "#D55E00")):
        touches = (sign * force > 0.0).astype(float)
        top.contourf(along, across, touches, levels=[0.5, 1.0], colors=[colour], alpha=0.6)
        at_cut = touches[n // 2] > 0.5
        cut.plot(along[at_cut], middle[at_cut], color=colour, lw=5.0, label=f"contact: {name}")
    top.set(aspect="equal", ylabel="$x_2$", title="u, and where the membrane is in contact")
    picture.colorbar(filled, ax=top, shrink=0.8)
    bumps = [0.2 - 2.0 * (along - 0.5) ** 2, 0.15 + 2.0 * (along - 1.5) ** 2]
    cut.fill_between(along, bumps[0], -1.0, color="#0072B2", alpha=0.2)
    cut.fill_between(along, bumps[1], 1.0, color="#D55E00", alpha=0.2)
    cut.plot(along, middle, color="black", lw=1.2, label="membrane")
    cut.set(xlim=(0.0, 2.0), ylim=(-0.35, 0.35), xlabel="$x_1$", ylabel="u at $x_2$ = 1/2")
    cut.legend(loc="lower right", frameon=False)
    picture.savefig("membrane.png")
    print("picture: membrane.png")
problem.destroy()
picture
