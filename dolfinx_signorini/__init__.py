"""Unilateral problems on FEniCSx: obstacles on the boundary and in the domain, and elastic contact.

UFL forms pose a `SignoriniProblem`, an `ObstacleProblem` or a `ContactProblem`, whose `solve` gives
the solution with gap, pressure and contact set. `solve_adaptively` solves to an accuracy,
`energy_bound` proves a bound of the error, and `solve_scene` does all that a scene file asks for.
The rooms of the package are in CONTRIBUTING.md.
"""

import lazy_loader

from dolfinx_signorini.base import requirements  # which asks for dolfinx, and loads its MPI

del requirements

# The names and their modules are in __init__.pyi.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

__version__ = "0.2.0"
