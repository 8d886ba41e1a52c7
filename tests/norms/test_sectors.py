"""Exponents of singular solutions at corners, against equations that are known in closed form."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from dolfinx_signorini.norms.sectors import sector_exponent

pytestmark = pytest.mark.pure

LAPLACIAN = np.eye(2).reshape(1, 2, 1, 2)
FREE, HELD = np.zeros((1, 0)), np.eye(1)
FREE_BODY, CLAMPED = np.zeros((2, 0)), np.eye(2)


def exponent(angle, first, last, tensor=LAPLACIAN, start=0.3):
    return sector_exponent([start, start + angle], tensor[None], (first, last))


def stiffness(poisson):
    """The stiffness of a body in plane strain with the modulus of elasticity 1."""
    first, second = poisson / (1 + poisson) / (1 - 2 * poisson), 0.5 / (1 + poisson)
    one = np.eye(2)
    return first * np.einsum("ia,jb->iajb", one, one) + second * (
        np.einsum("ij,ab->iajb", one, one) + np.einsum("ib,aj->iajb", one, one)
    )


def least_root(function):
    """The least root between 0 and 1 of a function that changes its sign there."""
    places = np.linspace(1e-3, 1.0 - 1e-3, 2000)
    values = function(places)
    k = np.flatnonzero(values[:-1] * values[1:] <= 0.0)[0]
    return brentq(function, places[k], places[k + 1], xtol=1e-14)


@pytest.mark.parametrize(
    ("degrees", "changes", "expected"),
    [
        (270.0, False, 2 / 3),
        (270.0, True, 1 / 3),
        (180.0, False, math.inf),  # integers belong to polynomials
        (180.0, True, 1 / 2),
        (135.0, False, 4 / 3),
        (90.0, False, math.inf),
        (45.0, True, math.inf),
        (200.0, False, 0.9),
        (360.0, False, 1 / 2),
    ],
)
def test_exponents_of_the_laplacian_follow_from_the_angle(degrees, changes, expected):
    angle = math.radians(degrees)
    for side in (FREE, HELD):
        other = (HELD if side is FREE else FREE) if changes else side
        assert exponent(angle, side, other) == pytest.approx(expected, rel=1e-8)


@given(st.floats(0.3, 6.2), st.floats(-3.0, 3.0), st.floats(0.2, 5.0), st.floats(-2.0, 2.0))
def test_a_diffusion_tensor_maps_the_corner(angle, start, factor, shear):
    """With K = S S^T the equation is that of the Laplacian on the domain S^{-1} x."""
    root = np.array([[factor, shear], [0.0, 1.0]])
    tensor = (root @ root.T).reshape(1, 2, 1, 2)
    ends = np.linalg.solve(root, [np.cos([start, start + angle]), np.sin([start, start + angle])])
    first, last = np.arctan2(ends[1], ends[0])
    mapped = np.mod(last - first, 2.0 * math.pi)
    wanted = math.pi / (2.0 * mapped)
    found = exponent(angle, HELD, FREE, tensor, start)
    if abs(wanted - 1.0) > 0.01 and wanted < 3.0:
        assert found == pytest.approx(wanted, rel=1e-4)


@pytest.mark.parametrize(
    ("ratio", "wanted"), [(5.8284271247461900, 0.5), (25.27414236908818, 0.25)]
)
def test_coefficients_that_jump_in_a_chequered_pattern(ratio, wanted):
    """Kellogg's example: Applicable Analysis 4 (1974) 101-129."""
    tensors = np.array([ratio, 1.0, ratio, 1.0])[:, None, None, None, None] * LAPLACIAN
    directions = 0.7 + np.arange(5) * math.pi / 2
    assert sector_exponent(directions, tensors, None) == pytest.approx(wanted, abs=1e-7)
    assert sector_exponent(directions, 1e-200 * tensors, None) == pytest.approx(wanted, abs=1e-7)


@given(st.floats(1.5, 100.0))
def test_a_jump_that_meets_the_boundary(ratio):
    """sin(a t) below the jump and c sin(a (w - t)) above, with continuous values and fluxes."""
    tensors = np.array([ratio, 1.0])[:, None, None, None, None] * LAPLACIAN
    below, above = math.pi / 2, math.pi / 4
    a = sector_exponent([0.0, below, below + above], tensors, (HELD, HELD))
    flux = ratio * math.cos(a * below) * math.sin(a * above)
    assert flux == pytest.approx(-math.sin(a * below) * math.cos(a * above), abs=1e-6)


def test_a_straight_jump_is_no_singularity():
    tensors = np.array([7.0, 1.0])[:, None, None, None, None] * LAPLACIAN
    assert sector_exponent([0.1, 0.1 + math.pi, 0.1 + 2 * math.pi], tensors, None) == math.inf
    half = [0.1, 0.1 + math.pi / 2, 0.1 + math.pi]
    assert sector_exponent(half, tensors, (FREE, FREE)) == math.inf
    assert sector_exponent([0.0, math.pi], tensors[:1] * np.nan, (FREE, FREE)) == math.inf


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.45])
@pytest.mark.parametrize("degrees", [240.0, 270.0, 300.0, 359.0])
def test_free_and_clamped_corners_of_a_body(degrees, poisson):
    """Williams, Journal of Applied Mechanics 19 (1952) 526-528."""
    angle, kappa = math.radians(degrees), 3.0 - 4.0 * poisson
    body = stiffness(poisson)

    def free(a):
        return np.sin(a * angle) ** 2 - (a * math.sin(angle)) ** 2

    def clamped(a):
        return (kappa * np.sin(a * angle)) ** 2 - (a * math.sin(angle)) ** 2

    found = exponent(angle, FREE_BODY, FREE_BODY, body)
    assert found == pytest.approx(least_root(free), rel=1e-6)
    found = exponent(angle, CLAMPED, CLAMPED, body)
    assert found == pytest.approx(least_root(clamped), rel=1e-6)


@pytest.mark.parametrize("poisson", [0.2, 0.3, 0.45])
def test_a_clamped_side_beside_a_free_one(poisson):
    """The same source, at a right angle."""
    kappa, angle = 3.0 - 4.0 * poisson, math.pi / 2

    def mixed(a):
        right = (kappa + 1.0) ** 2 / (4.0 * kappa) - (a * math.sin(angle)) ** 2 / kappa
        return np.sin(a * angle) ** 2 - right

    found = exponent(angle, CLAMPED, FREE_BODY, stiffness(poisson))
    assert found == pytest.approx(least_root(mixed), rel=1e-6)


def test_a_crack_opens_with_the_root_of_the_distance():
    body = stiffness(0.3)
    assert exponent(2.0 * math.pi, FREE_BODY, FREE_BODY, body) == pytest.approx(0.5, rel=1e-7)
    # Symmetry: the half plane ahead of the crack may slide, and does not move along its normal.
    sliding = np.array([[0.0], [1.0]])
    half = exponent(math.pi, sliding, FREE_BODY, body, start=0.0)
    assert half == pytest.approx(0.5, rel=1e-7)
