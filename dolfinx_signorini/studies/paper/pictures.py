"""Pictures of the paper: solution and load, convergence, and the bottom edge."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import fem, mesh
from matplotlib.figure import Figure
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.elements import control_points
from dolfinx_signorini.norms.orders import expected_order
from dolfinx_signorini.norms.references import interpolant
from dolfinx_signorini.pictures.palette import COLOURS, MARKERS
from dolfinx_signorini.pictures.picture import typeset_norm
from dolfinx_signorini.studies.paper.sampling import PAPER_NAMES
from dolfinx_signorini.studies.paper.solution import DETACHMENT, christof_haubner, paper_problem

EDGE_POINTS = 2000  # of the exact solution on the bottom edge


@dataclass(frozen=True)
class PaperPicture:
    """Nodal values of the paper's problem on one mesh, gathered on rank 0.

    The pictures of one solution are drawn from the same values:

        picture = paper_picture(comm, 101)
        if picture is not None:
            save(draw_bottom_edge(picture), Path("bottom_edge"))

    Attributes:
        n: Cells per side.
        u: The exact solution on the grid, shape (n + 1, n + 1), first index y.
        load: The load on the grid.
        u_h: The discrete solution on the grid.
        pressure: Density of the contact pressure on the bottom edge, shape (n + 1,).
        edge: On the bottom edge x, the exact u and the exact pressure du/dn, at points that do not
            depend on the mesh, shape (3, points).
    """

    n: int
    u: Array
    load: Array
    u_h: Array
    pressure: Array
    edge: Array


def paper_picture(comm: MPI.Comm, n: int) -> PaperPicture | None:
    """Solve the paper's problem on one mesh and gather what the pictures show.

    Args:
        comm: The communicator that shares the mesh.
        n: Cells per side.

    Returns:
        The values on rank 0, None on the others.
    """
    exact = christof_haubner(friedrichs_keller(comm, n))
    problem = paper_problem(exact)
    fields = [interpolant(problem.space, expression) for expression in (exact.u, exact.load)]
    fields += [problem.solve(), problem.pressure]
    problem.destroy()
    grids = [_grid(field, n) for field in fields]
    if comm.rank:
        return None
    u, load, u_h, density = grids
    return PaperPicture(n, u, load, u_h, density[0], _exact_on_edge())


def draw_solution_and_load(picture: PaperPicture) -> Figure:
    """Draw the solution and the load as surfaces, like Fig. 2 of Christof and Haubner."""
    figure = plt.figure(figsize=(10, 4.4))
    x = np.linspace(0.0, 1.0, picture.n + 1)
    grid = np.meshgrid(x, x)
    for place, (values, name) in enumerate(
        ((picture.u, "solution $u$"), (picture.load, "load $f$"))
    ):
        axes: Any = figure.add_subplot(1, 2, place + 1, projection="3d")
        axes.plot_surface(*grid, values, cmap="viridis", rcount=80, ccount=80, linewidth=0)
        axes.set(title=name, xlabel="$x_1$", ylabel="$x_2$")
        axes.view_init(elev=28, azim=-122)
    figure.tight_layout()
    return figure


def draw_convergence(rows: Sequence[Mapping[str, Any]], norms: Sequence[str]) -> Figure:
    """Draw the errors of a study against the cells per side, with the orders of the theory.

    Args:
        rows: Rows with "n" and "errors".
        norms: Norms to draw.
    """
    figure, axes = plt.subplots(figsize=(7.2, 5.6))
    n = np.array([row["n"] for row in rows], dtype=float)
    for i, norm in enumerate(norms):
        errors = np.array([row["errors"][norm] for row in rows])
        colour = COLOURS[i % len(COLOURS)]
        name = PAPER_NAMES.get(norm, norm)
        order = expected_order(name)
        label = typeset_norm(name) + ("" if order is None else f", order {order:g}")
        axes.loglog(n, errors, MARKERS[i % len(MARKERS)], color=colour, label=label)
        if order is not None:
            axes.loglog(n, errors[-1] * (n / n[-1]) ** -order, color=colour, linewidth=0.9)
    axes.set(xlabel="cells per side N", ylabel="error $u - u_h$")
    ticks = [n[-1]]
    for value in n[-2::-1]:
        if ticks[-1] >= 1.2 * value:  # closer labels would overlap
            ticks.append(value)
    axes.set_xticks(ticks, [f"{value:.0f}" for value in ticks], minor=False)
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    title = "markers: measured\nlines: theory"
    axes.legend(title=title, loc="center left", bbox_to_anchor=(1, 0.5))
    figure.tight_layout()
    return figure


def draw_bottom_edge(picture: PaperPicture) -> Figure:
    """Draw solution and contact pressure along the bottom edge, with the detachment point."""
    figure, (above, below) = plt.subplots(2, 1, figsize=(7.2, 5.6), sharex=True)
    x = np.linspace(0.0, 1.0, picture.n + 1)
    dots: dict[str, Any] = {"marker": ".", "linestyle": "", "color": COLOURS[1], "markersize": 4}
    points, exact, flux = picture.edge
    above.plot(points, exact, color=COLOURS[0], label="exact $u$")
    above.plot(x, picture.u_h[0], label=f"$u_h$, N = {picture.n}", **dots)
    below.plot(points, flux, color=COLOURS[0], label=r"exact $\partial_n u$")
    below.plot(x, picture.pressure, label=r"pressure of $u_h$", **dots)
    for axes, name in ((above, "solution"), (below, "contact pressure")):
        axes.axvline(DETACHMENT[0], color="black", linestyle=":", label="detachment point")
        axes.set_ylabel(name)
        axes.grid(alpha=0.3)
        axes.legend()
    below.set_xlabel("$x_1$ on the bottom edge, $x_2 = 0$")
    figure.tight_layout()
    return figure


def _exact_on_edge() -> Array:
    """Return x, u and du/dn of the exact solution on the bottom edge, in this process alone."""
    strip = mesh.create_rectangle(
        MPI.COMM_SELF, [(0.0, 0.0), (1.0, 1.0 / EDGE_POINTS)], (EDGE_POINTS, 1)
    )
    exact = christof_haubner(strip)
    space = fem.functionspace(strip, ("Lagrange", 1))
    x, y = control_points(space).T[:2]
    bottom = np.flatnonzero(y == 0.0)
    bottom = bottom[np.argsort(x[bottom])]
    fields = (interpolant(space, expression) for expression in (exact.u, -exact.grad[1]))
    return np.array([x[bottom], *(field.x.array[bottom] for field in fields)])


def _grid(function: fem.Function, n: int) -> Array:
    """Gather the nodal values of a Friedrichs-Keller mesh on rank 0, first index y."""
    space = function.function_space
    owned = space.dofmap.index_map.size_local
    x = control_points(space)[:owned]
    parts = space.mesh.comm.gather((x, function.x.array[:owned]), root=0)
    grid = np.zeros((n + 1, n + 1))
    for points, values in parts or ():
        i = np.rint(points * n).astype(int)
        grid[i[:, 1], i[:, 0]] = values
    return grid
