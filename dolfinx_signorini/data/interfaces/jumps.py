"""Data that are not smooth inside cells: formulas with where, abs, sign, min, max, and with poles.

A quadrature rule integrates a load that jumps inside a cell with an error of the size of the jump,
and one like r^-0.8 still worse. In such cells the formula is replaced by its L2 projection on
polynomials, cell by cell, which has the same integrals with the basis functions. The integrals of
the projection are over pieces of the cell. The pieces are cut along the line or plane where the
formula jumps or has a kink, after divisions that make curves so flat that a cut leaves little, and
are divided next to a pole until the integrals over the cell do not change any more.
"""

import functools
import math
from collections.abc import Iterator, Sequence

import basix
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import mesh
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.ranks import function_with, highest
from dolfinx_signorini.base.tolerances import HALF_OF_THE_DIGITS, ROUNDING
from dolfinx_signorini.data.formulas import Formula, Node, evaluated, together
from dolfinx_signorini.data.interfaces.interface import crossed, interfaces, middles
from dolfinx_signorini.data.interfaces.pieces import (
    DEEPEST,
    MOST_PIECES,
    inside,
    relative_sizes,
    subdivide,
    widths,
    with_reference,
)
from dolfinx_signorini.data.interfaces.singular_sets import NEAR_POLE, is_singular, poles
from dolfinx_signorini.meshes.elements import discontinuous_space
from dolfinx_signorini.meshes.quadrature import MANY, QuadratureRule, interior_rule
from dolfinx_signorini.meshes.sided_meshes import cell_corners, longest_side, sampled

WIDTH = 5e-4  # of the domain: pieces that are not smooth are made smaller than that
MOST_AT_POLES = 3000  # the same: poles along lines have more pieces


def integrable(formula: Formula, domain: mesh.Mesh, degree: int) -> Expr:
    """Return a formula as an expression that quadrature rules integrate well.

    Args:
        formula: The formula.
        domain: A mesh of triangles or tetrahedra; the call is collective.
        degree: The degree of the polynomials with which the formula is going to be integrated.

    Returns:
        The formula itself, or where it is not smooth inside a cell, its projection on polynomials
        of the degree.
    """
    smooth = formula.ufl(ufl.SpatialCoordinate(domain))
    if not is_singular(formula):
        return smooth
    space = discontinuous_space(domain, degree)
    element = space.element.basix_element
    cells, values = Projection(formula, domain, element, cell_corners(domain)).coefficients()
    if not domain.comm.allreduce(len(cells)):
        return smooth
    steps = discontinuous_space(domain, 0)
    marks = function_with(steps, steps.dofmap.list[cells, 0], 1.0)
    projection = function_with(space, space.dofmap.list[cells], values)
    return ufl.conditional(ufl.gt(marks, 0.5), projection, smooth)


def cut_cells(formulas: Sequence[Formula], domain: mesh.Mesh, degree: int) -> tuple[Array, Indices]:
    """Return pieces of the cells inside of which formulas jump or have a kink.

    Args:
        formulas: The formulas.
        domain: A mesh of triangles or tetrahedra; the call is collective.
        degree: The degree of polynomials on the mesh; the pieces are small enough for them.

    Returns:
        The vertices of the pieces, shape (pieces, vertices, coordinates), with the coordinates in
        the reference cell and in space side by side, and the cells of the pieces.
    """
    cells = _Cells(domain, cell_corners(domain), formulas)
    broken = cells.broken()
    pieces, owners, _ = zip(*cells.pieces(broken, degree), strict=True)
    return np.concatenate(pieces), broken[np.concatenate(owners)]


def broken_cells(formulas: Sequence[Formula], domain: mesh.Mesh) -> Indices:
    """Return the owned cells inside of which formulas jump or have a kink.

    Args:
        formulas, domain: See `cut_cells`.
    """
    return _Cells(domain, cell_corners(domain), formulas).broken()


class _Cells:
    """Cells of a mesh, or facets, with the interfaces and poles of formulas that may be in them.

    A piece of a cell is given by its vertices, with the coordinates in the reference cell and in
    space side by side, and by the number of the cell.

    Args:
        domain: The mesh.
        corners: The vertices of the cells, shape (cells, vertices, coordinates).
        formulas: The formulas that jump or have a kink at interfaces.
        denominators: What is zero at poles.

    Attributes:
        tested: Points of the reference cell where a pole is looked for.
    """

    tested: Array

    def __init__(
        self,
        domain: mesh.Mesh,
        corners: npt.NDArray[np.floating],
        formulas: Sequence[Formula],
        denominators: Sequence[Node] = (),
    ):
        self.comm, self.formulas, self.poles = domain.comm, formulas, denominators
        self.curves = interfaces(*formulas)
        self.d, self.dimension = domain.geometry.dim, corners.shape[1] - 1
        self.whole = with_reference(corners[..., : self.d])
        self.size = longest_side(domain)

    def broken(self) -> Indices:
        """Return the cells that interfaces cross, or may do so."""
        return np.flatnonzero(self._near(self.whole)[0])

    def pieces(self, cells: Indices, degree: int) -> Iterator[tuple[Array, Indices, int]]:
        """Divide cells into pieces that interfaces do not cross, and small ones; collective.

        Pieces are cut along interfaces as soon as these are so flat that the cut leaves little.
        Next to a pole pieces are divided until that changes nothing, and what is left in the end is
        left out.

        Args:
            cells: The cells.
            degree: The degree of the elements.

        Yields:
            Pieces, the places of their cells among the cells, and how often these have been
            divided.
        """
        width = highest(self.comm, widths(self.whole[cells][..., self.dimension :]))
        order = 3 if degree > 1 else 2  # of the error of the solution, at best
        target = self.size * min(WIDTH, (width / self.size) ** order)
        sizes = self.sizes  # collective, and only some ranks have curved pieces

        def look(pieces: Array, owners: Indices, level: int) -> tuple[Mask, list[Mask]]:
            broken, polar, values = self._near(pieces)
            curved = self._curved(pieces, values, sizes)
            if width * 0.5**level <= target or self._count(curved) > MOST_PIECES:
                curved[:] = False
            settled = self._settled(pieces, owners, polar, curved)
            curved, split = curved & ~settled, polar & ~settled
            smallest = width * 0.5**level <= ROUNDING * self.size or level == DEEPEST
            kept = ~(split & smallest)
            if smallest or (self.poles and self._count(split) > MOST_AT_POLES):
                split[:] = False
            return split | curved, [kept & ~broken, kept & broken]

        levels = subdivide(self.whole[cells], np.arange(len(cells)), look, self.comm)
        for pieces, owners, level, (smooth, broken) in levels:
            yield pieces[smooth], owners[smooth], level
            yield *self._cut(pieces[broken], owners[broken]), level

    def _cut(self, pieces: Array, owners: Indices) -> tuple[Array, Indices]:
        """Cut pieces along all interfaces."""
        for curve in self.curves if len(pieces) else []:
            pieces, parents = curve.cut(pieces, self.d)
            owners = owners[parents]
        return pieces, owners

    def _near(self, pieces: Array) -> tuple[Mask, Mask, list[Array]]:
        """Whether an interface may cross pieces, whether a pole is near, and values of interfaces.

        A pole is near that is in a piece, or nearer to the piece than about its width. The values
        are those that `interface.crossed` takes.
        """
        lattice = middles(self.dimension)
        points = np.concatenate((lattice, self.tested)) if self.poles else lattice
        nodes = [*(curve.node for curve in self.curves), *self.poles]
        found = together(nodes, inside(pieces[..., self.dimension :], points))
        values = [value[: len(lattice)] for value in found[: len(self.curves)]]
        broken, polar = np.zeros((2, len(pieces)), dtype=bool)
        for value in values:
            broken |= crossed(value)[0]
        for value in found[len(self.curves) :]:
            sizes = np.abs(value)
            polar |= sizes.min(axis=0) < NEAR_POLE * sizes.max(axis=0)
        return broken, polar, values

    def _curved(self, pieces: Array, values: Sequence[Array], sizes: Sequence[float]) -> Mask:
        """Whether interfaces are too curved in pieces for cuts as if they were flat.

        Args:
            pieces: The pieces.
            values: The values of each interface, see `_near`.
            sizes: The mean sizes of the formulas.
        """
        marks = np.zeros((len(values), 2, len(pieces)), dtype=bool)
        for mark, value in zip(marks, values, strict=True):
            mark[:] = crossed(value)
        alone = marks[:, 0].sum(axis=0) == 1  # what jumps may be nought on a part of the piece
        for curve, value, (_, curved) in zip(self.curves, values, marks, strict=True):
            rows = np.flatnonzero(curved & alone)
            if len(rows):
                corners = pieces[rows, :, self.dimension :]
                curved[rows] = curve.matters(corners, value[:, rows], self.formulas, sizes)
        return np.asarray(marks[:, 1].any(axis=0))

    @functools.cached_property
    def sizes(self) -> list[float]:
        """The mean sizes of the formulas in all cells, or in a sample of many; collective.

        Of a cell the median of the values at the vertices is taken, for one may be at a pole.
        """
        some = sampled(len(self.whole), max(1, len(self.whole) // MANY))
        result, corners = [], self.whole[some][..., self.dimension :]
        for formula in self.formulas:
            medians = np.median(np.abs(evaluated(formula.root, corners)), axis=1)
            sizes = medians[np.isfinite(medians)]
            total, count = np.sum(self.comm.allgather((sizes.sum(), sizes.size)), axis=0)
            result.append(float(total / max(count, 1.0)))
        return result

    def _settled(self, pieces: Array, owners: Indices, polar: Mask, curved: Mask) -> Mask:
        """Whether pieces are next to poles in cells whose integrals no division changes any more.

        Args:
            pieces, owners: The pieces, and the places of their cells.
            polar, curved: Whether a pole is near, or an interface too curved.
        """
        return np.zeros_like(polar)

    def _count(self, marks: Mask) -> int:
        """How many pieces of all ranks are marked."""
        return int(self.comm.allreduce(int(marks.sum())))


class Projection(_Cells):
    """The projection of a formula on polynomials in the cells where the formula is not smooth."""

    def __init__(
        self,
        formula: Formula,
        domain: mesh.Mesh,
        element: basix.finite_element.FiniteElement,
        corners: npt.NDArray[np.floating],
    ):
        super().__init__(domain, corners, [formula], poles(formula))
        self.formula, self.element = formula, element
        self.tested = self._rule(self._degree(0))[0]

    def coefficients(self) -> tuple[Indices, Array]:
        """Return cells, and in each of them the values of the basis of the polynomials."""
        broken, polar, _ = self._near(self.whole)
        cells = np.flatnonzero(broken | polar)
        if not self._count(broken | polar):
            return cells, np.zeros((0, self.element.dim))
        area = self._rule(self._degree(0))[1].sum()
        self.rounding = HALF_OF_THE_DIGITS * self.sizes[0] * area
        count, whole = len(cells), self.whole[cells]
        # Of the parts of cells next to poles, before their last division.
        self.before: Array = np.full((count, self.element.dim), np.inf)
        coarse = self._moments(whole, np.arange(count), 0, count)
        moments = np.zeros_like(coarse)
        for pieces, owners, level in self.pieces(cells, self.element.degree):
            moments += self._moments(pieces, owners, level, count)
        with np.errstate(invalid="ignore"):
            defect = np.abs(moments - coarse).max(axis=1, initial=0.0)
        kept = polar[cells] | (defect > self.rounding)
        points, weights = QuadratureRule("default", 2 * self.element.degree).points(
            self.element.cell_type
        )
        basis = self._basis(points)
        mass = basis.T @ (weights[:, None] * basis)
        values = np.linalg.solve(mass, moments[kept].T).T
        finite = np.isfinite(values).all(axis=1)
        return cells[kept][finite], values[finite]

    def _settled(self, pieces: Array, owners: Indices, polar: Mask, curved: Mask) -> Mask:
        if not polar.any():
            return polar
        near = np.isin(owners, owners[polar])
        each = self._each(pieces[near], self._degree(0))
        cells, count = owners[near], len(self.before)
        with np.errstate(invalid="ignore"):
            change = np.abs(_summed(each, cells, count) - self.before).max(axis=1)
        settled = polar & (change <= self.rounding)[owners]
        again = ((polar | curved) & ~settled)[near]
        self.before = _summed(each[again], cells[again], count)
        return settled

    def _degree(self, level: int) -> int:
        """The degree of the rule on pieces of cells that have been divided a number of times.

        On cells that are a quarter as large as what they resolve, a rule of degree m leaves about
        4^-(m + 1). Pieces do with the lower degree that leaves no more. From poles they are only as
        far away as they are large. Of the largest pieces, which are few, a rule is to resolve as
        much as the basis does.
        """
        exact = self.element.degree + 4
        if level < 2:
            return exact + self.element.degree
        return exact if self.poles else max(1, math.ceil(2.0 * (exact + 1.0) / (level + 2.0)) - 1)

    def _rule(self, degree: int) -> tuple[Array, Array]:
        """The points and weights of the rule of a degree."""
        kind = self.element.cell_type
        return interior_rule(kind, degree).points(kind)

    def _moments(self, pieces: Array, owners: Indices, level: int, count: int) -> Array:
        """The integrals of the formula with the basis for each cell, shape (cells, basis)."""
        return _summed(self._each(pieces, self._degree(level)), owners, count)

    def _each(self, pieces: Array, degree: int) -> Array:
        """The integrals of the formula with the basis on each piece, shape (pieces, basis)."""
        rule, weights = self._rule(degree)
        points = inside(pieces, rule)
        values = evaluated(self.formula.root, points[..., self.dimension :])
        weighted = values * relative_sizes(pieces) * weights[:, None]
        basis = self._basis(points[..., : self.dimension].reshape(-1, self.dimension))
        return np.einsum("qp,qpb->pb", weighted, basis.reshape(*weighted.shape, self.element.dim))

    def _basis(self, points: Array) -> Array:
        """The basis of the polynomials at points of the reference cell, shape (points, basis)."""
        if not len(points):  # basix needs one
            return np.zeros((0, self.element.dim))
        return np.array(self.element.tabulate(0, np.ascontiguousarray(points)))[0, :, :, 0]


def _summed(values: Array, owners: Indices, count: int) -> Array:
    """The sums of what pieces have for each of a number of cells, shape (cells, columns)."""
    return np.array([np.bincount(owners, column, count) for column in values.T]).T
