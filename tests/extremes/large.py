"""Discrete problems on thousands of unknowns, and their solutions from elsewhere."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from cases import Data, digits_of, humps, waves
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini import SignoriniProblem
from dolfinx_signorini.meshes.sided_meshes import boundary_facets

Array = npt.NDArray[np.float64]
Where = Callable[[Array], npt.NDArray[np.bool_]]


@dataclass(frozen=True)
class Large:
    """(K grad u, grad v) + (c u, v) = (load, v) with u >= obstacle on part of the boundary.

    Attributes:
        domain: The mesh.
        diffusion: K: a number, a matrix as nested tuples, or values of the cells' midpoints.
        reaction: c: a number, or values of the cells' midpoints.
        load: Of the coordinates (3, n), interpolated.
        obstacle: Of the coordinates (3, n).
        where: Tells of coordinates (3, n) whether facets with these vertices are in contact; the
            whole boundary by default.
        degree: Of the elements.
        fixed: As `where`, for u = 0.
        options: PETSc options.
    """

    domain: mesh.Mesh
    diffusion: Any = 1.0
    reaction: Any = 1.0
    load: Data = waves
    obstacle: Data = humps
    where: Where | None = None
    degree: int = 1
    fixed: Where | None = None
    options: dict[str, Any] | None = None

    def problem(self) -> SignoriniProblem:
        """Assemble it with the package."""
        space = fem.functionspace(self.domain, ("Lagrange", self.degree))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        f = fem.Function(space)
        f.interpolate(self.load)
        K, c = self._coefficient(self.diffusion), self._coefficient(self.reaction)
        a = ufl.inner(K * ufl.grad(u), ufl.grad(v)) * ufl.dx
        if not isinstance(self.reaction, float) or self.reaction:
            a += c * u * v * ufl.dx
        facets, bcs = boundary_facets(self.domain), []
        tdim = self.domain.topology.dim
        if self.where is not None:
            facets = mesh.locate_entities_boundary(self.domain, tdim - 1, self.where)
        if self.fixed is not None:
            held = mesh.locate_entities_boundary(self.domain, tdim - 1, self.fixed)
            dofs = fem.locate_dofs_topological(space, tdim - 1, held)
            bcs = [fem.dirichletbc(0.0, dofs, space)]
        return SignoriniProblem(
            a,
            f * v * ufl.dx,
            contact=facets,
            obstacle=self.obstacle,
            bcs=bcs,
            petsc_options=self.options,
        )

    def _coefficient(self, value: Any) -> Any:
        if callable(value):
            on_cells = fem.Function(fem.functionspace(self.domain, ("DG", 0)))
            on_cells.interpolate(value)
            return on_cells
        return fem.Constant(self.domain, value)


def owned(u: fem.Function) -> Array:
    """Return a copy of the owned values of a function."""
    return u.x.array[: u.function_space.dofmap.index_map.size_local].copy()


def digits_against(comm: MPI.Comm, values: Array, others: Array) -> float:
    """Return the digits of the largest difference relative to the largest of the others."""
    local = [float(np.abs(v).max(initial=0.0)) for v in (values - others, others)]
    error, size = np.max(comm.allgather(local), axis=0)
    return digits_of(error, size)


def posed(problem: SignoriniProblem, w: Data, force: Data) -> Array:
    """Give a problem the load with which a function of its space is the solution.

    Args:
        problem: The problem; its obstacle lies nowhere above the function.
        w: The solution at the nodes, of the coordinates (3, n).
        force: The contact force on the contact dofs: zero where w lies above the obstacle.

    Returns:
        The owned values of the solution.
    """
    u = fem.Function(problem.space)
    u.interpolate(w)
    x, dofs = problem.system.vector_of(u), problem.contact_dofs
    x.array_w[problem.fixed_dofs] = problem.system.fixed_values
    values = x.array_r.copy()
    problem.A.mult(x, problem.b)
    problem.b.array_w[dofs] -= force(problem.space.tabulate_dof_coordinates()[dofs].T)
    x.destroy()
    return values


def rotated(small: float) -> tuple[tuple[float, ...], ...]:
    """Return the matrix with eigenvalues 1, in the direction of 30 degrees, and a small one."""
    c, s, d = math.sqrt(0.75), 0.5, 1.0 - small
    return ((c * c + small * s * s, d * c * s), (d * c * s, s * s + small * c * c))


def checkerboard(contrast: float, squares: int = 8) -> Data:
    """Return values 1 and the contrast on the squares of a checkerboard."""

    def value(x: Array) -> Array:
        return np.where((np.floor(squares * x[0]) + np.floor(squares * x[1])) % 2, 1.0, contrast)

    return value
