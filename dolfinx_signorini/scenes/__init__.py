"""Scenes: a whole problem from a file, solved, measured and shown.

The parts, in the order data flows: suggestions, expressions and grammar (formulas), mesh_files,
domains, scene (the data), table, domain_table and scene_file (reading TOML), posing (the discrete
problem), regularity and expectations (orders of convergence, cost), family (the scene on any mesh),
solving (on its mesh, or to an accuracy), boundary (the contact boundary on one rank), summary,
pictures, report, results (the files), and the jobs check and solve.
"""

from dolfinx_signorini.scenes.posing import PosedScene, pose
from dolfinx_signorini.scenes.reading import load_scene
from dolfinx_signorini.scenes.scene import Scene
from dolfinx_signorini.scenes.solving import SceneResult, solve_scene

__all__ = ["PosedScene", "Scene", "SceneResult", "load_scene", "pose", "solve_scene"]
