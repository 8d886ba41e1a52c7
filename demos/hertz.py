# %% [markdown]
# # Hertz: an elastic block against a round, rigid obstacle
#
# A block is pressed against a rigid cylinder of radius R. In 1882 Heinrich Hertz found the pressure
# between them: an ellipse over the width 2a of the contact, which is unknown at first. Here the
# unknown is a vector, the displacement, and the constraint is one for each point of the lower side:
# the displacement along the direction of the obstacle is not larger than the gap.
#
# Run it with `python3 demos/hertz.py`, or on two processes with `mpirun -n 2`.

# %%
import dolfinx_signorini as ds
from dolfinx_signorini.pictures.picture import Picture

import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

comm, n = MPI.COMM_WORLD, 64

# %% [markdown]
# ## What Hertz found
#
# In plane strain with the force F per length, and E* = E / (1 - ν²), the contact has the half width
# a = 2 √(R F / (π E*)), and the pressure is p0 √(1 - (x/a)²) with p0 = 2 F / (π a).

# %%
E, nu, R, F = 200.0, 0.3, 8.0, 10.0
a_hertz = 2.0 * np.sqrt(R * F * (1.0 - nu**2) / (np.pi * E))
p0 = 2.0 * F / (np.pi * a_hertz)

# %% [markdown]
# ## The displacement of a half-plane under this pressure
#
# Hertz's body is a half-plane, which no mesh has. The block is the part of the half-plane
# with |x| ≤ 2 and 0 ≤ y ≤ 2, whose left, right and upper sides get the displacement of the
# half-plane as Dirichlet data: the exact solution of the block is the one of the half-plane. The
# displacement follows from one analytic function, the potential of Kolosov and Muskhelishvili.


# %%
def half_plane(x):
    z = x[0] + 1j * np.maximum(x[1], 0.0)
    s = np.sqrt(z - a_hertz) * np.sqrt(z + a_hertz)
    slope = 0.5j * p0 / a_hertz * (s - z)
    potential = 0.25j * p0 / a_hertz * (z * s - a_hertz**2 * np.log(z + s) - z**2)
    w = (3.0 - 4.0 * nu) * potential - np.conj(potential) - 2j * z.imag * np.conj(slope)
    return np.stack([w.real, w.imag]) * (1.0 + nu) / E


# %% [markdown]
# ## The problem
#
# The space has vectors of two components, and `ds.elasticity` is the form of linear elasticity.
# The obstacle lies below, in the direction (0, -1): u·d ≤ g says that the lower side does not move
# further down than the parabola with the curvature 1/R, which is Hertz's approximation of the
# circle. The parabola stands as high as the pressed half-plane touches it.

# %%
mesh = dolfinx.mesh.create_rectangle(comm, [(-2.0, 0.0), (2.0, 2.0)], (2 * n, n))
V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)
bottom = dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], 0.0))
others = dolfinx.mesh.locate_entities_boundary(
    mesh, 1, lambda x: np.isclose(np.abs(x[0]), 2.0) | np.isclose(x[1], 2.0)
)
data = fem.Function(V)
data.interpolate(half_plane)
no_load = fem.Constant(mesh, (0.0, 0.0))
problem = ds.ContactProblem(
    ds.elasticity(u, v, young=E, poisson=nu),
    ufl.inner(no_load, v) * ufl.dx,
    contact=bottom,
    gap=(x[0] ** 2 + a_hertz**2 * np.log(a_hertz)) / (2.0 * R),
    direction=(0.0, -1.0),
    bcs=[fem.dirichletbc(data, fem.locate_dofs_topological(V, 1, others))],
)
u_h = problem.solve()

# %% [markdown]
# ## Force, pressure and contact
#
# `problem.force` is the force of the obstacle on the body, a vector. It has no component along the
# obstacle, as there is no friction. `problem.pressure` and `problem.gap` are scalar functions.

# %%
force = problem.force
owned = V.dofmap.index_map.size_local
points = V.tabulate_dof_coordinates()[:owned]
at = problem.contact_nodes
parts = comm.gather((points[at, 0], problem.pressure.x.array[at], problem.gap.x.array[at]))
if comm.rank == 0:
    along, pressure, gap = (np.concatenate(part) for part in zip(*parts, strict=True))
    order = np.argsort(along)
    along, pressure, gap = along[order], pressure[order], gap[order]
    half_width = np.abs(along[gap == 0.0]).max()
    print(f"{problem.unknowns} unknowns, {problem.result.linear_solves} linear solves")
    print(f"force upwards   {force[1]:8.4f}, Hertz {F:8.4f}")
    print(f"largest pressure{pressure.max():8.4f}, Hertz {p0:8.4f}")
    print(f"last node in contact at {half_width:.4f}, Hertz {a_hertz:.4f}, cells of {2.0 / n:.4f}")
    assert abs(force[0]) < 1e-6 * F and abs(force[1] / F - 1.0) < 1e-3
    assert abs(pressure.max() / p0 - 1.0) < 2e-3
    assert abs(half_width - a_hertz) < 2.0 / n

# %% [markdown]
# ## Picture: the pressure along the lower side
#
# The nodes are on the ellipse of Hertz, up to the ends of the contact. There the pressure has an
# infinite slope, which limits the order of the error in the energy norm to 3/2 for elements of
# degree 2; degree 1 has its full order 1.

# %%
picture = Picture(figsize=(7.0, 3.6))
if comm.rank == 0:
    axes = picture.subplots()
    fine = np.linspace(-1.2, 1.2, 1001)
    ellipse = p0 * np.sqrt(np.maximum(1.0 - (fine / a_hertz) ** 2, 0.0))
    axes.plot(fine, ellipse, color="black", lw=1.2, label="Hertz")
    near = np.abs(along) <= 1.2
    axes.plot(along[near], pressure[near], "o", ms=3.5, color="#0072B2", label="at the nodes")
    axes.set(xlabel="$x$", ylabel="pressure", xlim=(-1.2, 1.2), ylim=(0.0, 1.1 * p0))
    axes.legend(frameon=False)
    picture.savefig("hertz.png")
    print("picture: hertz.png")
picture

# %% [markdown]
# ## Picture: the deformed block
#
# The colours are the von Mises stress, which is largest inside of the block, above the middle of
# the contact. The displacement is drawn larger than it is, and so is the gap.

# %%
body = problem.plot("hertz_body.png", what="deformed", stress=ds.von_mises(problem.u, E, nu))
if comm.rank == 0:
    print("picture: hertz_body.png")
problem.destroy()
body
