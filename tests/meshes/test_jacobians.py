"""Determinants and inverses of many small matrices, against LAPACK."""

import numpy as np
import pytest

from dolfinx_signorini.meshes.jacobians import determinants, inverses

pytestmark = pytest.mark.pure


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("size", [1e-9, 1.0, 1e6])
def test_small_matrices_have_their_determinants_and_inverses(dimension, size):
    rng = np.random.default_rng(3)
    matrices = size * (rng.normal(size=(50, dimension, dimension)) + 3.0 * np.eye(dimension))
    assert determinants(matrices) == pytest.approx(np.linalg.det(matrices), rel=1e-9)
    assert inverses(matrices) == pytest.approx(np.linalg.inv(matrices), rel=1e-9, abs=1e-9 / size)
    assert inverses(matrices[:0]).shape == (0, dimension, dimension)
