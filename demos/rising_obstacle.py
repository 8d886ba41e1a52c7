# %% [markdown]
# # A rising obstacle: what force lifts the edge of a sheet to which height?
#
# An elastic sheet hangs from its upper edge. A round punch rises against its lower edge, in 20
# steps, and more and more of the edge rests on the punch. The force of the punch is the integral of
# the contact pressure, `problem.force`.
#
# Run it with `python3 demos/rising_obstacle.py`, or on two processes with `mpirun -n 2`.

# %%
from dolfinx_signorini import SignoriniProblem

import dolfinx
import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

comm = MPI.COMM_WORLD

# %% [markdown]
# ## The problem
#
# The obstacle is a UFL expression with the height of the punch as a `Constant` in it.

# %%
mesh = dolfinx.mesh.create_rectangle(comm, [(-1.0, 0.0), (1.0, 1.0)], (128, 64))
space = fem.functionspace(mesh, ("Lagrange", 1))
edge, top = (
    dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x, y=y: np.isclose(x[1], y))
    for y in (0.0, 1.0)
)
u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
height = fem.Constant(mesh, 0.0)
problem = SignoriniProblem(
    ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
    fem.Constant(mesh, 0.0) * v * ufl.dx,
    contact=edge,
    obstacle=height - ufl.SpatialCoordinate(mesh)[0] ** 2,
    bcs=[fem.dirichletbc(0.0, fem.locate_dofs_topological(space, 1, top), space)],
)

# %% [markdown]
# ## Twenty steps
#
# Each `solve` sees the new height. Nothing is assembled again, and the contact set of the last step
# is where the next one starts.

# %%
energy = fem.form(0.5 * ufl.inner(ufl.grad(problem.u), ufl.grad(problem.u)) * ufl.dx)
along = space.tabulate_dof_coordinates()[problem.contact_dofs, 0]
heights, rows, shapes = np.linspace(0.0, 0.5, 21), [(0.0, 0.0)], []
for step in range(1, 21):
    height.value = heights[step]
    problem.solve()
    rows.append((problem.force, comm.allreduce(fem.assemble_scalar(energy))))
    shapes.append(comm.gather((along, problem.u.x.array[problem.contact_dofs])))
    result = problem.result
    if comm.rank == 0:
        print(
            f"height {heights[step]:.3f}: {result.active_dofs:2} dofs in contact, "
            f"force {rows[-1][0]:.4f}, {result.linear_solves} linear solves"
        )
problem.destroy()

# %% [markdown]
# ## The force is the derivative of the energy
#
# The least energy is a convex function of the height, and its derivative is the force. So from step
# to step the energy grows by at least the old force times the way, and at most by the new one.

# %%
forces, energies = np.transpose(rows)
work, way = np.diff(energies), np.diff(heights)
assert (forces[:-1] * way <= work + 1e-9).all() and (work <= forces[1:] * way + 1e-9).all()

# %% [markdown]
# ## Picture: the lower edge on the punch, and force against height

# %%
if comm.rank == 0:
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 4.0))
    for step in (5, 10, 15, 20):
        position, value = (np.concatenate(parts) for parts in zip(*shapes[step - 1], strict=True))
        order = np.argsort(position)
        (line,) = left.plot(position[order], value[order], label=f"height {heights[step]:g}")
        round_top = heights[step] - position[order] ** 2
        left.plot(position[order], round_top, "--", color=line.get_color(), lw=0.8)
    left.set(xlabel="$x_1$ on the lower edge", ylabel="sheet (lines), punch (dashes)")
    left.set(xticks=(-1.0, -0.5, 0.0, 0.5, 1.0), ylim=(0.0, 0.55))
    left.legend(frameon=False)
    right.plot(heights, forces, "o-", color="#D55E00", ms=4)
    right.set(xlabel="height of the punch", ylabel="force on the punch")
    right.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig("rising_obstacle.png", dpi=150)
    print("picture: rising_obstacle.png")
