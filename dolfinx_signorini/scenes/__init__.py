"""Scenes: a whole problem from a file, solved, measured and shown.

The parts, in the order in which data flow: formulas and parsing; toml_table; domain, gmsh_meshes,
mesh_files, polygons and domains; conditions; scene (the data) and reading (from a file); posing
(the discrete problem); regularity and expectations (orders of convergence, cost); solving; and
output (summary, pictures, files).
"""

from dolfinx_signorini.scenes.files.reading import load_scene
from dolfinx_signorini.scenes.files.scene import Scene
from dolfinx_signorini.scenes.posing import PosedScene, pose
from dolfinx_signorini.scenes.solving import SceneResult, solve_scene

__all__ = ["PosedScene", "Scene", "SceneResult", "load_scene", "pose", "solve_scene"]
