"""Scenes: a whole problem from a file, solved, measured and shown.

Data flow from `files/` and `domains/` to posing (the discrete problem), regularity and expectations
(orders of convergence, cost), solving, and `output/`.
"""

from dolfinx_signorini.scenes.files.reading import load_scene
from dolfinx_signorini.scenes.files.scene import Scene
from dolfinx_signorini.scenes.posing import PosedScene, pose
from dolfinx_signorini.scenes.solving import SceneResult, solve_scene

__all__ = ["PosedScene", "Scene", "SceneResult", "load_scene", "pose", "solve_scene"]
