# %% [markdown]
# # Your first contact problem
#
# A membrane is held along its upper edge and sags under its weight, which grows to the right, until
# its lower edge meets a floor at height -0.3. The part of the edge that touches the floor
# is unknown and belongs to the solution: such a problem is a Signorini problem.
#
#     -Δu = -2x in the unit square,       u = 0 on the upper edge,
#     u ≥ -0.3,  ∂u/∂n ≥ 0,  (u + 0.3) ∂u/∂n = 0 on the lower edge.
#
# The three conditions say that the membrane does not pass through the floor, that the floor pushes
# and does not pull, and that the floor pushes only where it is touched.

# %%
import dolfinx_signorini as ds

import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

mesh = dolfinx.mesh.create_unit_square(MPI.COMM_WORLD, 64, 64)
V = fem.functionspace(mesh, ("Lagrange", 1))

# %% [markdown]
# ## The forms are those of the problem without a floor
#
# Whoever has solved a linear problem with DOLFINx has these lines already.

# %%
u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)
a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
L = -2.0 * x[0] * v * ufl.dx
top = dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], 1.0))
bc = fem.dirichletbc(0.0, fem.locate_dofs_topological(V, 1, top), V)

# %% [markdown]
# ## The floor is one line
#
# `SignoriniProblem` takes what `dolfinx.fem.petsc.LinearProblem` takes, and two things more: the
# facets that may touch, and the obstacle, here a number. An expression, a function or a callable
# of the coordinates do as well.

# %%
bottom = dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], 0.0))
problem = ds.SignoriniProblem(a, L, contact=bottom, obstacle=-0.3, bcs=[bc])
u_h = problem.solve()
problem

# %% [markdown]
# ## What came out
#
# `problem.result` tells what the solve took, `problem.active` the dofs in contact,
# `ds.detachment_points` where contact ends, and `problem.gap` and `problem.pressure` are the
# distance to the floor and the pressure of the floor, as functions. `problem.force` is the force of
# the floor: the integral of the pressure.

# %%
points = ds.detachment_points(problem)
force = problem.force  # all ranks call this
lowest = mesh.comm.allreduce(u_h.x.array.min(), op=MPI.MIN)
if mesh.comm.rank == 0:
    print(f"{problem.result.active_dofs} dofs in contact, {problem.result.linear_solves} solves")
    print(f"natural residual {problem.result.natural_residual:.1e} of the data")
    print(f"the membrane is nowhere lower than {lowest:.3f}")
    print(f"the floor bears {force:.4f} of the weight 1")
    for point in points:
        print(f"contact ends at x = {point.position[0]:.3f} +- {point.uncertainty:.1g}")

# %% [markdown]
# ## Pictures
#
# The first picture has gap and pressure along the lower edge: where one of them is positive, the
# other one vanishes. The second picture has the solution, with the part in contact. A notebook
# shows the pictures, and a script saves them: the first argument of `plot` is the file.

# %%
problem.plot("contact.png", sides={"lower edge": bottom})

# %%
problem.plot("solution.png", what="solution")

# %% [markdown]
# ## Next
#
# Change the obstacle to `lambda x: -0.3 + 0.1 * x[0]`, or the floor to a ceiling with
# `bound="upper"`. A mesh from gmsh, and a file for ParaView: see the next tutorial.
