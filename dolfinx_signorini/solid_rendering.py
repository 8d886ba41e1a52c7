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
    mesh["solution u"] = surface["values"]
    plotter = pyvista.Plotter(off_screen=True, window_size=(1200, 900))
    plotter.set_background("white")
    bar = {"color": "black", "vertical": True, "position_x": 0.88, "position_y": 0.25}
    plotter.add_mesh(mesh, cmap=COLOUR_MAP, scalar_bar_args=bar, lighting=False)
    plotter.add_mesh(mesh.extract_all_edges(), color="black", opacity=0.2, line_width=1)
    titles = {"xtitle": "x", "ytitle": "y", "ztitle": "z"}
    plotter.show_bounds(color="black", location="outer", fmt="%.2g", font_size=14, **titles)
    plotter.camera_position = "iso"
    plotter.camera.zoom(0.8)
    plotter.enable_anti_aliasing("ssaa")
    np.save(image, plotter.screenshot(None, return_img=True))


if __name__ == "__main__":
    render(*sys.argv[1:])
