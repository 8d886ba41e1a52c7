"""The experiments: families of meshes, what is measured on each, and the rows on disk.

A row is one experiment on one mesh. Each row is stored when the row is done, and rows found on disk
are not computed again.
"""

import time
from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from dolfinx import mesh
from mpi4py import MPI

from dolfinx_signorini.base.logs import log
from dolfinx_signorini.base.records import ROWS, Records, Row, Wanted
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.norms.fractional import SAMPLES
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.solvers.cascade import coarse_levels, solve_cascade
from dolfinx_signorini.studies.paper.solution import PAPER_RULE
from dolfinx_signorini.studies.paper.tables import read_data
from dolfinx_signorini.studies.paper.theory import errors, measures, triangulations
from dolfinx_signorini.studies.paper.theory.discretisation import THEORY_RTOL, Discretisation
from dolfinx_signorini.studies.paper.theory.dual import EPSILONS
from dolfinx_signorini.studies.paper.theory.examples import EXAMPLES, Example
from dolfinx_signorini.studies.paper.theory.mixed import PowerProblem, UnknownProblem

P = TypeVar("P", bound=SignoriniProblem)

PROBLEMS: Mapping[str, Callable[..., SignoriniProblem]] = {  # without an example
    "power": PowerProblem,
    "unknown": UnknownProblem,
    "pole": partial(UnknownProblem, pole=True),
}

# What rows depend on besides the experiment and N.
SETTINGS = {
    "rtol": THEORY_RTOL,
    "epsilons": EPSILONS,
    "samples": SAMPLES,
    "reach": errors.REACH,
    "refinement": measures.REFINEMENT,
    "norms": measures.ERROR_NORMS,
    "second": measures.SECOND,
    "rule": str(PAPER_RULE),
    "measures": sorted(measures.MEASURES),
}


def experiments() -> dict[str, Mapping[str, Any]]:
    """Return all experiments by name; `data/experiments.toml` says what they consist of."""
    return read_data("experiments")


def solved(comm: MPI.Comm, make: Callable[[mesh.Mesh], P], n: int) -> P:
    """Return a problem on the Friedrichs-Keller mesh, solved through a cascade of coarser ones.

    Args:
        comm: The communicator that shares the mesh.
        make: Poses the problem on a mesh.
        n: Cells per side.
    """
    return solve_cascade(
        lambda m, _: make(friedrichs_keller(comm, m)),
        [*coarse_levels(n), n],
        rtol=THEORY_RTOL,
    )


def discretise(comm: MPI.Comm, example: Example, n: int) -> Discretisation:
    """Return an example on the Friedrichs-Keller mesh, solved; see `solved`."""
    return solved(comm, partial(Discretisation, example), n)


def compute_row(comm: MPI.Comm, experiment: Mapping[str, Any], n: int) -> Row:
    """Compute what an experiment measures on the mesh with n cells per side."""
    name, *numbers = experiment["example"].split()
    arguments: list[float] = [float(number) for number in numbers]

    def make(domain: mesh.Mesh) -> SignoriniProblem:
        if name in PROBLEMS:
            return PROBLEMS[name](domain, *arguments)
        example = EXAMPLES[name](*arguments, *([n] if name == "placed" else []))
        return Discretisation(example, domain)

    if "mesh" in experiment:
        problem = make(getattr(triangulations, experiment["mesh"])(comm, n))
        problem.solve(rtol=THEORY_RTOL)
    else:
        problem = solved(comm, make, n)
    row: Row = {"n": n}
    for measure in experiment["measure"]:
        row |= measures.MEASURES[measure](problem)
    problem.destroy()
    return row


def run_experiments(
    comm: MPI.Comm, names: Collection[str], max_n: int, folder: Path
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
    records, known = Records(comm, folder / ROWS, SETTINGS), experiments()
    wanted = []
    for name in names:
        # Dual solutions need a finer mesh than that of the row.
        finer = measures.REFINEMENT if "dual" in known[name]["measure"] else 1
        for n in known[name]["cells"]:
            if finer * n <= max_n:
                title, key = f"{name}, N = {n}", {"experiment": name, "n": n}
                wanted.append(Wanted(title, key, partial(_timed, comm, title, known[name], n), n))
    rows = records.table("theory", wanted)
    return {name: [row for row in rows if row["experiment"] == name] for name in names}


def _timed(comm: MPI.Comm, title: str, experiment: Mapping[str, Any], n: int) -> Row:
    """Compute a row, and tell how long that took."""
    start = time.perf_counter()
    row = compute_row(comm, experiment, n)
    log.info("%s: %.1f s", title, time.perf_counter() - start)
    return row
