"""Section 5 and conditions (A), (A_h) against their measurements."""

import functools
import math
from collections.abc import Callable, Sequence

from dolfinx_signorini.paper.theory.checks import (
    ROUNDING,
    Check,
    Row,
    Rows,
    bound_check,
    entry,
    fine,
    number,
    order_check,
    order_table,
    order_text,
    orders,
    table,
)
from dolfinx_signorini.paper.theory.contact_sets import (
    ContactSet,
    condition_a,
    condition_a_h,
    given_contact_set,
)
from dolfinx_signorini.paper.theory.dual import EPSILON
from dolfinx_signorini.paper.theory.proven import ProvenOrder, proven_order
from dolfinx_signorini.paper.theory.scenes import paper_scene
from dolfinx_signorini.paper.theory.violations import LENGTH, ever_more_intervals, fat_cantor_set

Checks = Callable[[Rows], list[Check]]
CORNERS = (0.0, 1.0, 2.0, 3.0)  # arc length on the boundary of the unit square
FINE = 31  # cells per side: from here on (A_h) holds for the paper's solution
SIGNS = {"plus": "+", "minus": "-"}
CHAINS = {"plus": "(20)", "minus": "(26)"}
GROWTH = 1.05  # of a constant that is independent of h, from the coarsest mesh to the finest
TERMS = {
    "plus": ("interpolation", "sign", "bumps", "bump_load", "remainder"),
    "minus": ("interpolation", "sign", "remainder"),
}


def _lemma(part: str, rows: Rows) -> list[Check]:
    family = rows["dual"]
    items = [row[part] for row in family]
    stability = [item["stability"] for item in items]
    exponent = f"(4 - eps)/3, eps = {EPSILON}"
    return [
        bound_check(
            "largest value of z, relative to its size",
            "<= 0",
            max(item["largest"] for item in items),
            number(max(item["largest"] for item in items)),
        ),
        bound_check(
            "largest size of z on the contact cells, relative to its whole",
            "0",
            max(item["contact"] for item in items),
            number(max(item["contact"] for item in items)),
        ),
        Check(
            f"||z||_H1 / ||load||_Lq, q = {exponent}",
            "<= C for all h",
            f"{min(stability):.4f} to {max(stability):.4f}",
            stability[-1] <= GROWTH * stability[0],
        ),
        order_check(
            f"||z - I_h(z)||_W1,q / ||load||_Lq, q = {exponent}",
            family,
            lambda row: row[part]["regularity"] / row["n"],
            ProvenOrder(1.0, False, "Lemma 5.2"),
        ),
    ]


def _lemma_tables(part: str, rows: Rows) -> list[tuple[str, str]]:
    lines = [
        [
            str(row["n"]),
            number(row[part]["largest"]),
            number(row[part]["contact"]),
            f"{row[part]['stability']:.4f}",
            f"{row[part]['regularity']:.4f}",
        ]
        for row in rows["dual"]
    ]
    columns = ("N", "largest z", "z on contact", "z in H1 / load", "z - I_h z in W1,q / (h load)")
    return [("The dual solution", table(columns, lines))]


def _proposition(part: str, rows: Rows) -> list[Check]:
    item = rows["dual"][-1][part]
    terms = {name: item[name] / item["error"] for name in TERMS[part]}
    largest = max(terms, key=lambda name: abs(terms[name]))
    return [
        order_check(
            f"||(u - u_h)^{SIGNS[part]}||_L4",
            fine(rows["paper"], FINE),
            entry("signed", part),
            proven_order(math.inf, "L4", contact_sets=True),
        ),
        *_chain(part, [row[part] for row in rows["dual"]]),
        Check(
            "the term that dominates on the finest mesh",
            "z - I_h(z), order 2 - eps",
            f"{largest}: {terms[largest]:.3f} of the left-hand side, order "
            + order_text(rows["dual"], entry(part, largest)),
            largest == "interpolation",
        ),
    ]


def _chain(part: str, items: Sequence[Row]) -> list[Check]:
    """The inequalities of a chain, each at its worst over the meshes."""
    slack = min(item["slack"] for item in items)
    orthogonality = max(item["sign"] / item["error"] for item in items)
    holder = max(item["interpolation"] / item["holder"] for item in items)
    split = max(item["holder"] / item["holder_split"] for item in items)
    admissible = min(item["admissible"] for item in items)
    return [
        bound_check(
            f"{CHAINS[part]}: right-hand side less left-hand side, over the left",
            ">= 0",
            -slack,
            "0 (equality)" if abs(slack) <= ROUNDING else f"at the least {slack:.4f}",
        ),
        bound_check(
            "(I_h(z), w)_H1 over the left-hand side", "<= 0", orthogonality, number(orthogonality)
        ),
        bound_check(
            "(z - I_h(z), w)_H1 over its Hölder bound", "<= 1", holder - 1.0, f"{holder:.4f}"
        ),
        bound_check(
            "Hölder bound over that with ||w||_W1,s between W1,4 and W1,inf",
            "<= 1",
            split - 1.0,
            f"{split:.4f}",
        ),
        bound_check(
            "the function tested with, on the contact cells",
            ">= 0",
            -admissible,
            number(admissible),
        ),
    ]


def _proposition_tables(part: str, rows: Rows) -> list[tuple[str, str]]:
    names = ("error", *TERMS[part], "holder", "holder_split")
    lines = []
    for row in rows["dual"]:
        item = row[part]
        small = ROUNDING * item["error"]
        figures = ["0" if abs(item[name]) <= small else f"{item[name]:.3e}" for name in names]
        lines.append([str(row["n"]), *figures])
    columns = ("N", *(name.replace("_", " ") for name in names))
    title = "The chain term by term: error <= " + " + ".join(TERMS[part]).replace("_", " ")
    return [(title, table(columns, lines))]


lemma_5_2: Checks = functools.partial(_lemma, "plus")
lemma_5_6: Checks = functools.partial(_lemma, "minus")
lemma_5_2_tables = functools.partial(_lemma_tables, "plus")
lemma_5_6_tables = functools.partial(_lemma_tables, "minus")
proposition_5_4: Checks = functools.partial(_proposition, "plus")
proposition_5_7: Checks = functools.partial(_proposition, "minus")
proposition_5_4_tables = functools.partial(_proposition_tables, "plus")
proposition_5_7_tables = functools.partial(_proposition_tables, "minus")


def contact_sets(rows: Sequence[Row]) -> list[ContactSet]:
    """Return the discrete contact sets of rows."""
    return [
        ContactSet(
            length=row["contact_set"]["length"],
            intervals=tuple((a, b) for a, b in row["contact_set"]["intervals"]),
            detachments=tuple(row["contact_set"]["detachments"]),
        )
        for row in rows
    ]


def definition_2_2(rows: Rows) -> list[Check]:
    """Condition (A) for the paper's solution and for two sets that violate it."""
    given = condition_a([given_contact_set(paper_scene().contact, LENGTH)])
    checks = [
        Check(
            "the paper's solution, contact on (0.5, 4.05) of the arc length",
            "holds",
            "holds" if given.holds else "; ".join(given.violations),
            given.holds,
        )
    ]
    for name, example in (
        ("a Cantor set of measure 1/2", fat_cantor_set(6)),
        ("ever smaller intervals at a point", ever_more_intervals(5)),
    ):
        verdict = condition_a(*example)
        checks.append(
            Check(name, "violated", "; ".join(verdict.violations) or "holds", not verdict.holds)
        )
    return checks


def definition_5_5(rows: Rows) -> list[Check]:
    """Condition (A_h) over the family, and the detachment point."""
    family = fine(rows["paper"], FINE)
    verdict = condition_a_h(contact_sets(family), CORNERS)
    balls = ", ".join(
        f"d = {d:.3f} with delta = {r:.3f}"
        for d, r in zip(verdict.points, verdict.radii, strict=True)
    )
    coarse = [row for row in rows["paper"] if row["n"] < FINE]
    caught = condition_a_h(contact_sets([*coarse, *family]), CORNERS)
    errors = [_detachment_error(row) * row["n"] for row in family]
    return [
        Check(
            f"(A_h) over N = {family[0]['n']} to {family[-1]['n']}",
            "holds",
            balls if verdict.holds else "; ".join(verdict.violations),
            verdict.holds,
        ),
        Check(
            f"(A_h) with N = {coarse[0]['n']} as well",
            "only for small h",
            "; ".join(caught.violations) or "holds",
            not caught.holds,
        ),
        Check(
            "error of the detachment point",
            "none",
            f"order {order_text(family, _detachment_error)}, "
            f"{min(errors):.3f} h to {max(errors):.3f} h",
            orders(family, _detachment_error)[-1] >= 0.95,
        ),
    ]


def _detachment_error(row: Row) -> float:
    """Distance of the point of Section 7 from the nearest detachment point found."""
    return min(abs(s - 0.5) for s in row["contact_set"]["detachments"])


def definition_5_5_tables(rows: Rows) -> list[tuple[str, str]]:
    """The contact sets and their detachment points."""
    lines = []
    for row, found in zip(rows["paper"], contact_sets(rows["paper"]), strict=True):
        lines.append(
            [
                str(row["n"]),
                ", ".join(f"[{a:.4f}, {b:.4f}]" for a, b in found.intervals),
                str(len(found.intervals)),
                str(len(found.singletons)),
                ", ".join(f"{s:.5f}" for s in found.detachments),
            ]
        )
    columns = ("N", "contact set of u_h", "components", "singletons", "detachment points")
    errors = order_table(
        fine(rows["paper"], FINE), {"detachment point less 0.5": _detachment_error}
    )
    return [
        ("Contact sets by arc length from (0, 0)", table(columns, lines)),
        ("The detachment point at (0.5, 0)", errors),
    ]


def no_tables(rows: Rows) -> list[tuple[str, str]]:
    """Return no table."""
    return []
