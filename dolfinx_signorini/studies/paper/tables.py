"""Tables of results beside the paper's, as terminal text, Markdown and CSV.

The paper truncates its figures and does not round them. Figures are shown in the same way here, and
agree where truncation to the digits that the paper prints gives what the paper prints.
"""

import csv
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import ROUND_DOWN, Decimal, localcontext
from importlib import resources
from typing import Any

from dolfinx_signorini.base.tables import csv_table, markdown_table, text_table
from dolfinx_signorini.norms.orders import eoc, expected_order, regression
from dolfinx_signorini.studies.paper.sampling import PAPER_NAMES, SAMPLING, column

PAPER = "Christof & Haubner (2020)"
NOTES = f"figures are truncated, as the paper's; paper: {PAPER}; diff.: relative difference"
REMAINING = (
    "Natural residuals from 1e-8 to 1e-11 leave the same last digits that differ: L4 at 1001 in\n"
    "Table 1, L4 from 701 on and Linf at 201 in Table 2. The algebra here is not the reason: a\n"
    "residual of 1e-11 leaves 6.0006670e-6 for L4 at 1001, where the paper has 6.0007e-6."
)


@dataclass(frozen=True)
class Cell:
    """One figure with the paper's:

        Cell(5.87457e-4, paper=Decimal("5.8745e-4")).agrees

    Attributes:
        value: The figure, None where the study has none.
        paper: The paper's figure with all digits that the paper prints, None where it has none.
    """

    value: float | None
    paper: Decimal | None = None

    @property
    def difference(self) -> float | None:
        """The relative difference from the paper's figure."""
        if self.value is None or self.paper is None:
            return None
        return self.value / float(self.paper) - 1.0

    @property
    def agrees(self) -> bool | None:
        """Whether the figure, truncated to the digits of the paper's figure, is the latter."""
        if self.value is None or self.paper is None:
            return None
        unit = Decimal((0, (1,), int(self.paper.as_tuple().exponent)))
        return 0 <= Decimal(str(self.value)) - self.paper < unit


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
        table = text_table(["N", *self.columns], self._lines("  "), self.title)
        return "\n".join([table.rstrip("\n"), *self.agreement()]) + "\n"

    def markdown(self) -> str:
        """Return the table in Markdown."""
        table = markdown_table(["N", *self.columns], self._lines(""))
        return "\n".join([self.title, "", table, *self.agreement()]) + "\n"

    def agreement(self) -> list[str]:
        """Return lines that say which figures agree with the paper's in all printed digits."""
        compared, differing = False, dict[str, list[str]]()
        for label, cells in self.rows:
            for name, cell in zip(self.columns, cells, strict=True):
                compared |= cell.agrees is not None
                if cell.agrees is False:
                    differing.setdefault(name, []).append(label)
        if not differing:
            return ["All printed digits agree with the paper's."] if compared else []
        names = "; ".join(f"{name} at {', '.join(at)}" for name, at in differing.items())
        return [f"All printed digits agree with the paper's but those of {names}.", REMAINING]

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
    errors = {str(row["n"]): row["errors"] for row in rows}
    return _beside(paper_table(1), errors, norms, "Table 1: error u - u_h on N x N squares", ".4e")


def order_table(rows: Sequence[Mapping[str, Any]], norms: Sequence[str]) -> PaperTable:
    """Return the experimental orders of a study beside the orders of the paper's Table 2.

    Args:
        rows: At least two rows with "n" and "errors", in the order of n.
        norms: The norms, in the order of the columns; see `sampling.paper_errors`.
    """
    paper, widths = paper_table(2), [1.0 / row["n"] for row in rows]
    errors = {norm: [row["errors"][norm] for row in rows] for norm in norms}
    orders = {norm: eoc(widths, errors[norm]) for norm in norms}
    found: dict[str, Mapping[str, float | None]] = {
        str(row["n"]): {norm: orders[norm][i] for norm in norms} for i, row in enumerate(rows[1:])
    }
    found["regression"] = {norm: regression(widths, errors[norm]) for norm in norms}
    found["theory"] = {norm: expected_order(PAPER_NAMES.get(norm, norm)) for norm in norms}
    # The paper's regression is over its ten widths; another range has another slope.
    if [row["n"] for row in rows] != [int(n) for n in paper_table(1)]:
        paper["regression"] = {}
    title = (
        "Table 2: experimental orders of convergence (EOC), their regression, and the theory's "
        "orders (less any epsilon)"
    )
    return _beside(paper, found, norms, title, ".5f")


def _beside(
    paper: Mapping[str, Mapping[str, Decimal]],
    figures: Mapping[str, Mapping[str, float | None]],
    norms: Sequence[str],
    title: str,
    style: str,
) -> PaperTable:
    """Figures by row label and norm beside the paper's; the title names the points of norms."""
    body = tuple(
        (label, tuple(Cell(own[m], paper.get(label, {}).get(column(m))) for m in norms))
        for label, own in figures.items()
    )
    points = [f"{PAPER_NAMES[norm]}: {SAMPLING[norm]}" for norm in norms if norm in SAMPLING]
    whole = ";\n".join([title, NOTES, *points])
    return PaperTable(whole, tuple(column(norm) for norm in norms), body, style)


def paper_table(number: int) -> dict[str, dict[str, Decimal]]:
    """Read a table of the paper: figure by row label and by the paper's name of the norm.

    The figures have the digits that the paper prints, zeros at their end included.
    """
    text = resources.files(__package__).joinpath(f"data/table{number}.csv").read_text()
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    return {
        row.pop("cells_per_side"): {norm: Decimal(figure) for norm, figure in row.items()}
        for row in csv.DictReader(lines)
    }


def read_data(name: str) -> dict[str, Any]:
    """Read one of the TOML files that belong to the package.

    Args:
        name: The name of the file without its ending.
    """
    file = resources.files(__package__).joinpath(f"data/{name}.toml")
    return tomllib.loads(file.read_text(encoding="utf-8"))


def _text(figure: float | Decimal | None, style: str) -> str:
    """The figure, truncated."""
    with localcontext(rounding=ROUND_DOWN):
        return "" if figure is None else format(Decimal(str(figure)), style)
