"""The adaptive loop in words, for a terminal or a report."""

from dolfinx_signorini.accuracy.adaptive import AdaptiveSolution
from dolfinx_signorini.accuracy.steps import Step


def step_line(step: Step) -> str:
    """Return one step of the loop in words."""
    return (
        f"{step.unknowns:8d} unknowns, error about {step.estimate:.2e}, after {step.seconds:.2f} s"
    )


def found_lines(found: AdaptiveSolution) -> list[tuple[str, str]]:
    """Return what was asked for and what came out, as pairs of name and text."""
    request = found.request
    asked = [] if request.accuracy is None else [f"error of {request.accuracy:g}"]
    if request.budget is not None:
        asked.append(f"{request.budget:g} s")
    rows = [
        ("asked for", f"{' or '.join(asked)}, {request.target.name}"),
        ("came out", f"error about {found.estimate:.2e} (estimated)"),
        ("because", found.stopped),
    ]
    for name, distance in found.polygonal.items():
        text = f"side {name} as its facets are; a smooth curve is up to about {distance:.0e} away"
        rows.append(("domain", text))
    return rows
