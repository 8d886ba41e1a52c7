"""The domains of scenes: squares, cubes, polygons, and meshes of gmsh and from files."""
