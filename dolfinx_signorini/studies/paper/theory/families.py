"""The experiments: families of meshes, what is measured on each, and the rows on disk.

A row is one experiment on one mesh. Each row is stored when the row is done, and rows found on disk
are not computed again.
"""

import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from dolfinx import mesh
from mpi4py import MPI

from dolfinx_signorini.base.logs import log
from dolfinx_signorini.base.records import ROWS, Records
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.solvers.cascade import coarse_levels, solve_cascade
from dolfinx_signorini.studies.paper.solution import PAPER_RULE
from dolfinx_signorini.studies.paper.theory import measures, parts, triangulations
from dolfinx_signorini.studies.paper.theory.discretisation import THEORY_RTOL, Discretisation
from dolfinx_signorini.studies.paper.theory.dual import EPSILONS
from dolfinx_signorini.studies.paper.theory.examples import (
    COMPOSED,
    PLACES,
    Example,
    composed_example,
    kinked_example,
    paper_example,
    placed_example,
    rough_example,
    sharp_example,
    smooth_example,
)
from dolfinx_signorini.studies.paper.theory.one_sided import SAMPLES

Row = dict[str, Any]

ROUGH_EXPONENTS = (2.5, 3.5, 6.0, 16.0)
POWER_EXPONENTS = (2.5, 3.5, 6.0, 16.0, math.inf)
SHARP_EXPONENT = 3.0

# What rows depend on besides the experiment and N.
SETTINGS = {
    "rtol": THEORY_RTOL,
    "epsilons": EPSILONS,
    "samples": SAMPLES,
    "reach": parts.REACH,
    "refinement": measures.REFINEMENT,
    "norms": measures.ERROR_NORMS,
    "second": measures.SECOND,
    "rule": str(PAPER_RULE),
}


@dataclass(frozen=True)
class Experiment:
    """A family of meshes, and what is measured on each:

        Experiment((25, 49), partial(measures.powers, p=3.0))

    Attributes:
        cells: Cells per side of the meshes, increasing; detachment points keep their places
            relative to the cells in which they lie.
        measure: The row of a mesh with so many cells per side.
        finest: Cells per side of the finest mesh that a row needs, as a multiple of its own.
    """

    cells: tuple[int, ...]
    measure: Callable[[MPI.Comm, int], Row]
    finest: int = 1


def experiments() -> dict[str, Experiment]:
    """Return all experiments by name."""
    paper = (15, 31, 51, 101, 201, 401, 701, 1001)
    odd, quarter = (25, 51, 101, 201, 401), (25, 49, 101, 201, 401)
    m = measures
    first = (m.errors, m.projection, m.supercloseness, m.one_sided, m.infimum)
    whole = (*first, m.obstacle, m.near, m.contact, m.factors, m.trace_interpolation)
    other = (m.errors, m.supercloseness, m.one_sided, m.infimum, m.contact)
    result = {
        "paper": _known(paper, paper_example, *whole),
        "smooth": _known(odd, smooth_example, m.projection),
        "kinked": _known((25, 51, 101, 201), kinked_example, m.stability),
        "dual": _known((25, 49, 99, 199), paper_example, m.dual, finest=m.REFINEMENT),
        "bounds": _known((25, 51, 101, 201), paper_example, m.bounds),
        "sharp": _known(
            (25, 51, 101, 201, 401),
            partial(sharp_example, SHARP_EXPONENT),
            m.errors,
            m.supercloseness,
            m.contact,
        ),
    }
    bounded = partial(sharp_example, math.inf)
    result["sharp inf"] = _known((25, 51, 101, 201, 401), bounded, m.errors)
    for name in COMPOSED:
        result[name] = _known(quarter, partial(composed_example, name), *other)
    result["dual two"] = _known(
        (25, 49, 101), partial(composed_example, "two"), m.dual, finest=m.REFINEMENT
    )
    for name, make, cells in (
        ("unstructured", triangulations.unstructured, (25, 51, 101, 201)),
        ("obtuse", triangulations.obtuse, (25, 51, 101, 201)),
        ("graded", triangulations.graded, (24, 50, 100, 200)),
    ):
        result[name] = _known(cells, paper_example, m.errors, m.shape, make=make)
    for p in ROUGH_EXPONENTS:
        result[rough_name(p)] = _known(
            (25, 51, 101, 201), partial(rough_example, p), m.supercloseness, m.one_sided, m.infimum
        )
    for p in POWER_EXPONENTS:
        result[power_name(p)] = Experiment(odd, partial(m.powers, p=p))
    for place in PLACES:
        cells = (50, 100, 200, 400)
        result[placed_name(place)] = _placed(cells, place)
    for name, pole in (("unknown", False), ("pole", True)):
        result[name] = Experiment((25, 51, 101, 201), partial(m.unknown, pole=pole))
    return result


def _known(
    cells: tuple[int, ...],
    example: Callable[[], Example],
    *chosen: measures.Measure,
    make: Callable[[MPI.Comm, int], mesh.Mesh] = friedrichs_keller,
    finest: int = 1,
) -> Experiment:
    """An experiment on an example."""
    return Experiment(cells, partial(_measured, example, chosen, make), finest)


def _measured(
    example: Callable[[], Example],
    chosen: tuple[measures.Measure, ...],
    make: Callable[[MPI.Comm, int], mesh.Mesh],
    comm: MPI.Comm,
    n: int,
) -> Row:
    if make is friedrichs_keller:
        d = discretise(comm, example(), n)
    else:
        d = Discretisation(example(), make(comm, n))
        d.solve(rtol=THEORY_RTOL)
    row: Row = {}
    for measure in chosen:
        row |= measure(d)
    d.destroy()
    return row


def _placed(cells: tuple[int, ...], place: float) -> Experiment:
    def measure(comm: MPI.Comm, n: int) -> Row:
        d = discretise(comm, placed_example(place, n), n)
        row = measures.errors(d)
        d.destroy()
        return row

    return Experiment(cells, measure)


def rough_name(p: float) -> str:
    """Return the name of the experiment of a regularity on problem (S)."""
    return f"rough {p:g}"


def power_name(p: float) -> str:
    """Return the name of the experiment of a regularity on problem (3)."""
    return f"power {p:g}"


def placed_name(place: float) -> str:
    """Return the name of the experiment of a place of the detachment point."""
    return f"placed {place:g}"


def discretise(comm: MPI.Comm, example: Example, n: int) -> Discretisation:
    """Return an example on the Friedrichs-Keller mesh, solved through a cascade of coarser ones.

    Args:
        comm: The communicator that shares the mesh.
        example: The example.
        n: Cells per side.
    """
    return solve_cascade(
        lambda m, _: Discretisation(example, friedrichs_keller(comm, m)),
        [*coarse_levels(n), n],
        rtol=THEORY_RTOL,
    )


def compute_row(comm: MPI.Comm, experiment: Experiment, n: int) -> Row:
    """Compute what an experiment measures on one mesh.

    Args:
        comm: The communicator that shares the mesh.
        experiment: The experiment.
        n: Cells per side.
    """
    return {"n": n} | experiment.measure(comm, n)


def run_experiments(
    comm: MPI.Comm, names: Iterable[str], max_n: int, folder: Path
) -> Mapping[str, list[Row]]:
    """Compute the rows of experiments that are not on disk yet.

    Args:
        comm: The communicator that shares each mesh.
        names: The experiments.
        max_n: Cells per side of the finest mesh.
        folder: Where `rows.jsonl` is.

    Returns:
        The rows of each experiment, by increasing N.

    Raises:
        InputError: The folder cannot be used.
        NotConvergedError: Some problem could not be solved.
    """
    records = Records(comm, folder / ROWS, SETTINGS)
    done = {(row["experiment"], row["n"]): row for row in records.rows}
    known, result = experiments(), {}
    for name in names:
        experiment = known[name]
        cells = [n for n in experiment.cells if experiment.finest * n <= max_n]
        for n in cells:
            if (name, n) not in done:
                start = time.perf_counter()
                records.append({"experiment": name} | compute_row(comm, experiment, n))
                done[name, n] = records.rows[-1]
                log.info("%s, N = %d: %.1f s", name, n, time.perf_counter() - start)
        result[name] = [done[name, n] for n in cells]
    return result
