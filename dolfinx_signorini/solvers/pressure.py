"""The contact boundary of a discrete solution: contact pressure and its density."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc

from dolfinx_signorini.system import DiscreteProblem

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ContactState:
    """A discrete solution as a finer mesh needs it.

    Attributes:
        u: The solution.
        density: The density of the contact pressure, zero away from the contact dofs.
    """

    u: fem.Function
    density: fem.Function


def multiplier(problem: DiscreteProblem, u: fem.Function) -> Array:
    """Return lambda = A u - b at the contact dofs of this rank: the force on each of them."""
    x = problem.vector_of(u)
    force = x.duplicate()
    problem.A.mult(x, force)
    force.axpy(-1.0, problem.b)
    values = force.array_r[problem.contact_dofs].copy()
    x.destroy()
    force.destroy()
    return values


def boundary_weights(problem: DiscreteProblem) -> Array:
    """Return the share of the contact boundary that belongs to each contact dof of this rank.

    The diagonal of the boundary mass matrix, scaled to add up to the whole: positive for every
    degree and dimension, unlike the integrals of the basis functions.

    Source: Hinton, Rock and Zienkiewicz, Earthq. Eng. Struct. Dyn. 4 (1976) 245-249.
    """
    space = problem.space
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    ds = ufl.Measure("ds", space.mesh, subdomain_data=[(1, problem.contact_integrals)])(1)
    matrix = fem_petsc.assemble_matrix(fem.form(u * v * ds))
    matrix.assemble()
    problem.ledger.add("matrix", "boundary mass matrix", matrix)
    diagonal = matrix.getDiagonal()
    ones = diagonal.duplicate()
    ones.set(1.0)
    rows = diagonal.duplicate()
    matrix.mult(ones, rows)
    total, trace = rows.sum(), diagonal.sum()
    weights = diagonal.array_r[problem.contact_dofs] * (total / trace if trace > 0.0 else 1.0)
    for item in (matrix, diagonal, ones, rows):
        item.destroy()
    return np.asarray(weights)


def contact_state(problem: DiscreteProblem, u: fem.Function) -> ContactState:
    """Return a solution with the density of its contact pressure."""
    density = fem.Function(problem.space, name="pressure")
    weights = boundary_weights(problem)
    density.x.array[problem.contact_dofs] = multiplier(problem, u) / weights
    density.x.scatter_forward()
    return ContactState(u=u, density=density)
