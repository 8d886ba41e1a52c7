# %% [markdown]
# # An accuracy you can trust
#
# Say how accurate the solution has to be, in which norm, and let the mesh follow. The package
# refines where the solution needs it, and tells its error in two ways: an *estimate* in any norm,
# and a *bound* of the energy error that is proven.
#
# The domain is an L: its corner makes the solution rough, which nobody has to know beforehand.

# %%
import dolfinx_signorini as ds

import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

comm = MPI.COMM_WORLD
square = dolfinx.mesh.create_rectangle(comm, [(-1.0, -1.0), (1.0, 1.0)], (8, 8))
kept = dolfinx.mesh.locate_entities(square, 2, lambda x: (x[0] <= 1e-9) | (x[1] <= 1e-9))
mesh = dolfinx.mesh.create_submesh(square, 2, kept)[0]


def on(axis: int, value: float) -> np.ndarray:
    """The facets of the boundary where a coordinate has a value."""
    return dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[axis], value))


# %% [markdown]
# ## How the problem is posed on any mesh
#
# The sides are handed over with the mesh, and are there again on every refinement of it.

# %%
sided = ds.SidedMesh(mesh, {"floor": on(1, -1.0), "wall": on(0, -1.0)})


def pose(sided: ds.SidedMesh) -> ds.SignoriniProblem:
    """Return the problem on a refinement of the first mesh."""
    V = fem.functionspace(sided.mesh, ("Lagrange", 2))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    wall = ds.dirichlet(V, sided.sides["wall"], 0.0)
    return ds.SignoriniProblem(
        a, -v * ufl.dx, contact=sided.sides["floor"], obstacle=-0.5, bcs=[wall]
    )


# %%
found = ds.solve_adaptively(pose, sided, norm="H1", accuracy=5e-3)
if comm.rank == 0:
    for step in found.steps:
        print(f"{step.unknowns:6d} unknowns, error about {step.estimate:.1e}")
    print(found.stopped)

# %% [markdown]
# ## The mesh, and the way to it
#
# Cells are small at the corner, at the ends of the wall, and where contact ends.

# %%
from dolfinx_signorini.accuracy.pictures import draw_adaptive

draw_adaptive(found)

# %% [markdown]
# ## A proven bound
#
# An estimate can be wrong; a bound cannot. `energy_bound` builds a flux that is in balance with the
# load on every cell, and its distance from the flux of the solution is more than the error. The
# equation is read from the forms of the problem, and its data on the wall are those of `dirichlet`.

# %%
bound = ds.energy_bound(found.problem)
if comm.rank == 0:
    print(f"the energy error is at most {bound.total:.2e}")
    print("this is proven" if not bound.sampled else "this is proven but for sampled data")

# %% [markdown]
# Other norms (`"Linf"`, `"W1_4"`, `"L2"`) and functionals of the solution work the same way:
# `norm=lambda u: u * ufl.dx` asks for the mean. `budget=10.0` in place of an accuracy asks for the
# best solution of ten seconds. How well the estimates hold is measured in *How accurate is it?*
