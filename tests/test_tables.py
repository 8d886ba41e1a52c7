"""Tables beside the paper's: differences, layout, and nothing lost on the way to a file."""

import csv
import io

import pytest

from dolfinx_signorini.paper.sampling import PAPER_NAMES
from dolfinx_signorini.paper.study import PAPER_NORMS
from dolfinx_signorini.paper.tables import Cell, error_table, order_table, paper_table

NORMS = ("L4", "Linf_sampled", "W1_4", "W1_inf_sampled", "H1_2_boundary")
COLUMNS = ("L4", "Linf", "W1_4", "W1_inf", "H1_2_boundary")  # the paper's names of them


def paper_rows(factor=1.0):
    return [
        {
            "n": int(n),
            "errors": {
                norm: factor * row[column] for norm, column in zip(NORMS, COLUMNS, strict=True)
            },
        }
        for n, row in paper_table(1).items()
    ]


def test_the_paper_does_not_differ_from_itself():
    table = error_table(paper_rows(), NORMS)
    assert [label for label, _ in table.rows] == [str(101 + 100 * i) for i in range(10)]
    assert all(cell.difference == 0.0 for _, cells in table.rows for cell in cells)


def test_differences_are_relative_to_the_paper():
    table = error_table(paper_rows(1.25), NORMS)
    assert all(cell.difference == pytest.approx(0.25) for _, cells in table.rows for cell in cells)
    assert Cell(3.0, 2.0).difference == 0.5
    assert Cell(3.0).difference is None
    assert Cell(None, 2.0).difference is None


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
    assert [cell.paper for cell in dict(table.rows)["101"]] == [None, 5.8745e-4]
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
    assert "midpoints" in table.text().splitlines()[1]
    text = table.text().splitlines()[1:]  # the first line of the title is the second one's
    assert len({len(line) for line in text[1:3]}) == 1
    assert [line.split()[0] for line in text[3:]] == [
        "101",
        "paper",
        "diff.",
        "201",
        "paper",
        "diff.",
    ]
    assert "5.8745e-04" in text[3] and "5.8745e-04" in text[4] and "+0.0e+00" in text[5]
    markdown = [line for line in table.markdown().splitlines() if line.startswith("|")]
    assert {line.count("|") for line in markdown} == {len(NORMS) + 2}
    assert len(markdown) == 2 + 6


def test_every_norm_of_the_study_has_a_paper_order():
    rows = [{"n": n, "errors": dict.fromkeys(PAPER_NORMS, 1.0 / n)} for n in (101, 201)]
    cells = dict(order_table(rows, PAPER_NORMS).rows)["201"]
    assert all(cell.paper is not None for cell in cells)
    assert [cell.value for cell in cells] == pytest.approx([1.0] * len(PAPER_NORMS))


def test_maxima_stand_beside_no_figure_of_the_paper():
    # The paper's figures are samples: they have its names, and the true maxima others.
    rows = [{"n": n, "errors": {"Linf": 2.0, "Linf_sampled": 1.0, "L4": 1.0}} for n in (101, 201)]
    for table in (error_table, order_table):
        found = table(rows, ("Linf", "Linf_sampled", "L4"))
        assert found.columns == ("Linf (maximum)", "Linf", "L4")
        cells = dict(found.rows)["201"]
        assert cells[0].paper is None and cells[1].paper is not None
        assert "vertices and edge midpoints" in found.title
        assert "midpoints" not in table(rows, ("Linf", "L4")).title
    assert set(PAPER_NAMES.values()) == {"Linf", "W1_inf"}
