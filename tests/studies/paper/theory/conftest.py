"""What the tests of the theory share: discretisations, solved once."""

import functools

import pytest
from mpi4py import MPI

from dolfinx_signorini.studies.paper.theory.examples import (
    paper_example,
    rough_example,
    smooth_example,
)
from dolfinx_signorini.studies.paper.theory.families import discretise


@functools.cache
def solved(name, n):
    """A scene on n x n squares; it lives as long as the tests do."""
    scenes = {"paper": paper_example, "smooth": smooth_example}
    scene = scenes[name]() if name in scenes else rough_example(float(name))
    return discretise(MPI.COMM_WORLD, scene, n)


@pytest.fixture
def discretisation():
    """The function (scene, cells per side) -> Discretisation; an exponent names a rough scene."""
    return solved
