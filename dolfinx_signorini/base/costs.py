"""Costs of a problem: the forms, matrices, vectors and arrays made for it, in bytes and seconds.

Every problem keeps a ledger. To note an entry takes a few numbers and no communication; the ranks
are added up, and the terms of the forms put into words, when somebody reads the ledger.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import ufl
from mpi4py import MPI
from petsc4py import PETSc
from ufl.algorithms import extract_arguments, extract_type
from ufl.differentiation import Derivative

from dolfinx_signorini.base.sums_of_squares import summands
from dolfinx_signorini.base.tables import text_table

Item: TypeAlias = "PETSc.Mat | PETSc.Vec | ufl.Form | int | None"

PLACES = {"cell": "cells", "exterior_facet": "the boundary", "interior_facet": "inner facets"}


@dataclass(frozen=True)
class Cost:
    """The cost of one object of a problem, or of one phase of its solution:

        largest = max(problem.costs(), key=lambda cost: cost.bytes)

    Attributes:
        kind: "form", "matrix", "vector", "array" or "phase".
        name: The name of the object or phase; for a form its terms as well.
        count: How often the object was made.
        bytes: The size of one such object, all ranks together; 0 for forms and phases.
        seconds: Wall-clock seconds of all times together, on the slowest rank.
    """

    kind: str
    name: str
    count: int
    bytes: int
    seconds: float


class Ledger:
    """The objects made so far: the same entries on all ranks, each rank with its own numbers:

    ledger = Ledger()
    ledger.add("matrix", "A", A, seconds=0.2)
    """

    def __init__(self) -> None:
        self._own: dict[tuple[str, str], Cost] = {}  # of this rank
        self._forms: dict[str, ufl.Form] = {}

    def add(self, kind: str, name: str, item: Item = None, seconds: float = 0.0) -> None:
        """Note that an object was made, or that a phase has ended.

        Args:
            kind: See `Cost`.
            name: See `Cost`; objects of the same kind and name share one entry.
            item: The object, its size in bytes on this rank, or the form to describe.
            seconds: The wall-clock seconds on this rank.
        """
        old = self._own.get((kind, name), Cost(kind, name, 0, 0, 0.0))
        if isinstance(item, ufl.Form):
            self._forms[name], item = item, None
        size = item if isinstance(item, int) else 0 if item is None else _bytes(item)
        new = Cost(kind, name, old.count + 1, max(old.bytes, size), old.seconds + seconds)
        self._own[kind, name] = new

    def read(self, comm: MPI.Comm) -> list[Cost]:
        """Return the costs, all ranks together; the call is collective."""
        costs = []
        for of_ranks in zip(*comm.allgather(list(self._own.values())), strict=True):
            own, form = of_ranks[0], self._forms.get(of_ranks[0].name)
            name = own.name if form is None else f"{own.name}: {describe(form)}"
            size = sum(cost.bytes for cost in of_ranks)
            seconds = max(cost.seconds for cost in of_ranks)
            costs.append(Cost(own.kind, name, own.count, size, seconds))
        return costs


def cost_text(costs: Iterable[Cost]) -> str:
    """Return costs as a table for a terminal, with the sum of their bytes in its last row."""
    costs = list(costs)
    rows = [
        (
            f"{cost.kind} {cost.name}",
            f"{cost.bytes / 1e6:.3f}" if cost.bytes else "-",
            f"{cost.seconds:.3f}" if cost.seconds else "-",
            str(cost.count),
        )
        for cost in costs
    ]
    total = ("all", f"{sum(cost.bytes for cost in costs) / 1e6:.3f}", "", "")
    return text_table(("cost", "MB", "seconds", "times"), [*rows, total])


def describe(form: ufl.Form) -> str:
    """Return the terms of a form in words, for example "diffusion on cells, reaction on cells".

    A term of a bilinear form is called "diffusion" where it differentiates an argument, else
    "reaction". A term of a linear form is called "load" on cells and "flux" on facets.
    """
    words = set()
    for integral in form.integrals():
        kind = integral.integral_type()
        for term in summands(integral.integrand()):
            word = "load" if kind == "cell" else "flux"
            if len(form.arguments()) == 2:
                slopes = extract_type(term, Derivative)
                word = "diffusion" if any(map(extract_arguments, slopes)) else "reaction"
            words.add(f"{word} on {PLACES.get(kind, kind)}")
    return ", ".join(sorted(words)) or "no term"


def _bytes(item: PETSc.Mat | PETSc.Vec) -> int:
    """The bytes on this rank: the entries, and for a matrix their columns and the row starts."""
    number, index = np.dtype(PETSc.ScalarType).itemsize, np.dtype(PETSc.IntType).itemsize
    if isinstance(item, PETSc.Vec):
        return int(item.getLocalSize() * number)
    entries = item.getInfo(PETSc.Mat.InfoType.LOCAL)["nz_allocated"]
    return int(entries * (number + index) + (item.getLocalSize()[0] + 1) * index)
