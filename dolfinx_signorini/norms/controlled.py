"""Norms whose quadrature error is controlled: two rules are compared, and parts of cells divided.

No rule is right for all errors: |e| has kinks where e changes its sign, e^16 is a polynomial of
high degree, and derivatives grow without bound at corners. Two rules of different degrees are
applied to each part of a cell. The parts where the rules differ most are divided into equal ones,
next to a singular point again and again, until what is left no longer matters.
"""

import math
from collections.abc import Callable, Sequence
from typing import cast

import basix
import numpy as np
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.logs import log
from dolfinx_signorini.base.ranks import anywhere
from dolfinx_signorini.base.tolerances import HALVINGS, ROUNDING, SIX_DIGITS
from dolfinx_signorini.meshes.parts import Parts
from dolfinx_signorini.meshes.quadrature import QuadratureRule, interior_rule
from dolfinx_signorini.norms.names import Norm
from dolfinx_signorini.norms.power_sums import collected, norm_of_all, p_norm

Sizes = Callable[[], dict[Norm, float]]

# Of a norm: how far off its quadrature may be by estimate. The estimate is one of random numbers:
# of 2,240 norms of waves on all elements, with p from 1 to 16, none was off by twice as much.
TOLERANCE = 5e-4
# What of the differences does not cancel: so much of the root of the sum of their squares, as for
# random numbers, and of the sum of their sizes.
SCATTER, COMMON = 2.0, 0.05
# Parts: on fewer ones two rules agree by chance, but not to six digits. One part has at most its
# share of what is allowed: next to a point where |e|^p is like r^-s the difference of the rules is
# a small share of what both lack, of 1/13 or more for s <= n - 1/2 on all n-dimensional cells with
# rules of degree 4 to 20.
FEWEST = 64
# Divisions, each of which makes what the rules miss next to such a point smaller by 2^(s - n): for
# s = n - 1/3 half of the tolerance is left.
DEEPEST = math.ceil(3.0 * math.log2(2.0 / TOLERANCE))
MOST, MORE = 600_000, 100  # points of a division on all ranks: at most, or for each place
# Of a norm: who is that far off after so many points is refused, and not warned of.
UNKNOWN = math.sqrt(TOLERANCE)


def controlled(
    evaluate: Callable[[QuadratureRule, Parts], dict[Norm, Array]],
    sizes: Sizes,
    places: tuple[basix.CellType, int],
    norms: Sequence[Norm],
    degree: int,
    comm: MPI.Comm,
) -> dict[Norm, Array]:
    """Return norms on each of the places of this rank, cells or facets; collective.

    The norms over all places of all ranks are right to 1e-3. Jumps and kinks of u inside of cells
    are found by divisions, too; a warning tells where these take too many points.

    Next to a point where |e|^p is like r^-s, in n dimensions, each division makes what the rules
    miss smaller by the factor 2^(s - n). The norms are right to 1e-3 for s <= n - 1/3, and a norm
    that `DEEPEST` divisions do not find is taken for an infinite one.

    Args:
        evaluate: The norms by a rule on parts of the places.
        sizes: The same norms of u_h over all places, which tell rounding from errors.
        places: The kind of the places, and how many there are on this rank.
        norms: The norms, with p < inf.
        degree: The degree of the smaller rule; the larger one has two more.
        comm: The communicator of the mesh.

    Raises:
        FloatingPointError: The error is not a number at some point, or a norm is infinite.
    """
    cell, count = places
    rules = [interior_rule(cell, degree + more) for more in (0, 2)]
    points = sum(len(rule.points(cell)[1]) for rule in rules) * Parts.children(cell)
    most, parts = max(MOST, MORE * comm.allreduce(count)), Parts.whole(count, cell)
    rows: list[Indices] = []
    sums = [_ControlledSum(norm, comm) for norm in norms]
    for division in range(DEEPEST + 1):
        coarse, fine = (evaluate(rule, parts) for rule in rules)
        marks = np.any([s.unsure(fine[s.norm], coarse[s.norm]) for s in sums], axis=0)
        if any(s.estimate > SIX_DIGITS for s in sums):
            marks |= comm.allreduce(sum(map(len, [marks, *rows]))) < FEWEST
        new = points * comm.allreduce(int(marks.sum()))
        if new and _ended(sums, sizes, division, new > most):
            new, marks[:] = 0, False
        rows.append(parts.rows[~marks])
        for s in sums:
            s.keep(fine[s.norm][~marks], coarse[s.norm][~marks])
        if not new:
            break
        parts = parts.divided(cell, marks)
    return {s.norm: s.on_places(np.concatenate(rows), count) for s in sums}


def allowed(p: float) -> float:
    """Return how far off a sum of p-th powers may be, relative to the sum."""
    return -math.expm1(-p * TOLERANCE)


class _ControlledSum:
    """A norm as a sum of p-th powers over parts of places, by two rules.

    `total` is the norm over all parts, as far as it is known, `estimate` how far off it may be,
    relative to the norm, and `resolved` whether that is within the tolerance.
    """

    def __init__(self, norm: Norm, comm: MPI.Comm):
        self.norm, self._comm, self._p = norm, comm, norm.p
        self.total, self.estimate, self.resolved = 0.0, 0.0, True
        # Of the parts that are kept: the norms, the norm over all, and the sums of differences.
        self._values: list[Array] = [np.zeros(0)]
        self._kept, self._sums = 0.0, cast(Array, np.zeros((3, 1)))

    def unsure(self, fine: Array, coarse: Array) -> Mask:
        """Whether each part is to be divided, by the norms on parts that are not kept; collective.

        A FloatingPointError is raised where one of them is not a number, on some rank.
        """
        before = self.total
        now, _ = (norm_of_all(self._comm, values, self._p) for values in (fine, coarse))
        self.total = float(p_norm(np.array([self._kept, now]), self._p))
        self._sums *= (before / (self.total or 1.0)) ** (self._p * np.array([[1.0], [2.0], [1.0]]))
        differences = self._differences(fine, coarse)
        bins = np.clip(-np.frexp(differences)[1], 0, HALVINGS - 1)
        bins[differences == 0.0] = HALVINGS - 1
        sums = self._sums + self._cumulated(differences, bins)
        estimates = np.abs(sums[0]) + SCATTER * np.sqrt(sums[1]) + COMMON * sums[2]
        limit = allowed(self._p)
        within, alone = bool(estimates[0] <= limit), np.abs(differences) > limit / FEWEST
        self.estimate = float(estimates[0] / self._p)
        self.resolved = within and not anywhere(self._comm, alone)
        # Half of the tolerance is for what is kept, the rest for the parts that are divided.
        good = np.flatnonzero(estimates <= (1.0 if within else 0.5) * limit)
        return np.asarray(alone | (bins < (good[0] if len(good) else HALVINGS)))

    def keep(self, fine: Array, coarse: Array) -> None:
        """Take the norms on parts that are not divided, by both rules; collective."""
        self._values.append(fine)
        now = norm_of_all(self._comm, fine, self._p)
        self._kept = float(p_norm(np.array([self._kept, now]), self._p))
        differences = self._differences(fine, coarse)
        all_in_one = np.zeros(len(differences), dtype=np.int64)
        self._sums = self._sums + self._cumulated(differences, all_in_one)[:, :1]

    def on_places(self, rows: Indices, count: int) -> Array:
        """The norm on each of `count` places, from those on the parts kept; `rows` has theirs."""
        return collected(np.concatenate(self._values), rows, count, self._p)

    def _differences(self, fine: Array, coarse: Array) -> Array:
        """How far apart the p-th powers are, relative to that of the norm."""
        one, other = ((values / (self.total or 1.0)) ** self._p for values in (fine, coarse))
        return np.asarray(one - other)

    def _cumulated(self, differences: Array, bins: Indices) -> Array:
        """Sums over each bin and all later ones, of differences, their squares and their sizes."""
        kinds = differences, differences**2, np.abs(differences)
        sums = self._comm.allreduce(np.array([np.bincount(bins, d, HALVINGS) for d in kinds]))
        return np.asarray(sums[:, ::-1].cumsum(axis=1)[:, ::-1])


def _ended(
    sums: Sequence[_ControlledSum],
    sizes: Sizes,
    division: int,
    many: bool,
) -> bool:
    """Whether nothing is divided any more, though some norms are not resolved.

    Raises:
        FloatingPointError: After all these divisions a norm must be infinite, or after so many
            points a norm is not known to `UNKNOWN`.
    """
    if division == 0:
        of_u_h = sizes()
        if all(s.total <= ROUNDING * of_u_h[s.norm] for s in sums):
            return True
    lost = [s for s in sums if not s.resolved and (division == DEEPEST or s.estimate > UNKNOWN)]
    if lost and (many or division == DEEPEST):
        names = ", ".join(str(s.norm) for s in lost)
        raise FloatingPointError(f"{names}: infinite, or so nearly that no quadrature finds it")
    for s in sums if many else []:
        if s.estimate > 2.0 * TOLERANCE:
            log.warning("%s: the quadrature may be off by %.1g of it", s.norm, s.estimate)
    return many
