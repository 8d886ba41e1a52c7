"""Problem (3), with Dirichlet data on part of the boundary, and problems without known solution.

Problem (3) has a solution with one singularity and nothing else: with polar coordinates about
(1/2, 0), the contact side below and Dirichlet data on the other sides,

    u = -r^b sin(3/2 theta)    or, for p > 4,    u = -(r^{3/2} + r^b) sin(3/2 theta),

b = 2 - 2/p. Second derivatives like r^{b-2} are in L^q for q < p only. For b = 3/2 the load is 0.
Without a cut-off function the singularity rules the error from coarse meshes on.
"""

import numpy as np
import ufl
from dolfinx import fem, mesh

from dolfinx_signorini.base.tolerances import ROUNDING
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.meshes.quadrature import CELL_RULE
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, owned_cells
from dolfinx_signorini.norms.manufactured import ManufacturedSolution
from dolfinx_signorini.norms.references import interpolant
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.studies.paper.solution import DETACHMENT, h1_product, half_angle
from dolfinx_signorini.studies.paper.theory.discretisation import NEAR_CELL_RULE, integrated
from dolfinx_signorini.studies.paper.theory.examples import times_powers


class PowerProblem(SignoriniProblem):
    """Problem (3) with a pure power of r as its solution, on a mesh of the unit square.

    Args:
        domain: The mesh.
        p: The exponent of the regularity.

    Attributes:
        exact: The solution.
    """

    def __init__(self, domain: mesh.Mesh, p: float):
        space, self.p = fem.functionspace(domain, ("Lagrange", 1)), p
        x = ufl.SpatialCoordinate(domain)
        _, c, s = half_angle(x[0] - DETACHMENT[0], x[1] - DETACHMENT[1])
        w = s * (s * s - 3.0 * c * c)  # -r^{3/2} sin(3/2 theta), which is harmonic
        pure = ManufacturedSolution(
            domain, w, (-1.5 * s, -1.5 * c), 0.0 * x[0], singular=(DETACHMENT,)
        )
        self.exact = times_powers(pure, p)
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        cells, load, point = owned_cells(domain), self.exact.load * v, (DETACHMENT,)
        bottom = mesh.locate_entities_boundary(domain, 1, lambda x: x[1] < ROUNDING)
        others = np.setdiff1d(boundary_facets(domain), bottom)
        dofs = fem.locate_dofs_topological(space, 1, others)
        super().__init__(
            ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
            integrated(load, domain, "dx", cells, point, CELL_RULE, NEAR_CELL_RULE),
            contact=bottom,
            bcs=[fem.dirichletbc(interpolant(space, self.exact.u), dofs)],
        )


class UnknownProblem(SignoriniProblem):
    """Problem (S) with a load whose solution nobody knows.

    The load is 40 (0.45 - x_1) + 0.3/(0.2 + x_2) or, with a pole, that plus |x - (1, 1)|^{-0.7},
    which is in L^2 and not in L^4.

    Args:
        domain: A mesh of the unit square.
        pole: Whether the load has the pole.

    Attributes:
        terms: The strong form.
    """

    def __init__(self, domain: mesh.Mesh, pole: bool = False):
        space = fem.functionspace(domain, ("Lagrange", 1))
        x = ufl.SpatialCoordinate(domain)
        load = 40.0 * (0.45 - x[0]) + 0.3 / (0.2 + x[1])
        if pole:
            offset = x - ufl.as_vector([1.0, 1.0])
            load -= 5.0 * ufl.dot(offset, offset) ** -0.35
        self.terms = EnergyTerms(reaction=1.0, load=load)
        form = load * ufl.TestFunction(space) * ufl.dx(metadata=CELL_RULE.metadata)
        super().__init__(h1_product(space), form, contact=boundary_facets(domain))
