"""Changes of the values of the data in a form since the last comparison."""

import hashlib

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

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
        self._data = [*form.constants(), *form.coefficients()]
        self._digest = self._read()

    def changed(self, comm: MPI.Comm) -> bool:
        """Return whether a value has changed on some rank since the last call; collective."""
        if not self._data:
            return False
        digest = self._read()
        changed = digest != self._digest
        self._digest = digest
        return anywhere(comm, changed)

    def _read(self) -> bytes:
        digest = hashlib.sha256()  # processors have instructions for it
        for item in self._data:
            values = item.x.array if isinstance(item, fem.Function) else item.value
            digest.update(np.ascontiguousarray(values).view(np.uint8).data)
        return digest.digest()
