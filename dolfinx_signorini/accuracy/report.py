"""The runs of a search and its outcome in words, for a terminal or a report."""

from dolfinx_signorini.accuracy.model import Trial
from dolfinx_signorini.accuracy.search import Outcome


def trial_line(trial: Trial) -> str:
    """Return one run of a search in words."""
    c = trial.configuration
    rtol = "default rtol" if c.rtol is None else f"rtol {c.rtol:.1e}"
    return f"{c}: error {trial.error:.3e}, {trial.unknowns} unknowns, {trial.seconds:.3g} s, {rtol}"


def outcome_lines(outcome: Outcome) -> list[tuple[str, str]]:
    """Return the choice of a search, its predictions and its results, as pairs of name and text."""
    predicted, run = outcome.predicted, outcome.run
    against = "estimated from a finer solution" if outcome.estimated else "exact solution known"
    return [
        ("chosen", f"{run.configuration}, {run.unknowns} unknowns"),
        ("predicted", f"error {predicted.error:.3g} in {outcome.norm}, {predicted.seconds:.3g} s"),
        (
            "came out",
            f"error {outcome.error:.3g} in {outcome.norm} ({against}), {run.total_seconds:.3g} s; "
            f"{outcome.seconds:.3g} s with all coarse runs",
        ),
    ]
