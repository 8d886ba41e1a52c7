"""PETSc options for one object at a time."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from petsc4py import PETSc


@contextmanager
def options_set(prefix: str, options: Mapping[str, Any]) -> Iterator[None]:
    """Put options into PETSc's database while an object reads them with `setFromOptions`.

    An option that a user has set under the same prefix, on the command line for example, wins, and
    the database is afterwards as it was before.

    Args:
        prefix: The prefix of the object, "" or with an underscore at its end.
        options: Values by the names of the options, without the prefix; None for a flag.
    """
    database = PETSc.Options()
    added = [key for key in options if not database.hasName(prefix + key)]
    for key in added:
        database[prefix + key] = options[key]
    try:
        yield
    finally:
        for key in added:
            database.delValue(prefix + key)
