"""The experiments: families of meshes, what is measured on each, and the rows on disk.

A row is one experiment on one mesh. Rows are stored as they are done, and rows found on disk are
not computed again.
"""

import math
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfinx_signorini.meshes import friedrichs_keller
from dolfinx_signorini.norms import error_norms
from dolfinx_signorini.paper.theory import parts, ritz
from dolfinx_signorini.paper.theory.contact_sets import discrete_contact_set
from dolfinx_signorini.paper.theory.discretisation import THEORY_RTOL, Discretisation
from dolfinx_signorini.paper.theory.dual import EPSILON, dual_chains
from dolfinx_signorini.paper.theory.examples import (
    PLACES,
    Example,
    paper_example,
    placed_example,
    rough_example,
    smooth_example,
)
from dolfinx_signorini.paper.theory.one_sided import SAMPLES, one_sided_approximation
from dolfinx_signorini.records import Records
from dolfinx_signorini.solvers.cascade import coarse_levels, solve_cascade

Row = dict[str, Any]

GRADIENT_NORMS = ("H1", "W1_2.6", "W1_4", "W1_16", "W1_inf")
TRACE_NORMS = ("H1_2_boundary", "H1_2_boundary_spectral")
ERROR_NORMS = ("L2", "L4", "L16", "Linf", *GRADIENT_NORMS, *TRACE_NORMS)
ROUGH_EXPONENTS = (2.5, 3.0, 3.5, 5.0, 8.0, 16.0)
REFINEMENT = 4  # of the mesh of the dual solutions against that of u_h

# What rows depend on besides the experiment and N.
SETTINGS = {
    "rtol": THEORY_RTOL,
    "epsilon": EPSILON,
    "samples": SAMPLES,
    "reach": parts.REACH,
    "refinement": REFINEMENT,
    "norms": ERROR_NORMS,
    "ritz_norms": ritz.RITZ_NORMS,
}


@dataclass(frozen=True)
class Experiment:
    """A family of meshes of one example:

        Experiment(lambda n: paper_example(), (25, 49), measure_dual, finest=REFINEMENT)

    Attributes:
        example: The example on a mesh with so many cells per side.
        cells: Cells per side of the meshes, increasing; the detachment point keeps its place
            relative to the cell in which the point lies.
        measure: What a row holds.
        finest: Cells per side of the finest mesh that a row needs, as a multiple of its own.
    """

    example: Callable[[int], Example]
    cells: tuple[int, ...]
    measure: Callable[[Discretisation], Row]
    finest: int = 1


def experiments() -> dict[str, Experiment]:
    """Return all experiments by name."""
    odd = (25, 51, 101, 201, 401)
    paper = (15, 31, 51, 101, 201, 401, 701, 1001)
    result = {
        "paper": Experiment(lambda _: paper_example(), paper, measure_paper),
        "smooth": Experiment(lambda _: smooth_example(), odd, measure_regularity),
        "dual": Experiment(lambda _: paper_example(), (25, 49, 99, 199), measure_dual, REFINEMENT),
    }
    for p in ROUGH_EXPONENTS:
        measure = partial(measure_regularity, p=p)
        result[rough_name(p)] = Experiment(partial(_rough, p), odd, measure)
    for place in PLACES:
        cells, example = (50, 100, 200, 400), partial(placed_example, place)
        result[placed_name(place)] = Experiment(example, cells, measure_placement)
    return result


def _rough(p: float, _: int) -> Example:
    return rough_example(p)


def rough_name(p: float) -> str:
    """Return the name of the experiment of a regularity."""
    return f"rough {p:g}"


def placed_name(place: float) -> str:
    """Return the name of the experiment of a place of the detachment point."""
    return f"placed {place:g}"


def measure_paper(discretisation: Discretisation) -> Row:
    """Return the row of Sections 3, 4 and 6 for the paper's solution."""
    return measure_regularity(discretisation) | {
        "signed": parts.signed_parts(discretisation),
        "parts": parts.near_and_far(discretisation, ["L16", "W1_16"]),
        "supercloseness_parts": parts.near_and_far_supercloseness(discretisation),
        "obstacle": asdict(ritz.check_obstacle_problem(discretisation)),
        "contact_set": asdict(discrete_contact_set(discretisation)),
    }


def measure_regularity(discretisation: Discretisation, p: float | None = None) -> Row:
    """Return the row of an example of another regularity.

    Args:
        discretisation: The example on a mesh.
        p: The exponent of the regularity, u in W^{2,p}; None for a smooth solution.
    """
    found = one_sided_approximation(discretisation)
    norms = ERROR_NORMS if p is None else (*ERROR_NORMS, critical_norm(p))
    kept = ("norm", "sampling_error", "upper_error", "cases")
    return {
        "ritz": ritz.ritz_errors(discretisation),
        "supercloseness": ritz.supercloseness(discretisation),
        "one_sided": {name: getattr(found, name) for name in kept},
        "errors": error_norms(discretisation.u_h, discretisation.exact, norms),
    }


def measure_placement(discretisation: Discretisation) -> Row:
    """Return the row of a place of the detachment point in its cell."""
    return {"errors": error_norms(discretisation.u_h, discretisation.exact, ERROR_NORMS)}


def measure_dual(discretisation: Discretisation) -> Row:
    """Return the row of Section 5."""
    n = len(discretisation.curve.s) // 4
    domain = friedrichs_keller(discretisation.comm, REFINEMENT * n)
    fine = Discretisation(discretisation.example, domain)
    chains = dual_chains(discretisation, fine)
    fine.destroy()
    return {
        name: asdict(chain) | {"slack": chain.slack}
        for name, chain in zip(("plus", "minus"), chains, strict=True)
    }


def critical_norm(p: float) -> str:
    """Return the W^{1,q} of Corollaries 4.1 and 4.2 with order 1, q rounded down to 3 digits."""
    q = 4.0 * p / (p + (2.0 if p < 4.0 else 4.0))
    return f"W1_{math.floor(1000.0 * q) / 1000.0:g}"


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
    discretisation = discretise(comm, experiment.example(n), n)
    row = {"n": n} | experiment.measure(discretisation)
    discretisation.destroy()
    return row


def compute_family(comm: MPI.Comm, name: str, cells: Iterable[int]) -> list[Row]:
    """Compute rows of an experiment without storing them.

    Args:
        comm: The communicator that shares the meshes.
        name: The experiment.
        cells: Cells per side of the meshes.
    """
    experiment = experiments()[name]
    return [compute_row(comm, experiment, n) for n in cells]


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
    records = Records(comm, folder / "rows.jsonl", SETTINGS)
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
                if comm.rank == 0:
                    seconds = time.perf_counter() - start
                    print(f"{name}, N = {n}: {seconds:.1f} s", file=sys.stderr, flush=True)
        result[name] = [done[name, n] for n in cells]
    return result
