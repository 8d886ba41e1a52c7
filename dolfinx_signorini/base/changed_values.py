"""Changes of the values of data, or of the nodes of a mesh, since the last comparison."""

import hashlib

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from mpi4py import MPI
from ufl.algorithms.analysis import extract_coefficients, extract_constants
from ufl.core.expr import Expr

from dolfinx_signorini.base.ranks import anywhere


class Watch:
    """Notices changed values of the Constants and Functions in forms, and meshes that move.

    For example:

        watch = Watch(L)
        speed.value = 2.0
        watch.changed(comm)  # True, and False when asked again

    Args:
        terms: Forms, expressions and meshes.
    """

    def __init__(self, *terms: ufl.Form | Expr | Mesh):
        self._data = [item for each in terms for item in _data_in(each)]
        self._digest = self._present()

    def changed(self, comm: MPI.Comm) -> bool:
        """Return whether a value has changed on some rank since the last call; collective."""
        if not self._data:
            return False
        before, self._digest = self._digest, self._present()
        return anywhere(comm, before != self._digest)

    def differs(self) -> bool:
        """Return whether a value of this rank is none of the start or of the last `changed`."""
        return self._present() != self._digest

    def _present(self) -> bytes:
        """A digest of the values that this rank has now."""
        digest = hashlib.sha256()  # processors have instructions for it
        for item in self._data:
            if isinstance(item, Mesh):
                values = item.geometry.x
            else:
                values = item.x.array if isinstance(item, fem.Function) else item.value
            digest.update(np.ascontiguousarray(values).view(np.uint8).data)
        return digest.digest()


def _data_in(terms: ufl.Form | Expr | Mesh) -> list[fem.Constant | fem.Function | Mesh]:
    """The mesh itself, or the Constants and Functions in a form or an expression."""
    if isinstance(terms, Mesh):
        return [terms]
    if isinstance(terms, ufl.Form):
        return [*terms.constants(), *terms.coefficients()]
    return [*extract_constants(terms), *extract_coefficients(terms)]
