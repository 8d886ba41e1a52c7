"""Facets that are held in contact, although the obstacle would have to pull there.

An obstacle pushes and never pulls. Where all dofs of a facet are in contact, the forces on them are
not negative, and yet the density of the pressure may be negative between them: there the contact
set has a gap that is narrower than the distance of the dofs. Two solutions that both hold the facet
do not show the gap. If the density is -q on a part of the length 2 a, the solution leaves the
obstacle by up to q a, as a crack of this length is opened by the stress q, and its derivatives are
wrong by about q, as far from the facet as the part is long.

The density is the function of the space whose products with the basis functions, integrated over
the contact boundary, are the contact forces. The density has an error of its own, which its
difference to its interpolation on the undivided mesh shows: so much below 0 does not count.

Source: Sneddon, The distribution of stress in the neighbourhood of a crack in an elastic solid,
Proc. R. Soc. Lond. A 187 (1946) 229-260.
"""

import math

import basix
import numpy as np
from dolfinx import fem, la
from mpi4py import MPI

from dolfinx_signorini.accuracy.cells import Array, Indices, collected
from dolfinx_signorini.accuracy.contact_ends import contact_on_facets, facet_lattice
from dolfinx_signorini.meshes import facet_scale, facet_vertices, owned_cells
from dolfinx_signorini.norm_names import Norm
from dolfinx_signorini.points import Points
from dolfinx_signorini.problem import SignoriniProblem
from dolfinx_signorini.quadrature import QuadratureRule
from dolfinx_signorini.refinement import Transfer

DOUBT = 2.0  # times the difference to the interpolation: the error of the density
TOLERANCE = 1e-8  # of the density: what the iteration may leave
ITERATIONS = 100  # at most; 5 to 15 are needed
ROUNDING = 1e-9  # of coordinates in the reference facet


def pulls(problem: SignoriniProblem, transfer: Transfer, norm: Norm) -> Array:
    """Return what gaps in held facets add to the error on each owned cell.

    Args:
        problem: The solved problem, on the divided mesh; the call is collective.
        transfer: Between the space on the undivided mesh and that of the problem.
        norm: An L^p or W^{1,p} norm of the domain.
    """
    domain = problem.space.mesh
    pairs, dofs, touching = contact_on_facets(problem)
    held, count = touching.all(axis=1), len(owned_cells(domain))
    if not problem.comm.allreduce(bool(held.any()), op=MPI.LOR):
        return np.zeros(count)
    density = _density(problem.forces, pairs, dofs)
    lattice = facet_lattice(problem.space)
    points = Points(domain, pairs[held], lattice)
    error = fem.Function(problem.space)
    error.x.array[:] = density.x.array - transfer.prolong(transfer.restrict(density)).x.array
    (pressure,), (unsure,) = (points.values(f) for f in (density, error))
    negative = pressure < 0.0
    excess = np.maximum(-pressure, 0.0).max(axis=1, initial=0.0)
    excess -= DOUBT * np.abs(unsure).max(axis=1, initial=0.0)
    dim = domain.topology.dim
    size = facet_scale(domain, pairs[held]) * negative.mean(axis=1)
    rim = np.column_stack((1.0 - lattice.sum(axis=1), lattice)).min(axis=1) < ROUNDING
    across = negative[:, rim].any(axis=1)  # a gap in the neighbours, too
    length = size ** (1.0 / (dim - 1.0)) * np.where(across, 2.0, 1.0)
    parts = np.maximum(excess, 0.0) * (1.0 if norm.derivatives else 0.5 * length)
    if not math.isinf(norm.p):
        parts *= length ** (dim / norm.p)
    return collected(parts, pairs[held, 0], count, norm.p)


def _density(forces: fem.Function, pairs: Indices, dofs: Indices) -> fem.Function:
    """The density of forces on dofs, a function of their space on the contact boundary.

    The mass matrix of the boundary is inverted by conjugate gradients. The inverses on facets, with
    the mean at dofs of several facets, are so near to the inverse that the steps are few.

    Args:
        forces: The forces.
        pairs: The owned contact facets as (cell, local facet) pairs.
        dofs: The dofs of these facets, shape (facets, dofs of a facet).
    """
    space = forces.function_space
    comm, owned = space.mesh.comm, space.dofmap.index_map.size_local
    sizes: Array = facet_scale(space.mesh, pairs)
    masses: Array = sizes[:, None, None] * _facet_masses(space)[pairs[:, 1]]
    inverses: Array = np.asarray(np.linalg.inv(masses), dtype=np.float64)
    carrier = fem.Function(space)

    def summed(values: Array) -> Array:
        carrier.x.array[:] = np.bincount(dofs.ravel(), values.ravel(), len(carrier.x.array))
        carrier.x.scatter_reverse(la.InsertMode.add)
        carrier.x.scatter_forward()
        return np.array(carrier.x.array)

    def applied(matrices: Array, x: Array) -> Array:
        return np.asarray((matrices @ x[dofs][:, :, None])[:, :, 0])

    def dot(x: Array, y: Array) -> float:
        return float(comm.allreduce(float(x[:owned] @ y[:owned])))

    shares = 1.0 / np.maximum(summed(np.ones(dofs.shape)), 1.0)
    rest, x, step = np.array(forces.x.array), np.zeros_like(shares), np.zeros_like(shares)
    begin = size = 0.0
    for _ in range(ITERATIONS):
        better = shares * summed(applied(inverses, shares * rest))
        last, size = size, dot(rest, better)
        begin = begin or size
        if size <= TOLERANCE**2 * begin:
            break
        step = better + (size / last if last else 0.0) * step
        image = summed(applied(masses, step))
        share = size / dot(step, image)
        x, rest = x + share * step, rest - share * image
    density = fem.Function(space)
    density.x.array[:] = x
    return density


def _facet_masses(space: fem.FunctionSpace) -> Array:
    """The products of the basis functions on each facet of the reference cell.

    Returns:
        The integrals over the facet, as a multiple of its size over that of the reference facet.
    """
    element, dim = space.element.basix_element, space.mesh.topology.dim
    facet = basix.cell.subentity_types(element.cell_type)[dim - 1][0]
    points, weights = QuadratureRule("default", 2 * element.degree).points(facet)
    corners = np.asarray(basix.geometry(element.cell_type))[facet_vertices(space.mesh)]
    masses = []
    for (first, *others), dofs in zip(corners, element.entity_closure_dofs[dim - 1], strict=True):
        places = first + points @ (np.array(others) - first)
        table = element.tabulate(0, places)[0][:, dofs, 0]
        masses.append(table.T @ (weights[:, None] * table))
    return np.array(masses)
