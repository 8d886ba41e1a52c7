"""Sampling of data: nothing that matters is between the samples, and looks are few."""

import numpy as np
import pytest

from dolfinx_signorini.data import parsing, sampling
from dolfinx_signorini.data.sampling import Datum, sample

CORNERS = np.array([[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], [[0.0, 0.0], [0.0, 1.0], [1.0, 1.0]]])


@pytest.mark.parametrize(
    ("text", "norm", "rounds"),
    [
        ("hypot(x - 0.4, y - 0.3)^-0.5", None, 16),
        ("exp(-((x - 0.41)^2 + (y - 0.37)^2)/1e-6)", np.pi * 1e-6, 30),
        ("where((x - 0.4)^2 + (y - 0.5)^2 < 0.01, 1, 0)", 0.01 * np.pi, 30),
    ],
)
def test_samples_have_the_integral_and_take_few_looks(text, norm, rounds, comm, monkeypatch):
    looks, enclosed = [], sampling.enclosed_on_boxes
    monkeypatch.setattr(
        sampling, "enclosed_on_boxes", lambda *args: looks.append(1) or enclosed(*args)
    )
    corners = CORNERS if comm.rank == 0 else CORNERS[:0]
    datum = Datum("the load", parsing.parse(text), "mass", 4, corners, np.arange(len(corners)))
    found = sample(datum, comm, 1.0)
    if norm is not None:
        assert found.norm == pytest.approx(norm, rel=0.05)
    assert comm.allreduce(float(found.weights.sum())) == pytest.approx(1.0, rel=1e-6)
    assert found.hidden == 0.0
    assert len(looks) <= rounds
