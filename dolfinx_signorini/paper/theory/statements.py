"""The statements of the paper: what they claim, what is computed for them, what is seen.

The texts are in `paper/data/statements.toml`; here is what measures each statement.
"""

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

from dolfinx_signorini.paper.theory import section3, section4, section5
from dolfinx_signorini.paper.theory.evidence import Check, Rows, Tables
from dolfinx_signorini.paper.theory.examples import PLACES
from dolfinx_signorini.paper.theory.experiments import placed_name, rough_name

Measured = tuple[Sequence[str], Callable[[Rows], list[Check]], Callable[[Rows], Tables]]

LOWER = tuple(map(rough_name, section4.LOWER))
UPPER = tuple(map(rough_name, section4.UPPER))
EXAMPLES = ("paper", "smooth", *LOWER, *UPPER)

# By the number of the statement: experiments, checks and tables.
MEASURED: Mapping[str, Measured] = {
    "2.2": (["paper"], section5.definition_2_2, section5.no_tables),
    "3.2": (["paper", "smooth"], section3.lemma_3_2, section3.lemma_3_2_tables),
    "3.3": (["paper"], section3.lemma_3_3, section3.lemma_3_3_tables),
    "3.4": (EXAMPLES, section3.lemma_3_4, section3.lemma_3_4_tables),
    "3.5": (EXAMPLES, section3.lemma_3_5, section3.lemma_3_5_tables),
    "3.6": (EXAMPLES, section3.theorem_3_6, section3.theorem_3_6_tables),
    "4.1": (LOWER, section4.corollary_4_1, section4.corollary_4_1_tables),
    "4.2": (UPPER, section4.corollary_4_2, section4.corollary_4_2_tables),
    "4.3": (["paper"], section4.theorem_4_3, section4.theorem_4_3_tables),
    "5.2": (["dual"], section5.lemma_5_2, section5.lemma_5_2_tables),
    "5.4": (["paper", "dual"], section5.proposition_5_4, section5.proposition_5_4_tables),
    "5.5": (["paper"], section5.definition_5_5, section5.definition_5_5_tables),
    "5.6": (["dual"], section5.lemma_5_6, section5.lemma_5_6_tables),
    "5.7": (["paper", "dual"], section5.proposition_5_7, section5.proposition_5_7_tables),
    "6.1": (["paper"], section4.theorem_6_1, section4.theorem_6_1_tables),
    "7": (list(map(placed_name, PLACES)), section4.placement, section4.placement_tables),
    "table2": (["paper"], section4.transition, section4.transition_tables),
}


@dataclass(frozen=True)
class Statement:
    """A statement of the paper with its experiments:

        (statement,) = select(["3.6"])
        checks = statement.checks(rows)

    Attributes:
        key: The number of the statement, by which the command line knows the statement.
        name: The name of the statement.
        figure: Name of the picture; empty without one.
        claim: What the statement says.
        comment: How the statement is measured and what is seen.
        experiments: What is computed for the statement.
        checks: The measured figures beside the proven ones; the first is the headline.
        tables: Titles and tables, in Markdown.
    """

    key: str
    name: str
    figure: str
    claim: str
    comment: str
    experiments: Sequence[str]
    checks: Callable[[Rows], list[Check]]
    tables: Callable[[Rows], Tables]


def _statement(key: str, texts: Mapping[str, str]) -> Statement:
    name, figure, claim, comment = (
        " ".join(texts[field].split()) for field in ("name", "figure", "claim", "comment")
    )
    return Statement(key, name, figure, claim, comment, *MEASURED[key])


_FILE = resources.files("dolfinx_signorini.paper").joinpath("data/statements.toml")
_TEXTS = tomllib.loads(_FILE.read_text(encoding="utf-8"))
STATEMENTS = tuple(_statement(key, texts) for key, texts in _TEXTS.items())


def select(keys: Sequence[str] | None) -> list[Statement]:
    """Return statements by their keys, all of them by default.

    Raises:
        KeyError: A key is unknown.
    """
    known = {statement.key: statement for statement in STATEMENTS}
    return list(STATEMENTS) if not keys else [known[key] for key in dict.fromkeys(keys)]
