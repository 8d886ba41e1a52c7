# %% [markdown]
# # A convergence study with your own exact solution
#
# How fast does the error fall when the mesh is refined? For an answer the exact solution has to be
# known. Choose one, and let the package make load, obstacle and data that belong to it.
#
# The solution here bends upwards from the right half of the lower edge, and rests on the left half:
# u = -r^(3/2) sin(3θ/2) about the point (1/2, 0), where contact ends. No solution of a Signorini
# problem in the plane detaches more smoothly, however smooth its data are.

# %%
import dolfinx_signorini as ds
from dolfinx_signorini.norms.orders import eoc, expected_order
from dolfinx_signorini.norms.references import interpolant
from dolfinx_signorini.pictures.picture import Picture

import numpy as np
import ufl
from dolfinx import fem, mesh
from matplotlib.figure import Figure
from mpi4py import MPI

comm = MPI.COMM_WORLD
NORMS = ["L2", "Linf", "H1", "W1_4", "W1_inf"]


def solution(x: ufl.SpatialCoordinate) -> ufl.core.expr.Expr:
    """The solution as an expression of the coordinates."""
    r = ufl.sqrt((x[0] - 0.5) ** 2 + x[1] ** 2)
    return -(r**1.5) * ufl.sin(1.5 * ufl.atan2(x[1], x[0] - 0.5))


# %% [markdown]
# ## One mesh
#
# `ds.manufacture` differentiates the solution: `exact.load` is -Δu and `exact.flux` the flux
# through the boundary. The solution lies on the obstacle 0 where x < 1/2, pressed by its flux.

# %%


def errors(n: int) -> dict[str, float]:
    """Solve on n cells per side, and return the error in each norm."""
    domain = ds.friedrichs_keller(comm, n)
    V = fem.functionspace(domain, ("Lagrange", 1))
    exact = ds.manufacture(domain, solution(ufl.SpatialCoordinate(domain)))
    edges = mesh.locate_entities_boundary(domain, 1, lambda x: x[1] > -1.0)
    bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    others = interpolant(V, exact.u)
    dofs = fem.locate_dofs_topological(V, 1, np.setdiff1d(edges, bottom))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    L = fem.Constant(domain, 0.0) * v * ufl.dx  # u is harmonic
    problem = ds.SignoriniProblem(a, L, contact=bottom, bcs=[fem.dirichletbc(others, dofs)])
    found = ds.error_norms(problem.solve(), exact, NORMS)
    problem.destroy()
    return found


# %% [markdown]
# ## The table
#
# `eoc` is the experimental order of convergence between one mesh and the next, and
# `expected_order` what the theory of Christof and Haubner (2020) promises.

# %%
cells = [8, 16, 32, 64]
rows = [errors(n) for n in cells]
widths = [1.0 / n for n in cells]
orders = {norm: eoc(widths, [row[norm] for row in rows]) for norm in NORMS}
if comm.rank == 0:
    print("norm    " + "".join(f"{f'N = {n}':>11}" for n in cells) + "   order  theory")
    for norm in NORMS:
        line = "".join(f"{row[norm]:11.2e}" for row in rows)
        print(f"{norm:8}{line}{orders[norm][-1]:8.2f}{expected_order(norm):8.2f}")

# %%


def draw() -> Figure:
    """Draw the errors over the width of the cells."""
    figure = Picture(figsize=(6.4, 4.2))
    axes = figure.subplots()
    for norm, marker in zip(NORMS, "osD^v", strict=True):
        axes.loglog(widths, [row[norm] for row in rows], marker=marker, label=norm)
    axes.set(xlabel="cell width $h$", ylabel="error $u - u_h$")
    axes.grid(alpha=0.3, which="both")
    axes.legend(frameon=False)
    return figure


draw()

# %% [markdown]
# ## Does the chosen solution obey the contact conditions?
#
# A solution that penetrates the obstacle or is pulled by it is no solution, and a convergence study
# with it measures nothing. `contact_violations` says which condition fails, where, and by how much:
# here none for u, and the sign of the pressure for -u.

# %%
from dolfinx_signorini.norms.manufactured import contact_violations

domain = ds.friedrichs_keller(comm, 16)
bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
for sign in (1.0, -1.0):
    w = ds.manufacture(domain, sign * solution(ufl.SpatialCoordinate(domain)))
    found = contact_violations(domain, bottom, w.u, w.flux, 0.0)
    if comm.rank == 0:
        print(f"{sign:+.0f} u:", *(found or ["obeys all conditions"]), sep="\n   ")
