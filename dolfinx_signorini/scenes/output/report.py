"""A solved scene as one HTML page without references: numbers, pictures, and the scene file."""

import base64
import html
from collections.abc import Iterable, Mapping, Sequence
from string import Template
from typing import Any

from dolfinx_signorini.scenes.output.summary import Summary, lines, time_line

PAGE = Template(
    """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff;
       max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2rem; }
table { border-collapse: collapse; }
th, td { text-align: left; vertical-align: top; padding: .2rem 1rem .2rem 0;
         border-bottom: 1px solid #ddd; }
th { font-weight: 600; } td { font-variant-numeric: tabular-nums; }
img { max-width: 100%; height: auto; display: block; margin: 1rem 0; }
pre { background: #f4f4f4; padding: 1rem; overflow-x: auto; font-size: .85rem; }
.note { border-left: 4px solid #D55E00; padding-left: 1rem; }
</style>
</head>
<body>
<h1>$title</h1>
$notes
<h2>Summary</h2>
$summary
<h2>Pictures</h2>
$pictures
<h2>Meshes</h2>
$meshes
<h2>Scene</h2>
<pre>$scene</pre>
<h2>To repeat the run</h2>
$versions
</body>
</html>
"""
)
CAPTIONS = {
    "solution": "The solution, and the parts of the boundary",
    "contact": "Gap and pressure on the contact boundary, or the pressure and where contact ends",
    "accuracy": "The adapted mesh with the estimated error of each cell, and the way to it",
}

OF_BODIES = {"solution": "The deformed body with its von Mises stress, and the obstacle"}


def write_report(record: Mapping[str, Any], summary: Summary, pictures: Mapping[str, bytes]) -> str:
    """Return the page, of the record of a run, the numbers of the scene and PNG images by name."""
    captions = CAPTIONS | (OF_BODIES if summary.body else {})
    repeat = [*record["versions"].items(), ("ranks", record["ranks"]), *record["options"].items()]
    return PAGE.substitute(
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
