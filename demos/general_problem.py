# %% [markdown]
# # Your own problem: contact on one side, clamped on another, over an uneven floor
#
# `SignoriniProblem` takes what `dolfinx.fem.petsc.LinearProblem` takes, UFL forms and Dirichlet
# conditions, and in addition the facets of the contact boundary and the obstacle. Here a membrane,
# stiffer to the right, is clamped at the top, pulled down by its weight, and held up on its bottom
# edge by a floor that is not flat.
#
# Run it with `python3 demos/general_problem.py`, or on two processes with `mpirun -n 2`.

# %%
from pathlib import Path

from dolfinx_signorini import SignoriniProblem

import dolfinx
import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

comm = MPI.COMM_WORLD

# %% [markdown]
# ## Mesh, space, and the parts of the boundary
#
# The left and right edges are not mentioned anywhere: they are free (Neumann).

# %%
mesh = dolfinx.mesh.create_rectangle(comm, [(0.0, 0.0), (2.0, 1.0)], (96, 48))
space = fem.functionspace(mesh, ("Lagrange", 1))
contact = dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], 0.0))
top = dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], 1.0))
clamped = fem.locate_dofs_topological(space, 1, top)
bc = fem.dirichletbc(PETSc.ScalarType(0.0), clamped, space)

# %% [markdown]
# ## Forms and floor
#
# The quadrature is named, so that a change of the coefficient does not change it behind our back.

# %%
u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
x = ufl.SpatialCoordinate(mesh)
dx = ufl.Measure("dx", mesh, metadata={"quadrature_degree": 4})
stiffness = 1.0 + x[0]
weight = 4.0
a = stiffness * ufl.inner(ufl.grad(u), ufl.grad(v)) * dx
L = -weight * v * dx


def floor(x: np.ndarray) -> np.ndarray:
    """Height of the floor at points x, shape (3, n)."""
    return -0.55 - 0.25 * np.cos(2.5 * np.pi * x[0])


problem = SignoriniProblem(a, L, contact=contact, obstacle=floor, bcs=[bc])
height = problem.solve()
result = problem.result
if comm.rank == 0:
    print(f"{problem.unknowns} unknowns, {result.active_dofs} of them on the floor")
    print(f"{result.linear_solves} linear solves; {result.reason}")
    print(f"relative natural residual {result.natural_residual:.1e}")

# %% [markdown]
# ## The contact force balances the weight
#
# `problem.pressure` is the density of the contact pressure, and `problem.force` its integral. Floor
# and clamp together bear the weight: the share of the clamp is the flux through the top edge.

# %%
pressure = problem.pressure
borne = problem.force
if comm.rank == 0:
    print(f"the floor bears {borne:.3f} of the weight {2.0 * weight:.3f}, the clamp the rest")

# %% [markdown]
# ## Picture: the bottom edge, the floor and the pressure

# %%
owned = problem.contact_dofs
parts = comm.gather(
    np.column_stack(
        [
            space.tabulate_dof_coordinates()[owned, 0],
            height.x.array[owned],
            problem.obstacle,
            pressure.x.array[owned],
        ]
    )
)
problem.destroy()
if parts is not None:
    table = np.vstack(parts)
    position, heights, ground, pressures = table[np.argsort(table[:, 0])].T
    figure, (above, below) = plt.subplots(2, 1, figsize=(7.2, 5.4), sharex=True)
    above.fill_between(position, ground, ground.min() - 0.1, color="0.85", label="floor")
    above.plot(position, heights, color="#0072B2", label="$u$ on the bottom edge")
    touching = heights <= ground
    above.plot(
        position[touching], heights[touching], "o", color="#D55E00", ms=4, label="in contact"
    )
    above.set_ylabel("height")
    below.plot(position, pressures, color="#D55E00")
    below.set(xlabel="$x_1$ on the bottom edge", ylabel="contact pressure")
    for axes in (above, below):
        axes.grid(alpha=0.3)
    above.legend(loc="lower center", ncols=3, bbox_to_anchor=(0.5, 1.0), frameon=False)
    figure.tight_layout()
    folder = Path("results")
    folder.mkdir(exist_ok=True)
    figure.savefig(folder / "demo_general_problem.png", dpi=150)
    print(f"picture: {folder}/demo_general_problem.png")
