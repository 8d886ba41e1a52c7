"""The list of statements is complete: against the numbers of the paper, typed in here.

Source: Christof and Haubner, Numer. Math. (2020): every numbered definition, lemma,
proposition, theorem, corollary, remark and assumption of Sections 2 to 6 with the items of the
remarks, every tag of a displayed formula, and both tables.
"""

import pytest

from dolfinx_signorini.studies.paper.theory import families
from dolfinx_signorini.studies.paper.theory.figures import FIGURES
from dolfinx_signorini.studies.paper.theory.statements import EQUATIONS, MEASURED, STATEMENTS

pytestmark = pytest.mark.pure

NUMBERED = {
    *("Proposition 2.1", "Definition 2.2", "Theorem 2.3", "Remark 2.4", "Assumption 2.5"),
    *("Proposition 2.6", "Definition 3.1", "Lemma 3.2", "Lemma 3.3", "Lemma 3.4", "Lemma 3.5"),
    *("Theorem 3.6", "Corollary 4.1", "Corollary 4.2", "Theorem 4.3", "Remark 4.4"),
    *("Definition 5.1", "Lemma 5.2", "Remark 5.3", "Proposition 5.4", "Definition 5.5"),
    *("Lemma 5.6", "Proposition 5.7", "Theorem 6.1", "Remark 6.2", "Table 1", "Table 2"),
}
ITEMS = {"2.4": 4, "4.4": 5, "6.2": 6}
TAGS = {*(f"({k})" for k in range(1, 31)), "(S)", "(S_h)", "(S~_h)", "(D)", "(D~)"}


def test_every_number_of_the_paper_is_listed():
    for number in NUMBERED:
        assert any(
            s.name == number or s.name.startswith((f"{number},", f"{number} (")) for s in STATEMENTS
        ), number
    keys = {s.key for s in STATEMENTS}
    for remark, count in ITEMS.items():
        assert {f"{remark}.{i + 1}" for i in range(count)} <= keys
    assert set(EQUATIONS) == TAGS


def test_every_statement_has_checks_or_a_reason():
    for statement in STATEMENTS:
        assert bool(statement.checks) != bool(statement.reason), statement.key
        assert bool(statement.checks) == bool(statement.comment), statement.key
        assert statement.claim.count("\\n") == 0
        assert len(statement.claim) < 130, statement.key
    assert set(MEASURED) == {s.key for s in STATEMENTS if s.checks}


def test_every_formula_names_a_statement_or_says_what_it_is():
    names = {s.name.split(",")[0] for s in STATEMENTS}
    for tag, text in EQUATIONS.items():
        named = any(name in text for name in names)
        assert named or text.startswith(("the ", "Morrey's", "a local")), tag


def test_what_statements_read_and_draw_exists():
    known = set(families.experiments())
    for statement in STATEMENTS:
        assert statement.experiments <= known
        assert statement.figure in {"", "one_sided", *FIGURES}
    # No experiment is made for nothing, but for the meshes of pictures.
    assert known == {name for s in STATEMENTS for name in s.experiments}
