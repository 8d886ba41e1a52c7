# %% [markdown]
# # A parameter sweep
#
# How does the contact set change when a floor is raised? In a loop, `solve` sees the changed value,
# keeps what did not change (matrix, multigrid), and starts from the last solution.

# %%
import dolfinx_signorini as ds
from dolfinx_signorini.pictures.picture import Picture

import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from matplotlib.figure import Figure
from mpi4py import MPI

comm = MPI.COMM_WORLD
mesh = ds.friedrichs_keller(comm, 64)
V = fem.functionspace(mesh, ("Lagrange", 1))
u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)
top, bottom = (
    dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x, y=y: np.isclose(x[1], y))
    for y in (1.0, 0.0)
)
a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
L = (-1.0 - 2.0 * x[1]) * v * ufl.dx
bc = fem.dirichletbc(0.0, fem.locate_dofs_topological(V, 1, top), V)

# %% [markdown]
# ## What changes is a Constant
#
# The height of the floor is a `Constant` in the obstacle. Every value in a form, in the obstacle or
# in Dirichlet data that is to change should be a `Constant` or a `Function`.

# %%
height = fem.Constant(mesh, -0.8)
floor = height + 0.1 * ufl.sin(3.0 * np.pi * x[0])
problem = ds.SignoriniProblem(a, L, contact=bottom, obstacle=floor, bcs=[bc])

# %%
heights = np.linspace(-0.8, -0.1, 15)
table = []
for value in heights:
    height.value = value
    problem.solve()
    result = problem.result
    table.append((value, result.active_dofs, problem.force, result.linear_solves))
if comm.rank == 0:
    print("height  dofs in contact  force of the floor  linear solves")
    for row in table:
        print("{:6.2f}{:17d}{:20.4f}{:15d}".format(*row))

# %%


def draw() -> Figure:
    """Draw the contact set and the force of the floor over its height."""
    figure = Picture(figsize=(8.0, 3.4))
    left, right = figure.subplots(1, 2)
    left.plot(heights, [row[1] for row in table], "o-")
    left.set(xlabel="height of the floor", ylabel="dofs in contact")
    right.plot(heights, [row[2] for row in table], "o-", color="#D55E00")
    right.set(xlabel="height of the floor", ylabel="force of the floor")
    for axes in (left, right):
        axes.grid(alpha=0.3)
    return figure


draw()

# %% [markdown]
# ## The same for a scene file, in one line
#
#     dolfinx-signorini sweep demos/scenes/obstacle.toml equation.load -0.5 -1 -2 -4
#
# prints a table, writes it as CSV and draws it. A sweep that was stopped goes on where it was. Any
# key of the file can be swept over, and `--set` changes the others.
