"""The program that draws a surface with PyVista, in a process without MPI: see `solid_pictures`.

Run: python3 solid_rendering.py SURFACE.npz IMAGE.npy
"""

import sys

COLOUR_MAP = "cividis"  # as in `palette`, which this program does without


def render(data: str, image: str) -> None:
    """Draw the surface in a file, and save the pixels.

    Args:
        data: A file of NumPy with points, values and triangles.
        image: Where the pixels go.
    """
    import numpy as np
    import pyvista

    surface = np.load(data)
    triangles = surface["triangles"]
    faces = np.column_stack((np.full(len(triangles), 3), triangles)).ravel()
    mesh = pyvista.PolyData(surface["points"], faces)
    mesh["u"] = surface["values"]
    plotter = pyvista.Plotter(off_screen=True, window_size=(1200, 1000))
    plotter.set_background("white")
    plotter.add_mesh(mesh, cmap=COLOUR_MAP, show_scalar_bar=False, lighting=False)
    plotter.add_mesh(mesh.extract_all_edges(), color="black", opacity=0.2, line_width=1)
    titles = {"xtitle": "x", "ytitle": "y", "ztitle": "z"}
    plotter.show_bounds(color="black", location="outer", fmt="%.2g", font_size=16, **titles)
    plotter.view_vector(surface["view"], viewup=(0.0, 0.0, 1.0))
    plotter.enable_anti_aliasing("ssaa")
    np.save(image, plotter.screenshot(None, return_img=True))


if __name__ == "__main__":
    render(*sys.argv[1:])
