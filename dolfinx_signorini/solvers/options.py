"""PETSc options for one object at a time."""

import ctypes
import difflib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from petsc4py import PETSc

from dolfinx_signorini.errors import InputError


@contextmanager
def options_set(
    prefix: str,
    options: Mapping[str, Any],
    defaults: Mapping[str, Any] | None = None,
    others: tuple[str, ...] = (),
) -> Iterator[None]:
    """Put options into PETSc's database while an object reads them with `setFromOptions`.

    An option that a user has set under the same prefix, on the command line for example, wins, and
    the database is afterwards as it was before.

    Args:
        prefix: The prefix of the object, "" or with an underscore at its end.
        options: Values by the names of the options, without the prefix; None for a flag.
        defaults: Further options, which the object need not read.
        others: Beginnings of the names of those `options` that another object reads.

    Raises:
        InputError: The object does not read one of the options, or does not take its value.
    """
    database = PETSc.Options()
    together = dict(defaults or {}) | dict(options)
    added = [key for key in together if not database.hasName(prefix + key)]
    for key in added:
        database[prefix + key] = together[key]
    try:
        yield
        unread = [k for k in added if k in options and not _read(prefix + k)]
    except PETSc.Error as error:
        names = ", ".join(options)
        if not names:
            raise
        message = f"PETSc does not take a value (its error {error.ierr}) of {names}"
        raise InputError(message, "petsc_options") from None
    finally:
        for key in added:
            database.delValue(prefix + key)
    for key in unread:
        if not key.startswith(others):
            near = difflib.get_close_matches(key, together.keys() - {key}, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            message = f"{key!r} is no option that the solver reads{hint}"
            raise InputError(message, "petsc_options")


def _read(name: str) -> bool:
    """Return whether an object has asked PETSc's database for an option; petsc4py cannot tell."""
    used = ctypes.c_int(0)
    petsc = ctypes.CDLL(PETSc.__file__)
    petsc.PetscOptionsUsed(None, name.encode(), ctypes.byref(used))
    return bool(used.value)
