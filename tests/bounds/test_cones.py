"""Energies of extensions from facets, against sums over many points of triangles."""

import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI

from dolfinx_signorini.bounds.cones import Cones
from dolfinx_signorini.bounds.frames import cell_frames
from dolfinx_signorini.meshes.polynomials import polynomials

DEGREE = 7


def by_points(frames, facet, series, positive, k, A, c):
    """The energy norm of the extension of degree k, with differences in place of derivatives."""
    middles = (np.arange(150) + 0.5) / 150
    s, t = (grid.ravel() for grid in np.meshgrid(np.sqrt(middles), middles))
    first, second = (j for j in range(3) if j != facet)
    corners = frames.corners[0]
    x = (1 - s)[:, None] * corners[facet] + (s * (1 - t))[:, None] * corners[first]
    x += (s * t)[:, None] * corners[second]
    inverse = np.linalg.inv(np.vstack((corners.T, np.ones(3))))

    def value(x):
        b = np.column_stack((x, np.ones(len(x)))) @ inverse.T
        height = b[:, first] + b[:, second]
        w = series @ polynomials(1, DEGREE, (b[:, second] / height)[:, None])
        return height**k * (np.maximum(w, 0.0) if positive else w)

    h = 1e-6
    slopes = [(value(x + e) - value(x - e)) / (2 * h) for e in h * np.eye(2)]
    gradient = np.column_stack(slopes)
    energy = np.einsum("qa,ab,qb->q", gradient, A, gradient) + c * value(x) ** 2
    return np.sqrt(energy.mean() * frames.volumes[0])


@pytest.mark.parametrize("positive", [False, True])
@pytest.mark.parametrize("facet", [0, 1, 2])
def test_energies_of_extensions(facet, positive):
    frames = cell_frames(mesh.create_unit_square(MPI.COMM_SELF, 1, 1))
    lattice = np.linspace(0.0, 1.0, DEGREE + 1)[:, None]
    t = lattice[:, 0]
    values = t * (1 - t) * (t - 0.43) * (1 + t)
    series = np.linalg.solve(polynomials(1, DEGREE, lattice).T, values)
    A, c = np.array([[2.0, 0.5], [0.5, 1.0]]), 30.0
    one = np.array([0])
    cones = Cones(
        frames, one, np.array([facet]), series[None], np.zeros((3, 1)), np.array([positive]), 1e-14
    )
    found = cones.norms(np.stack([A, A]), np.array([c, c]), np.zeros(2))
    ways = [by_points(frames, facet, series, positive, k, A, c) for k in np.arange(1.0, 9.0)]
    assert found[1] == 0.0
    assert 0.99 * min(ways) <= found[0] <= 1.1 * min(ways)
    exact = by_points(frames, facet, series, positive, 1.0, A, c)
    assert found[0] < exact


def test_what_is_missed_is_in_the_energy():
    frames = cell_frames(mesh.create_unit_square(MPI.COMM_SELF, 1, 1))
    lattice = np.linspace(0.0, 1.0, DEGREE + 1)[:, None]
    series = np.linalg.solve(polynomials(1, DEGREE, lattice).T, np.sin(np.pi * lattice[:, 0]))
    root = np.pi * np.sqrt(0.5)
    missed = np.array([[1.0], [np.pi], [root]])
    one, signed = np.array([0]), np.array([False])
    unknown = Cones(frames, one, one, 0.0 * series[None], missed, signed, 1e-14)
    known = Cones(frames, one, one, series[None], np.zeros((3, 1)), signed, 1e-14)
    A, c, none = np.stack([np.eye(2)] * 2), np.ones(2), np.zeros(2)
    low, high = (cones.norms(A, c, none)[0] for cones in (known, unknown))
    assert low <= high < 5.0 * low


@pytest.mark.parametrize("facet", [0, 1, 2])
def test_where_the_diffusion_may_be_larger(facet):
    frames = cell_frames(mesh.create_unit_square(MPI.COMM_SELF, 1, 1))
    lattice = np.linspace(0.0, 1.0, DEGREE + 1)[:, None]
    t = lattice[:, 0]
    series = np.linalg.solve(polynomials(1, DEGREE, lattice).T, t * (1 - t) * (t - 0.43))
    one, no = np.array([0]), np.array([False])
    cones = Cones(frames, one, np.array([facet]), series[None], np.zeros((3, 1)), no, 1e-14)
    A, c, strip = np.stack([1e-30 * np.eye(2)] * 2), np.zeros(2), np.array([50.0, 0.0])
    found = cones.norms(A, c, strip)
    everywhere = by_points(frames, facet, series, False, 1.0, 50.0 * np.eye(2), 0.0)
    assert everywhere <= found[0] <= 10.0 * everywhere and found[1] == 0.0
