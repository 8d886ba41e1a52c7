"""Tables of results beside the paper's, as terminal text, Markdown and CSV."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

from dolfinx_signorini.orders import eoc, expected_order, regression
from dolfinx_signorini.paper.sampling import PAPER_NAMES, SAMPLING, column
from dolfinx_signorini.tables import csv_table, markdown_table, text_table

PAPER = "Christof & Haubner (2020)"


@dataclass(frozen=True)
class Cell:
    """One figure with the paper's:

        Cell(5.8746e-4, paper=5.8745e-4).difference

    Attributes:
        value: The figure, None where the study has none.
        paper: The paper's figure, None where the paper has none.
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
class PaperTable:
    """A table of figures beside the paper's, to be printed or written:

        print(error_table(rows, ["L4", "Linf_sampled"]).text())

    Attributes:
        title: What the table shows, with units.
        columns: Names of the columns after the first.
        rows: Label and figures of each row.
        style: Format specification of the figures.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]
    style: str

    def text(self) -> str:
        """Return the table for a terminal."""
        return text_table(["N", *self.columns], self._lines("  "), self.title)

    def markdown(self) -> str:
        """Return the table in Markdown."""
        return f"{self.title}\n\n" + markdown_table(["N", *self.columns], self._lines(""))

    def csv(self) -> str:
        """Return the table as CSV with three columns per figure, at full precision."""
        kinds = ("", "_paper", "_difference")
        columns = ["N", *(column + kind for column in self.columns for kind in kinds)]
        rows = [
            [label, *(x for cell in cells for x in (cell.value, cell.paper, cell.difference))]
            for label, cells in self.rows
        ]
        return csv_table(columns, rows)

    def _lines(self, indent: str) -> list[list[str]]:
        """The lines of text: for each row the study's figures, the paper's, the differences."""
        lines = []
        for label, cells in self.rows:
            lines.append([label, *(_text(cell.value, self.style) for cell in cells)])
            if any(cell.paper is not None for cell in cells):
                paper = [_text(cell.paper, self.style) for cell in cells]
                lines.append([f"{indent}paper", *paper])
            if any(cell.difference is not None for cell in cells):
                differences = [_text(cell.difference, "+.1e") for cell in cells]
                lines.append([f"{indent}diff.", *differences])
        return lines


def error_table(rows: Sequence[Mapping[str, Any]], norms: Sequence[str]) -> PaperTable:
    """Return the errors of a study beside the errors of the paper's Table 1.

    Args:
        rows: Rows with "n" (cells per side) and "errors" (by norm), in the order of n.
        norms: The norms, in the order of the columns; see `sampling.paper_errors`.
    """
    paper, body = paper_table(1), []
    for row in rows:
        known = paper.get(str(row["n"]), {})
        cells = tuple(Cell(row["errors"][norm], known.get(column(norm))) for norm in norms)
        body.append((str(row["n"]), cells))
    title = f"Table 1: error u - u_h on N x N squares; paper: {PAPER}; diff.: relative difference"
    return PaperTable(_titled(title, norms), _columns(norms), tuple(body), ".4e")


def order_table(rows: Sequence[Mapping[str, Any]], norms: Sequence[str]) -> PaperTable:
    """Return the experimental orders of a study beside the orders of the paper's Table 2.

    Args:
        rows: At least two rows with "n" and "errors", in the order of n.
        norms: The norms, in the order of the columns; see `sampling.paper_errors`.
    """
    paper = paper_table(2)
    widths = [1.0 / row["n"] for row in rows]
    errors = {norm: [row["errors"][norm] for row in rows] for norm in norms}
    orders = {norm: eoc(widths, errors[norm]) for norm in norms}
    body = []
    for i, row in enumerate(rows[1:]):
        known = paper.get(str(row["n"]), {})
        cells = tuple(Cell(orders[m][i], known.get(column(m))) for m in norms)
        body.append((str(row["n"]), cells))
    # The paper's regression is over its ten widths; another range has another slope.
    complete = [row["n"] for row in rows] == [int(n) for n in paper_table(1)]
    known = paper["regression"] if complete else {}
    slopes = tuple(Cell(regression(widths, errors[m]), known.get(column(m))) for m in norms)
    expected = {m: expected_order(PAPER_NAMES.get(m, m)) for m in norms}
    theory = tuple(Cell(expected[m], paper["theory"].get(column(m))) for m in norms)
    title = (
        "Table 2: experimental orders of convergence (EOC), their regression, and the theory's "
        f"orders (less any epsilon);\npaper: {PAPER}; diff.: relative difference"
    )
    lines = (*body, ("regression", slopes), ("theory", theory))
    return PaperTable(_titled(title, norms), _columns(norms), lines, ".5f")


def paper_table(number: int) -> dict[str, dict[str, float]]:
    """Read a table of the paper: figure by row label and by the paper's name of the norm."""
    text = resources.files(__package__).joinpath(f"data/table{number}.csv").read_text()
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    return {
        row.pop("cells_per_side"): {norm: float(figure) for norm, figure in row.items()}
        for row in csv.DictReader(lines)
    }


def _columns(norms: Sequence[str]) -> tuple[str, ...]:
    return tuple(column(norm) for norm in norms)


def _titled(title: str, norms: Sequence[str]) -> str:
    """A title that says how sup norms are sampled, where there are some."""
    return f"{title};\n{SAMPLING}" if set(norms) & set(PAPER_NAMES) else title


def _text(figure: float | None, style: str) -> str:
    return "" if figure is None else format(figure, style)
