"""Costs of a problem: the forms, matrices, vectors and arrays that it holds, and its seconds.

Nothing is noted while a problem is solved: the objects are looked for when somebody asks.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc
from ufl.algorithms import extract_arguments, extract_type
from ufl.differentiation import Derivative

from dolfinx_signorini.base.sums_of_squares import summands
from dolfinx_signorini.base.tables import text_table

PLACES = {"cell": "cells", "exterior_facet": "the boundary", "interior_facet": "inner facets"}


@dataclass(frozen=True)
class Cost:
    """The cost of the objects of one name that a problem holds, or of one phase of its solution:

        largest = max(problem.costs(), key=lambda cost: cost.bytes)

    Attributes:
        kind: "form", "matrix", "vector", "array" or "phase".
        name: The attribute that holds the objects; the name of a phase, or of a form with its
            terms.
        count: The number of these objects.
        bytes: Their size, all ranks together; 0 for forms and phases.
        seconds: Wall-clock seconds of a phase, on the slowest rank; 0 for objects.
    """

    kind: str
    name: str
    count: int
    bytes: int
    seconds: float


def costs_of(
    comm: MPI.Comm, owner: object, forms: Mapping[str, ufl.Form], seconds: Mapping[str, float]
) -> list[Cost]:
    """Return the costs of forms, of the objects that an owner holds, and of phases; collective.

    Args:
        comm: The communicator of the owner.
        owner: An object of this package, which is searched with its attributes and theirs.
        forms: Forms by name.
        seconds: The seconds of phases by name, on this rank.
    """
    own = {("form", f"{name}: {describe(form)}"): (1, 0, 0.0) for name, form in forms.items()}
    for kind, name, size in _held(owner):
        count, total, _ = own.get((kind, name), (0, 0, 0.0))
        own[kind, name] = count + 1, total + size, 0.0
    own |= {("phase", name): (1, 0, value) for name, value in seconds.items()}
    of_ranks = comm.allgather(own)
    costs = []
    for kind, name in dict.fromkeys(key for part in of_ranks for key in part):
        parts = (part[kind, name] for part in of_ranks if (kind, name) in part)
        counts, sizes, times = zip(*parts, strict=True)
        if kind in ("form", "phase") or any(sizes):
            costs.append(Cost(kind, name, max(counts), sum(sizes), max(times)))
    return costs


def _held(owner: object) -> Iterator[tuple[str, str, int]]:
    """The kind, the attribute and the bytes on this rank of each object that an owner holds."""
    number, index = np.dtype(PETSc.ScalarType).itemsize, np.dtype(PETSc.IntType).itemsize
    queue: list[tuple[str, Any]] = [("", owner)]
    seen = set()
    for name, item in queue:  # which grows
        key = item.handle if isinstance(item, PETSc.Object) else id(item)
        if key in seen:
            continue
        seen.add(key)
        if isinstance(item, PETSc.Mat) and item and item.getType() != PETSc.Mat.Type.PYTHON:
            # The entries, their columns and the row starts.
            entries = int(item.getInfo(PETSc.Mat.InfoType.LOCAL)["nz_allocated"])
            rows = item.getLocalSize()[0]
            yield "matrix", name, entries * (number + index) + (rows + 1) * index
        elif isinstance(item, PETSc.Vec) and item:
            yield "vector", name, item.getLocalSize() * number
        elif isinstance(item, np.ndarray | fem.Function):
            yield "array", name, (item.x.array if isinstance(item, fem.Function) else item).nbytes
        elif isinstance(item, list | tuple):
            queue += [(name, part) for part in item]
        elif isinstance(item, dict):
            queue += [(name, part) for part in item.values()]
        elif type(item).__module__.startswith(__name__.partition(".")[0]):
            # What others share with the system is named after the system.
            parts = sorted(vars(item).items(), key=lambda pair: pair[0] != "_system")
            queue += [(f"{name} {key.lstrip('_')}".lstrip(), part) for key, part in parts]


def cost_text(costs: Iterable[Cost]) -> str:
    """Return costs as a table for a terminal, with the sum of their bytes in its last row."""
    rows, total = [], 0
    for cost in costs:
        total += cost.bytes
        size = f"{cost.bytes / 1e6:.3f}" if cost.bytes else "-"
        seconds = f"{cost.seconds:.3f}" if cost.seconds else "-"
        rows.append((f"{cost.kind} {cost.name}", size, seconds, cost.count if cost.bytes else ""))
    rows.append(("all", f"{total / 1e6:.3f}", "", ""))
    return text_table(("cost", "MB", "seconds", "objects"), rows)


def describe(form: ufl.Form) -> str:
    """Return the terms of a form in words, for example "diffusion on cells, reaction on cells".

    A term of a bilinear form is called "diffusion" where it differentiates an argument, else
    "reaction". A term of a linear form is called "load" on cells and "flux" on facets. Of vectors
    the words for diffusion and flux are "elasticity" and "traction".
    """
    words = set()
    vectors = any(argument.ufl_shape for argument in form.arguments())
    stiffness, flux = ("elasticity", "traction") if vectors else ("diffusion", "flux")
    for integral in form.integrals():
        kind = integral.integral_type()
        for term in summands(integral.integrand()):
            word = "load" if kind == "cell" else flux
            if len(form.arguments()) == 2:
                slopes = extract_type(term, Derivative)
                word = stiffness if any(map(extract_arguments, slopes)) else "reaction"
            words.add(f"{word} on {PLACES.get(kind, kind)}")
    return ", ".join(sorted(words)) or "no term"
