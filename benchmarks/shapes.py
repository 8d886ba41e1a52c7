"""Geometries of gmsh for the benchmarks on meshes that have no coarser levels."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gmsh
import numpy as np
from mpi4py import MPI

from dolfinx_signorini.base.compat import gmsh_mesh


@dataclass(frozen=True)
class Shape:
    """A geometry of gmsh with sizes of cells.

    Attributes:
        draw: Draws the geometry, and returns the function of the sizes or None.
        dimension: Of space.
        size: Of the cells.
        degree: Of the elements.
    """

    draw: Callable[[], Callable[[float, float, float], float] | None]
    dimension: int
    size: float
    degree: int = 1


def _plate(holes: list[tuple[float, float, float]], width: float = 2.0) -> Callable[[], None]:
    def draw() -> None:
        occ = gmsh.model.occ
        body = [(2, occ.addRectangle(0.0, 0.0, 0.0, width, 1.0))]
        cut = [(2, occ.addDisk(x, y, 0.0, r, r)) for x, y, r in holes]
        if cut:
            occ.cut(body, cut)

    return draw


def _airfoil() -> Callable[[float, float, float], float]:
    """A box around a thick symmetric profile, with small cells at its nose."""
    occ, t = gmsh.model.occ, 0.18
    xs = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, 24)))
    half = (
        5.0
        * t
        * (0.2969 * np.sqrt(xs) - 0.126 * xs - 0.3516 * xs**2 + 0.2843 * xs**3 - 0.1036 * xs**4)
    )
    upper = [occ.addPoint(x, y, 0.0) for x, y in zip(xs, half, strict=True)]
    lower = [occ.addPoint(x, -y, 0.0) for x, y in zip(xs[1:-1], half[1:-1], strict=True)]
    curves = [occ.addSpline(upper), occ.addSpline([upper[0], *lower, upper[-1]])]
    profile = occ.addPlaneSurface([occ.addCurveLoop(curves)])
    occ.cut([(2, occ.addRectangle(-1.0, -1.0, 0.0, 3.0, 2.0))], [(2, profile)])
    return lambda x, y, z: 0.15 + min(math.hypot(x, y), 1.5)


def _graded() -> Callable[[float, float, float], float]:
    gmsh.model.occ.addRectangle(0.0, 0.0, 0.0, 1.0, 1.0)
    return lambda x, y, z: 0.04 + y


def _ball_cut_out() -> None:
    occ = gmsh.model.occ
    occ.cut([(3, occ.addBox(0, 0, 0, 1, 1, 1))], [(3, occ.addSphere(0.55, 0.5, 0.45, 0.3))])


def _bracket() -> None:
    occ = gmsh.model.occ
    occ.fuse([(3, occ.addBox(0, 0, 0, 1, 0.3, 1))], [(3, occ.addBox(0, 0, 0, 1, 1, 0.3))])


def _cube() -> None:
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)


def _cube_graded() -> Callable[[float, float, float], float]:
    _cube()
    return lambda x, y, z: 0.3 + z


SHAPES = {
    "plate, one hole": Shape(_plate([(0.7, 0.45, 0.2)]), 2, 0.0037),
    "plate, five holes": Shape(
        _plate(
            [
                (0.3, 0.3, 0.1),
                (0.8, 0.7, 0.15),
                (1.1, 0.25, 0.12),
                (1.6, 0.6, 0.2),
                (0.4, 0.75, 0.08),
            ]
        ),
        2,
        0.0042,
    ),
    "airfoil": Shape(_airfoil, 2, 0.008),
    "graded to a side": Shape(_graded, 2, 0.006),
    "plate, a million": Shape(_plate([(1.3, 0.5, 0.25)]), 2, 0.00155),
    "plate, two holes, P2": Shape(_plate([(0.5, 0.5, 0.2), (1.5, 0.4, 0.15)]), 2, 0.0085, 2),
    "ball cut out": Shape(_ball_cut_out, 3, 0.026),
    "L-shaped solid": Shape(_bracket, 3, 0.018),
    "thin plate": Shape(lambda: gmsh.model.occ.addBox(0, 0, 0, 1, 1, 0.06) and None, 3, 0.0105),
    "cube, graded, P2": Shape(_cube_graded, 3, 0.062, 2),
}
# Shapes that settings were tried on.
TRIED = {
    "plate": Shape(_plate([(1.0, 0.5, 0.25)]), 2, 0.0037),
    "cube": Shape(_cube, 3, 0.026),
    "plate, P2": Shape(_plate([(1.0, 0.5, 0.25)]), 2, 0.0085, 2),
    "cube, P2": Shape(_cube, 3, 0.058, 2),
}


def mesh_of(comm: MPI.Comm, shape: Shape, factor: float) -> Any:
    """Mesh a shape by gmsh, on rank 0."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Verbosity", 1)
    gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
    size = shape.size * factor
    if comm.rank == 0:
        sizes = shape.draw()
        gmsh.model.occ.synchronize()
        if sizes is not None:
            gmsh.model.mesh.setSizeCallback(lambda d, t, x, y, z, lc: size * sizes(x, y, z))
        gmsh.option.setNumber("Mesh.MeshSizeMax", size if sizes is None else 1.0)
        gmsh.model.addPhysicalGroup(
            shape.dimension, [tag for _, tag in gmsh.model.getEntities(shape.dimension)], 1
        )
        gmsh.model.mesh.generate(shape.dimension)
    domain, *_ = gmsh_mesh(gmsh.model, comm, shape.dimension)
    gmsh.finalize()
    return domain
