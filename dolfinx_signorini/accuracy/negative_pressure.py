"""Negative contact pressure inside of facets: gaps that are narrower than the distance of nodes.

An obstacle pushes and never pulls. The forces on the dofs in contact are not negative, and yet the
density of the pressure, with the sign of the obstacle that holds a facet, may be negative between
the dofs: there the contact set has a gap that is narrower than the distance of the dofs. Two
solutions that both hold the facet do not show the gap.
If the density is -q on a part of the length 2 a, the solution leaves the obstacle by up to q a, as
a crack of this length is opened by the mean stress q, and its derivatives are wrong by about the
largest one, as far from the facet as the part is long.

The density is the function of the space whose products with the basis functions, integrated over
the contact boundary, are the contact forces. Where the pressure is like a root, at the ends of the
contact set, the density is below 0 by a share of its size on the cell, and so is the error there.
Facets with Dirichlet data show no gap: the forces on their dofs are those of the data, too.

Source: Sneddon, The distribution of stress in the neighbourhood of a crack in an elastic solid,
Proc. R. Soc. Lond. A 187 (1946) 229-260.
"""

import basix
import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from dolfinx_signorini.accuracy.contact_ends import (
    contact_on_entities,
    facet_lattice,
    shared_by_facets,
)
from dolfinx_signorini.accuracy.terms import Dual, Solved
from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.base.ranks import anywhere, highest, marked
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.meshes.elements import component_arrays
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.polynomials import depths
from dolfinx_signorini.meshes.quadrature import QuadratureRule
from dolfinx_signorini.meshes.sided_meshes import facet_scale, facet_vertices
from dolfinx_signorini.norms.pointwise import length
from dolfinx_signorini.norms.power_sums import collected
from dolfinx_signorini.problem.bound_constrained import Contact


def negative_pressure(solved: Solved, dual: Dual | None) -> Array:
    """Return what gaps between dofs in contact add to the error on each cell, see `terms.Term`.

    In a functional a gap counts by the force that holds the dual solution on the facet. The parts
    are zero for obstacles in the domain, where the load tells the pressure at each point.
    """
    problem, norm, zone = solved.fine, solved.target.norm, solved.fine.zones[-1]
    if zone.in_domain:  # facets come last
        return np.zeros((2, solved.count))
    space, domain = problem.system.layout.nodal, problem.space.mesh
    dim = domain.topology.dim
    pairs, dofs, touching = contact_on_entities(zone)
    fixed = marked(space, zone.held_nodes)[dofs]
    upper, both = _held_from_above(zone, dofs)
    held = touching.any(axis=1) & ~fixed.any(axis=1) & ~both
    if not anywhere(problem.comm, held):
        return np.zeros((2, solved.count))
    lattice = facet_lattice(space)
    (pressure,) = Points(domain, pairs[held], lattice).values(pressure_density(zone))
    pressure = np.where(upper[held, None], -pressure, pressure)
    negative = pressure < 0.0
    lack = np.maximum(-pressure, 0.0)
    largest, share = lack.max(axis=1, initial=0.0), negative.mean(axis=1)
    width = (facet_scale(domain, pairs[held]) * share) ** (1.0 / (dim - 1.0))
    rim = depths(lattice) < SOLVED
    across = negative[:, rim].any(axis=1)  # the facet beside has a part of the gap, too
    half = 0.5 * width * np.where(across, 2.0, 1.0)
    opened = half * lack.mean(axis=1) / np.where(share > 0.0, share, 1.0)
    if norm is None:
        assert dual is not None
        forces = shared_by_facets(space, pairs, np.abs(length(component_arrays(dual.forces))))
        parts = _compliance(solved) * half * largest * share * forces[held]
        on_cells = np.bincount(pairs[held, 0], parts, len(solved.parents))
        return solved.on_parents(np.array([on_cells, on_cells]))
    # Of order 1/2 between values and derivatives.
    parts = opened ** (1.0 - norm.derivatives) * largest**norm.derivatives
    parts *= width ** ((dim - norm.boundary) / norm.p) * solved.unit * _compliance(solved)
    return solved.in_norm(collected(parts, pairs[held, 0], len(solved.parents), norm.p))


def _held_from_above(zone: Contact, dofs: LocalIndices) -> tuple[Mask, Mask]:
    """Whether the second one of two obstacles holds a facet, and whether both do, by their dofs.

    Between two obstacles the pressure of the upper one is negative.
    """
    if len(zone.obstacles) < 2:
        return (np.zeros(len(dofs), dtype=bool),) * 2
    space = zone.normal_forces.function_space
    lower, upper = (marked(space, active)[dofs].any(axis=1) for active in zone.active_sides)
    return np.asarray(upper), np.asarray(lower & upper)


def _compliance(solved: Solved) -> float:
    """How far a crack opens, over what one opens that a scalar with the diffusion 1 has.

    This is one over the diffusion, as the difference of the solutions has it in the mean. In a body
    it is (1 - nu)/mu; taken is 1/mu if the volume does not change, and less otherwise.
    """
    comm, e = solved.fine.comm, fem.Function(solved.fine.space)
    vectors, owned = e.function_space.dofmap.bs > 1, solved.fine.system.A.getLocalSize()[0]
    slopes = ufl.sym(ufl.grad(e)) if vectors else ufl.grad(e)
    for known in (solved.error, solved.fine.u):  # the solutions may be equal
        largest = highest(comm, np.abs(known.x.array))
        e.x.array[:] = known.x.array / (largest or 1.0)  # squares stay in the range of numbers
        size = compiled.integral(ufl.inner(slopes, slopes) * ufl.dx)
        energy = comm.allreduce(float(solved.acting(e).x.array[:owned] @ e.x.array[:owned]))
        if energy > 0.0:
            return (2.0 if vectors else 1.0) * size / energy
    return 0.0


def pressure_density(zone: Contact) -> fem.Function:
    """Return the density of the contact pressure, a function of the space on the contact boundary.

    Unlike `SignoriniProblem.pressure`, a mean around each dof that is nowhere negative, the density
    is as accurate as the degree allows: its products with the basis functions are the forces. At
    dofs with Dirichlet data the contact force is not known, and the density is the one whose part
    of the highest degree is smallest on the facets around.

    Args:
        zone: The solved problem, or its contact boundary; the call is collective.
    """
    forces_at, owned = zone.normal_forces, zone.obstacle_nodes
    space = forces_at.function_space
    comm, (pairs, dofs, _) = space.mesh.comm, contact_on_entities(zone)
    density = fem.Function(space)
    first = sum(comm.allgather(len(owned))[: comm.rank])
    density.x.array[owned] = np.arange(first, first + len(owned))
    density.x.scatter_forward()
    places = density.x.array[dofs].astype(PETSc.IntType)
    sizes = facet_scale(space.mesh, pairs)[:, None, None]
    masses, highest = (sizes * products[pairs[:, 1]] for products in _facet_products(space))
    fixed = marked(space, zone.held_nodes)
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
    forces.array_w[:] = np.where(fixed[owned], 0.0, forces_at.x.array[owned])
    ksp = PETSc.KSP().create(comm)
    ksp.setType(PETSc.KSP.Type.PREONLY)
    ksp.getPC().setType(PETSc.PC.Type.LU)
    ksp.getPC().setFactorSolverType("mumps")
    ksp.setOperators(matrix)
    ksp.solve(forces, x)
    density.x.array[owned] = x.array_r
    density.x.scatter_forward()
    destroy(matrix, x, forces, ksp)
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
