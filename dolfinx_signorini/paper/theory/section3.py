"""Section 3 against its measurements: Lemmas 3.2 to 3.5 and Theorem 3.6."""

import math

from dolfinx_signorini.paper.theory.evidence import (
    Check,
    Row,
    Rows,
    Tables,
    Value,
    bound_check,
    entry,
    fine,
    number,
    order_check,
    order_table,
    order_text,
    row_table,
)
from dolfinx_signorini.paper.theory.experiments import ROUGH_EXPONENTS, rough_name
from dolfinx_signorini.paper.theory.proven import ProvenOrder, allowed_order, supercloseness_order

SUPERCLOSE = {rough_name(p): p for p in ROUGH_EXPONENTS} | {"paper": math.inf}
FINE = 31  # cells per side of the paper's solution


def lemma_3_2(rows: Rows) -> list[Check]:
    """Compare the errors of the Ritz projection with their proven orders."""
    checks = []
    for example, exponents in (("paper", (2, 3)), ("smooth", (2, 4))):
        family = fine(rows[example], FINE)
        for p in exponents:
            gradient = "H1" if p == 2 else f"W1_{p}"
            for norm, order in ((f"L{p}", 2.0), (gradient, 1.0), (f"L{p}_boundary", 2.0 - 1.0 / p)):
                reason = "the solution is smoother than W^{2,p}: the trace has order 2 as well"
                if example == "paper":
                    allowed = allowed_order(math.inf, norm)
                    reason = f"the singularity at one point allows {allowed:.3g}"
                what, value = f"u - R_h(u) in {norm}, {example}", entry("ritz", norm)
                proven = ProvenOrder(order, False, "Lemma 3.2")
                checks.append(order_check(what, family, value, proven, reason))
        checks.append(
            order_check(
                f"u - R_h(u) in H^1/2 of the boundary, {example}",
                family,
                entry("ritz", "H1_2_boundary_spectral"),
                ProvenOrder(1.5, True, "Lemma 3.2"),
                "both error parts, of orders 3/2 and 2, are seen",
            )
        )
    return checks


def lemma_3_2_tables(rows: Rows) -> Tables:
    """Return tables of the errors of the Ritz projection."""
    tables = []
    for example, p in (("paper", 3), ("smooth", 4)):
        norms = (f"L{p}", f"W1_{p}", f"L{p}_boundary", "H1_2_boundary_spectral")
        values = {norm: entry("ritz", norm) for norm in norms}
        text = order_table(fine(rows[example], FINE), values)
        tables.append((f"u - R_h(u), {example} solution", text))
    return tables


def lemma_3_3(rows: Rows) -> list[Check]:
    """Check that R_h(u) solves the problem with the obstacle R_h(u) - u."""
    family = rows["paper"]
    identity = max(row["obstacle"]["identity"] for row in family)
    minimum = min(row["obstacle"]["minimum"] for row in family)
    nodes = max(row["obstacle"]["minimum_nodes"] for row in family)
    order = order_text(fine(family, FINE), entry("obstacle", "distance_nodes"))
    return [
        bound_check(
            "smallest <du/dn, v_h - R_h(u)> over all v_h >= R_h(u) - u along every edge",
            ">= 0",
            minimum,
        ),
        bound_check(
            "(R_h(u), phi)_H1 - (f, phi) - <du/dn, phi> for all basis functions", "0", identity
        ),
        Check(
            "the same minimum with v_h >= R_h(u) - u at the nodes only",
            "not covered",
            f"< 0 on every mesh, {number(nodes)} on the finest",
            nodes < 0.0,
        ),
        Check(
            "H^1 distance of R_h(u) from the solution with that obstacle",
            "not covered",
            f"order {order}",
            True,
        ),
    ]


def lemma_3_3_tables(rows: Rows) -> Tables:
    """Return a table of what the obstacle at the nodes only changes."""
    values = {
        "minimum, whole edges": entry("obstacle", "minimum"),
        "minimum, nodes only": entry("obstacle", "minimum_nodes"),
        "H1 distance, nodes only": entry("obstacle", "distance_nodes"),
        "R_h(u) - u_h in H1": entry("supercloseness"),
    }
    text = row_table(rows["paper"], values)
    return [("The variational inequality tested with the worst v_h", text)]


def lemma_3_4(rows: Rows) -> list[Check]:
    """Check the Céa-type bound."""
    ratios = [_ratio(row) for name in ("smooth", *SUPERCLOSE) for row in rows[name]]
    what = f"||R_h(u) - u_h||_H1 / ||w_h||_H1, largest of {len(ratios)} (scene, N)"
    return [bound_check(what, "<= 1", max(ratios))]


def lemma_3_4_tables(rows: Rows) -> Tables:
    """Return a table of both sides of (9)."""
    values = {
        "R_h(u) - u_h in H1": entry("supercloseness"),
        "w_h in H1": entry("one_sided", "norm"),
        "ratio": lambda row: f"{_ratio(row):.4f}",
    }
    return [("Both sides of (9), the paper's solution", row_table(rows["paper"], values))]


def lemma_3_5(rows: Rows) -> list[Check]:
    """Check the one-sided approximation."""
    everything = [row["one_sided"] for name in SUPERCLOSE for row in rows[name]]
    below = max(item["sampling_error"] / item["norm"] for item in everything)
    above = max(item["upper_error"] / item["norm"] for item in everything)
    none = sum(item["cases"][3] for item in everything)
    nodes = sum(sum(item["cases"]) for item in everything)
    return [
        *_superclose(rows, "||w_h||_H1", entry("one_sided", "norm")),
        Check(
            "bound of R_h(u) - u - w_h between the samples, relative to ||w_h||_H1",
            "<= 0 for the exact (11)",
            f"<= {number(below)}",
            below < 1e-2,
        ),
        bound_check("w_h - R_h(u), relative to ||w_h||_H1", "<= 0", above),
        Check("boundary nodes of none of the three cases", "0", f"{none} of {nodes}", none == 0),
    ]


def lemma_3_5_tables(rows: Rows) -> Tables:
    """Return a table of the cases of Fig. 1 and the accuracy of the sampling."""
    names = ("case 1", "case 2", "case 3", "none")
    values = {name: entry("one_sided", "cases", k) for k, name in enumerate(names)}
    values["sampling error"] = entry("one_sided", "sampling_error")
    values["w_h in H1"] = entry("one_sided", "norm")
    return [("The cases of Fig. 1, the paper's solution", row_table(rows["paper"], values))]


def theorem_3_6(rows: Rows) -> list[Check]:
    """Compare the order of supercloseness with the proven one."""
    whole, *others = _superclose(rows, "||R_h(u) - u_h||_H1", entry("supercloseness"))
    paper = fine(rows["paper"], 101)
    near = entry("supercloseness_parts", "near")
    proven = supercloseness_order(math.inf)
    error = ProvenOrder(1.0, False, "")
    return [
        whole,
        order_check("its part near the detachment point", paper, near, proven),
        order_check("||u - u_h||_H1, beside it", paper, entry("errors", "H1"), error),
        *others,
    ]


def theorem_3_6_tables(rows: Rows) -> Tables:
    """Return a table of supercloseness with its parts."""
    values = {
        "u - u_h in H1": entry("errors", "H1"),
        "R_h(u) - u_h in H1": entry("supercloseness"),
        "near": entry("supercloseness_parts", "near"),
        "far": entry("supercloseness_parts", "far"),
    }
    return [("The paper's solution", order_table(fine(rows["paper"], 51), values))]


def _ratio(row: Row) -> float:
    return float(row["supercloseness"] / row["one_sided"]["norm"])


def _superclose(rows: Rows, what: str, value: Value) -> list[Check]:
    """Compare the orders of a value with those of Theorem 3.6, the paper's solution first."""
    checks = []
    for name, p in reversed(SUPERCLOSE.items()):
        exponent = "inf (the paper's solution)" if name == "paper" else f"{p:g}"
        reason = "two parts: order 3/2 near the detachment point and nearly 2 away from it"
        if name != "paper":
            allowed = allowed_order(p, "H1_2_boundary")
            reason = f"the regularity ends at one point only, which allows {allowed:.3g}"
        family = fine(rows[name], FINE if name == "paper" else 0)
        proven = supercloseness_order(p)
        checks.append(order_check(f"{what}, p = {exponent}", family, value, proven, reason))
    return checks
