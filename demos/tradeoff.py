# %% [markdown]
# # How much accuracy does this much time buy?
#
# The paper's problem on uniform, graded and adapted meshes, with elements of degrees 1 to 4.
#
# Run it with `python3 demos/tradeoff.py`, or on two processes with `mpirun -n 2`.

# %%
from dolfinx_signorini.accuracy.adaptive import found_lines, solve_adaptively
from dolfinx_signorini.accuracy.steps import step_line
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.studies.paper.solution import paper_family
from dolfinx_signorini.studies.tradeoff.family import GRADED_P2, GRADED_P4, UNIFORM_P1, UNIFORM_P2
from dolfinx_signorini.studies.tradeoff.runs import Configuration, Run, levels

from mpi4py import MPI

comm = MPI.COMM_WORLD
problem = paper_family(detachment=(0.47123, 0.0))


def show(configuration: Configuration) -> None:
    """Solve as the configuration says, and print what it cost and gave."""
    run = Run(comm, problem, configuration)
    assert run.posed.exact is not None
    errors = error_norms(run.u, run.posed.exact, ["L4", "W1_4", "W1_inf"])
    if comm.rank == 0:
        figures = "  ".join(f"{norm} {error:.2e}" for norm, error in errors.items())
        print(
            f"{configuration!s:21s}{run.unknowns:6d} unknowns {run.total_seconds:6.2f} s  {figures}"
        )
        for point in run.points:
            print(f"    graded towards x = {point.position[0]:.6f} +- {point.uncertainty:.1e}")
    run.destroy()


# %% [markdown]
# ## Uniform meshes
#
# The solution detaches from the obstacle at (0.47123, 0), and behaves like r^(3/2) there. This
# point dominates the largest error of the gradient, `W1_inf`: P1 elements halve this error with
# four times as many cells per side, which are sixteen times as many unknowns.

# %%
for n in (25, 51, 101):
    show(Configuration(UNIFORM_P1, n))

# %% [markdown]
# P2 elements gain much in `L4`, and little where the gradient is most wrong.

# %%
for n in (26, 52):
    show(Configuration(UNIFORM_P2, n))

# %% [markdown]
# ## Graded meshes
#
# Graded meshes have small cells at the detachment point. Nobody has to know this point: solutions
# on coarser meshes find it, each one more precisely than the one before. The first ones find it up
# to an edge of the mesh; the later ones extrapolate the zero of the gap from points where the gap
# is accurate.

# %%
if comm.rank == 0:
    print("cells across on the coarse levels for N = 48:", levels(Configuration(GRADED_P2, 48)))
for kind in (GRADED_P2, GRADED_P4):
    for n in (24, 48):
        show(Configuration(kind, n))

# %% [markdown]
# ## One dial
#
# Nobody has to choose a mesh, either. For a given accuracy the adaptive loop refines a coarse mesh
# where the solution needs it, and estimates the error from the solutions on its meshes: the loop is
# not told the solution.

# %%
found = solve_adaptively(
    lambda sided: problem.pose(sided, 2).problem,
    problem.make(comm, 4),
    norm="W1_inf",
    accuracy=0.2,
)
if comm.rank == 0:
    print(*map(step_line, found.steps), sep="\n")
    for name, text in found_lines(found):
        print(f"{name}: {text}")
found.problem.destroy()
