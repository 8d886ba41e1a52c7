"""A scene on one mesh, with u_h and R_h(u) from integrals that are consistent with each other.

The proofs of the paper use Green's formula (u, w)_H1 = (f, w) + <du/dn, w>. To make what follows
from it hold to rounding, and not just to the accuracy of some quadrature rule, two of the three
terms are integrated, (u, w)_H1 and <du/dn, w>, and the load of (S_h) is their difference. How far
it is from the load integrated with the paper's rule is measured by `green_defect`.
"""

import functools

import numpy as np
import ufl
from dolfinx import fem, mesh
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini import compat
from dolfinx_signorini.errors import NotConvergedError
from dolfinx_signorini.meshes import boundary_facets, cells_near_ball, facet_cells
from dolfinx_signorini.paper.solution import PAPER_RULE
from dolfinx_signorini.paper.theory.curve import BoundaryCurve
from dolfinx_signorini.paper.theory.scenes import Scene
from dolfinx_signorini.problem import SignoriniProblem
from dolfinx_signorini.quadrature import QuadratureRule
from dolfinx_signorini.solvers.pressure import ContactState

# On the cells near a singular point the gradient of u is like the root of the distance to it.
NEAR_CELL_RULE = QuadratureRule("Gauss-Jacobi", 63)
NEAR_FACET_RULE = QuadratureRule("Gauss-Jacobi", 127)
FAR_FACET_RULE = QuadratureRule("Gauss-Jacobi", 15)
NEAR = 3.0  # cells: how far "near" reaches
RTOL = 1e-11  # rounding keeps a mesh of 1001 cells per side above 1e-12
MAX_ITERATIONS = 300


class Discretisation:
    """A scene on one mesh of linear elements.

    Args:
        scene: The scene.
        domain: Its mesh.

    Attributes:
        exact: The solution on this mesh.
        a, load: The forms of (S_h).
        problem: (S_h).
        space: The space V_h.
        curve: The boundary.
        moments: (u, phi_i)_H1 for every basis function, a PETSc vector.
        flux: <du/dn, phi_i>, a PETSc vector.
    """

    def __init__(self, scene: Scene, domain: mesh.Mesh):
        self.scene = scene
        self.exact = scene.exact(domain)
        space = fem.functionspace(domain, ("Lagrange", 1))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        product, flux = self._product(v), self._flux(v)
        self.a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
        self.load = product - flux
        self.problem = SignoriniProblem(self.a, self.load, contact=boundary_facets(domain))
        self.space = self.problem.space
        self.curve = BoundaryCurve(self.space)
        self.moments, self.flux = _assembled(product), _assembled(flux)

    @property
    def comm(self) -> MPI.Comm:
        """The communicator of the mesh."""
        return self.space.mesh.comm

    @functools.cached_property
    def u_h(self) -> fem.Function:
        """The solution of (S_h), solved without a coarser one unless `solve` came first."""
        return self.solve(None)

    def solve(self, coarse: ContactState | None) -> fem.Function:
        """Solve (S_h) from a coarser solution; the result is `u_h` from then on."""
        result = self.problem.solve(coarse=coarse, rtol=RTOL)
        self.__dict__["u_h"] = result.u
        return result.u

    @functools.cached_property
    def ritz(self) -> fem.Function:
        """R_h(u), the Ritz projection of the solution (Definition 3.1)."""
        return self.riesz(self.moments)

    def riesz(self, load: PETSc.Vec) -> fem.Function:
        """Return the function of V_h whose H^1 products with the basis are given.

        Raises:
            NotConvergedError: The linear solver did not reach its tolerance.
        """
        x = load.duplicate()
        x.set(0.0)
        solve_linear(self.problem.A, load, x)
        result = self._function(x)
        x.destroy()
        return result

    def harmonic(self, boundary_values: fem.Function) -> fem.Function:
        """Return the extension of boundary values with the smallest H^1 norm in V_h.

        Raises:
            NotConvergedError: The linear solver did not reach its tolerance.
        """
        A = self.problem.A.copy()
        x, b = self.problem.vector_of(boundary_values), self.problem.A.createVecLeft()
        b.set(0.0)
        rows = self.problem.contact_dofs + A.getOwnershipRange()[0]
        A.zeroRowsColumns(rows, diag=4.0, x=x, b=b)
        solve_linear(A, b, x)
        result = self._function(x)
        for item in (A, x, b):
            item.destroy()
        return result

    def product(self, v: fem.Function, w: fem.Function) -> float:
        """Return (v, w)_H1 of two functions of V_h."""
        x, y = self.problem.vector_of(v), self.problem.vector_of(w)
        image = x.duplicate()
        self.problem.A.mult(x, image)
        value = image.dot(y)
        for item in (x, y, image):
            item.destroy()
        return float(value)

    def norm(self, v: fem.Function) -> float:
        """Return the H^1 norm of a function of V_h."""
        return float(np.sqrt(max(self.product(v, v), 0.0)))

    def exact_product(self, w: fem.Function) -> float:
        """Return (u, w)_H1 for a function of V_h and the exact u."""
        x = self.problem.vector_of(w)
        value = float(self.moments.dot(x))
        x.destroy()
        return value

    def difference(self, v: fem.Function, w: fem.Function) -> fem.Function:
        """Return v - w."""
        result = fem.Function(self.space)
        result.x.array[:] = v.x.array - w.x.array
        return result

    def interpolate_exact(self) -> fem.Function:
        """Return I_h(u), the Lagrange interpolant of the solution."""
        result = fem.Function(self.space)
        points = compat.interpolation_points(self.space.element)
        result.interpolate(fem.Expression(self.exact.u, points, comm=self.comm))
        result.x.scatter_forward()
        return result

    def green_defect(self) -> float:
        """Return how far the load here is from the paper's, as the H^1 norm of its solution."""
        v = ufl.TestFunction(self.space)
        paper = _assembled(self.exact.load * v * ufl.dx(metadata=PAPER_RULE.metadata))
        paper.axpy(-1.0, self.problem.b)
        defect = self.norm(self.riesz(paper))
        paper.destroy()
        return defect

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.problem.destroy()
        self.moments.destroy()
        self.flux.destroy()

    def _function(self, x: PETSc.Vec) -> fem.Function:
        result = fem.Function(self.space)
        result.x.array[: x.getLocalSize()] = x.array_r
        result.x.scatter_forward()
        return result

    def _product(self, v: ufl.Argument) -> ufl.Form:
        """(u, v)_H1 with the exact u and its gradient."""
        domain = self.exact.mesh
        cells = self.exact.support_cells()
        near = near_cells(domain, self.scene.singular)
        parts = [(1, np.setdiff1d(cells, near)), (2, np.intersect1d(cells, near))]
        dx = ufl.Measure("dx", domain, subdomain_data=parts)
        integrand = ufl.inner(ufl.as_vector(self.exact.grad), ufl.grad(v)) + self.exact.u * v
        return integrand * dx(1, metadata=PAPER_RULE.metadata) + integrand * dx(
            2, metadata=NEAR_CELL_RULE.metadata
        )

    def _flux(self, v: ufl.Argument) -> ufl.Form:
        """<du/dn, v> on the boundary."""
        domain = self.exact.mesh
        facets = facet_cells(domain, boundary_facets(domain))
        near = np.isin(facets[:, 0], near_cells(domain, self.scene.singular))
        parts = [(1, facets[~near].flatten()), (2, facets[near].flatten())]
        ds = ufl.Measure("ds", domain, subdomain_data=parts)
        integrand = ufl.dot(ufl.as_vector(self.exact.grad), ufl.FacetNormal(domain)) * v
        return integrand * ds(1, metadata=FAR_FACET_RULE.metadata) + integrand * ds(
            2, metadata=NEAR_FACET_RULE.metadata
        )


def near_cells(
    domain: mesh.Mesh, points: tuple[tuple[float, float], ...], reach: float = NEAR
) -> np.ndarray:
    """Return the owned cells within some cell sizes of points."""
    size = cell_size(domain)
    parts = [cells_near_ball(domain, point, reach * size) for point in points]
    return np.unique(np.concatenate([np.empty(0, dtype=np.int32), *parts]))


def cell_size(domain: mesh.Mesh) -> float:
    """Return the largest cell diameter, the same on all ranks."""
    count = domain.topology.index_map(domain.topology.dim).size_local
    sizes = domain.h(domain.topology.dim, np.arange(count, dtype=np.int32))
    return float(domain.comm.allreduce(float(sizes.max(initial=0.0)), op=MPI.MAX))


def solve_linear(A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> None:
    """Solve A x = b, A symmetric positive definite, by conjugate gradients with BoomerAMG.

    Raises:
        NotConvergedError: The residual did not fall to RTOL of the right-hand side.
    """
    if b.norm() == 0.0:
        x.set(0.0)
        return
    ksp = PETSc.KSP().create(A.comm)
    ksp.setOptionsPrefix("dolfinx_signorini_theory_")
    ksp.setOperators(A)
    ksp.setType("cg")
    ksp.getPC().setType("hypre")
    ksp.getPC().setHYPREType("boomeramg")
    ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    ksp.setTolerances(rtol=RTOL, atol=0.0, max_it=MAX_ITERATIONS)
    ksp.setInitialGuessNonzero(True)
    ksp.solve(b, x)
    reason = ksp.getConvergedReason()
    residual = ksp.getResidualNorm() / b.norm()
    ksp.destroy()
    if reason <= 0:
        raise NotConvergedError("the linear solver did not converge", residual, str(reason))


def _assembled(form: ufl.Form) -> PETSc.Vec:
    vector = fem_petsc.assemble_vector(fem.form(form))
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    return vector
