# %% [markdown]
# # Dynamics: an elastic block falls on a bump, and bounces
#
# A block falls, meets a round bump, and leaves the bump again. Each time step is a contact problem:
# the trapezoidal rule for inertia and elasticity, and the contact force at the end of the step.
# In flight this rule keeps the energy to rounding, and at contact the energy never grows, because
# the force does no positive work: the force pushes the block up, and the nodes in contact have
# moved down to the bump.
#
# Run it with `python3 demos/falling_block.py`, or on two processes with `mpirun -n 2`.
#
# Source: Kane, Repetto, Ortiz and Marsden, Comput. Methods Appl. Mech. Eng. 180 (1999) 1-26.

# %%
import dolfinx_signorini as ds
from dolfinx_signorini.pictures.picture import Picture

import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

comm, n, steps, dt = MPI.COMM_WORLD, 24, 240, 0.0025
density, gravity = 1.0, 10.0
mesh = dolfinx.mesh.create_unit_square(
    comm, n, n, diagonal=dolfinx.mesh.DiagonalType.crossed
)  # symmetric, so that the block does not turn
V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
trial, test, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)


def elastic(u, v):
    return ds.elasticity(u, v, young=1000.0, poisson=0.3)


# %% [markdown]
# ## One step
#
# From the displacement $u$ and the velocity $v$ a step without any force leads to $u + \tau v$. The
# forces change that: with the mean of the elastic forces before and after the step, the next
# displacement solves a contact problem with the form $(\rho u, w) + \tau^2/4\, a(u, w)$.

# %%
old, free, velocity = fem.Function(V), fem.Function(V), fem.Function(V)
bump = 0.1 - 0.5 * (x[0] - 0.5) ** 2
bottom = dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], 0.0))
problem = ds.ContactProblem(
    density * ufl.inner(trial, test) * ufl.dx + dt**2 / 4.0 * elastic(trial, test),
    density * ufl.inner(free, test) * ufl.dx
    - dt**2 / 4.0 * elastic(old, test)
    - dt**2 / 2.0 * density * gravity * test[1] * ufl.dx,
    contact=bottom,
    gap=0.32 + x[1] - bump,  # the block begins 0.32 above the ground, 0.22 above the bump
    direction=(0.0, -1.0),
)
u = problem.u
energies = [
    fem.form(density / 2.0 * ufl.inner(velocity, velocity) * ufl.dx),
    fem.form(0.5 * elastic(old, old)),
    fem.form(density * gravity * old[1] * ufl.dx),
]
height = fem.form(old[1] * ufl.dx)


def total(form):
    return comm.allreduce(fem.assemble_scalar(form), op=MPI.SUM)


# %% [markdown]
# ## The loop

# %%
parts, middle, forces, solves = [[total(form) for form in energies]], [0.0], [0.0], []
for _ in range(steps):
    free.x.array[:] = old.x.array + dt * velocity.x.array
    problem.solve(rtol=1e-10)
    velocity.x.array[:] += 2.0 / dt * (u.x.array - free.x.array)
    old.x.array[:] = u.x.array
    parts.append([total(form) for form in energies])
    middle.append(total(height))
    forces.append(problem.force[1] * 2.0 / dt**2)
    solves.append(problem.result.linear_solves)

# %% [markdown]
# ## What mechanics says
#
# In flight the middle of the block follows a parabola, and all energy together stays. At contact
# energy may only be lost, and the change of the momentum is the sum of all forces times the step.

# %%
parts, middle, forces = np.array(parts), np.array(middle), np.array(forces)
times, energy = dt * np.arange(steps + 1), parts.sum(axis=1)
landed, left = np.flatnonzero(forces > 1e-6 * forces.max())[[0, -1]]
scale = density * gravity * 0.22
flight = slice(0, landed)
assert np.abs(middle[flight] + gravity / 2.0 * times[flight] ** 2).max() < 1e-8
assert np.abs(energy[flight]).max() < 1e-8 * scale
assert np.diff(energy).max() < 1e-8 * scale
momentum = total(fem.form(density * velocity[1] * ufl.dx))
pushed = dt * (forces.sum() - steps * density * gravity)
assert abs(momentum - pushed) < 1e-6 * dt * forces.sum()
if comm.rank == 0:
    print(f"{problem.unknowns} unknowns, {steps} steps, {np.mean(solves):.2f} linear solves a step")
    print(f"contact from {times[landed]:.3f} to {times[left]:.3f}, force up to {forces.max():.1f}")
    print(f"energy lost at contact: {-energy[-1] / scale:.1%} of that of the fall")

# %% [markdown]
# ## Picture: the energies over time

# %%
picture = Picture(figsize=(7.0, 3.2))
if comm.rank == 0:
    axes = picture.subplots()
    colours = "#0072B2", "#D55E00", "#009E73"
    for part, name, colour in zip(
        parts.T, ("kinetic", "elastic", "of height"), colours, strict=True
    ):
        axes.plot(times, part / scale, color=colour, label=name)
    axes.plot(times, energy / scale, "k--", label="all together")
    axes.axvspan(times[landed], times[left], color="0.9", label="contact")
    axes.set(xlabel="time", ylabel="energy, of that of the fall")
    axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    picture.tight_layout()
    picture.savefig("falling_block.png")
    print("picture: falling_block.png")
problem.destroy()
picture
