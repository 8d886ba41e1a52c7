"""Options that several jobs share: how much is told, a folder, and keys of a scene file."""

import argparse
import logging
from pathlib import Path

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.records import folder_name


def add_talk(parser: argparse.ArgumentParser) -> None:
    """Add -q and -v, which set the level and are read before and behind the name of a job."""
    talk = parser.add_mutually_exclusive_group()
    talk.add_argument(
        "-q",
        "--quiet",
        dest="level",
        action="store_const",
        const=logging.WARNING,
        default=argparse.SUPPRESS,
        help="no progress: results and warnings only",
    )
    talk.add_argument(
        "-v",
        "--verbose",
        dest="level",
        action="store_const",
        const=logging.DEBUG,
        default=argparse.SUPPRESS,
        help="each mesh and each phase with its seconds",
    )


def add_out(parser: argparse.ArgumentParser, folder: str, holds: str, more: str = "") -> None:
    """Add --out, the folder of a job whose runs go on from what the folder holds.

    Args:
        parser: The parser of the job.
        folder: The default.
        holds: What the folder is for, in words.
        more: What else is to be said of its runs.
    """
    parser.add_argument(
        "--out",
        type=folder_name,
        default=Path(folder),
        metavar="DIR",
        help=f"folder for {holds}; a run that was stopped goes on from what it finds there{more} "
        "(default %(default)s)",
    )


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Add the scene file and --set."""
    scene = parser.add_argument("scene", type=Path, help="the scene, a TOML file")
    scene.complete = COMPLETE_SCENES  # type: ignore[attr-defined]
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        dest="overrides",
        metavar="KEY=VALUE",
        help="another value for a key of the scene file, may be repeated: domain.cells=200, "
        "contact.obstacle='-0.1*x', dirichlet.1.value=2 for the first [[dirichlet]]",
    )


# What shtab completes: files with this ending.
COMPLETE_SCENES = {
    "bash": "_dolfinx_signorini_scenes",
    "zsh": "_files -g '*.toml'",
    "tcsh": "f:*.toml",
}
PREAMBLE = {
    "bash": """
_dolfinx_signorini_scenes() {
  compgen -d -- "$1"
  compgen -f -X '!*.toml' -- "$1"
}
"""
}


def completion(parser: argparse.ArgumentParser, shell: str) -> str:
    """Return a script that completes the commands in a shell.

    Args:
        parser: The parser of the command line.
        shell: bash, zsh or tcsh.

    Raises:
        InputError: The package shtab is missing.
    """
    try:
        import shtab
    except ImportError:
        raise InputError(
            "needs the package shtab: apt install python3-shtab, or pip install shtab",
            "--completion",
        ) from None
    return str(shtab.complete(parser, shell=shell, preamble=PREAMBLE))
