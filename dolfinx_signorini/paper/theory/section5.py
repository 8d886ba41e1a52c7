"""Section 5 and conditions (A), (A_h) against their measurements."""

import math
from collections.abc import Sequence
from functools import partial

from dolfinx_signorini.paper.theory.contact_sets import (
    ContactSet,
    condition_a,
    condition_a_h,
    given_contact_set,
)
from dolfinx_signorini.paper.theory.dual import EPSILON
from dolfinx_signorini.paper.theory.evidence import (
    ROUNDING,
    Check,
    Row,
    Rows,
    Tables,
    Value,
    bound_check,
    entry,
    fine,
    order_check,
    order_table,
    order_text,
    orders,
    row_table,
)
from dolfinx_signorini.paper.theory.examples import paper_example
from dolfinx_signorini.paper.theory.proven import ProvenOrder, proven_order
from dolfinx_signorini.paper.theory.violations import LENGTH, ever_more_intervals, fat_cantor_set

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
    """Check what is known of the dual solution for one sign of the error."""
    family = rows["dual"]
    largest, contact = (max(row[part][key] for row in family) for key in ("largest", "contact"))
    stability = [row[part]["stability"] for row in family]
    exponent = f"(4 - eps)/3, eps = {EPSILON}"
    return [
        bound_check("largest value of z, relative to its size", "<= 0", largest),
        bound_check("largest size of z on the contact cells, relative to its whole", "0", contact),
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


def _lemma_tables(part: str, rows: Rows) -> Tables:
    """Return a table of the dual solution."""
    values: dict[str, Value] = {
        "largest z": entry(part, "largest"),
        "z on contact": entry(part, "contact"),
        "z in H1 / load": lambda row: f"{row[part]['stability']:.4f}",
        "z - I_h z in W1,q / (h load)": lambda row: f"{row[part]['regularity']:.4f}",
    }
    return [("The dual solution", row_table(rows["dual"], values))]


def _proposition(part: str, rows: Rows) -> list[Check]:
    """Check the order of one part of the error, and the chain of inequalities behind the order."""
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
    sign = max(item["sign"] / item["error"] for item in items)
    holder = max(item["interpolation"] / item["holder"] for item in items)
    split = max(item["holder"] / item["holder_split"] for item in items)
    admissible = min(item["admissible"] for item in items)
    chain = f"{CHAINS[part]}: right-hand side less left-hand side, over the left"
    equality = "0 (equality)" if abs(slack) <= ROUNDING else f"at the least {slack:.4f}"
    interpolated = "Hölder bound over that with ||w||_W1,s between W1,4 and W1,inf"
    return [
        bound_check(chain, ">= 0", slack, equality),
        bound_check("(I_h(z), w)_H1 over the left-hand side", "<= 0", sign),
        bound_check("(z - I_h(z), w)_H1 over its Hölder bound", "<= 1", holder),
        bound_check(interpolated, "<= 1", split),
        bound_check("the function tested with, on the contact cells", ">= 0", admissible),
    ]


def _proposition_tables(part: str, rows: Rows) -> Tables:
    """Return a table of the chain, term by term."""

    def term(name: str, row: Row) -> str:
        value, error = row[part][name], row[part]["error"]
        return "0" if abs(value) <= ROUNDING * error else f"{value:.3e}"

    names = ("error", *TERMS[part], "holder", "holder_split")
    values = {name.replace("_", " "): partial(term, name) for name in names}
    title = "The chain term by term: error <= " + " + ".join(TERMS[part]).replace("_", " ")
    return [(title, row_table(rows["dual"], values))]


lemma_5_2, lemma_5_2_tables = partial(_lemma, "plus"), partial(_lemma_tables, "plus")
lemma_5_6, lemma_5_6_tables = partial(_lemma, "minus"), partial(_lemma_tables, "minus")
proposition_5_4 = partial(_proposition, "plus")
proposition_5_7 = partial(_proposition, "minus")
proposition_5_4_tables = partial(_proposition_tables, "plus")
proposition_5_7_tables = partial(_proposition_tables, "minus")


def contact_set(row: Row) -> ContactSet:
    """Return the discrete contact set of a row."""
    found = row["contact_set"]
    intervals = tuple((a, b) for a, b in found["intervals"])
    return ContactSet(found["length"], intervals, tuple(found["detachments"]))


def definition_2_2(rows: Rows) -> list[Check]:
    """Check condition (A) for the paper's solution and for two sets that violate it."""
    given = condition_a([given_contact_set(paper_example().contact, LENGTH)])
    what = "the paper's solution, contact on (0.5, 4.05) of the arc length"
    checks = [Check(what, "holds", str(given), given.holds)]
    for name, approximations in (
        ("a Cantor set of measure 1/2", fat_cantor_set(6)),
        ("ever smaller intervals at a point", ever_more_intervals(5)),
    ):
        verdict = condition_a(*approximations)
        checks.append(Check(name, "violated", str(verdict), not verdict.holds))
    return checks


def definition_5_5(rows: Rows) -> list[Check]:
    """Check condition (A_h) over the family, and the detachment point."""
    family = fine(rows["paper"], FINE)
    verdict = condition_a_h([contact_set(row) for row in family], CORNERS)
    caught = condition_a_h([contact_set(row) for row in rows["paper"]], CORNERS)
    balls = ", ".join(
        f"d = {d:.3f} with delta = {r:.3f}"
        for d, r in zip(verdict.points, verdict.radii, strict=True)
    )
    errors = [detachment_error(row) * row["n"] for row in family]
    return [
        Check(
            f"(A_h) over N = {family[0]['n']} to {family[-1]['n']}",
            "holds",
            balls if verdict.holds else str(verdict),
            verdict.holds,
        ),
        Check(
            f"(A_h) with N = {rows['paper'][0]['n']} as well",
            "only for small h",
            str(caught),
            not caught.holds,
        ),
        Check(
            "error of the detachment point",
            "none",
            f"order {order_text(family, detachment_error)}, "
            f"{min(errors):.3f} h to {max(errors):.3f} h",
            orders(family, detachment_error)[-1] >= 0.95,
        ),
    ]


def detachment_error(row: Row) -> float:
    """Return the distance of the point of Section 7 from the nearest detachment point found."""
    return min(abs(s - 0.5) for s in row["contact_set"]["detachments"])


def definition_5_5_tables(rows: Rows) -> Tables:
    """Return tables of the contact sets and their detachment points."""
    values: dict[str, Value] = {
        "contact set of u_h": lambda row: ", ".join(
            f"[{a:.4f}, {b:.4f}]" for a, b in contact_set(row).intervals
        ),
        "components": lambda row: len(contact_set(row).intervals),
        "singletons": lambda row: len(contact_set(row).singletons),
        "detachment points": lambda row: ", ".join(
            f"{s:.5f}" for s in contact_set(row).detachments
        ),
    }
    points = {"detachment point less 0.5": detachment_error}
    return [
        ("Contact sets by arc length from (0, 0)", row_table(rows["paper"], values)),
        ("The detachment point at (0.5, 0)", order_table(fine(rows["paper"], FINE), points)),
    ]


def no_tables(rows: Rows) -> Tables:
    """Return no table."""
    return []
