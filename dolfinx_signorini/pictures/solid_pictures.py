"""Pictures of a solution on the surface of a solid, by PyVista where that is installed.

PyVista draws in a process of its own, off screen: where no display can be opened VTK ends its
process, and the picture is then drawn by matplotlib.
"""

import os
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from shutil import which
from typing import cast

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from mpl_toolkits.mplot3d import Axes3D

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.compiled import LONGEST
from dolfinx_signorini.pictures.contact_boundary import ContactBoundary
from dolfinx_signorini.pictures.contact_pictures import draw_faces
from dolfinx_signorini.pictures.palette import COLOUR_MAP
from dolfinx_signorini.pictures.picture import Picture
from dolfinx_signorini.pictures.triangles import Triangles

RENDERER = Path(__file__).with_name("solid_rendering.py")
EMPTY = 0.02  # of the pixels; an image with fewer that are not white shows nothing


def draw_solid(
    surface: Triangles, contact: ContactBoundary | None = None, title: str = ""
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
        figure = Picture(figsize=(7.6, 6.0))
        axes = figure.add_subplot()
        axes.imshow(_cropped(image))
        axes.set_axis_off()
        scale = Normalize(surface.values.min(), surface.values.max())
        colours = ScalarMappable(scale, COLOUR_MAP)
    else:
        figure = Picture(figsize=(7.6, 5.4))
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


def view_of(surface: Triangles, contact: ContactBoundary | None) -> Array:
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


def _render(surface: Triangles, view: Array) -> Array | None:
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
            subprocess.run(command, env=kept, capture_output=True, timeout=LONGEST, check=True)
            pixels = np.load(image)
        except (OSError, ValueError, subprocess.SubprocessError):
            return None
    return pixels if (pixels < 255).any(axis=2).mean() > EMPTY else None
