"""Section 3 against its measurements: Lemmas 3.2 to 3.5 and Theorem 3.6."""

import math

from dolfinx_signorini.paper.theory.checks import (
    Check,
    Rows,
    Value,
    bound_check,
    entry,
    fine,
    number,
    order_check,
    order_table,
    order_text,
    table,
)
from dolfinx_signorini.paper.theory.experiments import ROUGH_EXPONENTS, rough_name
from dolfinx_signorini.paper.theory.proven import ProvenOrder, allowed_order, supercloseness_order

ALL_SCENES = ("paper", "smooth", *(rough_name(p) for p in ROUGH_EXPONENTS))
FINE = 31  # cells per side of the paper's scene
SUPERCLOSE = (*((p, rough_name(p)) for p in ROUGH_EXPONENTS), (math.inf, "paper"))


def lemma_3_2(rows: Rows) -> list[Check]:
    """The Ritz projection's errors."""
    checks = []
    smooth = "the solution is smoother than W^{2,p}: the trace has order 2 as well"
    for scene, exponents in (("paper", (2, 3)), ("smooth", (2, 4))):
        family = fine(rows[scene], FINE)
        for p in exponents:
            gradient = "H1" if p == 2 else f"W1_{p}"
            for norm, order in ((f"L{p}", 2.0), (gradient, 1.0), (f"L{p}_boundary", 2.0 - 1.0 / p)):
                proven = ProvenOrder(order, False, "Lemma 3.2")
                allowed = f"the singularity at one point allows {allowed_order(math.inf, norm):.3g}"
                better = allowed if scene == "paper" else smooth
                checks.append(
                    order_check(
                        f"u - R_h(u) in {norm}, {scene}",
                        family,
                        entry("ritz", norm),
                        proven,
                        better,
                    )
                )
        checks.append(
            order_check(
                f"u - R_h(u) in H^1/2 of the boundary, {scene}",
                family,
                entry("ritz", "H1_2_boundary_spectral"),
                ProvenOrder(1.5, True, "Lemma 3.2"),
                "both error parts, of orders 3/2 and 2, are seen",
            )
        )
    return checks


def lemma_3_2_tables(rows: Rows) -> list[tuple[str, str]]:
    """Tables of the Ritz projection's errors."""
    return [
        (
            f"u - R_h(u), {scene} solution",
            order_table(
                fine(rows[scene], FINE),
                {
                    norm: entry("ritz", norm)
                    for norm in (f"L{p}", f"W1_{p}", f"L{p}_boundary", "H1_2_boundary_spectral")
                },
            ),
        )
        for scene, p in (("paper", 3), ("smooth", 4))
    ]


def lemma_3_3(rows: Rows) -> list[Check]:
    """R_h(u) solves the problem with the obstacle R_h(u) - u."""
    family = rows["paper"]
    identity = max(row["obstacle"]["identity"] for row in family)
    minimum = min(row["obstacle"]["minimum"] for row in family)
    nodes = max(row["obstacle"]["minimum_nodes"] for row in family)
    return [
        bound_check(
            "smallest <du/dn, v_h - R_h(u)> over all v_h >= R_h(u) - u along every edge",
            ">= 0",
            -minimum,
            number(minimum),
        ),
        bound_check(
            "(R_h(u), phi)_H1 - (f, phi) - <du/dn, phi> for all basis functions",
            "0",
            identity,
            number(identity),
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
            "order " + order_text(fine(family, FINE), entry("obstacle", "distance_nodes")),
            True,
        ),
    ]


def lemma_3_3_tables(rows: Rows) -> list[tuple[str, str]]:
    """What the obstacle at the nodes only changes."""
    lines = [
        [
            str(row["n"]),
            number(row["obstacle"]["minimum"]),
            number(row["obstacle"]["minimum_nodes"]),
            number(row["obstacle"]["distance_nodes"]),
            number(row["supercloseness"]),
        ]
        for row in rows["paper"]
    ]
    columns = (
        "N",
        "minimum, whole edges",
        "minimum, nodes only",
        "H1 distance, nodes only",
        "R_h(u) - u_h in H1",
    )
    return [("The variational inequality tested with the worst v_h", table(columns, lines))]


def lemma_3_4(rows: Rows) -> list[Check]:
    """The Céa-type bound."""
    ratios = [
        row["supercloseness"] / row["one_sided"]["norm"]
        for name in ALL_SCENES
        for row in rows[name]
    ]
    return [
        bound_check(
            f"||R_h(u) - u_h||_H1 / ||w_h||_H1, largest of {len(ratios)} (scene, N)",
            "<= 1",
            max(ratios) - 1.0,
            f"{max(ratios):.4f}",
        )
    ]


def lemma_3_4_tables(rows: Rows) -> list[tuple[str, str]]:
    """Both sides of (9)."""
    lines = [
        [
            str(row["n"]),
            number(row["supercloseness"]),
            number(row["one_sided"]["norm"]),
            f"{row['supercloseness'] / row['one_sided']['norm']:.4f}",
        ]
        for row in rows["paper"]
    ]
    columns = ("N", "R_h(u) - u_h in H1", "w_h in H1", "ratio")
    return [("Both sides of (9), the paper's solution", table(columns, lines))]


def lemma_3_5(rows: Rows) -> list[Check]:
    """One-sided approximation."""
    checks = [
        order_check(
            f"||w_h||_H1, p = {_infinite(p)}",
            fine(rows[name], FINE if name == "paper" else 0),
            entry("one_sided", "norm"),
            supercloseness_order(p),
            _singular(p),
        )
        for p, name in reversed(SUPERCLOSE)
    ]
    everything = [row["one_sided"] for _, name in SUPERCLOSE for row in rows[name]]
    below = max(item["sampling_error"] / item["norm"] for item in everything)
    above = max(item["upper_error"] / item["norm"] for item in everything)
    none = sum(item["cases"][3] for item in everything)
    nodes = sum(sum(item["cases"]) for item in everything)
    return [
        *checks,
        Check(
            "bound of R_h(u) - u - w_h between the samples, relative to ||w_h||_H1",
            "<= 0 for the exact (11)",
            f"<= {number(below)}",
            below < 1e-2,
        ),
        bound_check("w_h - R_h(u), relative to ||w_h||_H1", "<= 0", above, number(above)),
        Check("boundary nodes of none of the three cases", "0", f"{none} of {nodes}", none == 0),
    ]


def lemma_3_5_tables(rows: Rows) -> list[tuple[str, str]]:
    """The cases of Fig. 1 and the accuracy of the sampling."""
    lines = []
    for row in rows["paper"]:
        item = row["one_sided"]
        below = number(item["sampling_error"])
        lines.append([str(row["n"]), *map(str, item["cases"]), below, number(item["norm"])])
    columns = ("N", "case 1", "case 2", "case 3", "none", "sampling error", "w_h in H1")
    return [("The cases of Fig. 1, the paper's solution", table(columns, lines))]


def theorem_3_6(rows: Rows) -> list[Check]:
    """Supercloseness."""
    checks = [
        order_check(
            f"||R_h(u) - u_h||_H1, p = {_infinite(p)}",
            fine(rows[name], FINE if name == "paper" else 0),
            entry("supercloseness"),
            supercloseness_order(p),
            _singular(p),
        )
        for p, name in reversed(SUPERCLOSE)
    ]
    paper = fine(rows["paper"], 101)
    near = entry("supercloseness_parts", "near")
    proven = supercloseness_order(math.inf)
    error = ProvenOrder(1.0, False, "")
    return [
        checks[0],
        order_check("its part near the detachment point", paper, near, proven),
        order_check("||u - u_h||_H1, beside it", paper, entry("errors", "H1"), error),
        *checks[1:],
    ]


def theorem_3_6_tables(rows: Rows) -> list[tuple[str, str]]:
    """Supercloseness with its parts."""
    values: dict[str, Value] = {
        "u - u_h in H1": entry("errors", "H1"),
        "R_h(u) - u_h in H1": entry("supercloseness"),
        "near": entry("supercloseness_parts", "near"),
        "far": entry("supercloseness_parts", "far"),
    }
    return [("The paper's solution", order_table(fine(rows["paper"], 51), values))]


def _infinite(p: float) -> str:
    return "inf (the paper's solution)" if math.isinf(p) else f"{p:g}"


def _singular(p: float) -> str:
    """Why ||R_h(u) - u_h||_H1 and ||w_h||_H1 may converge faster than proven."""
    if math.isinf(p):
        return "two parts: order 3/2 near the detachment point and nearly 2 away from it"
    allowed = allowed_order(p, "H1_2_boundary")
    return f"the regularity ends at one point only, which allows {allowed:.3g}"
