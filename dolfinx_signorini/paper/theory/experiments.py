"""The experiments: families of meshes, what is measured on each, and the rows on disk.

A row is one experiment on one mesh. Rows are stored as they are done, and those found on disk are
not computed again.
"""

import functools
import math
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfinx_signorini.meshes import friedrichs_keller
from dolfinx_signorini.norms import error_norms
from dolfinx_signorini.paper.study import coarse_levels
from dolfinx_signorini.paper.theory.contact_sets import discrete_contact_set
from dolfinx_signorini.paper.theory.discretisation import RTOL, Discretisation
from dolfinx_signorini.paper.theory.dual import EPSILON, dual_chains
from dolfinx_signorini.paper.theory.one_sided import SAMPLES, one_sided_approximation
from dolfinx_signorini.paper.theory.parts import (
    REACH,
    near_and_far,
    near_and_far_supercloseness,
    signed_parts,
)
from dolfinx_signorini.paper.theory.placement import PLACES, placed_scene
from dolfinx_signorini.paper.theory.ritz import (
    RITZ_NORMS,
    check_obstacle_problem,
    ritz_errors,
    supercloseness,
)
from dolfinx_signorini.paper.theory.scenes import Scene, paper_scene, rough_scene, smooth_scene
from dolfinx_signorini.records import Records
from dolfinx_signorini.solvers.pressure import ContactState

Row = dict[str, Any]

ERROR_NORMS = (
    "L2",
    "L4",
    "L16",
    "Linf",
    "H1",
    "W1_2.6",
    "W1_4",
    "W1_16",
    "W1_inf",
    "H1_2_boundary",
    "H1_2_boundary_spectral",
)
ROUGH_EXPONENTS = (2.5, 3.0, 3.5, 5.0, 8.0, 16.0)
REFINEMENT = 4  # of the mesh of the dual solutions against that of u_h

# What rows depend on besides the experiment and N.
SETTINGS = {
    "rtol": RTOL,
    "epsilon": EPSILON,
    "samples": SAMPLES,
    "reach": REACH,
    "refinement": REFINEMENT,
    "norms": ERROR_NORMS,
    "ritz_norms": RITZ_NORMS,
}


@dataclass(frozen=True)
class Experiment:
    """A family of meshes of one scene.

    Attributes:
        scene: The scene on a mesh with so many cells per side.
        cells: Cells per side of the meshes, increasing; the detachment point keeps its place
            relative to the cell that it lies in.
        measure: What a row holds.
        finest: Cells per side of the finest mesh that a row needs, as a multiple of its own.
    """

    scene: Callable[[int], Scene]
    cells: tuple[int, ...]
    measure: Callable[[Discretisation], Row]
    finest: int = 1


def experiments() -> dict[str, Experiment]:
    """Return all experiments by name."""
    odd = (25, 51, 101, 201, 401)
    paper = (15, 31, 51, 101, 201, 401, 701, 1001)
    result = {
        "paper": Experiment(lambda _: paper_scene(), paper, measure_paper),
        "smooth": Experiment(lambda _: smooth_scene(), odd, measure_regularity),
        "dual": Experiment(lambda _: paper_scene(), (25, 49, 99, 199), measure_dual, REFINEMENT),
    }
    for p in ROUGH_EXPONENTS:
        result[rough_name(p)] = Experiment(
            functools.partial(_rough_scene, p), odd, functools.partial(measure_regularity, p=p)
        )
    for place in PLACES:
        result[placed_name(place)] = Experiment(
            functools.partial(placed_scene, place), (50, 100, 200, 400), measure_placement
        )
    return result


def rough_name(p: float) -> str:
    """Return the name of the experiment of a regularity."""
    return f"rough {p:g}"


def placed_name(place: float) -> str:
    """Return the name of the experiment of a place of the detachment point."""
    return f"placed {place:g}"


def measure_paper(discretisation: Discretisation) -> Row:
    """Return the row of Sections 3, 4 and 6 for the paper's solution."""
    return _superclose(discretisation) | {
        "errors": error_norms(discretisation.u_h, discretisation.exact, ERROR_NORMS),
        "signed": signed_parts(discretisation),
        "parts": near_and_far(discretisation, ["L16", "W1_16"]),
        "supercloseness_parts": near_and_far_supercloseness(discretisation),
        "obstacle": asdict(check_obstacle_problem(discretisation)),
        "contact_set": asdict(discrete_contact_set(discretisation)),
    }


def measure_regularity(discretisation: Discretisation, p: float | None = None) -> Row:
    """Return the row of a scene of another regularity: u in W^{2,p} for a given p."""
    norms = ERROR_NORMS if p is None else (*ERROR_NORMS, critical_norm(p))
    return _superclose(discretisation) | {
        "errors": error_norms(discretisation.u_h, discretisation.exact, norms),
    }


def measure_placement(discretisation: Discretisation) -> Row:
    """Return the row of a place of the detachment point in its cell."""
    return {"errors": error_norms(discretisation.u_h, discretisation.exact, ERROR_NORMS)}


def measure_dual(discretisation: Discretisation) -> Row:
    """Return the row of Section 5."""
    domain = discretisation.space.mesh
    n = cells_per_side(discretisation)
    fine = Discretisation(discretisation.scene, friedrichs_keller(domain.comm, REFINEMENT * n))
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


def cells_per_side(discretisation: Discretisation) -> int:
    """Return the cells per side of a mesh of the unit square."""
    return len(discretisation.curve.s) // 4


def discretise(comm: MPI.Comm, scene: Scene, n: int) -> Discretisation:
    """Return a scene on the Friedrichs-Keller mesh, solved through a cascade of coarser ones."""
    coarse: ContactState | None = None
    for level in (*coarse_levels(n), n):
        discretisation = Discretisation(scene, friedrichs_keller(comm, level))
        u_h = discretisation.solve(coarse)
        if level < n:
            coarse = discretisation.problem.contact_state(u_h)
            discretisation.destroy()
    return discretisation


def compute_row(comm: MPI.Comm, experiment: Experiment, n: int) -> Row:
    """Compute what an experiment measures on one mesh."""
    discretisation = discretise(comm, experiment.scene(n), n)
    row = {"n": n} | experiment.measure(discretisation)
    discretisation.destroy()
    return row


def compute_family(comm: MPI.Comm, name: str, cells: Iterable[int]) -> list[Row]:
    """Compute rows of an experiment without storing them."""
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
    result: dict[str, list[Row]] = {}
    known = experiments()
    for name in names:
        result[name] = []
        for n in known[name].cells:
            if known[name].finest * n > max_n:
                continue
            if (name, n) not in done:
                start = time.perf_counter()
                row = {"experiment": name} | compute_row(comm, known[name], n)
                records.append(row)
                done[name, n] = records.rows[-1]
                _report(comm, f"{name}, N = {n}: {time.perf_counter() - start:.1f} s")
            result[name].append(done[name, n])
    return result


def _rough_scene(p: float, _: int) -> Scene:
    return rough_scene(p)


def _superclose(discretisation: Discretisation) -> Row:
    """What Section 3 says about a scene."""
    one_sided = one_sided_approximation(discretisation)
    return {
        "ritz": ritz_errors(discretisation),
        "supercloseness": supercloseness(discretisation),
        "one_sided": {
            "norm": one_sided.norm,
            "sampling_error": one_sided.sampling_error,
            "upper_error": one_sided.upper_error,
            "cases": one_sided.cases,
        },
    }


def _report(comm: MPI.Comm, text: str) -> None:
    if comm.rank == 0:
        print(text, file=sys.stderr, flush=True)
