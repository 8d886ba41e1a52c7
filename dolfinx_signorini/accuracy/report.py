"""What came of asking for an accuracy, or spending a time, for people to read."""

from dolfinx_signorini.accuracy.model import Trial
from dolfinx_signorini.accuracy.search import Outcome

HEADER = f"{'configuration':24s} {'rtol':>8s} {'unknowns':>9s} {'seconds':>9s} {'error':>10s}"


def trial_line(trial: Trial) -> str:
    """Return one run as a line below `HEADER`."""
    c = trial.configuration
    rtol = "default" if c.rtol is None else f"{c.rtol:.1e}"
    return f"{c!s:24s} {rtol:>8s} {trial.unknowns:9d} {trial.seconds:9.3g} {trial.error:10.3e}"


def outcome_lines(outcome: Outcome) -> list[tuple[str, str]]:
    """Return what was chosen, predicted and reached, as pairs of name and text."""
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
