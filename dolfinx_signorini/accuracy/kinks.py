"""Kinks of derivatives inside cells, from jumps and kinks of load and reaction, in the error.

Across a jump of f - c u the second derivative of the solution u along the normal n jumps as well,
by J = (jump of f - c u) / (n.A n), and across a kink the third derivative by K, with the jump of
the derivative of f - c u in place of that of f - c u. With the distance d from the jump, u is a
smooth function and

    J max(d, 0)^2 / 2 + K max(d, 0)^3 / 6.

What polynomials of the degree of the elements leave of this part is computed cell by cell. The
difference of the solutions on two meshes may be small there by chance, where a jump cuts off little
of a cell for example.
"""

import math

import basix
import numpy as np

from dolfinx_signorini.accuracy.cells import MAX_DEGREE
from dolfinx_signorini.accuracy.contact_ends import SAMPLES
from dolfinx_signorini.accuracy.terms import Solved
from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.data.coefficients import Coefficients
from dolfinx_signorini.data.derivatives import Derivative
from dolfinx_signorini.data.interfaces.interface import Interface, interfaces
from dolfinx_signorini.data.interfaces.jumps import broken_cells
from dolfinx_signorini.data.interfaces.pieces import inside
from dolfinx_signorini.meshes.jacobians import determinants, inverses
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.polynomials import equispaced
from dolfinx_signorini.meshes.quadrature import interior_rule
from dolfinx_signorini.meshes.sided_meshes import cell_corners, cell_edges
from dolfinx_signorini.norms.names import Norm
from dolfinx_signorini.norms.power_sums import p_norm
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem

NEARER = 0.85  # of what interpolation leaves, at most: measured 0.25 to 0.85


def kink_errors(solved: Solved, data: Coefficients) -> Array:
    """Return what jumps and kinks of load and reaction inside cells leave in a norm of the error.

    The parts of owned cells are zero where a dual solution looks at the boundary, or is that of a
    functional, and add up with the power of the target.

    Args:
        solved: The two solutions; the call is collective.
        data: The coefficients of the finer problem.
    """
    problem, norm = solved.fine, solved.target.norm
    if norm is None or (norm.boundary and solved.target.weighted):
        return np.zeros(solved.count)
    domain, errors = problem.space.mesh, np.zeros(len(solved.parents))
    formulas = [formula for formula in (data.load, data.reaction) if formula is not None]
    parts = interfaces(*formulas)
    if not parts:
        return np.zeros(solved.count)
    cells = broken_cells(formulas, domain).astype(np.int32)
    if len(cells):
        kinks = _Kinks(problem, cells, data, norm)
        # Parts of formulas may be zero at the same place: each tells the whole kink there.
        errors[cells] = np.max([kinks.left(interface) for interface in parts], axis=0)
    return solved.in_norm(errors)[1]


class _Kinks:
    """The cells that have jumps inside of them, and what elements leave of the kinks there."""

    def __init__(
        self,
        problem: BoundConstrainedProblem,
        cells: LocalIndices,
        data: Coefficients,
        norm: Norm,
    ):
        self.norm, self.data = norm, data
        domain, element = problem.space.mesh, problem.space.element.basix_element
        dim = domain.topology.dim
        self.edges = cell_edges(domain, cells)
        corners = cell_corners(domain, cells)
        kind, variant = element.cell_type, basix.LagrangeVariant.gll_warped
        nodal = basix.create_element(basix.ElementFamily.P, kind, element.degree, variant)
        points, self.weights = interior_rule(kind, MAX_DEGREE).points(kind)
        if math.isinf(norm.p):
            points = equispaced(dim, SAMPLES // 2)
        self.table = np.asarray(nodal.tabulate(1, points))[..., 0]
        self.nodes, self.samples = (
            inside(corners, np.array(places, dtype=np.float64)) for places in (nodal.points, points)
        )
        middles = Points(domain, cells, np.full((1, dim), 1.0 / (dim + 1.0)))
        self.u = middles.values(problem.u)[0][:, 0]

    def left(self, interface: Interface) -> Array:
        """What the elements leave on each cell of the kink at an interface."""
        values = interface.values(self.samples)
        crossed = np.flatnonzero((values.min(axis=0) < 0.0) & (values.max(axis=0) > 0.0))
        ends = [self.samples[at[crossed], crossed] for at in (values.argmin(0), values.argmax(0))]
        x = ends[0] + interface.zeros(*ends)[:, None] * (ends[1] - ends[0])
        nodes = self.nodes[:, crossed]
        edges, result = self.edges[crossed], np.zeros(values.shape[1])
        with np.errstate(all="ignore"):
            slope = interface.gradients(x)
            steep = np.linalg.norm(slope, axis=1)
            normal = slope / steep[:, None]
            jump, kink = self._jumps(interface, x, normal, self.u[crossed])
            nodes, samples = (
                np.maximum(level / steep, 0.0)
                for level in (interface.values(nodes), values[:, crossed])
            )
            polynomials = self.table @ (jump * nodes**2 / 2.0 + kink * nodes**3 / 6.0)
            if self.norm.derivatives:
                there = (jump * samples + kink * samples**2 / 2.0)[..., None] * normal
                followed = np.einsum("jpc,cji->pci", polynomials[1:], inverses(edges))
                found = np.linalg.norm(there - followed, axis=2)
            else:
                found = jump * samples**2 / 2.0 + kink * samples**3 / 6.0 - polynomials[0]
        found = np.where(np.isfinite(found).all(axis=0), found, 0.0)
        scale = np.abs(determinants(edges)) ** (1.0 / self.norm.p)
        result[crossed] = NEARER * scale * p_norm(found.T, self.norm.p, self.weights)
        return result

    def _jumps(
        self, interface: Interface, x: Array, normal: Array, u: Array
    ) -> tuple[Array, Array]:
        """The jumps of the second and third derivatives of the solution along normals at points."""
        across = np.einsum("ci,ijc,cj->c", normal, self.data.diffusion_at(x), normal)
        jump, kink = np.zeros((2, len(x)))
        for formula, factor in ((self.data.load, 1.0), (self.data.reaction, -u)):
            if formula is not None:
                jump += factor * interface.jump(formula.root, x)
                for k, along in enumerate(normal.T):
                    kink += factor * along * interface.jump(Derivative(k)(formula.root), x)
        return jump / across, kink / across
