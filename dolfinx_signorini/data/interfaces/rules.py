"""Quadrature rules that data ask for: as few points as integrate a formula well, cell by cell.

A polynomial is integrated by the smallest rule that is exact. Other formulas get the rule of all
data on small meshes. On many cells most of these are so small that the formula is nearly linear in
each of them, and a smaller rule serves, with which the solution is as accurate as with exact
integrals. The cells where the formula is not nearly linear keep the larger rule: around singular
points and narrow peaks.
"""

from collections.abc import Sequence
from typing import TypeAlias

import basix
import numpy as np
import ufl
from dolfinx import mesh

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.ranks import anywhere
from dolfinx_signorini.data.formulas import Formula, Node, PerNode, evaluated
from dolfinx_signorini.data.interfaces.singular_sets import is_singular
from dolfinx_signorini.meshes.quadrature import (
    CELL_RULE,
    FACET_RULE,
    MANY,
    QuadratureRule,
    interior_rule,
)
from dolfinx_signorini.meshes.sided_meshes import owned_cells

CellMeasure: TypeAlias = ufl.Measure | ufl.measure.MeasureSum

ROUGH = 0.01  # of a formula's size: a larger deviation from linear in a cell asks for more points


def polynomial_degree(node: Node, degrees: Sequence[int] = (1, 1, 1)) -> int | None:
    """Return the degree of a formula that is a polynomial, or one on each side of its jumps.

    Args:
        node: The root of the formula's tree.
        degrees: The degrees of the coordinates.

    Returns:
        The degree, which may be too large where terms cancel; None for other formulas.
    """
    return _Degrees(degrees)(node)


class _Degrees(PerNode[int | None]):
    """The degrees of the nodes of a tree, see `polynomial_degree`."""

    def __init__(self, degrees: Sequence[int]):
        super().__init__()
        self.degrees = degrees

    def find(self, node: Node) -> int | None:
        if not node.args:
            return self.degrees[int(node.value)] if node.op == "coordinate" else 0
        parts = [self(a) for a in (node.args[1:] if node.op == "where" else node.operands)]
        known = _known(parts)
        if node.op == "sign" or known == [0] * len(parts):
            return 0
        if len(known) < len(parts):
            return None
        degree: int | None = node.operation.degree(*known, *node.exponents)
        return degree


def measures_for(
    domain: mesh.Mesh,
    products: Sequence[tuple[Sequence[Formula], int]],
    degree: int,
    divided: bool = True,
) -> list[CellMeasure]:
    """Return the measures of integrals over all cells of formulas times polynomials, of one form.

    DOLFINx takes one division of the cells for all integrals of a form: where a formula is rough in
    some cells, these are a part of the division, on which the other formulas keep their rules.

    Args:
        domain: The mesh; the call is collective.
        products: For each integral the formulas, and the degree of the polynomials that they are
            multiplied with. Where one of the formulas is singular in a cell, a polynomial of this
            degree stands in its place, see `jumps.integrable`.
        degree: The degree of the elements.
        divided: Whether cells may be divided into parts, so that large meshes have fewer points.
    """
    cells = domain.topology.index_map(domain.topology.dim).size_global
    many = divided and cells > MANY
    chosen = [_chosen(domain, *each, degree, many) for each in products]
    found = [rough for _, rough in chosen if rough is not None]
    if not found:
        return [ufl.Measure("dx", domain, metadata=rule.metadata) for rule, _ in chosen]
    together = np.any(found, axis=0)
    parts = [(k, np.flatnonzero(together == k).astype(np.int32)) for k in (False, True)]
    dx = ufl.Measure("dx", domain, subdomain_data=[(int(k), cells) for k, cells in parts])
    return [
        dx(0, metadata=rule.metadata)
        + dx(1, metadata=(rule if rough is None else CELL_RULE).metadata)
        for rule, rough in chosen
    ]


def _chosen(
    domain: mesh.Mesh, formulas: Sequence[Formula], factor: int, degree: int, many: bool
) -> tuple[QuadratureRule, Mask | None]:
    """The rule of an integral, and the owned cells that have the rule of all data in its place."""
    singular = any(map(is_singular, formulas))
    degrees = [polynomial_degree(formula.root) for formula in formulas]
    known, constant = _known(degrees), all(formula.constant is not None for formula in formulas)
    data = max([*known, factor if singular else 0])
    # Where a kernel has several rules, FFCx takes values at the only point of one for all of them.
    exact = factor + data if constant else max(factor + data, 2)
    if len(known) == len(degrees) and exact <= CELL_RULE.degree:
        return _interior(domain, exact), None
    # A projection that is integrated less well need not even be positive.
    needed = 2 * (factor if singular else degree)
    if needed > CELL_RULE.degree or not many:
        return cell_rule(domain, needed), None
    both = zip(formulas, degrees, strict=True)
    curved = [formula for formula, own in both if own is None or own > 1]
    rough = _rough(domain, curved)
    return _interior(domain, 2 * degree), rough if anywhere(domain.comm, rough) else None


def cell_rule(domain: mesh.Mesh, degree: int) -> QuadratureRule:
    """Return the rule of all data on cells, or one of a degree that this rule does not have."""
    return CELL_RULE if degree <= CELL_RULE.degree else _interior(domain, degree)


def facet_rule(domain: mesh.Mesh) -> QuadratureRule:
    """Return the rule of all data on facets."""
    return FACET_RULE if domain.topology.dim == 2 else CELL_RULE


def _rough(domain: mesh.Mesh, formulas: Sequence[Formula]) -> Mask:
    """In which of the owned cells one of some formulas is not nearly linear."""
    x = np.asarray(domain.geometry.x[:, : domain.geometry.dim], dtype=np.float64)
    corners = domain.geometry.dofmap[: len(owned_cells(domain))].T

    def means(values: Array) -> Array:
        return np.asarray(sum(values[corner] for corner in corners) / len(corners))

    middles = means(x)
    result = np.zeros(len(middles), dtype=bool)
    for formula in formulas:
        values, nodal = evaluated(formula.root, middles), evaluated(formula.root, x)
        finite = np.abs(values[np.isfinite(values)])
        total, count = np.sum(domain.comm.allgather((finite.sum(), len(finite))), axis=0)
        floor = ROUGH * float(total / max(count, 1.0))  # smaller deviations never matter
        with np.errstate(invalid="ignore"):
            result |= ~(np.abs(values - means(nodal)) <= ROUGH * np.abs(values) + floor)
    return result


def _interior(domain: mesh.Mesh, degree: int) -> QuadratureRule:
    return interior_rule(basix.CellType[domain.topology.cell_name()], degree)


def _known(degrees: Sequence[int | None]) -> list[int]:
    return [degree for degree in degrees if degree is not None]
