"""The report page of the extremes: every test records its rows, a command writes them down.

python3 -m pytest tests/extremes -m '' --complete --extremes-report docs/measurements/extremes.md
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from mpi4py import MPI

PAGE = "docs/measurements/extremes.md"
COMMAND = f"python3 -m pytest tests/extremes -m '' --complete --extremes-report {PAGE}"

TOPICS = {
    "levels": "The levels of multigrid",
    "scales": "Load and obstacle scales 1e-250 ... 1e250",
    "coefficients": "Diffusion and reaction coefficients 1e-12 ... 1e12 against each other",
    "size": "Domains of size 1e-9, 1e-3 and 1e9",
    "shape": "Anisotropic cells to 1e6 : 1, slivers, and obtuse cells",
    "cells": "N = 1, 2 and 2001, degrees 2 to 4, and space",
    "contact": "Contact everywhere, nowhere, at one node, at corners, in many parts",
    "biactive": "Biactive boundaries: u = 0 and no pressure",
    "detachment": "A detachment point exactly on a node, and within 1e-14 of one",
    "loads": "Discontinuous and point-like loads, and loads next to balance",
    "integrable": "Loads in L^p only",
    "exponents": "p = 1, 1 + 1e-6, 1000, inf",
    "rounding": "Errors at rounding level: an exact solution in V_h",
    "singular": "Evaluation within 1e-300 of the singular point",
    "tolerances": "Tolerances 0, 1e-16, 0.5",
    "stop": "One stop for the active set method and TAO",
    "ranks": "More ranks than cells",
}

INTRODUCTION = f"""# Extreme data: the tables

Each row is a test of the suite `tests/extremes`: the case, the truth it is compared with, the
digits attained, and the limit. The page is written by the command

    {COMMAND}

Digits are those of the largest error over all nodes relative to the largest value (or of a norm
relative to its value), 16 at the most. "50 digits" is a solution of the same discrete problem with
matrices, obstacle and active set in 50-digit arithmetic that shares no code with the package.
Where a row names no solver, the cascade solves with `rtol=1e-13`. A problem that is not solved is
refused, by an `InputError` that names the input, or by a `NotConvergedError` with the residual
reached.

N = 4 and 4 x 4 cells mean 25 unknowns. On one rank problems of at most 3,000 dofs (1,000 in space)
are solved directly. Larger problems are solved with multigrid: geometric multigrid on squares and
cubes, BoomerAMG elsewhere, with the levels of the first table. "SciPy's sparse LU" is an active set
method with a direct solver on the same matrix. "The known u in V_h" belongs to a problem whose load
was made for a chosen solution and chosen contact forces, so that the solution is known without a
solver. The solutions u are compared.
"""


@dataclass(frozen=True)
class Row:
    """One line of the report.

    Attributes:
        topic: Key of `TOPICS`.
        case: What is checked.
        against: The reference or the invariance it is held against.
        attained: What came out.
        stops: Where it stops.
    """

    topic: str
    case: str
    against: str
    attained: str
    stops: str = ""


ROWS = pytest.StashKey[list[Row]]()
Record = Callable[..., None]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--extremes-report", metavar="FILE", help="write the rows to this page")


def pytest_configure(config: pytest.Config) -> None:
    config.stash[ROWS] = []


@pytest.fixture
def record(request: pytest.FixtureRequest) -> Record:
    """Add a row to the report, see `Row`."""

    def add(topic: str, case: str, against: str, attained: float | str, stops: str = "") -> None:
        assert topic in TOPICS
        text = attained if isinstance(attained, str) else f"{attained:.1f} digits"
        request.config.stash[ROWS].append(Row(topic, case, against, text, stops))

    return add


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Write the page, if all tests passed and every topic has a row."""
    path = session.config.getoption("--extremes-report", None)
    if path is None or exitstatus != pytest.ExitCode.OK or MPI.COMM_WORLD.rank > 0:
        return
    rows = session.config.stash[ROWS]
    missing = [title for topic, title in TOPICS.items() if topic not in {r.topic for r in rows}]
    if missing:
        raise pytest.UsageError(f"no row, and so no report, for: {'; '.join(missing)}")
    Path(path).write_text(page(rows))


def page(rows: list[Row]) -> str:
    """Return the report as Markdown."""
    parts = [INTRODUCTION]
    for topic, title in TOPICS.items():
        parts.append(f"## {title}\n")
        parts.append("| Case | Held against | Attained | Where it stops |\n|---|---|---|---|")
        parts.extend(
            "| " + " | ".join(map(_cell, (r.case, r.against, r.attained, r.stops))) + " |"
            for r in rows
            if r.topic == topic
        )
        parts.append("")
    return "\n".join(parts)


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
