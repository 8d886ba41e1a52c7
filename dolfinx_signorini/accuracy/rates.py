"""Rates of convergence of single cells, and the error that a division of all cells leaves.

The indicator eta of a cell tells what the cell adds to the difference between a solution and the
solution w on the divided mesh. If a division multiplies the error by rho = 2^-s, the cell leaves in
the error of w

    eta rho / (1 - rho)           for indicators that add up unsquared, and in sup norms of
                                  derivatives, whose errors at a vertex have one sign on all meshes,
    eta rho / sqrt(1 - rho^2)     for local indicators: the errors on a cell and on its parts are
                                  almost orthogonal, and exactly so in the energy norm,
    eta rho / (1 - rho^2)         in sup norms of values at a singular point that was seen twice:
                                  with r^s the largest errors on both meshes have one sign, at
                                  distances that halve (measured with degrees 1 to 3 and s = 0.27 to
                                  0.9: 0.75 to 1 of this number). Elsewhere the exponent of
                                  1 - rho^2 is 3/4, for a cell may be slow by chance.

The rate s is the rate for smooth solutions, or less, and is measured where a cell has been divided,
from the indicators of the cell and of its parts. At a corner of the domain the exponent of the
solution is known, and a rate that was measured between this one and the rate for smooth solutions
tells how much of the indicator is singular: this part falls more slowly than the rest, and is the
larger part of what divisions leave. An indicator may be the product of a part of the
solution and a part of a dual solution, which is another one on every mesh: then the part of the
solution is measured alone, in energy, and tells the rate of the product, see
`Target.order_of_products`. Before a cell has been divided, the growth of the highest derivatives
tells what the rate for smooth solutions loses.
"""

import numpy as np
from dolfinx import mesh

from dolfinx_signorini.accuracy.cells import summed_at_vertices
from dolfinx_signorini.accuracy.marking import DEEP, NOTABLE, Divided, Marks, Prediction
from dolfinx_signorini.accuracy.targets import Target
from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.base.tolerances import ROUNDING
from dolfinx_signorini.meshes.sided_meshes import owned_cells
from dolfinx_signorini.norms.power_sums import p_norm

SLOWEST = 0.2  # rate; slower is not distinguished from no convergence, unless theory does
# Of the rate for smooth solutions: slower cells have a singular point, unknown ones are just not.
SINGULAR = 0.5


class Rates:
    """The rates of the cells of one mesh, and of the meshes refined from it.

    For example:

        rates = Rates(target("L4"), degree, count, dimension)
        remaining = rates.prediction(cells).remaining

    Args:
        target: What is to be accurate.
        degree: The degree of the elements.
        count: The number of owned cells.
        dimension: The dimension of space.

    Attributes:
        order: The rate for smooth solutions.
        power: The exponent with which the indicators add up.
        exponent: The exponent with which errors at separate places add up.
        values: The rate of each owned cell.
        corners: The rate that theory knows of each cell at a corner; infinity elsewhere.
        at_corners: Whether each cell is at a corner where theory has a slower rate than elsewhere.
        known: Whether theory tells the rate of each cell, see `know`.
        places: For each cell the singular point that the cell is known to have, a vertex or an end
            of contact; infinity for other cells.
    """

    def __init__(self, target: Target, degree: int, count: int, dimension: int):
        self.order, self.dimension = target.order(degree), dimension
        self.power, self.exponent = target.power, target.exponent
        self._target, self._power = target, 2.0 if target.weighted else target.power
        self._in_energy = target.order_in_energy(np.array(self.order))
        self._in_slopes = target.norm is not None and target.norm.derivatives > 0.0
        self.corners: Array = np.full(count, np.inf)
        self.at_corners: Mask = np.zeros(count, dtype=bool)
        self.values: Array = np.full(count, SINGULAR * self.order)
        self.places: Array = np.full((count, 3), np.inf)
        self.known: Mask = np.zeros(count, dtype=bool)
        self._confirmed: Mask = np.zeros(count, dtype=bool)
        self._measured: Mask = np.zeros(count, dtype=bool)
        self._divided: Divided | None = None  # by what the mesh became the present one
        # The number of the last divisions that gained nothing.
        self._stood: Indices = np.zeros(count, dtype=np.int64)

    def know(self, cells: Mask, most: float, least: float = SLOWEST) -> None:
        """Take the rates of some cells to lie between those of theory.

        Args:
            cells: Whether theory tells the rate of a cell.
            most, least: The rates; the same where what is measured is chance.
        """
        least, most = (float(np.clip(rate, SLOWEST, self.order)) for rate in (least, most))
        self.values = np.where(cells, np.clip(self.values, least, most), self.values)
        self.known = self.known | cells

    def assume(self, lost: Array) -> None:
        """Take cells whose rates have not been measured to lose what their derivatives tell.

        A solution r^a has derivatives of the order k of the degree that grow by 2^(k - a) in a
        division: so much less than in cells with a smooth solution falls the error in energy. In
        L^p the volume of the cells around the point counts, too, which may lie on an edge in space.

        Args:
            lost: The logarithm of this growth, see `Indicators`.
        """
        of_ball = np.minimum(lost, 1.0) * (1.0 - 2.0 / self._power)
        order = np.maximum(self._in_energy - lost - of_ball, 0.0)
        least = SINGULAR * self.order
        assumed = np.clip(self._target.order_of_products(order, order), least, self.order)
        slow = np.minimum(_of_theory(self.corners), assumed)
        unknown = np.where(assumed < self.order, slow, self.order)
        self.values = np.where(self._measured, self.values, unknown)

    @property
    def _singular(self) -> Mask:
        return self.values < SINGULAR * self.order

    @property
    def singular_corners(self) -> Mask:
        """Whether each cell is at a corner, and has not been seen to be smooth there."""
        return self._singular & (self.corners < self.order)

    @property
    def standing_corners(self) -> Mask:
        """Whether each cell is at a corner at which divisions were seen twice to gain nothing."""
        return (self._stood > 1) & self.at_corners

    def local_prediction(self, norms: Array, left: Array, p: float, lost: Array) -> Prediction:
        """Return what cells leave in an L^p norm by themselves.

        Where the energy norm of an error falls with the rate s, an L^p norm falls with s + 1. At a
        singular point the error is in a ball of the size of the cell: by the volume of the ball in
        d dimensions the rate is s + 1 - d (1/2 - 1/p). A rate that was not measured, nor is that of
        a singular point, is assumed of the norm itself, as in `prediction`.

        Args:
            norms: The L^p norms of w - I w on the cells, which tell what singular points leave.
            left: What the derivatives of w tell of its errors on the other cells.
            p: The exponent.
            lost: See `assume`.
        """
        least = np.where(self._measured, (1.0 - ROUNDING) * self.order, SINGULAR * self.order)
        of_norm = self.values >= least
        at_points = np.minimum(lost, 1.0) * self.dimension * (0.5 - 1.0 / p)
        rates = self._target.order_in_energy(self.values) + 1.0 - at_points
        rho = 2.0 ** -np.where(of_norm, self.values, np.clip(rates, SLOWEST, self.order))
        remaining = np.where(self._singular, norms * rho / (1.0 - rho), left)
        return self._foretold(remaining, rho, p, p)

    @property
    def shares(self) -> Array:
        """What each cell leaves in the error of the solution on the divided mesh, over its part."""
        rho, sup = 2.0**-self.values, np.isinf(self.power)
        of_one_sign = rho / (1.0 - rho)
        if self.power == 1.0 or (sup and self._in_slopes):
            left = of_one_sign
        elif sup:
            left = rho / (1.0 - rho**2) ** np.where(self._confirmed, 1.0, 0.75)
        else:
            left = rho / np.sqrt(1.0 - rho**2)
        # Where contact ends, the solution on the divided mesh may be no better by chance. The
        # largest errors are at the end itself, where the errors of all levels have the same sign.
        at_ends = of_one_sign if sup else 1.0
        return np.where(self.known, at_ends, left)

    def prediction(self, cells: Array) -> Prediction:
        """Return what the cells leave in the error of the solution on the divided mesh.

        Args:
            cells: The indicators.
        """
        left = cells * self.shares
        return self._foretold(left, 2.0**-self.values, self.power, self.exponent)

    def _foretold(self, remaining: Array, rho: Array, power: float, exponent: float) -> Prediction:
        # What derivatives alone tell is believed for one division.
        deepest = 1 if self._divided is None else DEEP
        seen = self._singular, self._confirmed, deepest
        return Prediction(remaining, rho, *seen, power, exponent, self.places)

    def refine(self, domain: mesh.Mesh, before: Array, marks: Marks, divided: Divided) -> None:
        """Carry the rates to a divided mesh.

        Args:
            domain: The mesh so far.
            before: The local indicators of the cells, see `Indicators`.
            marks: How the cells were to be divided.
            divided: The mesh that came out.
        """
        self._slow = divided.owners.of(self.values)
        self.values = np.where(divided.away, self.order, self._slow)
        self._confirmed = divided.owners.of(self._confirmed) & ~divided.away
        self._measured = divided.owners.of(self._measured)
        self._stood = np.where(divided.away, 0, divided.owners.of(self._stood))
        self.corners = np.full(len(self.values), np.inf)
        self.at_corners = np.zeros(len(self.values), dtype=bool)
        self.known = np.zeros(len(self.values), dtype=bool)
        self.places = np.full((len(self.values), 3), np.inf)
        self._domain, self._before = domain, before
        self._marks, self._divided = marks, divided

    def measure(self, cells: Array) -> None:
        """Measure the rates of the cells that have been divided; on the first mesh none has been.

        Args:
            cells: The local indicators of the present mesh.
        """
        if self._divided is None:
            return
        before, singular, divided = self._before, self._marks.singular, self._divided
        owned, levels = divided.owners.of, divided.levels
        deepest, towards = divided.collected(levels, np.inf), owned(singular)
        # Towards a singular point the cells at the point tell, elsewhere all of them.
        counted = np.where(~towards | (levels == owned(deepest)), cells, 0.0)
        now = divided.collected(counted, self._power)
        parts = divided.collected(np.ones(len(cells)), 1.0)
        depth = np.where(singular, deepest, np.log2(np.maximum(parts, 1.0)) / self.dimension)
        divided_enough = np.where(singular, deepest > 0.0, parts >= 2.0**self.dimension)
        told = divided_enough & (before > 0.0) & (now > 0.0)
        with np.errstate(all="ignore"):
            order = -np.log2(now / before) / depth
        rates = np.clip(self._target.order_of_products(order, order), SLOWEST, self.order)
        rates, told = owned(self._smoothed(rates, before, told)), owned(told)
        new = told & ~divided.away
        self.values = np.where(new, self._lasting(rates, owned(depth)), self.values)
        self._measured |= new | divided.away
        stands = np.where(self.values < 2.0 * SLOWEST, self._stood + 1, 0)
        self._stood = np.where(new, stands, self._stood)
        # The slow part of a slow cell is where most of the error is left, and is at the point.
        largest = owned(divided.collected(counted, np.inf))
        slow = told & (rates < SINGULAR * self.order)
        smooth = slow & (cells < NOTABLE * largest)
        self.values = np.where(smooth, self.order, self.values)
        self._confirmed |= slow & ~smooth & towards & ~divided.away
        # A cell away from the point may have the singular point itself, which is no vertex yet.
        similar = owned(before) * 2.0 ** (-self._target.order_in_energy(self._slow) * levels)
        missed = divided.away & (cells > NOTABLE * similar)
        self.values = np.where(missed, np.minimum(self._slow, self.values), self.values)

    def _lasting(self, rates: Array, depth: Array) -> Array:
        """The rates that leave at corners what a singular and a smooth part leave together.

        Args:
            rates: The measured rates of cells.
            depth: The divisions from which the rates were measured.
        """
        # In energy squares add up, of which the product of the singular parts has the root.
        times = 2.0 if self._target.weighted and not self._target.rough else 1.0
        slow = np.minimum(_of_theory(self.corners), self.order)
        in_energy = self._target.order_in_energy
        orders = in_energy(rates), self._in_energy, in_energy(slow)
        whole, smooth, singular = (2.0 ** (-times * each * depth) for each in orders)
        with np.errstate(all="ignore"):
            shares = (whole - smooth) / (singular - smooth) * singular / whole
        shares = np.clip(shares, 0.0, 1.0) ** (1.0 / times)
        left = [2.0**-s / (1.0 - 2.0**-s) for s in (self.order, slow)]
        both = (1.0 - shares) * left[0] + shares * left[1]
        # What is slower than theory has data that nobody has read.
        known = (slow < self.order) & (rates >= slow)
        return np.where(known, np.log2(1.0 + 1.0 / both), rates)

    def _smoothed(self, rates: Array, before: Array, told: Mask) -> Array:
        """Average the rates of the cells around the vertices of each cell, by their indicators.

        A single cell may be slow by chance. At a singular point all cells around a vertex are. Of
        the vertices of a cell the squares of the factors that the rates stand for are averaged, as
        errors add up.

        Args:
            rates: The measured rates of cells of the last mesh.
            before: The indicators of these cells.
            told: Whether the rate of a cell is known.
        """
        largest = highest(self._domain.comm, before) or 1.0
        shares = np.where(told, before / largest, 0.0)
        cells = owned_cells(self._domain)
        known = np.where(told, rates, 0.0)
        at_vertices = (summed_at_vertices(self._domain, v, cells) for v in (shares * known, shares))
        sums, weights = (v[self._domain.geometry.dofmap[cells]] for v in at_vertices)
        with np.errstate(all="ignore"):
            factors = 2.0 ** -np.where(weights > 0.0, sums / weights, self.order)
        return np.asarray(-np.log2(p_norm(factors, 2.0, 1.0 / factors.shape[1])))


def _of_theory(rates: Array) -> Array:
    """Rates that theory knows; the slowest one where the norm of the solution is infinite."""
    return np.where(rates > 0.0, rates, SLOWEST)
