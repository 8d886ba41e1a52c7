"""Signorini problems on FEniCSx: one-sided constraints on the boundary, solved with PETSc TAO.

The parts, in the order data flows: meshes, quadrature, manufactured (known solutions), costs,
checks, assembly, optimality, tao, active_set, patch, contact, cascade, problem, norms, rates,
study, plotting, cli.
"""

from dolfinx_signorini.errors import InputError, NotConvergedError
from dolfinx_signorini.manufactured import ManufacturedSolution, christof_haubner, interpolated
from dolfinx_signorini.meshes import friedrichs_keller
from dolfinx_signorini.norms import error_norms
from dolfinx_signorini.problem import SignoriniProblem, paper_problem
from dolfinx_signorini.quadrature import QuadratureRule
from dolfinx_signorini.solvers.cascade import solve_cascade
from dolfinx_signorini.solvers.pressure import ContactState
from dolfinx_signorini.solvers.residual import SolveResult

__all__ = [
    "ContactState",
    "InputError",
    "ManufacturedSolution",
    "NotConvergedError",
    "QuadratureRule",
    "SignoriniProblem",
    "SolveResult",
    "christof_haubner",
    "error_norms",
    "friedrichs_keller",
    "interpolated",
    "paper_problem",
    "solve_cascade",
]

__version__ = "0.1.0"
