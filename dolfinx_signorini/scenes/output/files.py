"""The files of a solved scene: fields for ParaView, CSV, pictures, the record, the report."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from dolfinx_signorini.base.records import on_first, versions, write_file
from dolfinx_signorini.base.tables import csv_table
from dolfinx_signorini.data.formulas import COORDINATES
from dolfinx_signorini.pictures.contact_boundary import ContactBoundary
from dolfinx_signorini.scenes.output.fields import write_fields
from dolfinx_signorini.scenes.output.folder import FILES, RECORD
from dolfinx_signorini.scenes.output.pictures import draw_scene
from dolfinx_signorini.scenes.output.report import write_report
from dolfinx_signorini.scenes.output.summary import Summary
from dolfinx_signorini.scenes.solving import SceneResult


def write_results(
    result: SceneResult,
    summary: Summary,
    boundaries: Sequence[ContactBoundary | None],
    outputs: tuple[str, ...],
    folder: Path,
) -> None:
    """Write the outputs of a solved scene; the call is collective.

    Args:
        result: The solved scene.
        summary: The numbers of the result.
        boundaries: Where its obstacles are, see `scene_boundaries`.
        outputs: Which of `OUTPUTS` to write; the record comes with all of them.
        folder: Where to write.
    """
    if "fields" in outputs:
        write_fields(result, folder)
    drawn = {"pictures", "report"} & set(outputs)
    figures = draw_scene(result, boundaries, summary.detachment_points) if drawn else {}

    def write() -> None:
        record = make_record(result, summary)
        if "boundary" in outputs:
            for name, boundary in zip(FILES["boundary"], boundaries, strict=False):
                assert boundary is not None  # rank 0 has all of them
                write_file(folder / name, boundary_csv(boundary))
        images = {name: figure.png() for name, figure in figures.items()}
        if "pictures" in outputs:
            for name, image in images.items():
                (folder / f"{name}.png").write_bytes(image)
        if "report" in outputs:
            write_file(folder / "report.html", write_report(record, summary, images))
        record["files"] = sorted([RECORD, *(path.name for path in folder.iterdir())])
        write_file(folder / RECORD, json.dumps(record, indent=1) + "\n")

    on_first(result.posed.problem.comm, folder.parent, write)


def boundary_csv(boundary: ContactBoundary) -> str:
    """Return the contact boundary as CSV: coordinates, u, gap, pressure, and whether in contact.

    The pressure is left empty where u has Dirichlet data. Of a body u.d stands in place of u.
    """
    unknown = boundary.unknown.replace(r" \cdot ", ".")
    axes = COORDINATES[: boundary.points.shape[1]]
    numbers: list[list[float]] = np.column_stack((boundary.points, boundary.values)).tolist()  # type: ignore[assignment]
    rows = [
        [*("" if np.isnan(number) else number + 0.0 for number in row), int(touching)]
        for row, touching in zip(numbers, boundary.touching, strict=True)
    ]
    return csv_table([*axes, unknown, "gap", "pressure", "in_contact"], rows)


def make_record(result: SceneResult, summary: Summary) -> dict[str, Any]:
    """Return everything that is needed to repeat a run; rank 0 only."""
    scene, found = result.posed.scene, result.found
    asked: dict[str, Any] = {"rtol": scene.rtol}
    if found is not None:
        request, norm = found.request, found.request.target.name
        asked = {"accuracy": request.accuracy, "budget": request.budget, "norm": norm}
        asked = {key: value for key, value in asked.items() if value is not None}
    return {
        "title": scene.title,
        "versions": versions(),
        "ranks": result.posed.problem.comm.size,
        "options": asked | {"degree": scene.degree},
        "scene": scene.text,
        "set": list(scene.overrides),
        "summary": asdict(summary),
        "meshes": [asdict(item) for item in (result.levels if found is None else found.steps)],
        "expected_orders": result.expectation.orders,
        "notes": list(result.expectation.notes),
        "solver": asdict(result.solve),
        **scene.domain.record(),
    }
