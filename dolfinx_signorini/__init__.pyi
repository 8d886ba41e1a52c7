"""The public names and their modules, which load when a name is first used."""

from .accuracy.adaptive import AdaptiveSolution, solve_adaptively
from .accuracy.stress_intensity import StressIntensity, stress_intensity
from .base.errors import InputError, NotConvergedError
from .bounds.energy_bound import EnergyBound, energy_bound
from .bounds.strong_form import EnergyTerms
from .meshes.box_meshes import box_mesh, friedrichs_keller
from .meshes.curved_sides import gmsh_projection
from .meshes.elements import bernstein_space
from .meshes.quadrature import QuadratureRule
from .meshes.sided_meshes import SidedMesh, boundary_facets, gmsh_mesh
from .norms.error_norms import error_norms
from .norms.manufactured import ManufacturedSolution, manufacture
from .norms.references import Reference, interpolated
from .problem.contact import ContactProblem
from .problem.contact_zones import ContactZone
from .problem.detachment import DetachmentPoint, detachment_points
from .problem.dirichlet import dirichlet
from .problem.elasticity import elasticity, stress, von_mises, weighted_strain
from .problem.obstacle import ObstacleProblem
from .problem.signorini import SignoriniProblem
from .scenes import Scene, SceneResult, load_scene, solve_scene
from .solvers import METHODS
from .solvers.cascade import coarse_levels, solve_cascade
from .solvers.pressure import ContactState
from .solvers.result import SolveResult
from .studies.paper.solution import christof_haubner

__all__ = [
    "METHODS",
    "AdaptiveSolution",
    "ContactProblem",
    "ContactState",
    "ContactZone",
    "DetachmentPoint",
    "EnergyBound",
    "EnergyTerms",
    "InputError",
    "ManufacturedSolution",
    "NotConvergedError",
    "ObstacleProblem",
    "QuadratureRule",
    "Reference",
    "Scene",
    "SceneResult",
    "SidedMesh",
    "SignoriniProblem",
    "SolveResult",
    "StressIntensity",
    "bernstein_space",
    "boundary_facets",
    "box_mesh",
    "christof_haubner",
    "coarse_levels",
    "detachment_points",
    "dirichlet",
    "elasticity",
    "energy_bound",
    "error_norms",
    "friedrichs_keller",
    "gmsh_mesh",
    "gmsh_projection",
    "interpolated",
    "load_scene",
    "manufacture",
    "solve_adaptively",
    "solve_cascade",
    "solve_scene",
    "stress",
    "stress_intensity",
    "von_mises",
    "weighted_strain",
]

__version__: str
