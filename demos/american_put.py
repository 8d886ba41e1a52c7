# %% [markdown]
# # An American put: a time loop whose solution stays above the pay-off
#
# Who holds an American put may sell a share for the price K at any time up to the time T. The value
# u of the put is never below the pay-off max(K - S, 0), with the price S of the share now: else one
# would buy the put and sell the share at once. Where the value is above the pay-off, the equation
# of Black and Scholes holds. The price below which it is best to sell, the exercise boundary, is
# the free boundary of an obstacle problem in each time step.
#
# Run it with `python3 demos/american_put.py`, or on two processes with `mpirun -n 2`.

# %%
import itertools
import time

import dolfinx_signorini as ds
from dolfinx_signorini.pictures.picture import Picture

import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

comm, cells, steps = MPI.COMM_WORLD, 1600, 200
K, r, sigma, T = 40.0, 0.06, 0.2, 1.0

# %% [markdown]
# ## The equation, in a symmetric form
#
# With x = log(S / K) and the time t that is left, the equation is
#
#     du/dt = sigma²/2 d²u/dx² + (r - sigma²/2) du/dx - r u
#
# The first derivative has no symmetric form. But with the weight w = exp((2 r / sigma² - 1) x) the
# first two terms are sigma²/2 (w u')' / w, and the form of w u v is symmetric: a weight that is
# positive does not change who is above whom.

# %%
mesh = dolfinx.mesh.create_interval(comm, cells, (-2.0, 2.0))
V = fem.functionspace(mesh, ("Lagrange", 1))
trial, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)[0]
w = ufl.exp((2.0 * r / sigma**2 - 1.0) * x)
dx = ufl.Measure("dx", mesh, metadata={"quadrature_degree": 4})


def payoff(x):
    return np.maximum(K - K * np.exp(x[0]), 0.0)


def generator(u, v):
    return (0.5 * sigma**2 * w * u.dx(0) * v.dx(0) + r * w * u * v) * dx


# %% [markdown]
# ## One step
#
# The solution of the step before stands in the load. It is the function that the problem fills,
# given as `u`, and each `solve` makes one step: of the implicit Euler method with theta = 1, of
# Crank and Nicolson's with theta = 1/2. At both ends the value is the pay-off.

# %%
u = fem.Function(V)
u.interpolate(payoff)
ends = fem.locate_dofs_geometrical(V, lambda x: np.isclose(np.abs(x[0]), 2.0))
kept = fem.Function(V)
kept.interpolate(payoff)
dt, theta = fem.Constant(mesh, 1.0), fem.Constant(mesh, 1.0)
problem = ds.ObstacleProblem(
    w * trial * v * dx + dt * theta * generator(trial, v),
    w * u * v * dx - dt * (1.0 - theta) * generator(u, v),
    lower=payoff,
    bcs=[fem.dirichletbc(kept, ends)],
    u=u,
)

# %% [markdown]
# ## The loop
#
# The exercise boundary starts at K and falls like a root of the time at first, so the steps grow
# like 1, 3, 5, ... The first four are steps of Euler's method, which damps what the kink of the
# pay-off excites. The put is exercised where u is equal to the pay-off: at `problem.active`.

# %%
times, boundary, solves = T * np.linspace(0.0, 1.0, steps + 1) ** 2, [K], 0
log_price = V.tabulate_dof_coordinates()[:, 0]
start = time.perf_counter()
for step in range(1, steps + 1):
    dt.value, theta.value = times[step] - times[step - 1], 1.0 if step <= 4 else 0.5
    problem.solve()
    solves += problem.result.linear_solves
    exercised = log_price[problem.active]
    highest = comm.allreduce(exercised[exercised < 0.0].max(initial=-np.inf), MPI.MAX)
    boundary.append(K * np.exp(highest))
seconds = time.perf_counter() - start
problem.destroy()

# %% [markdown]
# ## Values from the literature
#
# The put is one of Longstaff and Schwartz (Review of Financial Studies 14, 2001, table 1), who
# allow exercise 50 times a year. With exercise at any time the values are a little higher: below
# are the digits of a binomial tree with many steps.

# %%
owned = V.dofmap.index_map.size_local
parts = comm.allgather((log_price[:owned], u.x.array[:owned]))
grid, value = (np.concatenate(part) for part in zip(*parts, strict=True))
order = np.argsort(grid)
known = {36: 4.4867, 38: 3.2572, 40: 2.3195, 42: 1.6213, 44: 1.1129}
if comm.rank == 0:
    print(f"{1e3 * seconds / steps:.1f} ms and {solves / steps:.2f} linear solves per step")
for price, expected in known.items():
    found = np.interp(np.log(price / K), grid[order], value[order])
    if comm.rank == 0:
        print(f"S = {price}: {found:.5f}, known {expected:.4f}")
    assert abs(found - expected) < 2e-4, (price, found, expected)

# %% [markdown]
# ## The exercise boundary
#
# A put without an end is exercised below 2 r K / (2 r + sigma²) = 30, and one with an end above
# that: the less time is left, the higher is the boundary.

# %%
assert boundary[-1] > 2.0 * r * K / (2.0 * r + sigma**2)
assert all(later <= before for before, later in itertools.pairwise(boundary))
picture = Picture(figsize=(9.0, 4.0))
left, right = picture.panels(1, 2)
left.step(T - times, boundary, color="#D55E00", lw=1.5)
left.fill_between(T - times, boundary, 28.0, color="#D55E00", alpha=0.15, step="pre")
left.axhline(30.0, color="black", ls="--", lw=0.8)
left.text(0.02, 30.2, "boundary of a put without an end")
left.text(0.35, 32.0, "exercise", color="#D55E00")
left.text(0.35, 37.5, "keep the put")
left.set(xlabel="time (years; the put ends at 1)", ylabel="price S of the share")
left.set(xlim=(0.0, 1.0), ylim=(28.0, 41.0))
prices = np.linspace(28.0, 52.0, 241)
value_now = np.interp(np.log(prices / K), grid[order], value[order])
right.plot(prices, np.maximum(K - prices, 0.0), "k--", lw=0.8, label="pay-off")
right.plot(prices, value_now, color="#0072B2", label="value one year before the end")
right.axvline(boundary[-1], color="#D55E00", lw=1.0, label="exercise boundary")
right.set(xlabel="price S of the share", ylabel="value of the put", xlim=(28.0, 52.0))
right.legend(frameon=False)
if comm.rank == 0:
    picture.savefig("american_put.png")
    print("picture: american_put.png")
picture
