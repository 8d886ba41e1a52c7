"""Pictures of a solution on the surface of a solid, by PyVista where that is installed.

PyVista draws in a process of its own, off screen: where no display can be opened VTK ends its
process, and the picture is then drawn by matplotlib.
"""

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from shutil import which
from typing import cast

import numpy as np
from dolfinx import fem
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from mpl_toolkits.mplot3d import Axes3D

from dolfinx_signorini.base.arrays import Array, Indices
from dolfinx_signorini.meshes.elements import control_points, facet_pieces
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, facet_cells
from dolfinx_signorini.pictures.contact_boundary import ContactBoundary
from dolfinx_signorini.pictures.contact_pictures import draw_faces
from dolfinx_signorini.pictures.palette import COLOUR_MAP
from dolfinx_signorini.pictures.picture import Picture

RENDERER = Path(__file__).with_name("solid_rendering.py")
PATIENCE = 60.0  # seconds for PyVista
EMPTY = 0.02  # of the pixels; an image with fewer that are not white shows nothing


@dataclass(frozen=True)
class Surface:
    """A function on the boundary of a solid, as triangles.

    A solved problem in space gives one, on rank 0:

        surface = gather_surface(problem.u)
        if surface is not None:
            draw_solid(surface).savefig("solid.png")

    Attributes:
        points: Coordinates of the vertices, shape (points, 3).
        values: The values at the vertices.
        triangles: Indices of points, shape (triangles, 3).
    """

    points: Array
    values: Array
    triangles: Indices


def gather_surface(u: fem.Function) -> Surface | None:
    """Return a function on the boundary of its mesh of tetrahedra on rank 0, None on the others.

    Args:
        u: The function, in Lagrange elements; the call is collective.
    """
    space = u.function_space
    domain, index_map = space.mesh, space.dofmap.index_map
    facets = boundary_facets(domain)
    pairs = facet_cells(domain, facets[facets < domain.topology.index_map(2).size_local])
    local, _ = facet_pieces(space, pairs)
    used = np.unique(local)
    data = (
        index_map.local_to_global(used),
        control_points(space)[used],
        u.x.array[used],
        index_map.local_to_global(local.flatten()).reshape(-1, 3),
    )
    parts = domain.comm.gather(data, root=0)
    if parts is None:
        return None
    numbers, points, values, triangles = (np.concatenate(item) for item in zip(*parts, strict=True))
    numbers, first = np.unique(numbers, return_index=True)
    return Surface(points[first], values[first], np.searchsorted(numbers, triangles))


def draw_solid(
    surface: Surface, contact: ContactBoundary | None = None, title: str = ""
) -> Picture:
    """Return a picture of a function on the boundary of a solid.

    Args:
        surface: The boundary.
        contact: The contact boundary, which the picture shows from where most of it is seen.
        title: The title of the picture.
    """
    view = view_of(surface, contact)
    image = _render(surface, view)
    colours: ScalarMappable
    if image is not None:
        figure = Picture(figsize=(7.6, 6.0), layout="constrained")
        axes = figure.add_subplot()
        axes.imshow(_cropped(image))
        axes.set_axis_off()
        scale = Normalize(surface.values.min(), surface.values.max())
        colours = ScalarMappable(scale, COLOUR_MAP)
    else:
        figure = Picture(figsize=(7.6, 5.4), layout="constrained")
        axes = figure.add_subplot(projection="3d")
        values = surface.values[surface.triangles].mean(axis=1)
        faces = draw_faces(axes, surface.points[surface.triangles], values)
        faces.set_edgecolor((0.0, 0.0, 0.0, 0.15))
        azimuth = np.degrees(np.arctan2(view[1], view[0])) + 10.0
        cast(Axes3D, axes).view_init(elev=30.0 * view[2], azim=azimuth)
        colours = faces
    figure.colorbar(colours, ax=axes, label="solution $u$", shrink=0.7, pad=0.1)
    axes.set_title(title, parse_math=False)
    return figure


def view_of(surface: Surface, contact: ContactBoundary | None) -> Array:
    """Return the direction from a solid to the eye, -1 or 1 along each axis: where contact is.

    Args:
        surface: The boundary of the solid.
        contact: The contact boundary.
    """
    view = np.ones(3)
    if contact is not None and len(contact.pieces):
        low, high = surface.points.min(axis=0), surface.points.max(axis=0)
        middle = contact.points[contact.pieces].mean(axis=(0, 1))
        view[middle < low + 0.4 * (high - low)] = -1.0
    return view


def _cropped(image: Array) -> Array:
    """Return an image without its white margins."""
    rows, columns = np.nonzero((image < 255).any(axis=2))
    return image[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]


def _render(surface: Surface, view: Array) -> Array | None:
    """Return the image that PyVista makes, shape (height, width, 3); None where none comes out."""
    if find_spec("pyvista") is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        data, image = Path(folder) / "surface.npz", Path(folder) / "image.npy"
        np.savez(data, view=view, **vars(surface))
        # The process is none of MPI's.
        kept = {k: v for k, v in os.environ.items() if not k.startswith(("OMPI_", "PMIX_"))}
        command = [sys.executable, str(RENDERER), str(data), str(image)]
        if not kept.get("DISPLAY") and which("xvfb-run"):
            command = ["xvfb-run", "-a", *command]
        try:
            subprocess.run(command, env=kept, capture_output=True, timeout=PATIENCE, check=True)
            pixels = np.load(image)
        except (OSError, ValueError, subprocess.SubprocessError):
            return None
    return pixels if (pixels < 255).any(axis=2).mean() > EMPTY else None
