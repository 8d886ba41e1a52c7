"""Changes of the values of the data in a form or an expression since the last comparison."""

import hashlib

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.algorithms.analysis import extract_coefficients, extract_constants
from ufl.core.expr import Expr

from dolfinx_signorini.base.ranks import anywhere


class Watch:
    """Notices changed values of the Constants and Functions in a form.

    For example:

        watch = Watch(L)
        speed.value = 2.0
        watch.changed(comm)  # True, and False when asked again

    Args:
        form: The form.
    """

    def __init__(self, form: ufl.Form):
        self._data = data_in(form)
        self._digest = digest_of(self._data)

    def changed(self, comm: MPI.Comm) -> bool:
        """Return whether a value has changed on some rank since the last call; collective."""
        if not self._data:
            return False
        digest = digest_of(self._data)
        changed = digest != self._digest
        self._digest = digest
        return anywhere(comm, changed)


def data_in(terms: ufl.Form | Expr) -> list[fem.Constant | fem.Function]:
    """Return the Constants and Functions in a form or an expression."""
    if isinstance(terms, ufl.Form):
        return [*terms.constants(), *terms.coefficients()]
    return [*extract_constants(terms), *extract_coefficients(terms)]


def digest_of(data: list[fem.Constant | fem.Function]) -> bytes:
    """Return a digest of the values that Constants and Functions have on this rank."""
    digest = hashlib.sha256()  # processors have instructions for it
    for item in data:
        values = item.x.array if isinstance(item, fem.Function) else item.value
        digest.update(np.ascontiguousarray(values).view(np.uint8).data)
    return digest.digest()
