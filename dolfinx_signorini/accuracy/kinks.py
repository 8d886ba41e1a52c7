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

from dolfinx_signorini.accuracy.cells import norms_of_sizes, shared_out, total
from dolfinx_signorini.accuracy.targets import Target
from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.data.coefficients import Coefficients
from dolfinx_signorini.data.derivatives import gradients
from dolfinx_signorini.data.formulas import Node, evaluated
from dolfinx_signorini.data.interfaces.jumps import broken_cells
from dolfinx_signorini.data.interfaces.pieces import inside
from dolfinx_signorini.data.interfaces.roughness import switches
from dolfinx_signorini.meshes.jacobians import inverses
from dolfinx_signorini.meshes.quadrature import interior_rule
from dolfinx_signorini.meshes.sided_meshes import cell_edges, owned_cells
from dolfinx_signorini.norms.names import Norm
from dolfinx_signorini.problem.signorini import SignoriniProblem

SAMPLES = 12  # along the edge of a cell
ONTO = 3  # steps of Newton's method from a point of a cell onto the jump
ASIDE = 1e-7  # of a cell: on both sides of a jump
BESIDE = 1e-4  # of a cell: how far from a kink slopes are taken
RULE = 20  # its degree, for integrals of functions with a kink
NEARER = 0.45  # of what interpolation leaves: measured 0.25 to 0.85


def kink_errors(problem: SignoriniProblem, data: Coefficients, target: Target) -> Array:
    """Return what jumps and kinks of load and reaction inside cells leave in a norm of the error.

    Args:
        problem: The problem, which has been solved; the call is collective.
        data: The coefficients of the problem.
        target: What is to be accurate.

    Returns:
        One value for each owned cell; 0 for cells without a jump or kink, and for functionals and
        norms of the boundary.
    """
    domain, norm = problem.space.mesh, target.norm
    errors = np.zeros(len(owned_cells(domain)))
    if norm is None or norm.boundary:
        return errors
    formulas = [formula for formula in (data.load, data.reaction) if formula is not None]
    parts = switches(*formulas)
    if not parts:
        return errors
    cells = broken_cells(formulas, domain).astype(np.int32)
    if len(cells):
        kinks = _Kinks(problem, cells, data, norm)
        # Parts of formulas may be zero at the same place: each tells the whole kink there.
        errors[cells] = np.max([kinks.left(node) for node in parts], axis=0)
    if target.weighted:
        return shared_out(errors, norm.p, total(errors, norm.p, domain.comm) or 1.0)
    return errors


class _Kinks:
    """The cells that have jumps inside of them, and what elements leave of the kinks there."""

    def __init__(
        self,
        problem: SignoriniProblem,
        cells: LocalIndices,
        data: Coefficients,
        norm: Norm,
    ):
        self.norm, self.data = norm, data
        domain, space = problem.space.mesh, problem.space
        element, dim = space.element.basix_element, domain.topology.dim
        self.edges = cell_edges(domain, cells)
        x = np.asarray(domain.geometry.x[:, :dim], dtype=np.float64)
        corners = x[domain.geometry.dofmap[cells]]
        self.size = np.linalg.norm(self.edges, axis=1).max(axis=1)
        kind, variant = element.cell_type, basix.LagrangeVariant.gll_warped
        nodal = basix.create_element(basix.ElementFamily.P, kind, element.degree, variant)
        points, self.weights = interior_rule(kind, RULE).points(kind)
        if math.isinf(norm.p):
            equispaced = basix.LatticeType.equispaced
            points = np.array(basix.create_lattice(kind, SAMPLES, equispaced, exterior=True))
        self.table = np.asarray(nodal.tabulate(1, points))[..., 0]
        self.nodes, self.samples = (
            inside(corners, np.array(places, dtype=np.float64)) for places in (nodal.points, points)
        )
        centre = np.full((1, dim), 1.0 / (dim + 1.0))
        middle = np.asarray(element.tabulate(0, centre))[0, 0, :, 0]
        self.u = problem.u.x.array[space.dofmap.list[cells]] @ middle

    def left(self, node: Node) -> Array:
        """What the elements leave on each cell of the kink where a part of a formula is zero.

        Args:
            node: The part, which decides by its sign what the formula chooses.
        """
        values = evaluated(node, self.samples)
        nearest = np.argmin(np.abs(values), axis=0)
        x = self.samples[nearest, np.arange(len(nearest))]
        with np.errstate(all="ignore"):
            for _ in range(ONTO):
                slope = gradients(node, x)
                steep = np.linalg.norm(slope, axis=1)
                normal = slope / steep[:, None]
                x = x - (evaluated(node, x) / steep)[:, None] * normal
            jump, kink = self._jumps(x, normal)
            nodes, samples = (
                np.maximum(evaluated(node, places) / steep, 0.0)
                for places in (self.nodes, self.samples)
            )
            polynomials = self.table @ (jump * nodes**2 / 2.0 + kink * nodes**3 / 6.0)
            if self.norm.derivatives:
                there = (jump * samples + kink * samples**2 / 2.0)[..., None] * normal
                followed = np.einsum("jpc,cji->pci", polynomials[1:], inverses(self.edges))
                found = np.linalg.norm(there - followed, axis=2)
            else:
                found = jump * samples**2 / 2.0 + kink * samples**3 / 6.0 - polynomials[0]
        crossed = (values.min(axis=0) < 0.0) & (values.max(axis=0) > 0.0)
        found = np.where(crossed & np.isfinite(found).all(axis=0), found, 0.0)
        return NEARER * norms_of_sizes([np.abs(found.T)], self.weights, self.edges, self.norm.p)

    def _jumps(self, x: Array, normal: Array) -> tuple[Array, Array]:
        """The jumps of the second and third derivatives of the solution along normals at points."""

        def right_side(steps: float) -> Array:
            return self._right_side(x + (steps * self.size)[:, None] * normal)

        jump = right_side(ASIDE) - right_side(-ASIDE)
        slopes_above, slopes_below = (
            (right_side(2.0 * step) - right_side(step)) / (step * self.size)
            for step in (BESIDE, -BESIDE)
        )
        entries = [[evaluated(entry.root, x) for entry in row] for row in self.data.diffusion]
        across: Array = np.asarray(entries[0][0] if entries else 1.0)
        if len(entries) > 1:
            across = np.einsum("ci,ijc,cj->c", normal, np.array(entries), normal)
        return jump / across, (slopes_above - slopes_below) / across

    def _right_side(self, x: Array) -> Array:
        """The values of f - c u at points."""
        f, c = (
            evaluated(formula.root, x) if formula is not None else np.zeros(len(x))
            for formula in (self.data.load, self.data.reaction)
        )
        return f - c * self.u
