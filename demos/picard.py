# %% [markdown]
# # Picard: a coefficient that depends on the solution
#
# A plate is warm at its upper edge and cooled inside. A thermostat on the lower edge supplies heat
# where its temperature u would fall below 0: a Signorini problem. The plate conducts the better
# the warmer it is, -div((1 + u^2) grad u) = f, so that the problem is not linear. Picard's method
# solves it with the conductivity of the last iterate, again and again.
#
# Run it with `python3 demos/picard.py`, or on two processes with `mpirun -n 2`.

# %%
from dolfinx_signorini import SignoriniProblem

import dolfinx
import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import ufl
from dolfinx import fem, la
from mpi4py import MPI

comm = MPI.COMM_WORLD

# %% [markdown]
# ## One step
#
# The function that the problem fills, given as `u`, is a coefficient of the form a. So each `solve`
# is a step: it finds the coefficient changed, and assembles the matrix again.

# %%
mesh = dolfinx.mesh.create_unit_square(comm, 64, 64)
space = fem.functionspace(mesh, ("Lagrange", 1))
edge, top = (
    dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x, y=y: np.isclose(x[1], y))
    for y in (0.0, 1.0)
)
u, trial, v = fem.Function(space), ufl.TrialFunction(space), ufl.TestFunction(space)
dx = ufl.Measure("dx", mesh, metadata={"quadrature_degree": 4})
cooling = -8.0 * ufl.SpatialCoordinate(mesh)[0]


def a(temperature: fem.Function | ufl.Argument) -> ufl.Form:
    """The flow of heat by a temperature, with the conductivity of the last iterate."""
    return (1.0 + u**2) * ufl.inner(ufl.grad(temperature), ufl.grad(v)) * dx


L = cooling * v * dx
bc = fem.dirichletbc(1.0, fem.locate_dofs_topological(space, 1, top), space)
problem = SignoriniProblem(a(trial), L, contact=edge, bcs=[bc], u=u)

# %% [markdown]
# ## The iteration
#
# Each increment is a fraction of the one before: the iteration is a contraction. A step starts at
# the last solution, so that the later steps have little to do.

# %%
increments, factors = [np.inf], []
while increments[-1] > 1e-9:
    old = u.x.array.copy()
    problem.solve(rtol=1e-11)
    increments.append(comm.allreduce(np.abs(u.x.array - old).max(initial=0.0), op=MPI.MAX))
    factors.append(increments[-1] / increments[-2])
    result = problem.result
    if comm.rank == 0:
        print(
            f"step {len(factors):2}: increment {increments[-1]:.1e}, factor {factors[-1]:.3f}, "
            f"{result.active_dofs} dofs in contact, {result.linear_iterations} CG iterations"
        )
assert max(factors) < 0.5

# %% [markdown]
# ## The limit solves the problem that is not linear
#
# The heat that flows into the plate at a dof, a(u; u, v) - L(v) with its basis function v, comes
# from the thermostat on the lower edge, where min(u, heat) = 0, and is 0 inside.

# %%
heat = fem.assemble_vector(fem.form(a(u) - L))
heat.scatter_reverse(la.InsertMode.add)
contact, residual = problem.contact_dofs, heat.array[: problem.b.getLocalSize()]
residual[problem.fixed_dofs] = 0.0
residual[contact] = np.minimum(u.x.array[contact], residual[contact])
assert np.abs(residual).max(initial=0.0) < 1e-9
problem.destroy()

# %% [markdown]
# ## Picture: the increments

# %%
if comm.rank == 0:
    figure, axes = plt.subplots(figsize=(7.2, 4.2))
    axes.semilogy(range(1, len(increments)), increments[1:], "o-", color="#0072B2")
    axes.set(xlabel="step", ylabel="largest change of $u$ in the step")
    axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig("picard.png", dpi=150)
    print("picture: picard.png")
