"""The cells at corners of the domain, and the exponents of the distance that solutions have there.

Around a corner of a domain in the plane, or an edge of one in space, a solution is like r^a where
the angle and the conditions on both sides tell the exponent, see `norms.orders`. A side in contact
has given values, as a Dirichlet side, and a contact side that touches nothing is a Neumann side.

Sources: Grisvard, Elliptic Problems in Nonsmooth Domains (1985), Theorem 4.4.3.7; Dauge, Elliptic
Boundary Value Problems on Corner Domains (1988), for edges.
"""

import math

import numpy as np
from dolfinx import common, mesh

from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.ranks import largest, marked, summed
from dolfinx_signorini.data.coefficients import Coefficients
from dolfinx_signorini.data.formulas import evaluated
from dolfinx_signorini.meshes.angles import cell_angles
from dolfinx_signorini.meshes.elements import facet_dofs
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, facet_cells, owned_cells
from dolfinx_signorini.norms.orders import SMOOTH, corner_exponents
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem

JUMP = 2.0  # the ratio of diffusions in cells around a corner: a smooth one changes less


def exponents_at_corners(problem: BoundConstrainedProblem, known: Coefficients) -> Array:
    """Return for each owned cell the least exponent at one of its corners; collective.

    Args:
        problem: The solved problem.
        known: The coefficients of the problem.

    Returns:
        The exponents; `SMOOTH` for cells without a corner, and where the diffusion is not known or
        jumps at the corner, for then the angle alone does not tell the exponent. Those of elastic
        bodies depend on the material, too, and are not known.
    """
    domain = problem.space.mesh
    if problem.space.dofmap.bs > 1:
        return np.full(len(owned_cells(domain)), SMOOTH)
    facets, every = boundary_facets(domain), owned_cells(domain)
    on_facets, on_cells = (
        _corners(domain, codim)[owned] for codim, owned in ((1, facets), (0, every))
    )
    places = domain.topology.index_map(domain.topology.dim - 2)
    held, contact = _conditions(problem, facets)
    everywhere = np.ones(len(facets), dtype=bool)
    boundary, given, free, other = (
        summed(places, on_facets[chosen]) > 0.0 for chosen in (everywhere, held, ~held, ~contact)
    )
    cells = every[boundary[on_cells].any(axis=1)]
    on_cells, tensors = on_cells[cells], _diffusion(domain, known, cells)
    angles = seen = summed(places, on_cells, cell_angles(domain, cells))
    if tensors is not None:
        seen = summed(places, on_cells, cell_angles(domain, cells, tensors))
        boundary &= _spread(places, on_cells, np.trace(tensors, axis1=1, axis2=2)) < JUMP
    # Contact sides are of one kind, in contact or not, see `corner_exponents`.
    exponents = corner_exponents(angles, seen, given & free & other)
    exponents[~boundary] = SMOOTH
    result = np.full(len(every), SMOOTH)
    result[cells] = exponents[on_cells].min(axis=1, initial=SMOOTH)
    return result


def _corners(domain: mesh.Mesh, codim: int) -> LocalIndices:
    """The corners of cells, or of facets, which are vertices in the plane and edges in space."""
    topology, tdim = domain.topology, domain.topology.dim
    dim = tdim - codim
    topology.create_connectivity(dim, tdim - 2)
    links = topology.connectivity(dim, tdim - 2).array
    return links.reshape(-1, math.comb(dim + 1, tdim - 1))


def _spread(places: common.IndexMap, on_cells: LocalIndices, values: Array) -> Array:
    """The ratio of the largest and the least of positive values that cells have around places."""
    here, sizes = on_cells.ravel(), np.repeat(values, on_cells.shape[1])
    with np.errstate(all="ignore"):
        return largest(places, here, sizes) * largest(places, here, 1.0 / sizes)


def _conditions(problem: BoundConstrainedProblem, facets: LocalIndices) -> list[Mask]:
    """Whether the values on boundary facets are given, by data or contact; and contact facets."""
    space, layout = problem.space, problem.system.layout
    on_facets = facet_dofs(space, facet_cells(space.mesh, facets))
    given = np.concatenate([layout.fixed_dofs, problem.active])
    contact = layout.obstacle_dofs[: 0 if problem.in_domain else None]
    return [np.all(marked(space, dofs)[on_facets], axis=1) for dofs in (given, contact)]


def _diffusion(domain: mesh.Mesh, known: Coefficients, cells: LocalIndices) -> Array | None:
    """The diffusion tensors in the middles of cells; None for the identity."""
    if not known.diffusion:
        return None
    dim = domain.topology.dim
    middles = domain.geometry.x[domain.geometry.dofmap[cells]].mean(axis=1)[:, :dim]
    found = [[evaluated(entry.root, middles) for entry in row] for row in known.diffusion]
    if len(known.entries) == 1:
        return np.multiply.outer(found[0][0], np.eye(dim))
    return np.moveaxis(np.array(found), 2, 0)
