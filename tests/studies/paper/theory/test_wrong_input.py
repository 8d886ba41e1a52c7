"""Every check is fed a wrong input, and fails."""

import math

import pytest
from mpi4py import MPI

from dolfinx_signorini.studies.paper.theory import families
from dolfinx_signorini.studies.paper.theory.checks import (
    Limit,
    Order,
    Settles,
    Slope,
    Within,
)
from dolfinx_signorini.studies.paper.theory.report import Document
from dolfinx_signorini.studies.paper.theory.statements import MEASURED, STATEMENTS

CELLS = (50, 100, 200)
EVERY = [
    pytest.param(check, id=f"{key}-{i}-{check.name}")
    for key, statement in MEASURED.items()
    for i, check in enumerate(statement.checks)
]


def right(rule):
    """Figures that hold, from the meaning of the rule alone."""
    if isinstance(rule, Order):
        ends = [end for end in (rule.low, rule.high) if math.isfinite(end)]
        return [(n, 3.0 * n ** -(sum(ends) / len(ends))) for n in CELLS]
    if isinstance(rule, Within):
        ends = [end for end in (rule.low, rule.high) if math.isfinite(end)]
        inside = sum(ends) / len(ends) if len(ends) == 2 else ends[0] * 1.0
        return [(n, inside) for n in CELLS]
    if isinstance(rule, Slope):
        return [(n, rule.constant * (1.0 + math.log(n))) for n in CELLS]
    return [(n, rule.value if isinstance(rule, Limit) else 2.0) for n in CELLS]


def wrong(rule, figures):
    """Wrong inputs: the figures of a method that is too slow, too good, or beyond a limit."""
    inputs = []

    def changed(factor, shift=0.0):
        *before, (n, value) = figures
        return [*before, (n, value * factor + shift)]

    if isinstance(rule, Order):
        width = (rule.high - rule.low if math.isfinite(rule.high - rule.low) else 3.0) + 0.05
        d = width + 2.0 * max(rule.tolerance, Order(0.0, 1.0).tolerance)
        inputs += [[(n, v * n**d) for n, v in figures]] if math.isfinite(rule.low) else []
        inputs += [[(n, v * n**-d) for n, v in figures]] if math.isfinite(rule.high) else []
        inputs.append([(n, 0.0) for n, _ in figures])
    elif isinstance(rule, Within):
        for end, sign in ((rule.low, -1.0), (rule.high, 1.0)):
            if math.isfinite(end):
                inputs.append(changed(0.0, end + sign * max(2e-9, 0.05 * abs(end))))
        inputs.append(changed(math.nan))
    elif isinstance(rule, Slope):
        inputs += [[(n, v * n**d) for n, v in figures] for d in (-0.2, 0.2)]
    else:
        assert isinstance(rule, Limit | Settles)
        inputs += [changed(1.0 + 4.0 * rule.tolerance), changed(-1.0), changed(math.nan)]
    return inputs


@pytest.mark.parametrize("check", EVERY)
def test_the_check_fails_on_a_wrong_input(check):
    figures = right(check.rule)
    assert check.rule.judge(figures).holds
    inputs = wrong(check.rule, figures)
    assert inputs
    for figures in inputs:
        assert not check.rule.judge(figures).holds


def test_as_many_checks_fail_as_there_are():
    listed = [(s.key, check.name) for s in STATEMENTS for check in s.checks]
    assert len(EVERY) == len(listed) == len(set(listed)) > 200


@pytest.mark.slow
def test_every_check_holds_and_its_own_rows_made_wrong_fail(folder):
    rows = families.run_experiments(MPI.COMM_WORLD, families.experiments(), 201, folder)
    document = Document(STATEMENTS, rows)
    assert document.failing == []
    for statement in MEASURED.values():
        for check in statement.checks:
            figures = check.figures(rows)
            for made in wrong(check.rule, figures):
                assert not check.rule.judge(made).holds, check.name
