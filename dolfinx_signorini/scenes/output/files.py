"""The files of a solved scene: fields for ParaView, CSV, pictures, the record, the report."""

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dolfinx_signorini.accuracy.pictures import draw_adaptive
from dolfinx_signorini.contact_boundary import ContactBoundary, draw_contact
from dolfinx_signorini.plane_field import draw_plane_field, gather_plane_field
from dolfinx_signorini.records import on_first, versions, write_file
from dolfinx_signorini.scenes.output.fields import write_fields
from dolfinx_signorini.scenes.output.folder import RECORD
from dolfinx_signorini.scenes.output.report import write_report
from dolfinx_signorini.scenes.output.summary import Summary
from dolfinx_signorini.scenes.posing import boundary_parts
from dolfinx_signorini.scenes.solving import SceneResult


def write_results(
    result: SceneResult,
    summary: Summary,
    boundary: ContactBoundary | None,
    outputs: tuple[str, ...],
    folder: Path,
) -> None:
    """Write the outputs of a solved scene; the call is collective.

    Args:
        result: The solved scene.
        summary: Its numbers.
        boundary: Its contact boundary, on rank 0.
        outputs: Which of `OUTPUTS` to write; the record comes with all of them.
        folder: Where to write.
    """
    comm = result.posed.problem.comm
    if "fields" in outputs:
        write_fields(result, folder)
    drawn = {"pictures", "report"} & set(outputs)
    figures = draw_scene(result, summary, boundary) if drawn else {}

    def write() -> None:
        assert boundary is not None  # rank 0 has the boundary
        _write_small_files(result, summary, boundary, figures, outputs, folder)

    on_first(comm, folder.parent, write)


def draw_scene(
    result: SceneResult, summary: Summary, boundary: ContactBoundary | None
) -> dict[str, Figure]:
    """Return the pictures of a solved scene by name; none on all ranks but 0.

    Args:
        result: The solved scene; the call is collective.
        summary: Its numbers.
        boundary: Its contact boundary, on rank 0.
    """
    figures, posed = {}, result.posed
    if posed.scene.domain.dimension == 2:
        parts = boundary_parts(posed.scene, posed.sided)
        field = gather_plane_field(result.u, {kind.name: parts[kind] for kind in parts})
        if field is not None:
            styles = {kind.name: kind.style for kind in parts}
            figures["solution"] = draw_plane_field(
                field, styles, summary.detachment_points, posed.scene.title
            )
    if boundary is not None:
        figures["contact"] = draw_contact(boundary)
    if result.found is not None:
        way = draw_adaptive(result.found)
        if way is not None:
            figures["accuracy"] = way
    return figures


def boundary_csv(boundary: ContactBoundary) -> str:
    """Return the contact boundary as CSV: coordinates, u, gap, pressure, and whether in contact.

    The pressure is left empty where u has Dirichlet data.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    axes = ["x", "y", "z"][: boundary.points.shape[1]]
    writer.writerow([*axes, "u", "gap", "pressure", "in_contact"])
    for k, touching in enumerate(boundary.touching):
        numbers = [float(v) for v in (*boundary.points[k], *boundary.values[k])]
        writer.writerow([*("" if np.isnan(v) else v for v in numbers), int(touching)])
    return text.getvalue()


def make_record(result: SceneResult, summary: Summary) -> dict[str, Any]:
    """Return everything that is needed to repeat a run; rank 0 only.

    Args:
        result: The solved scene.
        summary: Its numbers.
    """
    scene = result.posed.scene
    return {
        "title": scene.title,
        "versions": versions(),
        "ranks": result.posed.problem.comm.size,
        "options": _options(result),
        "scene": scene.text,
        "summary": asdict(summary),
        "meshes": _meshes(result),
        "expected_orders": result.expectation.orders,
        "notes": list(result.expectation.notes),
        "solver": asdict(result.solve),
        **scene.domain.record(),
    }


def _options(result: SceneResult) -> dict[str, Any]:
    """Return what a run was asked for, on the command line or in the scene."""
    found, scene = result.found, result.posed.scene
    if found is None:
        return {"degree": scene.degree, "rtol": scene.rtol}
    request = found.request
    asked = {"accuracy": request.accuracy, "budget": request.budget, "norm": request.target.name}
    return {key: value for key, value in asked.items() if value is not None} | {
        "degree": scene.degree
    }


def _meshes(result: SceneResult) -> list[dict[str, Any]]:
    """Return the levels of the cascade, or the steps of the adaptive loop, in their order."""
    if result.found is not None:
        return [asdict(step) for step in result.found.steps]
    return [asdict(level) for level in result.levels]


def _write_small_files(
    result: SceneResult,
    summary: Summary,
    boundary: ContactBoundary,
    figures: dict[str, Figure],
    outputs: Sequence[str],
    folder: Path,
) -> None:
    """Write all outputs but the fields; rank 0 only."""
    record = make_record(result, summary)
    if "boundary" in outputs:
        write_file(folder / "boundary.csv", boundary_csv(boundary))
    images = {}
    for name, figure in figures.items():
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=150)
        images[name] = buffer.getvalue()
        if "pictures" in outputs:
            (folder / f"{name}.png").write_bytes(images[name])
    if "report" in outputs:
        write_file(folder / "report.html", write_report(record, summary, images))
    record["files"] = sorted([RECORD, *(path.name for path in folder.iterdir())])
    write_file(folder / RECORD, json.dumps(record, indent=1) + "\n")
