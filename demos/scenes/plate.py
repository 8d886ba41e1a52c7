"""Make the mesh of plate.toml with gmsh: a plate with a hole and named sides.

Run: python3 demos/scenes/plate.py
"""

from pathlib import Path

import gmsh

WIDTH = 0.08  # mesh width
AROUND_HOLE = 32  # cells

gmsh.initialize(readConfigFiles=False)
occ = gmsh.model.occ
plate = occ.addRectangle(0.0, 0.0, 0.0, 2.0, 1.0)
disk = occ.addDisk(0.7, 0.5, 0.0, 0.2, 0.2)
occ.cut([(2, plate)], [(2, disk)])
occ.synchronize()
names = {}
for _, line in gmsh.model.getEntities(1):
    x, y, _ = occ.getCenterOfMass(1, line)
    name = "ground" if y < 1e-6 else "top" if y > 1.0 - 1e-6 else "hole"
    names[line] = name if 1e-6 < x < 2.0 - 1e-6 else "ends"
for tag, name in enumerate(("ground", "top", "hole", "ends"), 1):
    lines = [line for line, found in names.items() if found == name]
    gmsh.model.addPhysicalGroup(1, lines, tag, name)
gmsh.model.addPhysicalGroup(2, [s for _, s in gmsh.model.getEntities(2)], 1, "plate")
gmsh.option.setNumber("Mesh.MeshSizeMax", WIDTH)
gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", AROUND_HOLE)
gmsh.option.setNumber("General.Terminal", 0)
gmsh.model.mesh.generate(2)
gmsh.write(str(Path(__file__).with_name("plate.msh")))
gmsh.finalize()
