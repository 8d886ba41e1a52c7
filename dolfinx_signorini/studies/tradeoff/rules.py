"""Rules on speed against accuracy, each with the figures measured for it."""

from collections.abc import Mapping, Sequence

from dolfinx_signorini.base.tables import markdown_table
from dolfinx_signorini.meshes.elements import HIGHEST_DEGREE
from dolfinx_signorini.studies.tradeoff.comparing import (
    Row,
    cheapest,
    compared,
    describe,
    finest,
    kind_of,
    of_kind,
    targets,
)
from dolfinx_signorini.studies.tradeoff.kinds import GRADED_P2, GRADED_P4, MESHES, UNIFORM_P1, Kind

NORMS = ("L4", "Linf", "W1_4", "W1_inf")
DEGREES = range(1, HIGHEST_DEGREE + 1)
SMALL = 0.01  # of the error of the discretisation: does not count
ROUGH = 0.05  # by so much a rule may change this error

Rule = tuple[str, str]


def sweep(rows: Sequence[Row], purpose: str) -> dict[str, list[Row]]:
    """Return the rows of a sweep by their configuration in words.

    Args:
        rows: The rows on one rank.
        purpose: The name of the sweep, see `Item`.
    """
    result: dict[str, list[Row]] = {}
    for row in rows:
        if row["purpose"] == purpose:
            result.setdefault(describe(row), []).append(row)
    return result


def shown(rows: Sequence[Row]) -> list[Row]:
    """Return the finest uniform P1 row, and the cheapest rows that are as accurate in some norm.

    Args:
        rows: The rows on one rank.
    """
    result = [finest(compared(rows, NORMS[0]))]
    for norm in NORMS:
        row = cheapest(compared(rows, norm), norm, result[0]["errors"][norm])
        if row is not None and row not in result:
            result.append(row)
    return result


def _best(rows: Sequence[Row]) -> Rule:
    parts: list[str] = []
    lines: list[list[str]] = []
    for norm in NORMS:
        own = compared(rows, norm)
        base = finest(own)
        error = base["errors"][norm]
        best = _required(own, norm, error)
        parts.append(
            f"- {norm} = {error:.3g}: {describe(best)} takes {_cost(best)}, {describe(base)} "
            f"{_cost(base)}: {base['total'] / best['total']:.3g} times as long."
        )
        for mesh in MESHES:
            cells = [f"{norm} = {error:.3g}" if mesh == MESHES[0] else "", mesh]
            for degree in DEGREES:
                row = cheapest(of_kind(own, Kind(mesh, degree)), norm, error)
                cells.append("" if row is None else _cost(row))
            lines.append(cells)
    columns = ("error", "mesh", *(f"P{degree}" for degree in DEGREES))
    return (
        "The accuracy of a million P1 unknowns is cheap",
        "The cheapest configuration that is as accurate as the finest uniform P1 mesh:\n\n"
        + "\n".join(parts)
        + "\n\nThe cheapest one by mesh and degree, in seconds and unknowns; empty where none of "
        "those measured is as accurate:\n\n" + markdown_table(columns, lines),
    )


def _choice(rows: Sequence[Row]) -> Rule:
    best: dict[float, dict[str, str]] = {}
    for norm in NORMS:
        own = compared(rows, norm)
        for target in targets(own, norm):
            row = cheapest(own, norm, target)
            if row is not None and target != finest(own)["errors"][norm]:
                best.setdefault(target, {})[norm] = f"{describe(row)}: {row['total']:.2g} s"
    lines = [
        (f"{target:.0e}", *(best[target].get(norm, "") for norm in NORMS))
        for target in sorted(best, reverse=True)
    ]
    return (
        "What to take for which error",
        "The cheapest of all in each norm:\n\n" + markdown_table(("error at most", *NORMS), lines),
    )


def _adapted(rows: Sequence[Row]) -> Rule:
    parts = []
    for norm in NORMS:
        own = compared(rows, norm)
        loop = [row for row in own if row["mesh"] == "adapted"]
        given = [row for row in own if row["mesh"] != "adapted"]
        error = finest(own)["errors"][norm]
        best, other = _required(loop, norm, error), _required(given, norm, error)
        shares = [row["errors"][norm] / row["accuracy"] for row in loop]
        parts.append(
            f"- {norm} = {error:.3g}: {describe(best)} takes {_cost(best)}, the best of the "
            f"other meshes, {describe(other)}, {_cost(other)}. Over {len(loop)} runs of the loop "
            f"the true error was {min(shares):.2g} to {max(shares):.2g} times the accuracy asked "
            "for."
        )
    return (
        "The adaptive loop needs no mesh and no N, and takes its time",
        "The loop is told an accuracy, and starts from 4 by 4 squares; the seconds are those of "
        "all its steps. A uniform or graded mesh of the right N is known afterwards only.\n\n"
        + "\n".join(parts),
    )


def _sup_norm(rows: Sequence[Row]) -> Rule:
    parts = []
    for strong, weak, target in (("Linf", "L4", 1e-4), ("W1_inf", "W1_4", 0.2)):
        pair = [_required(compared(rows, norm), norm, target) for norm in (strong, weak)]
        parts.append(
            f"An error of {target:g} costs {pair[0]['total']:.3g} s in {strong} "
            f"({describe(pair[0])}) and {pair[1]['total']:.3g} s in {weak} ({describe(pair[1])})."
        )
    return "Ask for the norm you need: sup norms cost more", " ".join(parts)


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
            f"For {name} the algebraic error is {share(fine):.1e} of that of the discretisation, "
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

        enough = next(row for row in line if excess(row) <= ROUGH)
        degrees.append(f"{enough['rule']} for P{enough['degree']}")
        seconds = [row["seconds"]["assembly"] for row in (enough, line[-1])]
        parts.append(
            f"{name}: a Gauss-Jacobi rule of degree {enough['rule']} gives all four errors within "
            f"{excess(enough):.2%} of those of degree {line[-1]['rule']}; degree {line[0]['rule']} "
            f"is off by a factor of {1.0 + excess(line[0]):.3g}. The assembly takes "
            f"{seconds[0]:.3g} s against {seconds[1]:.3g} s."
        )
    return f"Quadrature of the load against p: degree {', '.join(degrees)}", " ".join(parts)


def _method(rows: Sequence[Row]) -> Rule:
    lines = [row for row in rows if row["purpose"] == "method"]
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
    given = [row for row in rows if row["purpose"] == "main" and row["mesh"] != "adapted"]
    alone = {describe(row): row for row in given if row["ranks"] == 1}
    pairs = [(alone[describe(row)], row) for row in given if row["ranks"] == 2]
    parts = []
    for kind in (UNIFORM_P1, GRADED_P2, GRADED_P4):
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


def _time(rows: Sequence[Row]) -> Rule:
    parts = []
    for row in shown(rows):
        shares = ", ".join(
            f"{phase} {seconds / row['total']:.0%}" for phase, seconds in row["seconds"].items()
        )
        parts.append(
            f"- {describe(row)}, {row['total']:.3g} s: "
            f"{shares}; the errors take {row['seconds_errors']:.3g} s more"
        )
    base = shown(rows)[0]
    share = base["seconds"]["solve"] / base["total"]
    return (
        f"The solve is {share:.0%} of the time on the finest uniform P1 mesh: save unknowns",
        'On adapted meshes all that comes before the last step is "coarse".\n\n' + "\n".join(parts),
    )


def _cost(row: Row) -> str:
    return f"{row['total']:.3g} s ({row['unknowns']})"


def _required(rows: Sequence[Row], norm: str, target: float) -> Row:
    """The cheapest row that reaches an error; one must exist."""
    row = cheapest(rows, norm, target)
    if row is None:
        raise ValueError(f"no row is accurate enough in {norm}")
    return row


def rules(rows: Sequence[Row]) -> list[Rule]:
    """Return the rules with their titles.

    Args:
        rows: All rows; only the rule about ranks reads rows on several ranks.

    Raises:
        ValueError, KeyError, IndexError, StopIteration: Some rule has no rows.
    """
    serial = [row for row in rows if row["ranks"] == 1]
    return [
        _best(serial),
        _choice(serial),
        _adapted(serial),
        _sup_norm(serial),
        _tolerance(serial),
        _quadrature(serial),
        _method(serial),
        _ranks(rows),
        _time(serial),
    ]
