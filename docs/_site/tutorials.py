"""The tutorials: narrated scripts of demos/ as notebooks, which run when the site is built."""

import re
from pathlib import Path
from typing import Any

import jupytext

TUTORIALS = (
    "first_contact",
    "gmsh_to_paraview",
    "convergence_study",
    "parabolic",
    "parameter_sweep",
    "trusted_accuracy",
    "high_order",
    "parallel_and_large",
    "membrane",
    "hertz",
    "growing_load",
    "falling_block",
    "american_put",
    "irreversible",
)
DOWNLOAD = """:::{{tip}}
Download this page as a notebook: {{nb-download}}`{name}.ipynb`, or as a script for any number of
processes: {{download}}`{name}.py <../../demos/{name}.py>`.
:::"""


LINK = re.compile(r"\]\((?:\.\./)+demos/(\w+)(\.py)?\)")


def linked(app: Any, page: str, source: list[str]) -> None:
    """Let links to scripts and scene files of demos/ lead to the pages that the site has of them.

    Args:
        app: The application of Sphinx, which calls this function.
        page: The name of the page.
        source: The text of the page, replaced in place.
    """
    up = "../" * page.count("/")

    def target(found: re.Match[str]) -> str:
        name, script = found.groups()
        return f"]({up}{f'tutorials/{name}.ipynb' if script else 'gallery/index.md'})"

    source[0] = LINK.sub(target, source[0])


def make_notebooks(docs: Path) -> None:
    """Write one notebook for each tutorial, where the script is newer.

    Args:
        docs: The folder of the site.
    """
    (docs / "tutorials").mkdir(exist_ok=True)
    for name in TUTORIALS:
        script, notebook = (
            docs.parent / "demos" / f"{name}.py",
            docs / "tutorials" / f"{name}.ipynb",
        )
        book = jupytext.read(script)
        book.metadata["kernelspec"] = {
            "name": "python3",
            "language": "python",
            "display_name": "Python 3",
        }
        title, _, text = book.cells[0].source.partition("\n")
        book.cells[0].source = f"{title}\n\n{DOWNLOAD.format(name=name)}\n{text}"
        for number, cell in enumerate(book.cells):
            cell["id"] = f"{name.replace('_', '-')}-{number}"  # the same in each build
        content = jupytext.writes(book, fmt="ipynb")
        if not notebook.exists() or notebook.read_text() != content:
            notebook.write_text(content)
