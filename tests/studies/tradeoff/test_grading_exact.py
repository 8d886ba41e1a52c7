"""Gradings towards points that are known with an uncertainty, and towards two points."""

import numpy as np
import pytest
from mpi4py import MPI

from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import SidedMesh
from dolfinx_signorini.problem.detachment import DetachmentPoint
from dolfinx_signorini.studies.tradeoff.grading import RADIUS, RESOLUTION, TOLERANCE, graded_mesh

COMM = MPI.COMM_WORLD
WIDTH = 1.0 / 40


def graded(n, *arguments):
    """Midpoints and sizes of all cells of n squares a side, graded: the root of twice the area."""
    domain = graded_mesh(SidedMesh(friedrichs_keller(COMM, n), {}), *arguments).mesh
    x = domain.geometry.x[domain.geometry.dofmap[: domain.topology.index_map(2).size_local], :2]
    (a, b), (c, d) = (x[:, 1] - x[:, 0]).T, (x[:, 2] - x[:, 0]).T
    parts = COMM.allgather((x.mean(axis=1), np.sqrt(np.abs(a * d - b * c))))
    return (np.concatenate(part) for part in zip(*parts, strict=True))


def grading(distance, exponent, radius=RADIUS):
    """h (r / R)^{1 - mu}, and R (h / R)^{1/mu} next to the point."""
    sizes = WIDTH * np.minimum(distance / radius, 1.0) ** (1.0 - exponent)
    return np.maximum(sizes, radius * (WIDTH / radius) ** (1.0 / exponent))


@pytest.mark.parametrize("exponent", [0.5, 0.25])
@pytest.mark.parametrize("uncertainty", [0.02, 0.05])
def test_wherever_an_uncertain_point_really_is_the_cells_are_small_enough(exponent, uncertainty):
    point = DetachmentPoint((0.5, 0.0), uncertainty, 1.0)
    middles, sizes = graded(40, [point], WIDTH, exponent)
    for angle in np.linspace(0.0, 2.0 * np.pi, 17):
        place = np.add(point.position, uncertainty * np.array([np.cos(angle), np.sin(angle)]))
        distance = np.linalg.norm(middles - place, axis=1)
        wanted = np.maximum(grading(distance, exponent), RESOLUTION * uncertainty)
        assert (sizes <= TOLERANCE * wanted * (1.0 + 1e-9)).all()


@pytest.mark.parametrize("uncertainty", [0.005, 0.02])
def test_no_cells_are_spent_on_what_the_uncertainty_hides(uncertainty):
    # The cells next to a point known exactly are 100 times smaller.
    assert grading(0.0, 0.25) < 0.2 * RESOLUTION * uncertainty
    point = DetachmentPoint((0.5, 0.0), uncertainty, 1.0)
    _, sizes = graded(40, [point], WIDTH, 0.25)
    # Bisection may overshoot by a factor of two, and the closure by the same.
    assert sizes.min() >= 0.25 * RESOLUTION * uncertainty


def test_two_points_share_the_way_between_them():
    # Each has a radius of half their distance: between the two balls nothing is refined.
    places = (0.4, 0.0), (0.6, 0.0)
    points = [DetachmentPoint(place, 1e-9, 1.0) for place in places]
    middles, sizes = graded(40, points, WIDTH, 0.5)
    distance = np.min([np.linalg.norm(middles - place, axis=1) for place in places], axis=0)
    wanted = grading(distance, 0.5, radius=0.1)
    assert (sizes <= TOLERANCE * wanted * (1.0 + 1e-9)).all()
    outside = distance > 0.12
    assert sizes[outside] == pytest.approx(WIDTH, rel=1e-9)


def test_points_close_to_each_other_do_not_refine_further_than_half_way():
    # With mu = 1/2 cells are cut where 1.5 (r / R)^{1/2} < 1: up to 0.44 R, and the cells next to
    # these. R is half the distance of the points, 0.05; the whole distance would reach 0.044.
    places, width = [(0.45, 0.0), (0.55, 0.0)], 1.0 / 160
    points = [DetachmentPoint(place, 1e-9, 1.0) for place in places]
    middles, sizes = graded(160, points, width, 0.5)
    distance = np.min([np.linalg.norm(middles - place, axis=1) for place in places], axis=0)
    assert sizes[distance > 0.033] == pytest.approx(width, rel=1e-9)
    assert sizes[distance < 0.02].max() < 0.8 * width
