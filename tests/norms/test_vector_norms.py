"""Norms of vectors and of quantities such as the stress: known values, and what does not matter."""

import math

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from hypothesis import given
from hypothesis import strategies as st
from mpi4py import MPI

from dolfinx_signorini import (
    InputError,
    Reference,
    elasticity,
    error_norms,
    interpolated,
    stress,
    weighted_strain,
)
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.norms.references import carried, discrete

COMM = MPI.COMM_WORLD
VOLUME = ("L1", "L2", "L4", "Linf", "H1", "W1_4", "W1_inf")
BOUNDARY = ("L2_boundary", "Linf_boundary", "H1_boundary", "H1_2_boundary_spectral")


def field(values, degree=2, n=5, dim=2):
    """A vector function on the unit square or cube."""
    domain = friedrichs_keller(COMM, n) if dim == 2 else mesh.create_unit_cube(COMM, n, n, n)
    function = fem.Function(fem.functionspace(domain, ("Lagrange", degree, (dim,))))
    function.interpolate(values)
    return function


def waves(x):
    return np.stack([np.sin(3.0 * x[0] + x[1]), np.cos(2.0 * x[1]) * x[0]])


def test_known_values():
    """u = (3 x, 4 x): |u| = 5 x, and the derivative along x has the length 5."""
    norms = error_norms(field(lambda x: np.stack([3.0 * x[0], 4.0 * x[0]])), None, VOLUME)
    powers = {p: 5.0**p / (p + 1.0) for p in (1.0, 2.0, 4.0)}
    for p in powers:
        assert norms[f"L{p:.0f}"] == pytest.approx(powers[p] ** (1.0 / p), rel=1e-12)
    assert norms["H1"] == pytest.approx(math.sqrt(powers[2.0] + 25.0), rel=1e-12)
    assert norms["W1_4"] == pytest.approx((powers[4.0] + 5.0**4) ** 0.25, rel=1e-12)
    assert norms["Linf"] == pytest.approx(5.0, rel=1e-14)
    assert norms["W1_inf"] == pytest.approx(5.0, rel=1e-12)


def test_in_space_and_on_the_boundary():
    """u = (x, 2 y, 2 z) on the cube, and a field with a tangential derivative on the square."""
    norms = error_norms(
        field(lambda x: np.stack([x[0], 2 * x[1], 2 * x[2]]), 1, 2, 3), None, VOLUME
    )
    assert norms["L2"] == pytest.approx(math.sqrt(3.0), rel=1e-12)
    assert norms["H1"] == pytest.approx(math.sqrt(12.0), rel=1e-12)
    assert norms["Linf"] == pytest.approx(3.0, rel=1e-14)
    turning = field(lambda x: np.stack([x[1], -x[0]]))
    norms = error_norms(turning, None, BOUNDARY)
    # |u|^2 = x^2 + y^2 on four sides, and |du/ds| = 1 on each of them.
    assert norms["L2_boundary"] == pytest.approx(math.sqrt(4 * 1 / 3 + 2.0), rel=1e-12)
    assert norms["H1_boundary"] == pytest.approx(math.sqrt(4 / 3 + 2.0 + 4.0), rel=1e-12)
    assert norms["Linf_boundary"] == pytest.approx(math.sqrt(2.0), rel=1e-13)


@pytest.mark.parametrize("name", [*VOLUME, *BOUNDARY])
def test_one_component_is_a_scalar(name):
    vector = field(lambda x: np.stack([0.0 * x[0], np.sin(4.0 * x[0] * x[1])]))
    scalar = fem.Function(fem.functionspace(vector.function_space.mesh, ("Lagrange", 2)))
    scalar.interpolate(lambda x: np.sin(4.0 * x[0] * x[1]))
    have, want = (error_norms(f, None, [name])[name] for f in (vector, scalar))
    assert have == pytest.approx(want, rel=1e-12)


@given(st.floats(0.0, 6.3))
def test_axes_do_not_matter(angle):
    """Turned components change no norm."""
    c, s = math.cos(angle), math.sin(angle)
    one = field(waves)
    other = field(lambda x: np.array([[c, -s], [s, c]]) @ waves(x))
    have, want = (error_norms(f, None, (*VOLUME, *BOUNDARY)) for f in (one, other))
    for name in (*VOLUME, *BOUNDARY):
        assert have[name] == pytest.approx(want[name], rel=1e-6), name


def test_references():
    """A closed form, its interpolant, a discrete function, and one on another mesh."""
    u_h = field(lambda x: 0.0 * x[:2], degree=1, n=4)
    domain = u_h.function_space.mesh
    x = ufl.SpatialCoordinate(domain)
    exact = ufl.as_vector([x[0] ** 2, x[0] * x[1]])
    slopes = (ufl.as_vector([2 * x[0], x[1]]), ufl.as_vector([0 * x[0], x[0]]))
    closed = Reference(domain, exact, slopes)
    fine = field(lambda x: np.stack([x[0] ** 2, x[0] * x[1]]), n=7)
    same = fem.Function(fem.functionspace(domain, ("Lagrange", 2, (2,))))
    same.interpolate(lambda x: np.stack([x[0] ** 2, x[0] * x[1]]))
    # The squares: x^4 + x^2 y^2, and with derivatives 4 x^2 + y^2 + x^2.
    want = {"L2": math.sqrt(1 / 5 + 1 / 9), "H1": math.sqrt(1 / 5 + 1 / 9 + 2.0)}
    for reference in (closed, interpolated(closed, 2), discrete(same), carried(fine, domain)):
        have = error_norms(u_h, reference, list(want))
        assert have == pytest.approx(want, rel=1e-10)
        q = error_norms(u_h, reference, ["L2"], of=ufl.grad)["L2"]
        assert q == pytest.approx(math.sqrt(2.0), rel=1e-10)
    with pytest.raises(InputError, match="shape"):
        Reference(domain, exact, (x[0], x[1]))
    with pytest.raises(InputError, match="shape"):
        error_norms(u_h, Reference(domain, x[0], (x[0], x[1])), ["L2"])


@pytest.mark.parametrize("plane", ["strain", "stress"])
@pytest.mark.parametrize("dim", [2, 3])
def test_the_weighted_strain_has_the_energy(dim, plane):
    def values(x):
        return np.stack([np.sin(x[k] + 2.0 * x[k - 1]) for k in range(dim)])

    u = field(values, 2, 3, dim)
    energy = fem.assemble_scalar(fem.form(elasticity(u, u, 70.0, 0.3, plane)))
    energy = COMM.allreduce(energy)
    found = error_norms(u, None, ["L2"], of=lambda u: weighted_strain(u, 70.0, 0.3, plane))["L2"]
    assert found == pytest.approx(math.sqrt(energy), rel=1e-9)


def test_stress_of_a_stretched_body():
    """Uniaxial stress E e in the plane, with the free width: the other stresses vanish."""
    E, nu, e = 200.0, 0.3, 1e-3
    u = field(lambda x: np.stack([e * x[0], -nu * e * x[1]]), degree=1)
    norms = error_norms(
        u, None, ["L2", "Linf", "L1_boundary"], of=lambda u: stress(u, E, nu, "stress")
    )
    assert norms["L2"] == pytest.approx(E * e, rel=1e-12)
    assert norms["Linf"] == pytest.approx(E * e, rel=1e-12)
    assert norms["L1_boundary"] == pytest.approx(4.0 * E * e, rel=1e-12)
    with pytest.raises(InputError, match="quantity"):
        error_norms(u, None, ["H1"], of=lambda u: stress(u, E, nu))


def test_a_scalar_has_quantities_too():
    u = fem.Function(fem.functionspace(friedrichs_keller(COMM, 4), ("Lagrange", 1)))
    u.interpolate(lambda x: 3.0 * x[0] + 4.0 * x[1])
    assert error_norms(u, None, ["L4"], of=ufl.grad)["L4"] == pytest.approx(5.0, rel=1e-12)
