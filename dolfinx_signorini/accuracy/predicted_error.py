"""The error of a solution, predicted as a function.

The difference of a solution u_h and the solution w on the divided mesh comes from cells, and each
cell leaves a share of its part in the error of w, as its rate of convergence has it. With the terms
of the identity of the error, see `terms`, and the share s_i of a dof, the mean of those of the
cells around, the predicted error e solves

    a(e, v) = sum of s_i (R_i (v - I v)_i + F_w,i v_i) over the dofs i of the divided mesh
              - sum of s_j F_j (I v)_j over the dofs j of the undivided mesh

for all v that vanish where w is held. At dofs that w has caught, and at those of data that are not
known between the nodes, e is s_i (w - u_h)_i, and where both solutions meet known data 0. With all
shares 1 this is w - u_h. Errors of cells cancel and add up in e as they do in the solution.
"""

from dolfinx import fem

from dolfinx_signorini.accuracy.terms import Solved, difference, product
from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.ranks import averaged
from dolfinx_signorini.meshes.elements import component_arrays
from dolfinx_signorini.meshes.sided_meshes import owned_cells


def predicted_error(solved: Solved, shares: Array) -> fem.Function:
    """Return what divisions leave of the difference of two solutions; the call is collective.

    Args:
        solved: The two solutions.
        shares: What each owned cell of the undivided mesh leaves of its part.
    """
    fine, transfer = solved.fine, solved.transfer
    weights = at_dofs(fine.space, shares[solved.parents])
    load = product(solved.residual, weights)
    released = product(solved.coarse.forces, at_dofs(solved.coarse.u.function_space, shares))
    released.x.array[:] *= fine.sense
    released.x.array[:] += transfer.prolong.transposed(load).x.array
    load = difference(load, transfer.restrict.transposed(released))
    load.x.array[:] += product(solved.contact_forces, weights).x.array
    # Where the predicted error is held, these are its values.
    start = product(solved.error, weights)
    start.x.array[solved.met] = 0.0
    load = difference(load, solved.acting(start))
    correction, _ = fine.solve_linearised(load, released=solved.hardly_pressed)
    start.x.array[:] += correction.x.array
    return start


def at_dofs(space: fem.FunctionSpace, values: Array) -> fem.Function:
    """Return for each dof the mean of the values of the cells around; the call is collective.

    Args:
        space: The space.
        values: One value for each owned cell.
    """
    result, dofs = fem.Function(space), space.dofmap.list[: len(owned_cells(space.mesh))]
    means = averaged(space.dofmap.index_map, dofs, values[:, None])
    for part in component_arrays(result):
        part[:] = means
    return result
