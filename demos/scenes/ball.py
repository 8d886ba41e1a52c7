"""Make the mesh of ball.toml with gmsh: a quarter of the lower half of a ball, with named sides.

Run: python3 demos/scenes/ball.py
"""

from pathlib import Path

import gmsh
import numpy as np

WIDTH, FINE = 0.3, 0.1  # mesh widths, and around the lowest point

gmsh.initialize(readConfigFiles=False)
occ = gmsh.model.occ
ball = occ.addSphere(0.0, 0.0, 0.0, 1.0)
corner = occ.addBox(-2.0, -2.0, -2.0, 2.0, 2.0, 2.0)
occ.intersect([(3, ball)], [(3, corner)])
occ.synchronize()
sides: dict[str, list[int]] = {"ball": [], "x": [], "y": [], "top": []}
for _, surface in gmsh.model.getEntities(2):
    at = np.array(occ.getCenterOfMass(2, surface))
    flat = np.flatnonzero(np.abs(at) < 1e-6)
    sides[("x", "y", "top")[flat[0]] if len(flat) else "ball"].append(surface)
for tag, (name, surfaces) in enumerate(sides.items(), 1):
    gmsh.model.addPhysicalGroup(2, surfaces, tag, name)
gmsh.model.addPhysicalGroup(3, [v for _, v in gmsh.model.getEntities(3)], 1, "body")
for dim, point in gmsh.model.getEntities(0):
    low = gmsh.model.getValue(dim, point, [])[2] < -0.9
    gmsh.model.mesh.setSize([(dim, point)], FINE if low else WIDTH)
gmsh.option.setNumber("General.Terminal", 0)
gmsh.model.mesh.generate(3)
gmsh.write(str(Path(__file__).with_name("ball.msh")))
gmsh.finalize()
