"""Checks of an assembled problem: what makes no sense is refused before anything is solved."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from dolfinx_signorini.errors import InputError, require

if TYPE_CHECKING:
    from dolfinx_signorini.system import DiscreteProblem

Indices = npt.NDArray[np.int32]
Array = npt.NDArray[np.float64]

SYMMETRY_TOLERANCE = 1e-10  # relative; assembly rounds at 1e-15
VANISHING = 1e-12  # relative; what is as small as that against rounding is nothing
SMALLEST, LARGEST = 1e-290, 1e290  # beyond, products of entries lose digits or overflow


def check_bounds(problem: DiscreteProblem, dofs: Indices, values: Array) -> None:
    """Refuse an obstacle or Dirichlet data that are not finite, or an obstacle above the data.

    Args:
        problem: The problem, with its Dirichlet data.
        dofs: The owned dofs on the contact boundary, those with Dirichlet data included.
        values: The obstacle at these.
    """
    comm = problem.comm
    fixed, data = problem.fixed_dofs, problem.fixed_values
    bad = dofs[~np.isfinite(values)]
    place = _place(problem, bad[0]) if len(bad) else ""
    require(comm, not len(bad), f"obstacle: it is not a finite number at {place}")
    bad = fixed[~np.isfinite(data)]
    place = _place(problem, bad[0]) if len(bad) else ""
    require(comm, not len(bad), f"Dirichlet data: not a finite number at {place}")
    common, i, j = np.intersect1d(dofs, fixed, return_indices=True)
    above = np.flatnonzero(values[i] > data[j])
    message = ""
    if len(above):
        k = above[0]
        message = (
            f"obstacle: {values[i[k]]:.6g} lies above the Dirichlet data "
            f"{data[j[k]]:.6g} at {_place(problem, common[k])}"
        )
    require(comm, not message, message)


def check_entries(problem: DiscreteProblem) -> Array:
    """Refuse entries that are not finite, or a diagonal that is not positive; return the diagonal.

    The diagonal is that of the rows of this rank.
    """
    comm = problem.comm
    finite = bool(np.isfinite(problem.b.array_r).all())
    require(comm, finite, "load: the assembled form L has an entry that is not finite")
    vector = problem.A.getDiagonal()
    diagonal = np.array(vector.array_r)
    vector.destroy()
    finite = bool(np.isfinite(diagonal).all())
    require(comm, finite, "form a: the assembled matrix has an entry that is not finite")
    positive = bool((diagonal > 0.0).all())
    require(comm, positive, "form a: not positive definite, a diagonal entry is not positive")
    return diagonal


def check_range(problem: DiscreteProblem, diagonal: Array) -> None:
    """Refuse an operator, forces or a solution too large or small to have all their digits."""
    load = np.abs(problem.b.array_r).max(initial=0.0)
    with np.errstate(over="ignore", under="ignore"):
        push = (problem.contact_diagonal * np.maximum(problem.obstacle, 0.0)).max(initial=0.0)
        local = np.array([diagonal.max(initial=0.0), load, max(load, push)])
        operator, load, force = np.max(problem.comm.allgather(local), axis=0)
        height = force / operator
    for name, size in (
        ("form a: its largest diagonal entry", operator),
        ("load: its largest entry", load),
        ("obstacle: its force", force),
        ("load and obstacle: the size of the solution", height),
    ):
        if size != 0.0 and not SMALLEST <= size <= LARGEST:
            raise InputError(
                f"{name}, {size:.3g}, is not between {SMALLEST:g} and {LARGEST:g}; "
                "choose other units"
            )


def check_symmetry(problem: DiscreteProblem) -> None:
    """Refuse a form that is not symmetric: compare x.(A y) with y.(A x) for two vectors."""
    A = problem.A
    x, y, product = (A.createVecRight() for _ in range(3))
    index = np.arange(*A.getOwnershipRange(), dtype=np.float64)
    x.array_w[:] = np.cos(1.7 * index**2)
    y.array_w[:] = np.sin(2.3 * index**2 + 1.0)
    A.mult(y, product)
    largest = product.norm(PETSc.NormType.INFINITY)
    x.scale(1.0 / largest)  # no product overflows
    forward = x.dot(product)
    size = largest * x.norm(PETSc.NormType.NORM_1)
    A.mult(x, product)
    defect = abs(forward - y.dot(product))
    for vec in (x, y, product):
        vec.destroy()
    symmetric = defect <= SYMMETRY_TOLERANCE * size
    require(problem.comm, symmetric, "form a: not symmetric, so that no energy is minimised")


def check_definite(problem: DiscreteProblem, diagonal: Array) -> bool:
    """Refuse a(1, 1) < 0, and a form without a unique solution where it vanishes on constants.

    Returns:
        Whether the form vanishes on constants: the only functions it may leave out, and where it
        does, the load has to press against the obstacle.
    """
    comm, A, b = problem.comm, problem.A, problem.b
    x, product = A.createVecRight(), A.createVecLeft()
    x.set(1.0)
    x.array_w[problem.fixed_dofs] = 0.0
    A.mult(x, product)
    energy, bound = x.dot(product), comm.allreduce(float(diagonal.sum()))
    vanishes = product.norm(PETSc.NormType.NORM_1) <= VANISHING * bound
    work, loads = b.dot(x), b.norm(PETSc.NormType.NORM_1)
    x.destroy()
    product.destroy()
    definite = energy >= -VANISHING * bound
    require(comm, definite, "form a: not positive definite, a(1, 1) is negative")
    singular = vanishes and comm.allreduce(len(problem.fixed_dofs)) == 0
    if not singular:
        return False
    require(
        comm,
        comm.allreduce(len(problem.contact_dofs)) > 0,
        "contact: empty, while the form a vanishes on constants: the operator is singular; "
        "give contact facets, a Dirichlet condition or a reaction term",
    )
    require(
        comm,
        work < -VANISHING * loads,
        f"load: L(1) = {work:.6g} is not negative, while the form a vanishes on constants: "
        + ("the energy is unbounded" if work > VANISHING * loads else "the solution is not unique")
        + "; the load must press against the obstacle",
    )
    return True


def _place(problem: DiscreteProblem, dof: int) -> str:
    x = problem.space.tabulate_dof_coordinates()[dof]
    return "(" + ", ".join(f"{c:.6g}" for c in x) + ")"
