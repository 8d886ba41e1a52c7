"""Unilateral problems on FEniCSx: obstacles on the boundary and in the domain, and elastic contact.

UFL forms pose a `SignoriniProblem`, an `ObstacleProblem` or a `ContactProblem`, whose `solve` gives
the solution with gap, pressure and contact set. `solve_adaptively` solves to an accuracy,
`energy_bound` proves a bound of the error, and `solve_scene` does all that a scene file asks for.
The rooms of the package are in CONTRIBUTING.md.
"""

from dolfinx_signorini.base import requirements  # isort: skip  # before what needs dolfinx
from dolfinx_signorini.accuracy.adaptive import AdaptiveSolution, solve_adaptively
from dolfinx_signorini.accuracy.stress_intensity import StressIntensity, stress_intensity
from dolfinx_signorini.base.errors import InputError, NotConvergedError
from dolfinx_signorini.bounds.energy_bound import EnergyBound, energy_bound
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.meshes.box_meshes import box_mesh, friedrichs_keller
from dolfinx_signorini.meshes.curved_sides import gmsh_projection
from dolfinx_signorini.meshes.elements import bernstein_space
from dolfinx_signorini.meshes.quadrature import QuadratureRule
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, boundary_facets, gmsh_mesh
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.manufactured import ManufacturedSolution, manufacture
from dolfinx_signorini.norms.references import Reference, interpolated
from dolfinx_signorini.problem.contact import ContactProblem
from dolfinx_signorini.problem.contact_zones import ContactZone
from dolfinx_signorini.problem.detachment import DetachmentPoint, detachment_points
from dolfinx_signorini.problem.dirichlet import dirichlet
from dolfinx_signorini.problem.elasticity import elasticity, stress, von_mises, weighted_strain
from dolfinx_signorini.problem.obstacle import ObstacleProblem
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.scenes import Scene, SceneResult, load_scene, solve_scene
from dolfinx_signorini.solvers import METHODS
from dolfinx_signorini.solvers.cascade import coarse_levels, solve_cascade
from dolfinx_signorini.solvers.pressure import ContactState
from dolfinx_signorini.solvers.result import SolveResult
from dolfinx_signorini.studies.paper.solution import christof_haubner

del requirements

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

__version__ = "0.2.0"
