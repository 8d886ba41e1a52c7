"""Ten rules on speed against accuracy, each with the figures measured for it."""

from collections.abc import Callable, Mapping, Sequence

from dolfinx_signorini.tradeoff.comparing import Row, cheapest, describe, is_baseline, kind_of
from dolfinx_signorini.tradeoff.kinds import GRADED_P2, UNIFORM_P1, UNIFORM_P2, Kind

NORMS = ("L4", "Linf", "W1_4", "W1_inf")
SMALL = 0.01  # an error that does not count

Rule = tuple[str, str]


def _main(rows: Sequence[Row], kind: Kind | None = None) -> list[Row]:
    """The rows of the main grid on one rank, of one kind or of all."""
    rows = [row for row in rows if row["purpose"] == "main" and row["ranks"] == 1]
    return [row for row in rows if kind in (None, kind_of(row))]


def sweep(rows: Sequence[Row], purpose: str) -> dict[str, list[Row]]:
    """Return the rows of a sweep on one rank by their configuration in words.

    Args:
        rows: All rows.
        purpose: The name of the sweep, see `Item`.
    """
    result: dict[str, list[Row]] = {}
    for row in rows:
        if row["purpose"] == purpose and row["ranks"] == 1:
            result.setdefault(describe(row), []).append(row)
    return result


def shown(main: Sequence[Row]) -> list[Row]:
    """Return the finest uniform P1 row, and the cheapest rows that are as accurate in some norm."""
    finest = max((row for row in main if is_baseline(row)), key=lambda row: row["n"])
    rows = [finest]
    for norm in ("L4", "W1_4", "W1_inf"):
        row = cheapest(main, norm, finest["errors"][norm])
        if row is not None and row not in rows:
            rows.append(row)
    return rows


def _tolerance(rows: Sequence[Row]) -> Rule:
    def share(row: Row) -> float:
        return max(row["algebraic"][norm] / row["errors"][norm] for norm in NORMS)

    parts, loosest = [], []
    for name, line in sweep(rows, "tolerance").items():
        line = sorted(line, key=lambda row: -row["rtol"])
        fine = next(row for row in line if share(row) <= SMALL)
        tightest = line[-1]
        loosest.append(fine["rtol"])
        parts.append(
            f"For {name} the algebraic error is {share(fine):.1%} of that of the discretisation, "
            f"in the worst of four norms, at rtol {fine['rtol']:.0e} ({fine['total']:.3g} s), and "
            f"{share(tightest):.1e} of it at {tightest['rtol']:.0e} ({tightest['total']:.3g} s)."
        )
    return (
        f"Tolerance against h: a natural residual of {min(loosest):.0e} is enough here",
        " ".join(parts)
        + " On finer meshes tighten it in proportion to the error that is wanted, not to h.",
    )


def _quadrature(rows: Sequence[Row]) -> Rule:
    parts, degrees = [], []
    for name, line in sweep(rows, "rule").items():
        line = sorted(line, key=lambda row: row["rule"])
        best = line[-1]["errors"]

        def excess(row: Row, best: Mapping[str, float] = best) -> float:
            return max(abs(row["errors"][norm] / best[norm] - 1.0) for norm in NORMS)

        enough = next(row for row in line if excess(row) <= 0.1 * SMALL)
        degrees.append(f"{enough['rule']} for P{enough['degree']}")
        seconds = [row["seconds"]["assembly"] for row in (enough, line[-1])]
        parts.append(
            f"{name}: a Gauss-Jacobi rule of degree {enough['rule']} gives all four errors within "
            f"{excess(enough):.2%} of those of degree {line[-1]['rule']}; degree {line[0]['rule']} "
            f"is off by a factor of {1.0 + excess(line[0]):.3g}. The assembly takes "
            f"{seconds[0]:.3g} s against {seconds[1]:.3g} s."
        )
    return f"Quadrature of the load against p: degree {', '.join(degrees)}", " ".join(parts)


def _against(rows: Sequence[Row], norm: str, kind: Kind | None = None) -> tuple[Row, Row]:
    """The finest uniform P1 row, and the cheapest row of a kind that is as accurate."""
    main = _main(rows)
    finest = min((row for row in main if is_baseline(row)), key=lambda row: row["errors"][norm])
    other = cheapest(_main(rows, kind), norm, finest["errors"][norm])
    if other is None:
        raise ValueError(f"{norm}: no {kind or 'row'} as accurate as uniform P1")
    return finest, other


def _comparison(finest: Row, other: Row, norm: str) -> str:
    return (
        f"{norm} = {finest['errors'][norm]:.3g}: {describe(other)} takes {other['total']:.3g} s "
        f"({other['unknowns']} unknowns), {describe(finest)} {finest['total']:.3g} s "
        f"({finest['unknowns']}): {finest['total'] / other['total']:.3g} times as long."
    )


def _second_degree(rows: Sequence[Row]) -> Rule:
    parts = [_comparison(*_against(rows, norm, UNIFORM_P2), norm) for norm in ("L4", "W1_4")]
    coarse = [cheapest(_main(rows, kind), "L4", 1e-2) for kind in (UNIFORM_P1, UNIFORM_P2)]
    tail = ""
    if coarse[0] and coarse[1]:
        tail = (
            f" For L4 = 0.01 it is {coarse[1]['total']:.3g} s with P2 against "
            f"{coarse[0]['total']:.3g} s with P1. In the Bernstein basis u_h is nowhere below the "
            "obstacle."
        )
    return "P2 pays for more than two digits, on uniform meshes, too", " ".join(parts) + tail


def _grading(rows: Sequence[Row]) -> Rule:
    parts = []
    for norm in ("W1_inf", "Linf", "W1_4", "L4"):
        uniform = _main(rows, UNIFORM_P2)
        finest = min(uniform, key=lambda row: row["errors"][norm])
        graded = cheapest(_main(rows, GRADED_P2), norm, finest["errors"][norm])
        if graded is not None:
            parts.append(
                f"{norm} = {finest['errors'][norm]:.2g}: {graded['total']:.3g} s graded, "
                f"{finest['total']:.3g} s uniform ({finest['total'] / graded['total']:.1f} times)."
            )
    return (
        "Grading pays where the norm sees the detachment point, in the sup norms first",
        "P2 on graded meshes, as accurate as on the finest uniform one: " + " ".join(parts),
    )


def _sup_norm(rows: Sequence[Row]) -> Rule:
    main = _main(rows)
    parts = []
    for strong, weak, target in (("Linf", "L4", 1e-4), ("W1_inf", "W1_4", 0.2)):
        pair = [cheapest(main, norm, target) for norm in (strong, weak)]
        if pair[0] is None or pair[1] is None:
            raise ValueError(f"no row reaches {target} in {strong}")
        parts.append(
            f"An error of {target:g} costs {pair[0]['total']:.3g} s in {strong} "
            f"({describe(pair[0])}) and {pair[1]['total']:.3g} s in {weak} ({describe(pair[1])})."
        )
    return "Ask for the norm you need: L^inf costs more than L^4", " ".join(parts)


def _best(rows: Sequence[Row]) -> Rule:
    parts = []
    for norm in ("L4", "W1_4", "W1_inf"):
        parts.append("- " + _comparison(*_against(rows, norm), norm))
    return (
        "The accuracy of a million P1 unknowns is cheap",
        "The cheapest configuration that is as accurate as the finest uniform P1 mesh:\n\n"
        + "\n".join(parts),
    )


def _method(rows: Sequence[Row]) -> Rule:
    lines = [row for row in rows if row["purpose"] == "method" and row["ranks"] == 1]
    largest = max(row["n"] for row in lines)
    times = {row["method"]: row["total"] for row in lines if row["n"] == largest}
    others = ", ".join(
        f"{name} {value:.3g} s" for name, value in times.items() if name != "cascade"
    )
    return (
        "Let the cascade find where TAO starts",
        f"Uniform P1, N = {largest}, to a residual of 1e-6: cascade {times['cascade']:.3g} s; TAO "
        f"alone from zero: {others}.",
    )


def _ranks(rows: Sequence[Row]) -> Rule:
    pairs = []
    for row in rows:
        if row["purpose"] == "main" and row["ranks"] == 2:
            match = next(r for r in _main(rows) if describe(r) == describe(row))
            pairs.append((match, row))
    if not pairs:
        raise ValueError("no rows on two ranks")
    parts = []
    for kind in (UNIFORM_P1, GRADED_P2):
        own = [pair for pair in pairs if kind_of(pair[0]) == kind]
        one, two = max(own, key=lambda pair: pair[0]["unknowns"])
        slower = [p[0]["unknowns"] for p in own if p[1]["total"] >= p[0]["total"]]
        faster = [p[0]["unknowns"] for p in own if p[0]["unknowns"] > max(slower, default=0)]
        where = f"faster from {min(faster)} unknowns on" if faster else "not faster here"
        parts.append(
            f"{describe(one)}: {one['total']:.3g} s on one rank, {two['total']:.3g} s on two "
            f"({one['total'] / two['total']:.2f} times as fast); two ranks are {where}."
        )
    return "Choose the mesh before the number of ranks", " ".join(parts)


def _reference(rows: Sequence[Row]) -> Rule:
    worst = {norm: 0.0 for norm in NORMS}
    for row in _main(rows):
        for norm, value in row.get("errors_interpolated", {}).items():
            if norm in worst:
                worst[norm] = max(worst[norm], abs(value / row["errors"][norm] - 1.0))
    figures = ", ".join(f"{norm} {value:.1%}" for norm, value in worst.items())
    return (
        "Measure against the exact solution where there is one",
        "Interpolated by polynomials of degree 4, the exact solution changes the measured errors "
        f"by up to {figures}: near the detachment point no degree interpolates it well.",
    )


def _time(rows: Sequence[Row]) -> Rule:
    finest, *others = shown(_main(rows))
    parts = []
    for row in (finest, *others):
        shares = ", ".join(
            f"{phase} {seconds / row['total']:.0%}" for phase, seconds in row["seconds"].items()
        )
        parts.append(
            f"- {describe(row)}, {row['total']:.3g} s: "
            f"{shares}; the errors take {row['seconds_errors']:.3g} s more"
        )
    share = finest["seconds"]["solve"] / finest["total"]
    return (
        f"The solve is {share:.0%} of the time on the finest uniform mesh: save unknowns",
        "\n".join(parts),
    )


RULES: tuple[Callable[[Sequence[Row]], Rule], ...] = (
    _best,
    _second_degree,
    _grading,
    _sup_norm,
    _tolerance,
    _quadrature,
    _method,
    _ranks,
    _reference,
    _time,
)
