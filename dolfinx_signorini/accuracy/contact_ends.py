"""The cells at the ends of the contact set, where a solution is like r^{3/2} and not smoother.

A few meshes do not tell the rate at these cells, but theory does: the discrete contact set ends at
a dof, which is now nearer to the true end and now farther away.

Source: Christof and Haubner, Section 2.2, for the singularity.
"""

import math

import basix
import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfinx_signorini.accuracy.targets import Target
from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.ranks import marked
from dolfinx_signorini.meshes.elements import facet_dofs
from dolfinx_signorini.meshes.sided_meshes import cells_with_dofs
from dolfinx_signorini.problem.signorini import SignoriniProblem

EXPONENT = 1.5  # of the distance
CODIMENSION = 2  # of the ends: points in the plane, curves in space
SAMPLES = 24  # on each edge of a facet


def rate_at_ends(target: Target) -> float:
    """Return the rate with which divisions towards an end of the contact set reduce the error.

    Args:
        target: What is to be accurate.
    """
    if target.weighted or target.norm is None:
        # In energy, the solution has r^{3/2}, and the dual solution r^{1/2}.
        return 2.0 * EXPONENT - 1.0
    share = 0.0 if math.isinf(target.norm.p) else CODIMENSION / target.norm.p
    return EXPONENT - target.norm.derivatives + share


def cells_at_contact_ends(
    problem: SignoriniProblem, parents: LocalIndices, count: int
) -> npt.NDArray[np.bool_]:
    """Tell which cells have an end of the contact set; the call is collective.

    Args:
        problem: The solved problem, on the mesh with every cell divided.
        parents: For each owned cell of this mesh the coarse cell around the cell.
        count: The number of owned coarse cells.

    Returns:
        For each owned coarse cell whether the cell is at a facet with dofs in contact and others.
    """
    space = problem.space
    _, dofs, touching = contact_on_facets(problem)
    held = marked(space, problem.fixed_dofs)[dofs]
    ends = touching.any(axis=1) & ~(touching | held).all(axis=1)
    cells = cells_with_dofs(space, marked(space, dofs[ends].ravel()))
    result = np.zeros(count, dtype=bool)
    result[parents[cells[cells < len(parents)]]] = True
    return result


def contact_on_facets(
    problem: SignoriniProblem,
) -> tuple[LocalIndices, LocalIndices, npt.NDArray[np.bool_]]:
    """Return the owned contact facets with their dofs, and whether the dofs are in contact.

    Args:
        problem: The solved problem; the call is collective.

    Returns:
        The (cell, local facet) pairs, and two arrays of the shape (facets, dofs of a facet).
    """
    space = problem.space
    pairs = problem.system.layout.facet_cells
    dofs = facet_dofs(space, pairs)
    return pairs, dofs, marked(space, problem.active)[dofs]


def facet_lattice(space: fem.FunctionSpace) -> Array:
    """Return points of the reference facet, in order, from which functions on a facet are known.

    Args:
        space: A space on triangles, with SAMPLES parts of an edge, or on tetrahedra, with a third.
    """
    dim = space.mesh.topology.dim
    facet = basix.cell.subentity_types(space.element.basix_element.cell_type)[dim - 1][0]
    count = SAMPLES if dim == 2 else SAMPLES // 3
    kind = basix.LatticeType.equispaced
    lattice: Array = np.asarray(basix.create_lattice(facet, count, kind, exterior=True))
    return lattice[np.lexsort(lattice.T[::-1])]
