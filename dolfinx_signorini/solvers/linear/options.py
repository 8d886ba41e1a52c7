"""PETSc options for one object at a time."""

import ctypes
import difflib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from petsc4py import PETSc

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.logs import log


@contextmanager
def options_set(
    prefix: str, options: Mapping[str, Any], defaults: Mapping[str, Any] | None = None
) -> Iterator[set[str]]:
    """Put options into PETSc's database while an object reads them.

    An object reads its options with `setFromOptions`, and those of its parts, such as the levels of
    a multigrid preconditioner, in its set-up.

    An option that a user has set under the same prefix, on the command line for example, wins, and
    the database is afterwards as it was before.

    Args:
        prefix: The prefix of the object, "" or with an underscore at its end.
        options: Values by the names of the options, without the prefix; None for a flag.
        defaults: Further options.

    Returns:
        A set that has, behind the context, the names of those `options` that were not read.

    Raises:
        InputError: The object does not take the value of an option.
    """
    database = PETSc.Options()
    together = dict(defaults or {}) | dict(options)
    added = [key for key in together if not database.hasName(prefix + key)]
    for key in added:
        database[prefix + key] = together[key]
    unread: set[str] = set()
    try:
        yield unread
        unread.update(k for k in added if k in options and not _read(prefix + k))
    except PETSc.Error as error:
        names = ", ".join(options)
        if not names:
            raise
        message = f"PETSc does not take a value (its error {error.ierr}) of {names}"
        raise InputError(message, "petsc_options") from None
    finally:
        for key in added:
            database.delValue(prefix + key)


def warn_of_unread(
    unread: Collection[str], known: Collection[str], others: tuple[str, ...]
) -> None:
    """Warn of options that no object has read by the end of the first set-up.

    Args:
        unread: The names of the options.
        known: Names that may have been meant.
        others: Beginnings of the names of options that another object reads.
    """
    for key in sorted(unread):
        if not key.startswith(others):
            near = difflib.get_close_matches(key, set(known) - {key}, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            log.warning("petsc_options: %r is no option that the solver reads%s", key, hint)


def _read(name: str) -> bool:
    """Return whether an object has asked PETSc's database for an option; petsc4py cannot tell."""
    used = ctypes.c_int(0)
    petsc = ctypes.CDLL(PETSc.__file__)
    petsc.PetscOptionsUsed(None, name.encode(), ctypes.byref(used))
    return bool(used.value)
