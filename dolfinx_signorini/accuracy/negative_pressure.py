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
with Dirichlet data show no gap: the forces on their dofs are those of the data, too.

Source: Sneddon, The distribution of stress in the neighbourhood of a crack in an elastic solid,
Proc. R. Soc. Lond. A 187 (1946) 229-260.
"""

import math

import basix
import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.accuracy.cells import collected
from dolfinx_signorini.accuracy.contact_ends import contact_on_facets, facet_lattice
from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.ranks import marked
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.quadrature import QuadratureRule
from dolfinx_signorini.meshes.refinement import Transfer
from dolfinx_signorini.meshes.sided_meshes import facet_scale, facet_vertices, owned_cells
from dolfinx_signorini.norms.names import Norm
from dolfinx_signorini.problem.signorini import SignoriniProblem

DOUBT = 2.0  # times the difference to the interpolation: more than the error of the density


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
    is as accurate as the degree allows: its products with the basis functions are the forces. At
    dofs with Dirichlet data the contact force is not known, and the density is the one whose part
    of the highest degree is smallest on the facets around.

    Args:
        problem: The solved problem; the call is collective.
    """
    space, comm = problem.space, problem.comm
    pairs, dofs, _ = contact_on_facets(problem)
    owned, density = problem.system.layout.boundary_dofs, fem.Function(space)
    first = sum(comm.allgather(len(owned))[: comm.rank])
    density.x.array[owned] = np.arange(first, first + len(owned))
    density.x.scatter_forward()
    places = density.x.array[dofs].astype(PETSc.IntType)
    sizes = facet_scale(space.mesh, pairs)[:, None, None]
    masses, highest = (sizes * products[pairs[:, 1]] for products in _facet_products(space))
    fixed = marked(space, problem.fixed_dofs)
    # With a share of the masses the dofs at corners where two facets meet are determined, too.
    rows = np.where(fixed[dofs][:, :, None], highest + SOLVED * masses, masses)
    matrix = PETSc.Mat().create(comm)
    matrix.setSizes(((len(owned), None), (len(owned), None)))
    matrix.setType(PETSc.Mat.Type.AIJ)
    matrix.setUp()
    starts = np.arange(0, rows.size + 1, rows.shape[2], dtype=PETSc.IntType)
    columns = np.broadcast_to(places[:, None, :], rows.shape).ravel()
    add = PETSc.InsertMode.ADD
    matrix.setValuesIJV(starts, columns, rows.ravel(), addv=add, rowmap=places.ravel())
    matrix.assemble()
    x, forces = matrix.createVecs()
    forces.array_w[:] = np.where(fixed[owned], 0.0, problem.forces.x.array[owned])
    ksp = PETSc.KSP().create(comm)
    ksp.setType(PETSc.KSP.Type.PREONLY)
    ksp.getPC().setType(PETSc.PC.Type.LU)
    ksp.getPC().setFactorSolverType("mumps")
    ksp.setOperators(matrix)
    ksp.solve(forces, x)
    density.x.array[owned] = x.array_r
    density.x.scatter_forward()
    for item in (matrix, x, forces, ksp):
        item.destroy()
    return density


def _facet_products(space: fem.FunctionSpace) -> tuple[Array, Array]:
    """The products of the basis functions, and of their parts of the highest degree, on facets.

    Returns:
        For each facet of the reference cell the integrals over the facet, as a multiple of its size
        over that of the reference facet.
    """
    element, dim = space.element.basix_element, space.mesh.topology.dim
    facet = basix.cell.subentity_types(element.cell_type)[dim - 1][0]
    points, weights = QuadratureRule("default", 2 * element.degree).points(facet)
    legendre = basix.PolynomialType.legendre
    lower = basix.tabulate_polynomials(legendre, facet, element.degree - 1, points)
    corners = np.asarray(basix.geometry(element.cell_type))[facet_vertices(space.mesh)]
    masses, highest = [], []
    for (first, *others), dofs in zip(corners, element.entity_closure_dofs[dim - 1], strict=True):
        places = first + points @ (np.array(others) - first)
        table = element.tabulate(0, places)[0][:, dofs, 0]
        known = lower @ (weights[:, None] * table)
        masses.append(table.T @ (weights[:, None] * table))
        highest.append(masses[-1] - known.T @ known)
    return np.array(masses), np.array(highest)
