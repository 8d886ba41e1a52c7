"""Data that are not smooth inside cells: formulas with where, abs, sign, min, max, and with poles.

A quadrature rule integrates a load that jumps inside a cell with an error of the size of the jump,
and one like r^-0.8 still worse. In such cells the formula is replaced by its L2 projection on
polynomials, cell by cell, which has the same integrals with the basis functions. The integrals of
the projection are over pieces of the cell. The pieces are cut along the line or plane where the
formula jumps or has a kink, after divisions that make curves flat, and are divided next to a pole
until a piece is no larger than its distance from the pole. The same goes for facets.
"""

from collections.abc import Iterator, Sequence

import basix
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.tolerances import ROUNDING, SOLVED
from dolfinx_signorini.bounds.reference_flux import barycentric
from dolfinx_signorini.data.formulas import Formula, Node, evaluated
from dolfinx_signorini.data.interfaces.interface import Interface, interfaces, middles
from dolfinx_signorini.data.interfaces.pieces import (
    DEEPEST,
    MOST_PIECES,
    inside,
    subdivide,
    widths,
    with_reference,
)
from dolfinx_signorini.data.interfaces.roughness import NEAR_POLE, jumps, poles, rough
from dolfinx_signorini.meshes.elements import constants
from dolfinx_signorini.meshes.quadrature import MANY, QuadratureRule, interior_rule
from dolfinx_signorini.meshes.sided_meshes import (
    facet_cells,
    facet_vertices,
    longest_side,
    owned_cells,
    sampled,
)

SMOOTH = 1e-7  # of the mean size: a rule that is less far off integrates well enough
WIDTH = 5e-4  # of the domain: pieces that are not smooth are made smaller than that
MOST_AT_POLES = 3000  # the same: poles along lines have more pieces


def integrable(
    formula: Formula, domain: mesh.Mesh, degree: int, follows: Expr | None = None
) -> Expr:
    """Return a formula as an expression that quadrature rules integrate well.

    Args:
        formula: The formula.
        domain: A mesh of triangles or tetrahedra; the call is collective.
        degree: The degree of the polynomials with which the formula is going to be integrated.
        follows: For data that follow from a solution, the same data as an expression. The rules of
            such data look for poles themselves, see `measure_for_load`.

    Returns:
        The formula itself, or where it is not smooth inside a cell, its projection on polynomials
        of the degree.
    """
    smooth = formula.ufl(ufl.SpatialCoordinate(domain)) if follows is None else follows
    if not (rough(formula) if follows is None else jumps(formula)):
        return smooth
    space = fem.functionspace(domain, ("DG", degree))
    element = space.element.basix_element
    projected = _Projection(formula, domain, element, _corners(domain), follows is None)
    cells, values = projected.coefficients()
    if not domain.comm.allreduce(len(cells)):
        return smooth
    marks = fem.Function(constants(domain))
    marks.x.array[marks.function_space.dofmap.list[cells, 0]] = 1.0
    projection = fem.Function(space)
    projection.x.array[space.dofmap.list[cells]] = values
    for function in (marks, projection):
        function.x.scatter_forward()
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
    cells = _Cells(domain, _corners(domain), interfaces(*formulas))
    found = list(cells.pieces(np.flatnonzero(cells.broken(cells.whole)[0]), degree))
    return tuple(np.concatenate(arrays) for arrays in zip(*found, strict=True))


def broken_cells(formulas: Sequence[Formula], domain: mesh.Mesh) -> Indices:
    """Return the owned cells inside of which formulas jump or have a kink.

    Args:
        formulas, domain: See `cut_cells`.
    """
    cells = _Cells(domain, _corners(domain), interfaces(*formulas))
    return np.flatnonzero(cells.broken(cells.whole)[0])


def _corners(domain: mesh.Mesh) -> npt.NDArray[np.floating]:
    return domain.geometry.x[domain.geometry.dofmap[owned_cells(domain)]]


def integrable_on_facets(
    formula: Formula, domain: mesh.Mesh, facets: npt.NDArray[np.int32], degree: int
) -> Expr:
    """Return a formula as an expression that quadrature rules on boundary facets integrate well.

    In the cell of a facet where the formula is not smooth, a function has the projection on the
    facet as its trace, and another function is positive on this facet and 0 on the others.

    Args:
        formula: The formula.
        domain: A mesh of triangles or tetrahedra; the call is collective.
        facets: The boundary facets that the expression is integrated on.
        degree: The degree of the polynomials with which the formula is going to be integrated.
    """
    result = formula.ufl(ufl.SpatialCoordinate(domain))
    if not rough(formula):
        return result
    dimension, cell = domain.topology.dim, basix.CellType[domain.topology.cell_name()]
    owned = facets < domain.topology.index_map(dimension - 1).size_local
    pairs = facet_cells(domain, np.unique(facets[owned]).astype(np.int32))
    vertices = facet_vertices(domain)
    corners = domain.geometry.x[domain.geometry.dofmap[pairs[:, :1], vertices[pairs[:, 1]]]]
    kind = basix.cell.subentity_types(cell)[dimension - 1][0]
    variant = basix.LagrangeVariant.gll_warped
    element = basix.create_element(basix.ElementFamily.P, kind, degree, variant)
    found, values = _Projection(formula, domain, element, corners).coefficients()
    space = fem.functionspace(domain, ("DG", degree))
    marks = fem.functionspace(domain, ("DG", dimension))
    for local in range(len(vertices)):
        chosen = pairs[found, 1] == local
        if not domain.comm.allreduce(int(chosen.sum())):
            continue
        cells = pairs[found[chosen], 0]
        trace, bubble = fem.Function(space), fem.Function(marks)
        on, nodes = _on_facet(space.element.basix_element, vertices[local])
        table = np.array(element.tabulate(0, nodes))[0, :, :, 0]
        trace.x.array[space.dofmap.list[cells][:, on]] = values[chosen] @ table.T
        shares = barycentric(marks.element.basix_element.points)
        bubble.x.array[marks.dofmap.list[cells]] = shares[:, vertices[local]].prod(axis=1)
        for function in (trace, bubble):
            function.x.scatter_forward()
        result = ufl.conditional(ufl.gt(bubble, SOLVED), trace, result)
    return result


def _on_facet(
    element: basix.finite_element.FiniteElement, vertices: npt.NDArray[np.int32]
) -> tuple[Indices, Array]:
    """Which nodes of a cell lie on a facet, and their coordinates in the reference facet."""
    shares = barycentric(np.array(element.points))
    on = np.flatnonzero(np.abs(shares[:, vertices].sum(axis=1) - 1.0) < 1e-12)
    return on, np.ascontiguousarray(shares[on][:, vertices[1:]])


class _Cells:
    """Cells of a mesh, or facets, with the interfaces and poles that may be inside of them.

    A piece of a cell is given by its vertices, with the coordinates in the reference cell and in
    space side by side, and by the number of the cell.

    Args:
        domain: The mesh.
        corners: The vertices of the cells, shape (cells, vertices, 3).
        curves: The interfaces.
        denominators: What is zero at poles.
    """

    def __init__(
        self,
        domain: mesh.Mesh,
        corners: npt.NDArray[np.floating],
        curves: Sequence[Interface],
        denominators: Sequence[Node] = (),
    ):
        self.comm, self.curves, self.poles = domain.comm, curves, denominators
        self.d, self.dimension = domain.geometry.dim, corners.shape[1] - 1
        self.whole = with_reference(corners[..., : self.d])
        self.size = longest_side(domain.comm, domain.geometry.x[:, : self.d])
        self.tested = middles(self.dimension)  # points where a pole is looked for

    def pieces(self, cells: Indices, degree: int) -> Iterator[tuple[Array, Indices]]:
        """Divide cells into pieces that interfaces do not cross, and small ones; collective.

        Pieces are cut along interfaces as soon as these are flat. What is left next to a pole in
        the end is left out.

        Args:
            cells: The cells.
            degree: The degree of the elements.
        """
        longest = float(widths(self.whole[cells][..., self.dimension :]).max(initial=0.0))
        width = self.comm.allreduce(longest, op=MPI.MAX)
        order = 3 if degree > 1 else 2  # of the error of the solution, at best
        target = self.size * min(WIDTH, (width / self.size) ** order)

        def look(pieces: Array, owners: Indices, level: int) -> tuple[Mask, list[Mask]]:
            split = self.polar(pieces)
            smallest = width * 0.5**level <= ROUNDING * self.size or level == DEEPEST
            kept = ~(split & smallest)
            if smallest or self._count(split) > MOST_AT_POLES:
                split[:] = False
            broken, curved = self.broken(pieces)
            if width * 0.5**level > target and self._count(curved) <= MOST_PIECES:
                split |= curved
            return split, [kept & ~broken, kept & broken]

        levels = subdivide(self.whole[cells], cells, look, self.comm)
        for pieces, owners, _, (smooth, broken) in levels:
            yield pieces[smooth], owners[smooth]
            parts, numbers = pieces[broken], owners[broken]
            for curve in self.curves:
                parts, parents = curve.cut(parts, self.d)
                numbers = numbers[parents]
            yield parts, numbers

    def broken(self, pieces: Array) -> tuple[Mask, Mask]:
        """Whether interfaces cross pieces, or may do so, and whether one of these is curved."""
        result = np.zeros((2, len(pieces)), dtype=bool)
        for curve in self.curves:
            result |= curve.crosses(pieces[..., self.dimension :])
        return result[0], result[1]

    def polar(self, pieces: Array) -> Mask:
        """Whether a pole is in a piece, or nearer to the piece than about its width."""
        found = np.zeros(len(pieces), dtype=bool)
        for pole in self.poles:
            sizes = np.abs(evaluated(pole, inside(pieces[..., self.dimension :], self.tested)))
            found |= sizes.min(axis=0) < NEAR_POLE * sizes.max(axis=0)
        return found

    def _count(self, marks: Mask) -> int:
        """How many pieces of all ranks are marked."""
        return int(self.comm.allreduce(int(marks.sum())))


class _Projection(_Cells):
    """The projection of a formula on polynomials in the cells where the formula is not smooth."""

    def __init__(
        self,
        formula: Formula,
        domain: mesh.Mesh,
        element: basix.finite_element.FiniteElement,
        corners: npt.NDArray[np.floating],
        look_for_poles: bool = True,
    ):
        denominators = poles(formula) if look_for_poles else []
        super().__init__(domain, corners, interfaces(formula), denominators)
        self.formula, self.element = formula, element
        rule = interior_rule(element.cell_type, element.degree + 4)
        self.points, self.weights = rule.points(element.cell_type)
        self.tested = np.concatenate((self.tested, self.points))

    def coefficients(self) -> tuple[Indices, Array]:
        """Return cells, and in each of them the values of the basis of the polynomials."""
        polar = self.polar(self.whole)
        cells = np.flatnonzero(self.broken(self.whole)[0] | polar)
        coarse = self._moments(self.whole[cells], cells)
        moments = np.zeros_like(coarse)
        for pieces, owners in self.pieces(cells, self.element.degree):
            moments += self._moments(pieces, owners)
        with np.errstate(invalid="ignore"):
            defect = np.abs(moments - coarse)[cells].max(axis=1, initial=0.0)
        cells = cells[polar[cells] | (defect > SMOOTH * self._mean() * self.weights.sum())]
        points, weights = QuadratureRule("default", 2 * self.element.degree).points(
            self.element.cell_type
        )
        basis = self._basis(points)
        mass = basis.T @ (weights[:, None] * basis)
        values = np.linalg.solve(mass, moments[cells].T).T
        finite = np.isfinite(values).all(axis=1)
        return cells[finite], values[finite]

    def _mean(self) -> float:
        """The mean size of the formula in all cells, or in a sample of many.

        Of a cell the median of the values at the vertices is taken, for one may be at a pole.
        """
        some = sampled(len(self.whole), max(1, len(self.whole) // MANY))
        values = evaluated(self.formula.root, self.whole[some][..., self.dimension :])
        medians = np.median(np.abs(values), axis=1)
        sizes = medians[np.isfinite(medians)]
        total, count = np.sum(self.comm.allgather((sizes.sum(), sizes.size)), axis=0)
        return float(total / max(count, 1.0))

    def _moments(self, pieces: Array, cells: Indices) -> Array:
        """The integrals of the formula with the basis for each cell, shape (cells, basis)."""
        edges = (pieces[:, 1:] - pieces[:, :1])[..., : self.dimension]
        points = inside(pieces, self.points)
        values = evaluated(self.formula.root, points[..., self.dimension :])
        weighted = (values * np.abs(np.linalg.det(edges)) * self.weights[:, None]).ravel()
        basis = self._basis(points[..., : self.dimension].reshape(-1, self.dimension))
        owners, count = np.tile(cells, len(self.weights)), len(self.whole)
        return np.array([np.bincount(owners, weighted * f, count) for f in basis.T]).T

    def _basis(self, points: Array) -> Array:
        """The basis of the polynomials at points of the reference cell, shape (points, basis)."""
        if not len(points):  # basix needs one
            return np.zeros((0, self.element.dim))
        return np.array(self.element.tabulate(0, np.ascontiguousarray(points)))[0, :, :, 0]
