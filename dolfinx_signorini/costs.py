"""What a scene costs: the forms, matrices, vectors and arrays made for it, with bytes and seconds.

Every problem keeps a ledger. An entry is a few numbers; what takes work or communication, such as
adding up the ranks, is done when the ledger is read.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import ufl
from mpi4py import MPI
from petsc4py import PETSc
from ufl.core.expr import Expr
from ufl.corealg.traversal import unique_pre_traversal
from ufl.differentiation import Derivative

Item: TypeAlias = "PETSc.Mat | PETSc.Vec | ufl.Form | int | None"

PLACES = {"cell": "cells", "exterior_facet": "the boundary", "interior_facet": "inner facets"}


@dataclass(frozen=True)
class Cost:
    """One thing that was made.

    Attributes:
        kind: "form", "matrix", "vector", "array" or "phase".
        name: What it is; for a form with the terms that it has.
        count: How often it was made.
        bytes: What one of them takes, on all ranks; 0 for forms and phases.
        seconds: Wall-clock seconds of making all of them, on the slowest rank.
    """

    kind: str
    name: str
    count: int
    bytes: int
    seconds: float


@dataclass
class _Entry:
    count: int = 0
    bytes: int = 0
    seconds: float = 0.0
    form: ufl.Form | None = None


class Ledger:
    """What was made so far; the same entries on all ranks, with the numbers of each."""

    def __init__(self) -> None:
        self._entries: dict[tuple[str, str], _Entry] = {}

    def add(self, kind: str, name: str, item: Item = None, seconds: float = 0.0) -> None:
        """Note that something was made.

        Args:
            kind, name: See `Cost`; what has the same ones is counted in one entry.
            item: It, or its bytes on this rank, or the form for its terms.
            seconds: What it took on this rank.
        """
        entry = self._entries.setdefault((kind, name), _Entry())
        entry.count += 1
        entry.seconds += seconds
        if isinstance(item, ufl.Form):
            entry.form = item
        elif item is not None:
            entry.bytes = max(entry.bytes, item if isinstance(item, int) else _bytes(item))

    def read(self, comm: MPI.Comm) -> list[Cost]:
        """Return the entries of all ranks added up; the call is collective."""
        numbers = np.array([(e.bytes, e.seconds) for e in self._entries.values()]).reshape(-1, 2)
        parts = np.array(comm.allgather(numbers))
        size, seconds = parts[:, :, 0].sum(axis=0), parts[:, :, 1].max(axis=0)
        return [
            Cost(
                kind=kind,
                name=name if entry.form is None else f"{name}: {describe(entry.form)}",
                count=entry.count,
                bytes=int(size[i]),
                seconds=float(seconds[i]),
            )
            for i, ((kind, name), entry) in enumerate(self._entries.items())
        ]


def cost_text(costs: Iterable[Cost]) -> str:
    """Return costs as a table for people."""
    rows = list(costs)
    lines = [f"{'kind':7} {'MB':>10} {'seconds':>9} {'times':>6}  what"]
    for c in rows:
        size = f"{c.bytes / 1e6:10.3f}" if c.bytes else f"{'-':>10}"
        seconds = f"{c.seconds:9.3f}" if c.seconds else f"{'-':>9}"
        lines.append(f"{c.kind:7} {size} {seconds} {c.count:6d}  {c.name}")
    lines.append(f"{'all':7} {sum(c.bytes for c in rows) / 1e6:10.3f}")
    return "\n".join(lines) + "\n"


def describe(form: ufl.Form) -> str:
    """Return the terms of a form in words.

    Of a bilinear form "diffusion" is a term with derivatives of the arguments and "reaction" one
    without; of a linear form "load" is what acts on cells and "flux" what acts on facets.
    """
    bilinear = len(form.arguments()) == 2
    words = []
    for integral in form.integrals():
        kind = integral.integral_type()
        for term in _summands(integral.integrand()):
            if bilinear:
                word = "diffusion" if _differentiates_arguments(term) else "reaction"
            else:
                word = "load" if kind == "cell" else "flux"
            words.append(f"{word} on {PLACES.get(kind, kind)}")
    return ", ".join(sorted(set(words))) or "no term"


def _summands(term: Expr) -> Iterator[Expr]:
    if isinstance(term, ufl.classes.Sum):
        for operand in term.ufl_operands:
            yield from _summands(operand)
    else:
        yield term


def _differentiates_arguments(term: Expr) -> bool:
    return any(
        isinstance(inner, ufl.Argument)
        for node in unique_pre_traversal(term)
        if isinstance(node, Derivative)
        for inner in unique_pre_traversal(node)
    )


def _bytes(item: PETSc.Mat | PETSc.Vec) -> int:
    """What the part of this rank takes: entries, and for a matrix their columns and row starts."""
    number, index = np.dtype(PETSc.ScalarType).itemsize, np.dtype(PETSc.IntType).itemsize
    if isinstance(item, PETSc.Vec):
        return int(item.getLocalSize() * number)
    entries = item.getInfo(PETSc.Mat.InfoType.LOCAL)["nz_allocated"]
    return int(entries * (number + index) + (item.getLocalSize()[0] + 1) * index)
