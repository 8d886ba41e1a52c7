"""The statements of the paper: what they claim, what is computed for them, what is seen."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from dolfinx_signorini.paper.theory import section3, section4, section5
from dolfinx_signorini.paper.theory.checks import Check, Rows
from dolfinx_signorini.paper.theory.experiments import ROUGH_EXPONENTS, placed_name, rough_name
from dolfinx_signorini.paper.theory.placement import PLACES

LOWER = tuple(rough_name(p) for p in ROUGH_EXPONENTS if p < 4.0)
UPPER = tuple(rough_name(p) for p in ROUGH_EXPONENTS if p > 4.0)


@dataclass(frozen=True)
class Statement:
    """A statement of the paper with its experiment.

    Attributes:
        key: Its number, by which the command line knows it.
        name: Its name.
        claim: What it says.
        experiments: What is computed for it.
        checks: The measured figures beside the proven ones; the first is its headline.
        tables: Titles and tables, in Markdown.
        comment: How it is computed and what is seen.
        figure: Name of its picture; empty without one.
    """

    key: str
    name: str
    claim: str
    experiments: tuple[str, ...]
    checks: Callable[[Rows], list[Check]]
    tables: Callable[[Rows], list[tuple[str, str]]]
    comment: str
    figure: str


STATEMENTS: Sequence[Statement] = (
    Statement(
        "2.2",
        "Definition 2.2, condition (A)",
        "The relative boundary of the contact set has measure zero, and its relative interior has "
        "finitely many components.",
        ("paper",),
        section5.definition_2_2,
        section5.no_tables,
        "A set of finitely many intervals satisfies (A) by itself. Any other set is given by "
        "finer and finer approximations from inside and from outside, and the limits of what lies "
        "between them, and of the number of components inside, are estimated.",
        "",
    ),
    Statement(
        "3.2",
        "Lemma 3.2, the Ritz projection",
        "For v in W^{2,p}: ||v - R_h(v)||_Lp + h ||v - R_h(v)||_W1,p + h^{1/p} ||v - R_h(v)||_Lp "
        "of the boundary <= C h^2 ||v||_W2,p. For v in H^{5/2-eps}: ||v - R_h(v)||_H1/2 of the "
        "boundary <= C h^{3/2-eps}.",
        ("paper", "smooth"),
        section3.lemma_3_2,
        section3.lemma_3_2_tables,
        "The H^{1/2} norm is the spectral one, from the Fourier series along the boundary. The "
        "paper's solution is r^{3/2} at the detachment point and smooth elsewhere; the smooth one "
        "is 2 + cos(pi x) cos(2 pi y).",
        "projection",
    ),
    Statement(
        "3.3",
        "Lemma 3.3, R_h(u) as the solution of an obstacle problem",
        "R_h(u) solves the problem with the obstacle R_h(u) - u on the boundary in place of 0.",
        ("paper",),
        section3.lemma_3_3,
        section3.lemma_3_3_tables,
        "What is to be shown is <du/dn, v_h - R_h(u)> >= 0 for all v_h >= R_h(u) - u. The "
        "smallest value is a linear program in the boundary values of v_h; that it is 0 with the "
        "obstacle at 65 samples of every edge shows that it is with the obstacle along the whole "
        "edge. With the obstacle at the nodes only it is negative: on the edge that holds the "
        "detachment point, u is positive at one end and the flux in the other half, and v_h may "
        "take less there. R_h(u) is then no solution, and misses it by order 3/2 in H^1: no more "
        "than it is away from u_h.",
        "supercloseness",
    ),
    Statement(
        "3.4",
        "Lemma 3.4, a Céa-type property",
        "||R_h(u) - u_h||_H1 <= ||w_h||_H1 for every w_h in V_h with R_h(u) - u <= w_h <= R_h(u) "
        "on the boundary. (9)",
        section3.ALL_SCENES,
        section3.lemma_3_4,
        section3.lemma_3_4_tables,
        "Tested with the w_h of Lemma 3.5, on all scenes and meshes.",
        "supercloseness",
    ),
    Statement(
        "3.5",
        "Lemma 3.5, one-sided approximation",
        "There is such a w_h with ||w_h||_H1 <= C h^{3/2-1/p} for u in W^{2,p}, 2 < p < 4, and <= "
        "C h^{3/2-2/p-eps} for u = u_s + u_r, p > 4.",
        section3.ALL_SCENES,
        section3.lemma_3_5,
        section3.lemma_3_5_tables,
        "w_h is the solution of the linear program (11) by HiGHS, extended by the discrete "
        "harmonic extension. The constraint is set at 65 points of every edge and through the "
        "tangents where u vanishes at a node; how far it may be violated between the points is "
        "bounded by the change of u' from one point to the next. Every boundary node must be of "
        "one of the cases of the paper's Fig. 1: w_h touches R_h(u) - u at the node, or on the "
        "edge before it, or on the one behind it. For p > 4 the proven order is the better one of "
        "both parts, as such solutions are in W^{2,4-eps}, too.",
        "one_sided",
    ),
    Statement(
        "3.6",
        "Theorem 3.6, supercloseness",
        "||R_h(u) - u_h||_H1 <= C h^{3/2-1/p} for u in W^{2,p}, 2 < p < 4, and <= C "
        "h^{3/2-2/p-eps} for u = u_s + u_r, p > 4.",
        section3.ALL_SCENES,
        section3.theorem_3_6,
        section3.theorem_3_6_tables,
        "For the paper's solution p is arbitrarily large. The difference has two parts, measured "
        "within eight cell diameters of the detachment point and outside: the first converges "
        "with the proven order 3/2; the second, nearly of order 2, is the larger one on coarse "
        "meshes, which is why the whole seems to converge faster than proven.",
        "supercloseness",
    ),
    Statement(
        "4.1",
        "Corollary 4.1, u in W^{2,p} with 2 < p < 4",
        "u - u_h is of order 1 in W^{1,4p/(p+2)}, 1/2 - 1/p in W^{1,inf}, and 3/2 - 1/p in L^q "
        "for all q, in L^inf (up to |ln h|^{1/2}) and in H^{1/2} of the boundary.",
        LOWER,
        section4.corollary_4_1,
        section4.corollary_4_1_tables,
        "The scenes are r^{1/2-2/p} times the paper's solution: like r^{2-2/p} at the detachment "
        "point, in W^{2,q} for q < p and not for q = p. The corollary holds for every function in "
        "W^{2,p}; these have their singularity at one point only, and converge as it allows.",
        "regularity",
    ),
    Statement(
        "4.2",
        "Corollary 4.2, u = u_s + u_r with p > 4",
        "u - u_h is of order 1 - eps in W^{1,4p/(p+4)}, 1/2 - 2/p - eps in W^{1,inf}, and 3/2 - "
        "2/p - eps in L^inf and in H^{1/2} of the boundary.",
        UPPER,
        section4.corollary_4_2,
        section4.corollary_4_2_tables,
        "The scenes are (1 + r^{1/2-2/p}) times the paper's solution: u_s is the paper's "
        "solution, u_r is like r^{2-2/p}. As u is in W^{2,4-eps}, too, Corollary 4.1 with p close "
        "to 4 is better for p < 8; the better order counts.",
        "regularity",
    ),
    Statement(
        "4.3",
        "Theorem 4.3, optimal orders",
        "For u = u_s + u_r with any p: order 1 in W^{1,8/3-eps}, 1 - eps in W^{1,4}, 1/2 - eps in "
        "W^{1,inf}, 3/2 - eps in L^inf and in H^{1/2} of the boundary.",
        ("paper",),
        section4.theorem_4_3,
        section4.theorem_4_3_tables,
        "The paper's solution. Norms as in the paper's tables, but for H^{1/2}, which is the "
        "spectral one here.",
        "errors",
    ),
    Statement(
        "5.2",
        "Lemma 5.2, the dual problem (D)",
        "Its solution satisfies z <= 0, z = 0 on the contact cells, ||z||_H1 <= C ||load||_Lq "
        "(18) and ||z||_W2,q <= C ||load||_Lq (19), q = (4 - eps)/3, load = max(0, u - u_h)^3.",
        ("dual",),
        section5.lemma_5_2,
        section5.lemma_5_2_tables,
        "z is computed on a mesh four times as fine as that of u_h, with the vertex rule for its "
        "reaction term, so that the discrete maximum principle holds. (19) is seen in the order 1 "
        "of the interpolation of z in W^{1,q}; as z is only r^{1/2} at the ends of the contact "
        "cells, q = 4/3 is just out of reach, and the constant settles slowly.",
        "dual",
    ),
    Statement(
        "5.4",
        "Proposition 5.4, the part (u - u_h)^+",
        "||(u - u_h)^+||_L4 <= C h^{2-eps}.",
        ("paper", "dual"),
        section5.proposition_5_4,
        section5.proposition_5_4_tables,
        "The chain (20), (21) is for the load divided by the third power of the left-hand side, "
        "so that this is the error itself. The remainder is what the approximation of z "
        "contributes. Two terms are of the size of the error: the interpolation of z tested with "
        "u_h - u, and the hat functions at the ends of the contact cells, which make the function "
        "tested with admissible.",
        "dual",
    ),
    Statement(
        "5.5",
        "Definition 5.5, condition (A_h)",
        "There are points d_i and radii delta_i such that, for small h, each ball holds exactly "
        "one point of the relative boundary of {u_h = 0}, no component is a single point, and the "
        "balls keep away from each other and from the corners.",
        ("paper",),
        section5.definition_5_5,
        section5.definition_5_5_tables,
        "The contact set of u_h has two ends. One converges to the detachment point (0.5, 0). The "
        "other one lies on the right side, near the arc length 1.225, and does not converge to the "
        "end of the contact set of u: behind it both u and its flux vanish, and u_h is positive by "
        "its error, of order h^2. (A_h) asks for no more than that it stays where it is; that the "
        "contact sets of u_h approximate that of u, as Section 7 observes, is true of the first "
        "end only. Detachment points are found by the change of sign of gap less pressure between "
        "two nodes. On the coarsest mesh u_h lifts off at a corner, which the check catches.",
        "contact_sets",
    ),
    Statement(
        "5.6",
        "Lemma 5.6, the dual problem (D~)",
        "As Lemma 5.2, with the contact set of u_h in place of that of u, and the load max(0, u_h "
        "- u)^3: (22), (23).",
        ("dual",),
        section5.lemma_5_6,
        section5.lemma_5_6_tables,
        "Computed as for Lemma 5.2.",
        "dual",
    ),
    Statement(
        "5.7",
        "Proposition 5.7, the part (u - u_h)^-",
        "||(u - u_h)^-||_L4 <= C h^{2-eps} under (A_h).",
        ("paper", "dual"),
        section5.proposition_5_7,
        section5.proposition_5_7_tables,
        "The chain (26) as for Proposition 5.4. No hat functions are needed, and it holds with "
        "equality: z has its contact pressure only where u vanishes.",
        "dual",
    ),
    Statement(
        "6.1",
        "Theorem 6.1, optimal orders under (A) and (A_h)",
        "For bounded loads: the orders of Theorem 4.3, and 2 - eps for (u - u_h)^+ and (u - "
        "u_h)^- in L^4.",
        ("paper",),
        section4.theorem_6_1,
        section4.theorem_6_1_tables,
        "The paper's solution.",
        "errors",
    ),
    Statement(
        "7",
        "Section 7, the place of the detachment point",
        "The paper keeps the detachment point off the nodes, in the middle of an edge, as the "
        "worst "
        "case.",
        tuple(placed_name(place) for place in PLACES),
        section4.placement,
        section4.placement_tables,
        "The paper's solution moved by a part of an edge. The orders are the same everywhere, and "
        "the place changes the errors by a constant factor. The middle is the worst place in no "
        "norm: the gradient of the error is largest with the point at a quarter of the edge, and "
        "L^4, L^inf and H^{1/2} of the error are with the point at three quarters, next to the "
        "first node in contact. L^16 is worst with the point on a node, as soon as the error near "
        "the point rules it.",
        "placement",
    ),
    Statement(
        "table2",
        "Table 2, orders past p = 4",
        "By inverse estimates: order 1.625 - eps in L^16 and 0.625 - eps in W^{1,16}.",
        ("paper",),
        section4.transition,
        section4.transition_tables,
        "The error has two parts, measured within eight cell diameters of the detachment point "
        "and outside. Near the point it is of the proven order, outside of order 2. In L^16 the "
        "outer part is the larger one on coarse meshes and the inner one on fine ones: the order "
        "of the whole is the mean of both, weighted with their shares in the 16th power, and "
        "passes from 2 to 1.625 where the shares change, as the L^16 column of the paper's Table "
        "2 does. In W^{1,16} the inner part is the larger one from the start.",
        "transition",
    ),
)


def select(keys: Sequence[str] | None) -> list[Statement]:
    """Return statements by their keys, all of them by default.

    Raises:
        KeyError: A key is unknown.
    """
    known = {statement.key: statement for statement in STATEMENTS}
    return list(STATEMENTS) if not keys else [known[key] for key in dict.fromkeys(keys)]
