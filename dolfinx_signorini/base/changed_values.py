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
    """Notices changed values of the Constants and Functions in a form or an expression.

    For example:

        watch = Watch(L)
        speed.value = 2.0
        watch.changed(comm)  # True, and False when asked again

    Args:
        terms: The form or the expression; None for nothing.
    """

    def __init__(self, terms: ufl.Form | Expr | None):
        self._data: list[fem.Constant | fem.Function] = []
        if terms is not None:
            self._data = [*extract_constants(terms), *extract_coefficients(terms)]
        self._digest = self._present()

    def changed(self, comm: MPI.Comm, remember: bool = True) -> bool:
        """Return whether a value has changed on some rank; collective.

        Args:
            comm: The communicator.
            remember: Whether the values are compared with those of this call the next time.
        """
        if not self._data:
            return False
        digest = self._present()
        changed = digest != self._digest
        if remember:
            self._digest = digest
        return anywhere(comm, changed)

    def _present(self) -> bytes:
        """A digest of the values that the data have on this rank."""
        digest = hashlib.sha256()  # processors have instructions for it
        for item in self._data:
            values = item.x.array if isinstance(item, fem.Function) else item.value
            digest.update(np.ascontiguousarray(values).view(np.uint8).data)
        return digest.digest()
