"""Forms and expressions whose compiled code is looked up once in a process.

DOLFINx looks up the code of each new form in a folder that holds all code compiled so far: the
folder is listed, and the code loaded, again each time. On a mesh of some thousand cells this takes
longer than everything else. Forms with the same signature have the same code, whatever their mesh.
The numbers in a form become components of a constant first, so that a sweep over a number compiles
one code.

A process that is killed while it compiles leaves a file in the folder which makes DOLFINx wait for
code that never comes. The file is removed when it is old.
"""

import functools
import importlib.metadata
import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from pathlib import Path
from typing import Any

import ffcx.naming
import numpy as np
import ufl
from dolfinx import default_scalar_type, fem, jit
from mpi4py import MPI
from ufl.algorithms.check_arities import ArityMismatch
from ufl.algorithms.compute_form_data import compute_form_data
from ufl.algorithms.map_integrands import map_integrand_dags
from ufl.classes import BesselFunction, Power, RealValue
from ufl.core.expr import Expr
from ufl.corealg.multifunction import MultiFunction
from ufl.corealg.traversal import unique_pre_traversal
from ufl.domain import extract_unique_domain

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.errors import InputError

_codes: dict[tuple[str, str], Any] = {}  # by signature and options
# By the signature of a form: its numbers, and the signature with a constant in their place.
_numbered: dict[str, tuple[list[float], str]] = {}

# Setuptools, which calls the C compiler, reads the files of all installed packages six times for
# each code: without the memory 185 ms for a code, with the memory 107 ms.
_entry_points = functools.cache(importlib.metadata.entry_points)

# What FFCx says after it has waited in vain for the code of another process.
WAITED = re.compile(r"JIT compilation timed out.*remove (.*\.c)\)", re.DOTALL)
LONGEST = 60.0  # seconds that another process takes, before it is taken for one that is gone


def form(item: ufl.Form, subject: str = "", **options: Any) -> fem.Form:
    """Return a compiled form, as `dolfinx.fem.form` does; the call is collective.

    Args:
        item: The form.
        subject: What a form that users gave is called in messages.
        options: The keywords of `dolfinx.fem.form`.

    Raises:
        InputError: A form that users gave is not linear in each of its arguments, or its integrals
            of one type have different subdomain data.
    """
    if subject:
        _check_subdomains(item, subject)
    with _remembered(subject, lambda _: _without_numbers(item)):
        return fem.form(_with_constant(item), **options)


def form_on(
    item: ufl.Form,
    spaces: Sequence[fem.FunctionSpace],
    subdomains: dict[fem.IntegralType, list[tuple[int, LocalIndices]]],
) -> fem.Form:
    """Return a compiled form on the mesh of its spaces; the call is collective.

    The form is one of arguments on a `ufl.Mesh` without data: whoever keeps such a form for all
    meshes of a kind pays for its making and its signature once.

    Args:
        item: The form, without coefficients and constants.
        spaces: The spaces of its arguments.
        subdomains: Where to integrate, by type of integral: numbers of subdomains, each with cells
            or with (cell, local facet) pairs, flat.
    """
    domain = spaces[0].mesh
    key = item.signature(), "without a mesh"
    code = _once(domain.comm, key, lambda: fem.compile_form(domain.comm, item))
    return fem.create_form(code, list(spaces), domain, subdomains, {}, {})


def expression(item: Expr, points: Array, comm: MPI.Comm) -> fem.Expression:
    """Return a compiled expression, as `dolfinx.fem.Expression` does; the call is collective.

    Args:
        item: The expression.
        points: The points in the reference cell or facet, shape (points, dimension).
        comm: The communicator of the mesh.
    """
    with _remembered():
        return fem.Expression(_without_numbers(item), points, comm=comm)


def check_linear(item: ufl.Form, subject: str) -> None:
    """Refuse a form that is not linear in each argument: DOLFINx lets other ranks wait for ever.

    Raises:
        InputError: With the subject that is given.
    """
    try:
        compute_form_data(item, complex_mode=False)
    except (ArityMismatch, ValueError):  # UFL trips over its own message where a term has none
        message = "each term must be linear in each trial and test function"
        raise InputError(message, subject) from None


def _check_subdomains(item: ufl.Form, subject: str) -> None:
    """Refuse integrals of one type with different subdomain data, which DOLFINx does not take."""
    for by_type in item.subdomain_data().values():
        for kind, data in by_type.items():
            if any(other is not data[0] for other in data):
                message = (
                    f"the subdomain_data of its {kind} integrals differ, or some have none; give "
                    "all of these integrals one measure, whose tags name every part"
                )
                raise InputError(message, subject)


class _Components(MultiFunction):
    """Replaces numbers by components of a constant; exponents and orders belong to the code."""

    def __init__(self, constant: Expr, places: dict[float, int]) -> None:
        super().__init__()
        self._constant, self._places = constant, places

    expr = MultiFunction.reuse_if_untouched

    def real_value(self, o: Expr) -> Expr:
        return self._constant[self._places[float(o)]] if float(o) in self._places else o

    def power(self, o: Expr, base: Expr, exponent: Expr) -> Expr:
        kept = o.ufl_operands[1]
        return self.expr(o, base, kept if isinstance(kept, RealValue) else exponent)

    def bessel_function(self, o: Expr, _: Expr, x: Expr) -> Expr:
        return self.expr(o, o.ufl_operands[0], x)


def _with_constant(item: ufl.Form) -> ufl.Form:
    """Return what is to DOLFINx the form `_without_numbers`: the form, with one constant more.

    DOLFINx takes from a form its signature, its constants and what they belong to. The form without
    numbers is made for its first signature, and again where its code is to be compiled.
    """
    key = item.signature()
    if key not in _numbered:
        _numbered[key] = _numbers(item), _without_numbers(item).signature()
    numbers, signature = _numbered[key]
    made = copy(item)
    if numbers:
        made._signature = signature
        made._constants = (*item.constants(), _constant(item, numbers))
    return made


def _constant(item: Any, numbers: Sequence[float]) -> fem.Constant:
    return fem.Constant(_domain(item), np.array(numbers, dtype=default_scalar_type))


def _domain(item: Any) -> Any:
    return item.ufl_domain() if isinstance(item, ufl.Form) else extract_unique_domain(item)


def _numbers(item: Any) -> list[float]:
    """The numbers of a form or an expression that belong to no code; none without a domain."""
    integrals = item.integrals() if isinstance(item, ufl.Form) else []
    integrands = [integral.integrand() for integral in integrals] or [item]
    places: dict[float, int] = {}
    for node in (node for integrand in integrands for node in unique_pre_traversal(integrand)):
        code = {Power: 1}.get(type(node), 0 if isinstance(node, BesselFunction) else None)
        for k, operand in enumerate(node.ufl_operands):
            if k != code and isinstance(operand, RealValue):
                places.setdefault(float(operand), len(places))
    return [] if _domain(item) is None else list(places)


def _without_numbers(item: Any) -> Any:
    """Return a form or an expression whose numbers are components of one constant.

    One constant, because UFL sorts operands: components by their place, constants by a name that
    depends on what the process has made before.
    """
    numbers = _numbers(item)
    if not numbers:
        return item
    places = {value: k for k, value in enumerate(numbers)}
    return map_integrand_dags(_Components(_constant(item, numbers), places), item)


@contextmanager
def _remembered(
    subject: str = "", coded: Callable[[Any], Any] = lambda item: item
) -> Iterator[None]:
    """Let DOLFINx find the codes that this module has seen.

    Args:
        subject: What forms of users are called in messages.
        coded: Returns what is compiled where the code of an item has not been seen.
    """
    look_up = jit.ffcx_jit

    def remember(comm: MPI.Comm, item: Any, *given: Any, **options: Any) -> Any:
        def found() -> Any:
            if subject:
                check_linear(item, subject)
            return look_up(comm, coded(item), *given, **options)

        compute = ffcx.naming.compute_signature
        signature = item.signature() if isinstance(item, ufl.Form) else compute([item], "")
        return _once(comm, (str(signature), repr((given, options))), found)

    with _replaced(jit, "ffcx_jit", remember):
        yield


@contextmanager
def _replaced(module: Any, name: str, function: Callable[..., Any]) -> Iterator[None]:
    """Let a module have another function under a name."""
    before = getattr(module, name)
    setattr(module, name, function)
    try:
        yield
    finally:
        setattr(module, name, before)


def _once(comm: MPI.Comm, key: tuple[str, str], look_up: Callable[[], Any]) -> Any:
    known = key in _codes
    if comm.size > 1:  # to look a code up is collective
        known = comm.allreduce(known, op=MPI.LAND)
    if not known:
        _codes[key] = _found(comm, look_up)
    return _codes[key]


def _found(comm: MPI.Comm, look_up: Callable[[], Any]) -> Any:
    """Look a code up, however long another process compiles it, or whatever that has left."""
    # On several ranks the first one waits for the code, and all raise what DOLFINx makes of that.
    raised: type[Exception] = TimeoutError if comm.size == 1 else RuntimeError
    while True:
        try:
            with _replaced(importlib.metadata, "entry_points", _entry_points):
                return look_up()
        except raised as error:
            again = comm.bcast(_may_come(str(error)) if comm.rank == 0 else None)
            if not again:
                raise


def _may_come(message: str) -> bool:
    """Whether a code may be found after an error; remove the file of a process that is gone."""
    begun = WAITED.search(message)
    if begun is None:
        return False
    file = Path(begun[1])
    if file.exists() and abs(time.time() - file.stat().st_mtime) > LONGEST:
        file.unlink(missing_ok=True)
    return True
