"""Negative contact pressure inside of facets: gaps that are narrower than the distance of nodes.

An obstacle pushes and never pulls. The forces on the dofs in contact are not negative, and yet the
density of the pressure may be negative between the dofs: there the contact set has a gap that is
narrower than the distance of the dofs. Two solutions that both hold the facet do not show the gap.
If the density is -q on a part of the length 2 a, the solution leaves the obstacle by up to q a, as
a crack of this length is opened by the stress q, and its derivatives are wrong by about q, as far
from the facet as the part is long.

The density is the function of the space whose products with the basis functions, integrated over
the contact boundary, are the contact forces. The density has an error of its own, which its
difference to its interpolation on the undivided mesh shows: so much below 0 does not count. Facets
with Dirichlet data are left out: the forces on their dofs are those of the data, too.

Source: Sneddon, The distribution of stress in the neighbourhood of a crack in an elastic solid,
Proc. R. Soc. Lond. A 187 (1946) 229-260.
"""

import math

import basix
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.accuracy.cells import collected
from dolfinx_signorini.accuracy.contact_ends import contact_on_facets, facet_lattice
from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.ranks import marked, summed
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.quadrature import QuadratureRule
from dolfinx_signorini.meshes.refinement import Transfer
from dolfinx_signorini.meshes.sided_meshes import facet_scale, facet_vertices, owned_cells
from dolfinx_signorini.norms.names import Norm
from dolfinx_signorini.problem.signorini import SignoriniProblem

DOUBT = 2.0  # times the difference to the interpolation: more than the error of the density
TOLERANCE = 1e-8  # of the density: what the iteration may leave
ITERATIONS = 100  # at most; 5 to 15 are needed


def negative_pressure(problem: SignoriniProblem, transfer: Transfer, norm: Norm) -> Array:
    """Return what gaps between dofs in contact add to the error on each owned cell.

    Args:
        problem: The solved problem, on the divided mesh; the call is collective.
        transfer: Between the space on the undivided mesh and that of the problem.
        norm: An L^p or W^{1,p} norm of the domain.
    """
    space, domain = problem.space, problem.space.mesh
    dim, count = domain.topology.dim, len(owned_cells(domain))
    pairs, dofs, touching = contact_on_facets(problem)
    fixed = marked(space, problem.fixed_dofs)[dofs]
    held = touching.any(axis=1) & ~fixed.any(axis=1)
    if not problem.comm.allreduce(bool(held.any()), op=MPI.LOR):
        return np.zeros(count)
    density, error = pressure_density(problem), fem.Function(space)
    error.x.array[:] = density.x.array - transfer.prolong(transfer.restrict(density)).x.array
    lattice = facet_lattice(space)
    points = Points(domain, pairs[held], lattice)
    (pressure,), (unsure,) = (points.values(f) for f in (density, error))
    negative = pressure < 0.0
    lack = np.where(negative, -pressure, 0.0).max(axis=1, initial=0.0)
    lack -= DOUBT * np.abs(unsure).max(axis=1, initial=0.0)
    size = facet_scale(domain, pairs[held]) * negative.mean(axis=1)
    rim = np.column_stack((1.0 - lattice.sum(axis=1), lattice)).min(axis=1) < SOLVED
    across = negative[:, rim].any(axis=1)  # the facet beside has a part of the gap, too
    length = size ** (1.0 / (dim - 1.0)) * np.where(across, 2.0, 1.0)
    parts = np.maximum(lack, 0.0) * (1.0 if norm.derivatives else 0.5 * length)
    if not math.isinf(norm.p):
        parts *= length ** (dim / norm.p)
    return collected(parts, pairs[held, 0], count, norm.p)


def pressure_density(problem: SignoriniProblem) -> fem.Function:
    """Return the density of the contact pressure, a function of the space on the contact boundary.

    Unlike `SignoriniProblem.pressure`, a mean around each dof that is nowhere negative, the density
    is as accurate as the degree allows. On facets with Dirichlet data the density is known roughly.

    Args:
        problem: The solved problem; the call is collective.
    """
    space = problem.space
    pairs, dofs, _ = contact_on_facets(problem)
    mass = _BoundaryMass(space, pairs, dofs)
    # The density at dofs with Dirichlet data is taken to be the mean at the dofs beside them.
    forces, weights = problem.forces.x.array, mass.matrices.sum(axis=2)
    free = ~marked(space, problem.fixed_dofs)[dofs]
    force, weight = ((free * f[dofs]).sum(axis=1) for f in (forces, mass.summed(weights)))
    mean = np.divide(force, weight, out=np.zeros_like(force), where=weight > 0.0)
    density = fem.Function(space)
    unknown = np.where(free, 0.0, mean[:, None] * weights)
    density.x.array[:] = mass.divided(forces + mass.summed(unknown))
    return density


class _BoundaryMass:
    """The products of basis functions, integrated over contact facets: a matrix facet by facet.

    Args:
        space: The space; the call is collective.
        pairs: The owned contact facets as (cell, local facet) pairs.
        dofs: The dofs of these facets, shape (facets, dofs of a facet).

    Attributes:
        matrices: The products on each facet, shape (facets, dofs, dofs).
    """

    def __init__(self, space: fem.FunctionSpace, pairs: LocalIndices, dofs: LocalIndices):
        sizes: Array = facet_scale(space.mesh, pairs)
        self.dofs, self._space = dofs, space
        self.matrices: Array = sizes[:, None, None] * _facet_masses(space)[pairs[:, 1]]

    def summed(self, values: Array) -> Array:
        """Return for each dof the sum of the values that facets of all ranks have for the dof."""
        return summed(self._space.dofmap.index_map, self.dofs, values)

    def divided(self, rest: Array) -> Array:
        """Return the dofs of the function whose products with the basis functions are given.

        By conjugate gradients: the inverses on facets, with the mean at dofs of several facets, are
        so near to the inverse that the steps are few.

        Args:
            rest: The products of all dofs of this rank; 0 away from the facets.
        """
        inverses: Array = np.asarray(np.linalg.inv(self.matrices), dtype=np.float64)
        shares = 1.0 / np.maximum(self.summed(np.ones(self.dofs.shape)), 1.0)
        x, step = np.zeros_like(rest), np.zeros_like(rest)
        first = size = 0.0
        for _ in range(ITERATIONS):
            better = shares * self._applied(inverses, shares * rest)
            last, size = size, self._dot(rest, better)
            first = first or size
            if size <= TOLERANCE**2 * first:
                break
            step = better + (size / last if last else 0.0) * step
            image = self._applied(self.matrices, step)
            share = size / self._dot(step, image)
            x, rest = x + share * step, rest - share * image
        return x

    def _applied(self, matrices: Array, x: Array) -> Array:
        return self.summed((matrices @ x[self.dofs][:, :, None])[:, :, 0])

    def _dot(self, x: Array, y: Array) -> float:
        owned = self._space.dofmap.index_map.size_local
        return float(self._space.mesh.comm.allreduce(float(x[:owned] @ y[:owned])))


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
