"""Tables beside the paper's: differences, layout, and nothing lost on the way to a file."""

import csv
import io
from decimal import Decimal

import pytest

from dolfinx_signorini.studies.paper.sampling import PAPER_NAMES
from dolfinx_signorini.studies.paper.study import PAPER_NORMS
from dolfinx_signorini.studies.paper.tables import Cell, error_table, order_table, paper_table

pytestmark = pytest.mark.pure

NORMS = ("L4", "Linf_sampled", "W1_4", "W1_inf_sampled", "H1_2_boundary_sampled")
COLUMNS = ("L4", "Linf", "W1_4", "W1_inf", "H1_2_boundary")  # the paper's names of them


def paper_rows(factor=1.0):
    return [
        {
            "n": int(n),
            "errors": {
                norm: factor * float(row[column])
                for norm, column in zip(NORMS, COLUMNS, strict=True)
            },
        }
        for n, row in paper_table(1).items()
    ]


def test_the_paper_does_not_differ_from_itself():
    table = error_table(paper_rows(), NORMS)
    assert [label for label, _ in table.rows] == [str(101 + 100 * i) for i in range(10)]
    assert all(cell.difference == 0.0 for _, cells in table.rows for cell in cells)
    assert table.agreement() == ["All printed digits agree with the paper's."]


@pytest.mark.parametrize(
    ("value", "agrees"),
    [
        (7.4510e-4, True),
        (7.451099999e-4, True),  # is truncated, not rounded
        (7.450999999e-4, False),
        (7.4511e-4, False),
        (7.4510e-3, False),
        (-7.4510e-4, False),
    ],
)
def test_figures_agree_where_their_truncation_does(value, agrees):
    assert Cell(value, Decimal("7.4510e-4")).agrees is agrees
    rows = paper_rows()[:3]
    rows[1]["errors"]["Linf_sampled"] = value
    table = error_table(rows, NORMS)
    says = table.agreement()[0]
    assert says == "All printed digits agree with the paper's" + (
        "." if agrees else " but those of Linf at 201."
    )
    assert says in table.text() and says in table.markdown()
    shown = table.text().splitlines()
    (line,) = [line.split() for line in shown if line.startswith("201")]
    assert (line[2] == "7.4510e-4") == agrees


def test_nothing_is_said_of_digits_where_the_paper_has_no_figures():
    assert Cell(1.0).agrees is None and Cell(None, Decimal(1)).agrees is None
    assert error_table([{"n": 10, "errors": {"L4": 1.0}}], ["L4"]).agreement() == []


def test_differences_are_relative_to_the_paper():
    table = error_table(paper_rows(1.25), NORMS)
    assert all(cell.difference == pytest.approx(0.25) for _, cells in table.rows for cell in cells)
    assert Cell(3.0, Decimal(2)).difference == 0.5
    assert Cell(3.0).difference is None
    assert Cell(None, Decimal(2)).difference is None


def test_orders_do_not_depend_on_a_factor():
    first, second = (order_table(paper_rows(f), NORMS) for f in (1.0, 7.0))
    for (label, a), (other, b) in zip(first.rows, second.rows, strict=True):
        assert label == other
        for x, y in zip(a, b, strict=True):
            assert x.value == pytest.approx(y.value)
            assert x.paper == y.paper


def test_regression_and_theory_close_the_orders():
    rows = dict(order_table(paper_rows(), NORMS).rows)
    assert list(rows)[-2:] == ["regression", "theory"]
    assert [cell.value for cell in rows["theory"]] == [2.0, 1.5, 1.0, 0.5, 1.5]
    assert all(cell.difference == 0.0 for cell in rows["theory"])
    assert all(abs(cell.difference) < 3e-4 for cell in rows["regression"])


def test_the_papers_regression_stands_only_beside_its_ten_widths():
    rows = dict(order_table(paper_rows()[:4], NORMS).rows)
    assert all(cell.paper is None for cell in rows["regression"])
    assert all(cell.value is not None for cell in rows["regression"])


def test_norms_and_widths_that_the_paper_has_not():
    rows = [{"n": n, "errors": {"L2": 1.0 / n**2, "L4": 2.0 / n**2}} for n in (10, 20, 101)]
    table = error_table(rows, ("L2", "L4"))
    assert [cell.paper for cell in dict(table.rows)["10"]] == [None, None]
    assert [cell.paper for cell in dict(table.rows)["101"]] == [None, Decimal("5.8745e-4")]
    assert dict(order_table(rows, ("L2",)).rows)["20"][0].value == pytest.approx(2.0)
    assert "20" in table.text()


def test_csv_holds_every_digit():
    rows = paper_rows(1 / 3)
    lines = list(csv.DictReader(io.StringIO(error_table(rows, NORMS).csv())))
    for row, line in zip(rows, lines, strict=True):
        assert int(line["N"]) == row["n"]
        for norm, column in zip(NORMS, COLUMNS, strict=True):
            assert float(line[column]) == row["errors"][norm]
            assert float(line[f"{column}_paper"]) == pytest.approx(3 * row["errors"][norm])
            assert float(line[f"{column}_difference"]) == pytest.approx(-2 / 3)


def test_text_and_markdown_show_value_paper_and_difference():
    table = error_table(paper_rows()[:2], NORMS)
    title, text = table.title.splitlines(), table.text().splitlines()
    assert "midpoints" in title[2] and "quadrature points" in title[3] and "Newton" in title[4]
    assert text[:5] == title
    text = text[4:]
    assert len({len(line) for line in text[1:3]}) == 1
    assert [line.split()[0] for line in text[3:-1]] == [
        "101",
        "paper",
        "diff.",
        "201",
        "paper",
        "diff.",
    ]
    assert "5.8745e-4" in text[3] and "5.8745e-4" in text[4] and "+0.0e+0" in text[5]
    markdown = [line for line in table.markdown().splitlines() if line.startswith("|")]
    assert {line.count("|") for line in markdown} == {len(NORMS) + 2}
    assert len(markdown) == 2 + 6


def test_every_norm_of_the_study_has_a_paper_order():
    rows = [{"n": n, "errors": dict.fromkeys(PAPER_NORMS, 1.0 / n)} for n in (101, 201)]
    cells = dict(order_table(rows, PAPER_NORMS).rows)["201"]
    assert all(cell.paper is not None for cell in cells)
    assert [cell.value for cell in cells] == pytest.approx([1.0] * len(PAPER_NORMS))


@pytest.mark.parametrize(
    ("norm", "kind", "points"),
    [("Linf", "maximum", "midpoints"), ("H1_2_boundary", "default rule", "Newton-Cotes points")],
)
def test_other_points_stand_beside_no_figure_of_the_paper(norm, kind, points):
    # The paper's figures are by its points: they have its names, and maxima and integrals others.
    own = f"{norm}_sampled"
    rows = [{"n": n, "errors": {norm: 2.0, own: 1.0, "L4": 1.0}} for n in (101, 201)]
    for table in (error_table, order_table):
        found = table(rows, (norm, own, "L4"))
        assert found.columns == (f"{norm} ({kind})", norm, "L4")
        cells = dict(found.rows)["201"]
        assert cells[0].paper is None and cells[1].paper is not None
        assert points in found.title and points not in table(rows, (norm, "L4")).title
    assert set(PAPER_NAMES.values()) == {"Linf", "W1_inf", "H1_2_boundary"}
