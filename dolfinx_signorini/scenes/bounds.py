"""The proven bound of the energy error of a scene."""

from dataclasses import replace

from dolfinx_signorini.base.ranks import anywhere
from dolfinx_signorini.bounds.energy_bound import EnergyBound, energy_bound
from dolfinx_signorini.data.smoothness import load_is_a_function
from dolfinx_signorini.meshes.sided_meshes import cell_corners
from dolfinx_signorini.scenes.posing import PosedScene

MADE = "the bound is that of the problem with the obstacle that was made at the nodes"
KINKED = "whether the flux of the manufactured solution is continuous is known at points only"


def bound_of_scene(posed: PosedScene) -> EnergyBound:
    """Return the bound of the energy error of a scene whose problem has been solved.

    Args:
        posed: The scene on a mesh; the call is collective.

    Raises:
        InputError: The problem has not been solved, its data make no sense, or there is no such
            bound, see `Scene.refuse`.
    """
    scene, problem = posed.scene, posed.problem
    scene.refuse(["bound"], option=True)
    bound, notes = energy_bound(problem), []
    if scene.manufactured and scene.solution is not None:
        corners, entries = cell_corners(posed.sided.mesh), scene.diffusion_entries
        kinked = not load_is_a_function(scene.solution, entries, corners)
        notes += [KINKED] * anywhere(problem.comm, kinked)
    if scene.contact is not None and scene.contact.value is None:
        notes.append(MADE)
    return replace(bound, sampled=bound.sampled or bool(notes), notes=(*bound.notes, *notes))
