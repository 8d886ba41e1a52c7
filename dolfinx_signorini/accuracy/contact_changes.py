"""The part in an error of dofs that are in contact in one of two solutions only.

Let w be the solution on the divided mesh and u_h the solution before, with forces F_i >= 0 at the
dofs i in contact. Let z be the dual solution of a functional J, which vanishes at the dofs in
contact in w and is held there by forces G_i. For the interpolation I on the undivided mesh,

    J(w - u_h) = a(w - u_h, z - I z) - sum_i F_i (I z)_i - sum_i G_i (w - u_h)_i.

The first sum has the dofs in contact in u_h that w has released, the second one those that w has
caught. The differences w - I w and z - I z, which bound the first term, do not know of both sums.

Source: Blum and Suttmeier, An adaptive finite element discretisation for a simplified Signorini
problem, Calcolo 37 (2000) 65-77, for the dual problem with the contact set held.
"""

import numpy as np
from dolfinx import fem

from dolfinx_signorini.accuracy.cells import collected
from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.ranks import summed
from dolfinx_signorini.meshes.sided_meshes import owned_cells


def contact_changes(
    released: tuple[fem.Function, fem.Function],
    caught: tuple[fem.Function, fem.Function],
    parents: LocalIndices,
) -> Array:
    """Return what the two sums add on each owned cell of the undivided mesh; collective.

    Args:
        released: The forces F and the function I z, on the undivided mesh.
        caught: The forces G and the function w - u_h, on the divided mesh.
        parents: For each owned cell of the divided mesh the undivided cell around the cell.
    """
    coarse, fine = _products(*released), _products(*caught)
    return np.asarray(coarse + collected(fine, parents, len(coarse), 1.0))


def _products(forces: fem.Function, moved: fem.Function) -> Array:
    """The sizes of force times movement, shared evenly by the owned cells of each dof."""
    space = forces.function_space
    cells = space.dofmap.list[: len(owned_cells(space.mesh))]
    number = summed(space.dofmap.index_map, cells)
    shares = np.abs(forces.x.array * moved.x.array) / np.maximum(number, 1.0)
    return np.asarray(shares[cells].sum(axis=1))
