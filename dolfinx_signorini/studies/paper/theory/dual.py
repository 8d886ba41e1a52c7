"""The dual problems (D) and (D~) of Section 5, and the chains of inequalities (20), (21) and (26).

The dual solution z is replaced by its finite element approximation on a mesh that is nested in the
mesh of u_h and finer by an integer factor. On the mesh of u_h itself z would be its own interpolant
and the decisive term (z - I_h(z), u_h - u)_H1 would vanish. The price is one more term in the
chain, the `remainder`, with which the chain holds to rounding.

All quantities are for the load divided by the third power of E = ||(u - u_h)^+||_L4, or with - for
+, so that the left end of each chain is E itself.
"""

from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_signorini.accuracy.terms import difference
from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.arrays import Mask
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.meshes.between_meshes import interpolate_between
from dolfinx_signorini.meshes.sided_meshes import owned_cells
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.references import interpolant
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.studies.paper.solution import PAPER_RULE
from dolfinx_signorini.studies.paper.theory.boundary import edges_that_meet, ends_of
from dolfinx_signorini.studies.paper.theory.discretisation import (
    THEORY_RTOL,
    Discretisation,
    cell_size,
)
from dolfinx_signorini.studies.paper.theory.errors import expression_norms, second_seminorms

EPSILONS = (0.1, 0.25, 0.45)  # of the exponents (4 - eps)/3 and their like
TOO_HIGH = 2.0  # an exponent above 4/3: second derivatives of z are not in this L^q


@dataclass(frozen=True)
class DualChain:
    """One dual problem and its chain, term by term:

        plus, minus = dual_chains(coarse, fine)
        assert plus.slack >= -1e-9

    Attributes:
        error: E, the L^4 norm of (u - u_h)^+ or (u - u_h)^-: the left end of the chain.
        duality: (z, w)_H1 with w = u_h - u for (D) and u - u_h for (D~).
        bumps: (z, Sigma)_H1 with Sigma the hat functions of (20); 0 for (D~).
        bump_load: The integral of the load with Sigma; 0 for (D~).
        remainder: What the finite element approximation of z contributes: load(w - I w) -
            (z, w - I w)_H1, I the interpolation on the finer mesh.
        interpolation: (z - I_h(z), w)_H1, a part of `duality`.
        sign: (I_h(z), w)_H1, the other part, which is not positive.
        holder: ||z - I_h(z)||_{W^{1,q}} ||w||_{W^{1,s}} for each epsilon, q = (4 - eps)/3 and s
            its conjugate, which bounds `interpolation`.
        holder_split: The same with ||w||_{W^{1,s}} interpolated between W^{1,4} and W^{1,inf}.
        stability: ||z||_H1 over ||load||_{L^q} for each epsilon: the constant of (18) and (22).
        regularity: The discrete W^{2,q} seminorm of z over ||load||_{L^q} for each q, and for one
            above 4/3: the constant of (19) and (23).
        largest: The largest value of z relative to its size: not positive but for rounding.
        contact: The largest |z| on the contact cells relative to its size.
        admissible: The smallest nodal value on the contact cells of the function w + Sigma that
            the chain is tested with, relative to its size.
    """

    error: float
    duality: float
    bumps: float
    bump_load: float
    remainder: float
    interpolation: float
    sign: float
    holder: dict[str, float]
    holder_split: dict[str, float]
    stability: dict[str, float]
    regularity: dict[str, float]
    largest: float
    contact: float
    admissible: float

    @property
    def slack(self) -> float:
        """Right-hand side less left-hand side of (20) or (26), over the left: not negative."""
        right = self.duality + self.bumps + self.bump_load + self.remainder
        return (right - self.error) / self.error


def discrete_contact_cells(discretisation: Discretisation) -> Mask:
    """Return whether u_h vanishes on an edge."""
    active = discretisation.curve.values(discretisation.u_h) <= 0.0
    return active & np.roll(active, -1)


def dual_chains(coarse: Discretisation, fine: Discretisation) -> tuple[DualChain, DualChain]:
    """Solve (D) and (D~) for a discretisation, and evaluate their chains.

    Args:
        coarse: The discretisation of u_h.
        fine: The same example on a finer mesh that is nested in the coarse one, for z.

    Raises:
        NotConvergedError: A solver did not reach its tolerance.
    """
    contact = edges_that_meet(coarse.curve, coarse.example.contact)
    positive = _Dual(coarse, fine, contact, 1.0)
    negative = _Dual(coarse, fine, discrete_contact_cells(coarse), -1.0)
    return positive.chain(), negative.chain()


class _Dual:
    """One dual problem; sign = 1 for (D), -1 for (D~)."""

    def __init__(self, coarse: Discretisation, fine: Discretisation, cells: Mask, sign: float):
        self.coarse, self.fine, self.sign, self.cells = coarse, fine, sign, cells
        self.u_h, self.dx = transfer(coarse.u_h, fine.space), ufl.dx(metadata=PAPER_RULE.metadata)
        part = ufl.max_value(sign * (fine.exact.u - self.u_h), 0.0)
        # By the same points as the load: error_norms turns the rule on half of the cells.
        self.error = compiled.integral(part**4 * self.dx) ** 0.25
        self.load = -((part / fem.Constant(fine.space.mesh, np.float64(self.error))) ** 3)
        middle = fine.curve.s + 0.5 * fine.curve.widths
        fine_cells = cells[np.searchsorted(coarse.curve.s, middle, side="right") - 1]
        self.held = ends_of(fine_cells)  # nodes
        form = self.load * ufl.TestFunction(fine.space) * self.dx
        contact = fine.curve.facets_between(fine_cells)
        problem = SignoriniProblem(fine.a, form, contact=contact)
        self.z = problem.solve(rtol=THEORY_RTOL)
        problem.destroy()

    def chain(self) -> DualChain:
        """Evaluate the terms."""
        coarse, fine, sign, z = self.coarse, self.fine, self.sign, self.z
        strong = error_norms(self.u_h, fine.exact, ["W1_inf"])["W1_inf"]
        bumps = self._bumps(strong)
        z_h = transfer(z, coarse.space)
        rough = difference(z, transfer(z_h, fine.space))
        duality = sign * (fine.product(z, self.u_h) - fine.exact_product(z))
        orthogonality = sign * (coarse.product(z_h, coarse.u_h) - coarse.exact_product(z_h))
        size = highest(fine.comm, -z.x.array)
        interpolated = interpolant(fine.space, fine.exact.u)
        test = difference(self.u_h, interpolated)  # the interpolant of w + Sigma
        test.x.array[:] = sign * test.x.array + bumps.x.array
        values = fine.curve.values(test)
        # The load on w less that on the interpolant of w.
        rest = -sign * compiled.integral(self.load * (fine.exact.u - interpolated) * self.dx)
        return DualChain(
            error=self.error,
            duality=duality,
            bumps=fine.product(z, bumps),
            bump_load=-compiled.integral(self.load * bumps * self.dx),
            remainder=rest + sign * (fine.exact_product(z) - fine.product(z, interpolated)),
            interpolation=duality - orthogonality,
            sign=orthogonality,
            **self._by_epsilon(rough, strong),
            largest=highest(fine.comm, z.x.array) / size,
            contact=float(np.abs(fine.curve.values(z)[self.held]).max(initial=0.0)) / size,
            admissible=float(values[self.held].min(initial=0.0) / np.abs(values).max()),
        )

    def _by_epsilon(self, rough: fem.Function, strong: float) -> dict[str, dict[str, float]]:
        """What depends on epsilon."""
        fine, size = self.fine, self.fine.norm(self.z)
        result: dict[str, dict[str, float]] = {
            name: {} for name in ("holder", "holder_split", "stability", "regularity")
        }
        exponents = {f"{e:g}": (4.0 - e) / 3.0 for e in EPSILONS}
        loads = [f"L{q!r}" for q in (*exponents.values(), TOO_HIGH)]
        load = expression_norms(fine.space, self.load, loads)
        seminorms = second_seminorms(self.z, (*exponents.values(), TOO_HIGH))
        for (key, q), name in zip(exponents.items(), loads, strict=False):
            norm, conjugate = f"W1_{q!r}", f"W1_{q / (q - 1.0)!r}"
            rest = error_norms(rough, None, [norm])[norm]
            weak, middle = error_norms(self.u_h, fine.exact, [conjugate, "W1_4"]).values()
            theta = 1.0 - 4.0 * (q - 1.0) / q
            result["holder"][key] = rest * weak
            result["holder_split"][key] = rest * strong**theta * middle ** (1.0 - theta)
            result["stability"][key] = size / load[name]
            result["regularity"][key] = seminorms[f"{q:g}"] / load[name]
        result["regularity"]["none"] = seminorms[f"{TOO_HIGH:g}"] / load[loads[-1]]
        return result

    def _bumps(self, slope: float) -> fem.Function:
        """The sum of C h ||u - u_h||_{W^{1,inf}} phi_i over the ends of the contact cells."""
        ends = (self.cells != np.roll(self.cells, 1)) & (self.sign > 0.0)
        values = np.where(ends, cell_size(self.coarse.space.mesh) * slope, 0.0)
        return transfer(self.coarse.curve.function(values), self.fine.space)


def transfer(source: fem.Function, space: fem.FunctionSpace) -> fem.Function:
    """Return a function interpolated into a space on another mesh of the same domain."""
    target = fem.Function(space)
    interpolate_between([(source, target)], owned_cells(space.mesh))
    return target
