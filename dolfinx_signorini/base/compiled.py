"""Forms and expressions whose compiled code is looked up once in a process.

DOLFINx looks up the code of each new form in a folder that holds all code compiled so far: the
folder is listed, and the code loaded, again each time. On a mesh of some thousand cells this takes
longer than everything else. Forms with the same signature have the same code, whatever their mesh.

A process that is killed while it compiles leaves a file in the folder which makes DOLFINx wait for
code that never comes. The file is removed when it is old.
"""

import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import ffcx.naming
import ufl
from dolfinx import fem, jit
from mpi4py import MPI
from ufl.algorithms.check_arities import ArityMismatch
from ufl.algorithms.compute_form_data import compute_form_data
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.errors import InputError

_codes: dict[tuple[str, str], Any] = {}  # by signature and options

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
    with _remembered(subject):
        return fem.form(item, **options)


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
        return fem.Expression(item, points, comm=comm)


def check_linear(item: ufl.Form, subject: str) -> None:
    """Refuse a form that is not linear in its arguments: DOLFINx lets other ranks wait for ever.

    Args:
        item: The form.
        subject: What the form is called in messages.

    Raises:
        InputError: The form is not linear in each of its arguments.
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


@contextmanager
def _remembered(subject: str = "") -> Iterator[None]:
    """Let DOLFINx find the codes that this module has seen.

    Args:
        subject: What a form that users gave is called in messages.
    """
    look_up = jit.ffcx_jit

    def remember(comm: MPI.Comm, item: Any, **options: Any) -> Any:
        def found() -> Any:
            if subject:
                check_linear(item, subject)
            return look_up(comm, item, **options)

        return _once(comm, (_signature(item), repr(options)), found)

    jit.ffcx_jit = remember
    try:
        yield
    finally:
        jit.ffcx_jit = look_up


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


def _signature(item: Any) -> str:
    return str(
        item.signature()
        if isinstance(item, ufl.Form)
        else ffcx.naming.compute_signature([item], "")
    )
