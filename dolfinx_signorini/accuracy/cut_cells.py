"""Cut cells, inside of which the diffusion jumps: errors that no comparison of solutions shows.

Across a jump the normal flux of the solution u is continuous, and the normal derivative jumps. No
polynomial w follows: in a cell that is cut, the derivative along the normal n is wrong on both
sides. The flux is in equilibrium on average, so that sigma, the projection of n.A grad w on
polynomials of the degree of grad w, is close to n.A grad u, and

    (sigma - n.A grad w) / (n.A n) n    is close to    grad (u - w).

Where the cell is much stiffer than its neighbours, the flux of the neighbours stands for sigma. On
both sides of the cell the solutions are apart by the integral of this error along the normal. What
that means elsewhere, the solution for cells that are strained by this error tells.
"""

import math

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_signorini.accuracy.cells import summed_at_vertices, volumes
from dolfinx_signorini.accuracy.marking import NOTABLE
from dolfinx_signorini.accuracy.targets import Target, size
from dolfinx_signorini.accuracy.terms import Solved
from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.ranks import function_with
from dolfinx_signorini.base.tolerances import SOLVED, TINY
from dolfinx_signorini.data.coefficients import Coefficients
from dolfinx_signorini.data.interfaces.interface import interfaces
from dolfinx_signorini.data.interfaces.jumps import cut_cells
from dolfinx_signorini.data.interfaces.pieces import inside
from dolfinx_signorini.meshes.jacobians import spanned
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.polynomials import polynomials
from dolfinx_signorini.meshes.quadrature import QuadratureRule, interior_rule
from dolfinx_signorini.meshes.sided_meshes import cell_edges, owned_cells
from dolfinx_signorini.norms.power_sums import collected, p_norm, total
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem

SPREAD = 1.7  # times what cut cells add: the cells around have part in the error, as measured


def cut_errors(solved: Solved, data: Coefficients) -> Array:
    """Return what each owned cell adds to the error, if jumps of the diffusion cut the cell.

    The parts add up with the power of the target.

    Args:
        solved: The two solutions; the call is collective.
        data: The coefficients of the finer problem.
    """
    problem, target = solved.fine, solved.target
    comm, errors = problem.comm, np.zeros(len(solved.parents))
    nothing = np.zeros(solved.count)
    if not interfaces(*data.entries):
        return nothing
    cuts = _Cuts(problem, data)
    if not comm.allreduce(len(cuts.cells)):
        return nothing
    slopes, norm = cuts.errors(), target.norm
    if norm is None or norm.derivatives < 1:
        strains = cuts.integrals(slopes[..., None] * cuts.normals) / cuts.volumes[:, None]
        steps = np.linalg.norm(strains, axis=1) * cuts.widths()
        if target.weighted:
            parts = np.linalg.norm(strains, axis=1) * cuts.volumes
            whole = total(parts, 1.0, comm) or 1.0
            found = parts / whole * cuts.distance(strains, steps, target)
        else:
            found = np.maximum(
                steps, 0.5 * cuts.integrals(np.abs(slopes)) / cuts.volumes * cuts.widths()
            )
    else:
        sizes = p_norm(slopes[..., None] * cuts.normals, norm.p)
        pieces = p_norm(sizes.T, norm.p, cuts.weights.T)
        found = collected(pieces, cuts.owners, len(cuts.cells), norm.p)
    errors[cuts.cells] = found
    return SPREAD * collected(errors, solved.parents, solved.count, target.power)


class _Cuts:
    """The points of cells that are cut, shape (points of a piece, pieces), and functions at points.

    Attributes:
        cells: The cells that are cut.
        normals: The normals of the jump at the points, shape (points, pieces, dimension).
        across: n.A n.
    """

    def __init__(self, problem: BoundConstrainedProblem, data: Coefficients):
        self.domain, self.problem = problem.space.mesh, problem
        self.u, self.space, self.data = problem.u, problem.space, data
        element = self.space.element.basix_element
        dim, self.degree = self.domain.topology.dim, element.degree
        pieces, owners = cut_cells(data.entries, self.domain, self.degree)
        cells, self.owners = np.unique(owners, return_inverse=True)
        self.cells = cells.astype(np.int32)
        rule = interior_rule(element.cell_type, 2 * self.degree)
        points, weights = rule.points(element.cell_type)
        places = inside(pieces, points)
        self.reference, self.x = places[..., :dim], places[..., dim:]
        edges = (pieces[:, 1:] - pieces[:, :1])[..., dim:]
        self.weights = spanned(edges) * weights[:, None]
        self.edges = cell_edges(self.domain, self.cells)
        self.normals = self._normals()
        A = data.diffusion_at(self.x)
        self.fluxes = np.einsum("ij...,...j->...i", A, self.normals)  # A n
        self.across = (self.fluxes * self.normals).sum(axis=2)
        self.volumes = self.integrals(np.ones_like(self.across))

    def _normals(self) -> Array:
        """The normals of the jumps; zero where none is found."""
        result = np.zeros_like(self.x)
        for interface in interfaces(*self.data.entries):  # what is inside of a formula comes last
            values = interface.values(self.x)
            above, below = (self.largest(side) > 0.0 for side in (values, -values))
            slope = interface.gradients(self.x)
            length = np.linalg.norm(slope, axis=2)
            there = (above & below)[self.owners] & (length > 0.0)
            result[there] = slope[there] / length[there][:, None]
        return result

    def errors(self) -> Array:
        """The errors of the derivative of the solution along the normals."""
        points = Points(self.domain, self.cells[self.owners], np.swapaxes(self.reference, 0, 1))
        flux = np.einsum("ipq,qpi->qp", points.gradients(self.u)[0], self.fluxes)
        beside = np.einsum("qpi,pi->qp", self.normals, self._beside()[self.owners])
        means, known = (self.integrals(f) / self.volumes for f in (flux, beside))
        noisy = np.abs(means - known) > NOTABLE * np.abs(known)
        sigma = np.where(noisy[self.owners], beside, self._projected(flux))
        with np.errstate(all="ignore"):
            errors = (sigma - flux) / self.across
        return np.where(self.across > 0.0, errors, 0.0)

    def _projected(self, values: Array) -> Array:
        """The projection on polynomials of the degree of the derivatives, cell by cell."""
        dim = self.reference.shape[2]
        basis = polynomials(dim, self.degree - 1, self.reference)
        scale = volumes(self.domain)[self.cells] / math.factorial(dim)
        moments = np.array([self.integrals(values * f) / scale for f in basis])
        return np.asarray((moments[:, None, self.owners] * basis).sum(axis=0))

    def widths(self) -> Array:
        """The widths of the cells along their normals."""
        means = self.integrals(self.normals)
        means /= np.maximum(np.linalg.norm(means, axis=1), TINY)[:, None]
        along = np.einsum("cij,ci->cj", self.edges, means)
        return along.max(axis=1, initial=0.0) - along.min(axis=1, initial=0.0)

    def largest(self, values: Array) -> Array:
        """The largest values on the cells."""
        return collected(values.max(axis=0), self.owners, len(self.cells), math.inf)

    def integrals(self, values: Array) -> Array:
        """The integrals over the cells of a function, or of several side by side."""
        sums = np.einsum("qp,qp...->p...", self.weights, values)
        result = np.zeros((len(self.cells), *sums.shape[1:]))
        np.add.at(result, self.owners, sums)
        return result

    def distance(self, strains: Array, steps: Array, target: Target) -> float:
        """The size of what the solution moves by when the cells that are cut are strained.

        Args:
            strains: The mean error of the gradient in each of the cells.
            steps: The step of the solution across each of them. Far from the cells the solution
                moves by about the mean step, and near one of them by its step.
            target: The norm or functional.
        """
        stiff = self.integrals(self.across) / self.volumes
        dim, cells, norm = strains.shape[1], self.cells, target.norm
        space = fem.functionspace(self.domain, ("DG", 0, (dim,)))
        forces = function_with(space, space.dofmap.list[cells, 0], stiff[:, None] * strains)
        v = ufl.TestFunction(self.space)
        rule = QuadratureRule("default", self.degree - 1)
        load = ufl.inner(forces, ufl.grad(v)) * ufl.dx(metadata=rule.metadata)
        movement, _ = self.problem.solve_linearised(load, SOLVED)
        moved = size(movement, target)
        if norm is None or norm.boundary:
            return moved
        comm, widths = self.domain.comm, self.widths()
        areas = self.volumes / np.where(widths > 0.0, widths, np.inf)
        sizes = volumes(self.domain) / math.factorial(dim)
        mean = total(areas * steps, 1.0, comm) / (total(areas, 1.0, comm) or 1.0)
        far = mean * total(sizes, 1.0, comm) ** (1.0 / norm.p)
        near = total(steps * self.volumes ** (1.0 / norm.p), norm.p, comm)
        return min(moved, math.hypot(far, near))

    def _beside(self) -> Array:
        """The flux next to the cells that are cut: a mean over cells that are not."""
        count = len(owned_cells(self.domain))
        whole = np.ones(count, dtype=bool)
        whole[self.cells] = False
        cells = np.flatnonzero(whole).astype(np.int32)
        dim = self.domain.topology.dim
        middles = Points(self.domain, cells, np.full((1, dim), 1.0 / (dim + 1.0)))
        A = self.data.diffusion_at(np.stack(middles.x, axis=2))
        fluxes = np.einsum("ijcq,jcq->ic", A, middles.gradients(self.u)[0])
        # Errors of the flux are smallest where A is small.
        weights = volumes(self.domain)[cells] / np.trace(A)[:, 0]
        values = weights, *(weights * fluxes)
        sums = np.array([summed_at_vertices(self.domain, f, cells) for f in values])
        around = sums[:, self.domain.geometry.dofmap[self.cells]].sum(axis=2)
        return np.asarray((around[1:] / np.where(around[0] > 0.0, around[0], np.inf)).T)
