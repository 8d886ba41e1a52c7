"""A solved scene as one HTML page without references: numbers, pictures, and the scene file."""

import base64
import html
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

from dolfinx_signorini.scenes.output.summary import Summary, lines, time_line

PAGE = Path(__file__).parent / "data" / "report.html"  # with names of what is filled in
CAPTIONS = {
    "solution": "The solution, and the parts of the boundary",
    "contact": "Gap and pressure on the contact boundary, or the pressure and where contact ends",
    "contact_boundary": "Gap and pressure on the contact boundary",
    "accuracy": "The adapted mesh with the estimated error of each cell, and the way to it",
}

OF_BODIES = {"solution": "The deformed body with its von Mises stress, and the obstacle"}


def write_report(record: Mapping[str, Any], summary: Summary, pictures: Mapping[str, bytes]) -> str:
    """Return the page, of the record of a run, the numbers of the scene and PNG images by name."""
    captions = CAPTIONS | (OF_BODIES if summary.body else {})
    repeat = [*record["versions"].items(), ("ranks", record["ranks"]), *record["options"].items()]
    return Template(PAGE.read_text()).substitute(
        title=html.escape(record["title"]),
        notes="".join(f'<p class="note">{html.escape(note)}</p>' for note in record["notes"]),
        summary=_table([*lines(summary), time_line(summary.phases)]),
        pictures="".join(_picture(captions[name], image) for name, image in pictures.items()),
        meshes=_meshes(record["meshes"]),
        scene=html.escape(record["scene"]),
        versions=_table([(key, str(value)) for key, value in repeat]),
    )


def _table(rows: Iterable[tuple[str, str]]) -> str:
    cells = (
        f'<tr><th scope="row">{html.escape(name)}</th><td>{html.escape(value)}</td></tr>'
        for name, value in rows
    )
    return f"<table>{''.join(cells)}</table>"


def _picture(caption: str, image: bytes) -> str:
    data = base64.b64encode(image).decode()
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{data}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def _number(value: str | int | float) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _meshes(meshes: Sequence[Mapping[str, Any]]) -> str:
    header = "".join(f'<th scope="col">{key.replace("_", " ")}</th>' for key in meshes[0])
    rows = ("".join(f"<td>{_number(value)}</td>" for value in row.values()) for row in meshes)
    return f"<table><tr>{header}</tr>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>"
