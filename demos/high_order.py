# %% [markdown]
# # High order: when it pays
#
# Elements of degree 2 to 4 need far fewer unknowns for the same error where the solution is smooth,
# and a mesh that is graded towards the detachment point keeps this gain where the solution is not
# smooth. On a uniform mesh the point r^(3/2) limits every degree.

# %%
from pathlib import Path

import dolfinx_signorini as ds
from dolfinx_signorini.scenes.files.reading import parse_scene

from mpi4py import MPI

comm = MPI.COMM_WORLD
TEXT = """
[domain]
shape = "square"
cells = 16

[define]
a = "x - 0.5"
r = "hypot(a, y)"

[contact]
sides = "bottom"
obstacle = 0

[[dirichlet]]
sides = ["left", "right", "top"]

[solution]
u = "-r^1.5 * sin(1.5*atan2(y, a))"
manufactured = true
norms = ["L2", "Linf", "H1"]
"""

# %% [markdown]
# ## Uniform meshes
#
# A scene is a problem as text. Any key can be overridden, here `degree` and `domain.cells`.

# %%
from dolfinx_signorini.norms.error_norms import error_norms


def solved(*overrides: str) -> tuple[int, dict[str, float]]:
    """Solve the scene with some keys overridden; return unknowns and errors."""
    scene = parse_scene(TEXT, Path("high_order.toml"), comm, overrides)
    result = ds.solve_scene(scene, comm)
    errors = error_norms(result.u, result.posed.exact, scene.norms)
    unknowns = result.posed.problem.unknowns
    result.destroy()
    return unknowns, errors


if comm.rank == 0:
    print("degree  cells  unknowns        L2      Linf        H1")
for degree in (1, 2, 3):
    for cells in (16, 32, 64):
        unknowns, errors = solved(f"degree={degree}", f"domain.cells={cells}")
        if comm.rank == 0:
            line = "".join(f"{errors[norm]:10.1e}" for norm in ("L2", "Linf", "H1"))
            print(f"{degree:6d}{cells:7d}{unknowns:10d}{line}")

# %% [markdown]
# ## Adapted meshes
#
# Where an accuracy is asked for, the mesh is graded by itself, and the full order is back: compare
# the unknowns with those above. Without `degree` the loop chooses one of 2 to 4.

# %%
for degree in (1, 2, 3):
    scene = parse_scene(TEXT, Path("high_order.toml"), comm)
    result = ds.solve_scene(scene, comm, accuracy=5e-3, norm="H1", degree=degree)
    true = error_norms(result.u, result.posed.exact, ["H1"])["H1"]
    if comm.rank == 0:
        print(
            f"degree {degree}: {result.posed.problem.unknowns} unknowns, "
            f"estimated {result.found.estimate:.1e}, true {true:.1e}"
        )
    if degree < 3:
        result.destroy()

# %%
result.plot()

# %% [markdown]
# ## Where the constraint holds
#
# Scenes of degree 2 and more use the Bernstein basis: coefficients that are not below those of
# the obstacle keep the whole polynomial above the obstacle, and not only at nodes. In a script of
# your own `ds.bernstein_space(mesh, degree)` is such a space. In `("Lagrange", 2)` the constraint
# holds at vertices and edge midpoints, and between them u may fall below the obstacle, by as much
# as the mesh leaves. Which degree is the cheapest is measured in *Speed against accuracy*.
