"""The reference: every public name, the command line and the scene file, from their definitions."""

import argparse
import re
from pathlib import Path

import dolfinx_signorini
from dolfinx_signorini.commands.main import make_parser
from dolfinx_signorini.data.formulas import CONSTANTS, COORDINATES
from dolfinx_signorini.data.operations import FUNCTIONS
from dolfinx_signorini.scenes.domains.kinds import DOMAINS
from dolfinx_signorini.scenes.files.conditions import CONDITIONS
from dolfinx_signorini.scenes.files.scene import OUTPUTS

GROUPS = {
    "Problems and their solution": (
        "SignoriniProblem",
        "ObstacleProblem",
        "ContactZone",
        "dirichlet",
        "SolveResult",
        "METHODS",
        "solve_cascade",
        "coarse_levels",
        "ContactState",
        "InputError",
        "NotConvergedError",
    ),
    "Elastic bodies": ("ContactProblem", "elasticity", "stress", "von_mises", "weighted_strain"),
    "Accuracy": (
        "error_norms",
        "solve_adaptively",
        "AdaptiveSolution",
        "energy_bound",
        "EnergyBound",
        "EnergyTerms",
        "DetachmentPoint",
        "detachment_points",
        "StressIntensity",
        "stress_intensity",
    ),
    "Known solutions": (
        "manufacture",
        "ManufacturedSolution",
        "Reference",
        "interpolated",
        "christof_haubner",
    ),
    "Meshes, elements and quadrature": (
        "friedrichs_keller",
        "box_mesh",
        "gmsh_mesh",
        "gmsh_projection",
        "boundary_facets",
        "SidedMesh",
        "bernstein_space",
        "QuadratureRule",
    ),
    "Scenes": ("load_scene", "solve_scene", "Scene", "SceneResult"),
}
# Modules whose public names are documented as a whole.
MODULES = {
    "Norms": "norms.error_norms",
    "Orders of convergence": "norms.orders",
    "Checks of known solutions": "norms.manufactured",
    "Checkpoints": "meshes.checkpoints",
    "The contact boundary as data": "pictures.contact_boundary",
    "Refined meshes": "meshes.refinement",
    "Costs": "base.costs",
    "Messages": "base.logs",
    "Records of jobs": "base.records",
}
# The members of a class, those of its ancestors in this package included.
CLASS = ":members:", ":inherited-members: Exception", ":show-inheritance:"
API_HEAD = """# Python

Every name of `import dolfinx_signorini as ds`, and below the modules that a study needs beside.
"""


def make_reference(docs: Path) -> None:
    """Write the pages.

    Args:
        docs: The folder of the site.
    """
    folder = docs / "reference"
    folder.mkdir(exist_ok=True)
    (folder / "api.md").write_text(_api())
    (folder / "cli.md").write_text(_cli())
    (folder / "scene_definitions.md").write_text(_scene())


def _api() -> str:
    grouped = {name for names in GROUPS.values() for name in names}
    others = [name for name in dolfinx_signorini.__all__ if name not in grouped]
    groups = GROUPS | ({"More": tuple(others)} if others else {})
    page = API_HEAD
    for title, names in groups.items():
        page += f"\n## {title}\n"
        for name in names:
            thing = getattr(dolfinx_signorini, name)
            full = f"dolfinx_signorini.{name}"
            if isinstance(thing, type):
                page += _directive(f"autoclass:: {full}", *CLASS)
            elif callable(thing):
                page += _directive(f"autofunction:: {full}")
            else:
                page += f"\n`{name}` = `{thing!r}`\n"
    for title, module in MODULES.items():
        full = f"dolfinx_signorini.{module}"
        page += f"\n## {title}: `{module}`\n" + _directive(f"automodule:: {full}", ":members:")
    return page


def _directive(head: str, *options: str) -> str:
    lines = "\n".join(f"   {option}" for option in options)
    return f"\n```{{eval-rst}}\n.. {head}\n{lines}\n```\n"


def _cli() -> str:
    parser = make_parser()
    page = "# Commands\n\n" + _options(parser)
    jobs = next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    for name, job in jobs.choices.items():
        usage = re.sub(r"^usage: ", "", job.format_usage())
        page += f"\n## {name}\n\n{_sentence(job.description or '')}\n\n"
        page += f"```text\n{usage}```\n\n" + _options(job)
    page += (
        "\n## Exit codes\n\n"
        "0 done; 2 the input is refused; 3 a solver did not converge, or the accuracy was not "
        "reached (the best solution is written); 130 interrupted; 143 terminated.\n\n"
        "Results go to the standard output, progress and errors to the standard error stream. "
        "Under `mpirun` only rank 0 speaks.\n"
    )
    return page


def _options(parser: argparse.ArgumentParser) -> str:
    page = ""
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction | argparse._SubParsersAction):
            continue
        names = ", ".join(f"`{name}`" for name in action.option_strings) or f"`{action.dest}`"
        value = action.metavar or (action.dest.upper() if action.type else "")
        if action.choices:
            value = "{" + ",".join(map(str, action.choices)) + "}"
        takes = action.nargs != 0 and action.option_strings and value
        text = (action.help or "") % {"default": action.default, "prog": parser.prog}
        page += f"{names}{f' `{value}`' if takes else ''}\n: {_sentence(text)}\n\n"
    return page


def _sentence(text: str) -> str:
    text = re.sub(r"([<>*_\[\]{}])", r"\\\1", text)
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")


def _scene() -> str:
    page = "# Definitions of scene files\n\nMade from the program itself; the text is on "
    page += "[the page of scene files](../scenes.md).\n\n## Shapes of `[domain]`\n"
    for shape, domain in DOMAINS.items():
        first = _first_line(domain.__doc__)
        width = f" Its width is `{domain.width_key}`." if domain.width_key else ""
        page += f"\n`{shape}`\n: {first}{width}\n"
    page += "\n## Conditions\n"
    for kind in CONDITIONS:
        first = _first_line(kind.__doc__)
        page += f"\n`{kind.key}`, with the datum `{kind.value_key}`\n: {first}\n"
    page += "\n## Formulas\n\nCoordinates: " + ", ".join(f"`{name}`" for name in COORDINATES)
    page += ". Constants: " + ", ".join(f"`{name}`" for name in CONSTANTS)
    page += ". Functions: " + ", ".join(f"`{name}`" for name in FUNCTIONS) + ", `where`.\n"
    page += "\n## Outputs\n"
    for name, text in OUTPUTS.items():
        page += f"\n`{name}`\n: {_sentence(text)}\n"
    return page


def _first_line(doc: str | None) -> str:
    return _sentence((doc or "").strip().splitlines()[0].rstrip("."))
