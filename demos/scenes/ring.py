"""Make the mesh of ring.toml with gmsh: a ring with named sides.

Run: python3 demos/scenes/ring.py
"""

from pathlib import Path

import gmsh
import numpy as np

INNER, OUTER, WIDTH = 0.8, 1.0, 0.12
TOP = np.radians(10.0)  # half of the angle that is held at the top

gmsh.initialize(readConfigFiles=False)
geo = gmsh.model.geo
middle = geo.addPoint(0.0, 0.0, 0.0)


def circle(radius: float, angles: list[float]) -> list[int]:
    """Arcs between points at some angles, all of the way around."""
    points = [
        geo.addPoint(radius * np.cos(a), radius * np.sin(a), 0.0, WIDTH) for a in np.radians(angles)
    ]
    ends = [*points[1:], points[0]]
    return [geo.addCircleArc(a, middle, b) for a, b in zip(points, ends, strict=True)]


up = np.degrees(TOP)
outer = circle(OUTER, [90.0 - up, 90.0 + up, 180.0, 270.0, 360.0])
inner = circle(INNER, [0.0, 90.0, 180.0, 270.0])
geo.addPlaneSurface([geo.addCurveLoop(outer), geo.addCurveLoop(inner)], 1)
geo.synchronize()
for tag, (name, lines) in enumerate(
    {"top": outer[:1], "outer": outer[1:], "inner": inner}.items(), 1
):
    gmsh.model.addPhysicalGroup(1, lines, tag, name)
gmsh.model.addPhysicalGroup(2, [1], 1, "ring")
gmsh.option.setNumber("General.Terminal", 0)
gmsh.model.mesh.generate(2)
gmsh.write(str(Path(__file__).with_name("ring.msh")))
gmsh.finalize()
