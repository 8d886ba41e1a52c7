"""Tables of results beside the paper's, as terminal text, Markdown and CSV."""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

from dolfinx_signorini.orders import eoc, expected_order, regression

PAPER = "Christof & Haubner (2020)"


@dataclass(frozen=True)
class Cell:
    """One figure with the paper's.

    Attributes:
        value: The figure, None where there is none.
        paper: The paper's figure, None where it has none.
    """

    value: float | None
    paper: float | None = None

    @property
    def difference(self) -> float | None:
        """The relative difference from the paper's figure."""
        if self.value is None or self.paper is None:
            return None
        return self.value / self.paper - 1.0


@dataclass(frozen=True)
class Table:
    """A table of figures.

    Attributes:
        title: What it shows, with units.
        columns: Names of the columns after the first.
        rows: Label and figures of each row.
        style: Format specification of the figures.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]
    style: str

    def lines(self) -> list[list[str]]:
        """Return the table as text cells: for each row ours, the paper's, the difference."""
        result = [["N", *self.columns]]
        for label, cells in self.rows:
            result.append([label, *(_text(cell.value, self.style) for cell in cells)])
            if any(cell.difference is not None for cell in cells):
                result.append(["  paper", *(_text(cell.paper, self.style) for cell in cells)])
                result.append(["  diff.", *(_text(cell.difference, "+.1e") for cell in cells)])
            elif any(cell.paper is not None for cell in cells):
                result.append(["  paper", *(_text(cell.paper, self.style) for cell in cells)])
        return result

    def text(self) -> str:
        """Return the table for a terminal."""
        lines = self.lines()
        widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
        out = [self.title]
        for number, line in enumerate(lines):
            cells = [line[0].ljust(widths[0])]
            cells += [cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True)]
            out.append("  ".join(cells).rstrip())
            if number == 0:
                out.append("-" * (sum(widths) + 2 * (len(widths) - 1)))
        return "\n".join(out) + "\n"

    def markdown(self) -> str:
        """Return the table in Markdown."""
        lines = [["N", *self.columns], ["---", *["---:"] * len(self.columns)]]
        lines += [[cell.strip() for cell in line] for line in self.lines()[1:]]
        return f"{self.title}\n\n" + "".join("| " + " | ".join(line) + " |\n" for line in lines)

    def csv(self) -> str:
        """Return the table as CSV with three columns per figure, at full precision."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        kinds = ("", "_paper", "_difference")
        writer.writerow(["N", *(column + kind for column in self.columns for kind in kinds)])
        for label, cells in self.rows:
            figures = [x for cell in cells for x in (cell.value, cell.paper, cell.difference)]
            writer.writerow([label, *("" if x is None else repr(x) for x in figures)])
        return out.getvalue()


def error_table(rows: Sequence[Mapping[str, Any]], norms: Sequence[str]) -> Table:
    """Return the errors of a study beside those of the paper's Table 1.

    Args:
        rows: Rows with "n" (cells per side) and "errors" (by norm), in the order of n.
        norms: The norms, in the order of the columns.
    """
    paper = _paper_table(1)
    return Table(
        f"Table 1: error u - u_h on N x N squares; paper: {PAPER}; diff.: relative difference",
        tuple(norms),
        tuple(
            (
                str(row["n"]),
                tuple(
                    Cell(row["errors"][norm], paper.get(str(row["n"]), {}).get(norm))
                    for norm in norms
                ),
            )
            for row in rows
        ),
        ".4e",
    )


def order_table(rows: Sequence[Mapping[str, Any]], norms: Sequence[str]) -> Table:
    """Return the experimental orders of a study beside those of the paper's Table 2.

    Args:
        rows: At least two rows with "n" and "errors", in the order of n.
        norms: The norms, in the order of the columns.
    """
    paper = _paper_table(2)
    widths = [1.0 / row["n"] for row in rows]
    errors = {norm: [row["errors"][norm] for row in rows] for norm in norms}
    orders = {norm: eoc(widths, errors[norm]) for norm in norms}
    body = []
    for i, row in enumerate(rows[1:]):
        known = paper.get(str(row["n"]), {})
        body.append((str(row["n"]), tuple(Cell(orders[m][i], known.get(m)) for m in norms)))
    # The paper's regression is over its ten widths; another range has another slope.
    complete = [row["n"] for row in rows] == [int(n) for n in _paper_table(1)]
    known = paper["regression"] if complete else {}
    slopes = tuple(Cell(regression(widths, errors[m]), known.get(m)) for m in norms)
    theory = tuple(Cell(expected_order(m), paper["theory"].get(m)) for m in norms)
    return Table(
        "Table 2: experimental orders of convergence (EOC), their regression, and the theory's "
        f"orders (less any epsilon);\npaper: {PAPER}; diff.: relative difference",
        tuple(norms),
        (*body, ("regression", slopes), ("theory", theory)),
        ".5f",
    )


def _paper_table(number: int) -> dict[str, dict[str, float]]:
    """Read a table of the paper: norm and figure by row label."""
    text = resources.files(__package__).joinpath(f"data/table{number}.csv").read_text()
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    return {
        row.pop("cells_per_side"): {norm: float(figure) for norm, figure in row.items()}
        for row in csv.DictReader(lines)
    }


def _text(figure: float | None, style: str) -> str:
    return "" if figure is None else format(figure, style)
