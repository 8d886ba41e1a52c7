"""Pictures of the paper: solution and load, convergence, and the bottom edge."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import basix
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.norms.manufactured import ManufacturedSolution
from dolfinx_signorini.norms.orders import expected_order
from dolfinx_signorini.norms.references import interpolant
from dolfinx_signorini.pictures.palette import COLOURS
from dolfinx_signorini.pictures.picture import Picture, add_curve, name_cells, typeset_norm
from dolfinx_signorini.pictures.triangles import gather_triangles
from dolfinx_signorini.studies.paper.sampling import PAPER_NAMES
from dolfinx_signorini.studies.paper.solution import (
    DETACHMENT,
    PAPER_RULE,
    christof_haubner,
    paper_problem,
)
from dolfinx_signorini.studies.paper.theory.boundary import BoundaryCurve


@dataclass(frozen=True)
class PaperPicture:
    """Nodal values of the paper's problem on one mesh, gathered on rank 0.

    The pictures of one solution are drawn from the same values:

        picture = paper_picture(comm, 101)
        if picture is not None:
            draw_bottom_edge(picture).save(Path("bottom_edge"))

    Attributes:
        n: Cells per side.
        u: The exact solution on the grid, shape (n + 1, n + 1), first index y.
        load: The load on the grid.
        u_h: The discrete solution on the grid.
        pressure: Density of the contact pressure on the bottom edge, shape (n + 1,).
        edge: On the bottom edge x, the exact u and the exact pressure du/dn, at the points of the
            paper's rule on each edge of the mesh, shape (3, points).
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
    grids, edge = [_grid(field, n) for field in fields], _exact_on_edge(exact, problem.space, n)
    if comm.rank:
        return None
    u, load, u_h, density = grids
    return PaperPicture(n, u, load, u_h, density[0], edge)


def draw_solution_and_load(picture: PaperPicture) -> Picture:
    """Draw the solution and the load as surfaces, like Fig. 2 of Christof and Haubner."""
    figure = Picture(figsize=(10, 4.4))
    x = np.linspace(0.0, 1.0, picture.n + 1)
    grid = np.meshgrid(x, x)
    for place, (values, name) in enumerate(
        ((picture.u, "solution $u$"), (picture.load, "load $f$"))
    ):
        axes: Any = figure.add_subplot(1, 2, place + 1, projection="3d")
        axes.plot_surface(*grid, values, cmap="viridis", rcount=80, ccount=80, linewidth=0)
        axes.set(title=name, xlabel="$x_1$", ylabel="$x_2$")
        axes.view_init(elev=28, azim=-122)
    return figure


def draw_convergence(rows: Sequence[Mapping[str, Any]], norms: Sequence[str]) -> Picture:
    """Draw the errors of a study against the cells per side, with the orders of the theory.

    Args:
        rows: Rows with "n" and "errors".
        norms: Norms to draw.
    """
    figure = Picture(figsize=(7.2, 5.6))
    (axes,) = figure.panels()
    n = [row["n"] for row in rows]
    for i, norm in enumerate(norms):
        name = PAPER_NAMES.get(norm, norm)
        order = expected_order(name)
        label = typeset_norm(name) + ("" if order is None else f", order {order:g}")
        add_curve(axes, n, [row["errors"][norm] for row in rows], label, i, order)
    name_cells(axes, n)
    axes.set_ylabel("error $u - u_h$")
    title = "markers: measured\nlines: theory"
    axes.legend(title=title, loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


def draw_bottom_edge(picture: PaperPicture) -> Picture:
    """Draw solution and contact pressure along the bottom edge, with the detachment point."""
    figure = Picture(figsize=(7.2, 5.6))
    above, below = figure.panels(2, sharex=True)
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
        axes.legend()
    below.set_xlabel("$x_1$ on the bottom edge, $x_2 = 0$")
    return figure


def _exact_on_edge(exact: ManufacturedSolution, space: fem.FunctionSpace, n: int) -> Array:
    """Return x, u and du/dn of the exact solution on the bottom edge, at the points of a rule."""
    curve, (t, _) = BoundaryCurve(space), PAPER_RULE.points(basix.CellType.interval)
    values = curve.samples([exact.u, -exact.grad[1]], t[:, 0])[:n]
    x = curve.s[:n, None] + curve.widths[:n, None] * t[:, 0]
    return np.asarray(np.concatenate([x[:, :, None], values], axis=2).reshape(-1, 3).T)


def _grid(function: fem.Function, n: int) -> Array:
    """Gather the nodal values of a Friedrichs-Keller mesh on rank 0, first index y."""
    grid, drawn = np.zeros((n + 1, n + 1)), gather_triangles(function)
    if drawn is not None:
        i = np.rint(drawn.points * n).astype(int)
        grid[i[:, 1], i[:, 0]] = drawn.values
    return grid
