"""Parts of the estimates on meshes with fewer cells than ranks."""

import numpy as np
import pytest
from dolfinx import fem, mesh

from dolfinx_signorini.accuracy.derivatives import highest_derivatives


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_highest_derivatives_of_two_cells(comm, degree):
    domain = mesh.create_unit_square(comm, 1, 1)
    f = fem.Function(fem.functionspace(domain, ("Lagrange", degree)))
    f.interpolate(lambda x: x[0] ** degree)
    found = np.concatenate(comm.allgather(highest_derivatives(f, degree)))
    assert found == pytest.approx(np.full(2, [1.0, 2.0, 6.0][degree - 1]))
