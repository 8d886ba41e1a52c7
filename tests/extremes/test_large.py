"""Extremes on thousands of unknowns, where multigrid levels are at work, against sparse LU."""

import ctypes
import re

import numpy as np
import pytest
from large import Large, checkerboard, digits_against, humps, owned, posed, rotated, waves
from large_meshes import (
    corner,
    largest_angle,
    obtuse,
    slit,
    stretched,
    unit_cube,
    unit_square,
)

from dolfinx_signorini import InputError

N = 64
PRINT = {"pc_hypre_boomeramg_print_statistics": 1}
LU = "active sets with SciPy's sparse LU"


def constant(value):
    return lambda x: value + 0.0 * x[0]


def on_height(height, data):
    """Data on the unit square, moved to a rectangle of this height."""
    return lambda x: data(np.array([x[0], x[1] / height]))


def flat(domain, height, **arguments):
    return Large(
        domain, load=on_height(height, waves), obstacle=on_height(height, humps), **arguments
    )


def pin(x):
    """An obstacle that sticks out at one node of the lower side."""
    return np.where(np.hypot(x[0] - 0.5, x[1]) < 1e-9, 0.5, -10.0)


def comb(x):
    """An obstacle that sticks out at every second node of the boundary."""
    return np.where(np.rint(N * (x[0] + x[1])) % 2 == 0, 0.5, -10.0)


def parts(x):
    """An obstacle of 64 waves around the unit square."""
    return 0.02 * np.cos(32.0 * np.pi * (x[0] + x[1]))


def kink(x):
    return 0.1 - np.abs(x[0] - 1.0 / 3.0) - 0.3 * np.abs(x[1] - 1.0 / 3.0)


def jump(x):
    return np.where(x[0] + x[1] < 0.9, 0.1, -0.1)


def needle(x):
    """An obstacle so curved at the lower side that contact is narrower than a cell."""
    return -1e4 * (x[0] - 0.5 - 0.5 / N) ** 2 - 1e4 * x[1]


def pressed_on_a_needle():
    return Large(unit_square(N), reaction=0.0, load=constant(-1.0), obstacle=needle)


def balanced(rest):
    """A load whose integral is -rest."""
    return lambda x: np.cos(2.0 * np.pi * x[0]) * np.cos(np.pi * x[1]) - rest


def at_the_corner(domain):
    """Contact on the sides that meet at (1/2, 1/2), pressed on, and held at the bottom."""

    def where(x):
        upright = (np.abs(x[0] - 0.5) < 1e-9) & (x[1] > 0.5 - 1e-9)
        return upright | (np.abs(x[1] - 0.5) < 1e-9) & (x[0] > 0.5 - 1e-9)

    return Large(
        domain,
        reaction=0.0,
        load=constant(-1.0),
        where=where,
        fixed=lambda x: x[1] < 1e-9,
        obstacle=lambda x: -0.05 - 0.1 * np.hypot(x[0] - 0.5, x[1] - 0.5),
    )


def in_space(n, degree):
    return Large(
        unit_cube(n),
        degree=degree,
        load=lambda x: waves(x) + 0.3 * np.sin(5.0 * x[2]),
        obstacle=lambda x: humps(x) * np.cos(6.0 * x[2]),
    )


SQUARE = f"N = {N}"
# Topic, case, problem, tolerance, and the digits that are expected at least.
CASES = [
    ("coefficients", f"diffusion 1e12, reaction 1, {SQUARE}", lambda: (1e12, 1.0), 1e-12, 11),
    ("coefficients", f"diffusion 1e-12, reaction 1, {SQUARE}", lambda: (1e-12, 1.0), 1e-12, 11),
    ("coefficients", f"diffusion 1, reaction 1e12, {SQUARE}", lambda: (1.0, 1e12), 1e-12, 11),
    ("coefficients", f"diffusion 1, reaction 1e-12, {SQUARE}", lambda: (1.0, 1e-12), 1e-12, 11),
    *(
        (
            "coefficients",
            f"diffusion 1 and {small:g} along axes rotated by 30 degrees, {SQUARE}",
            lambda small=small: Large(unit_square(N), rotated(small)),
            1e-12,
            10,
        )
        for small in (1e-3, 1e-6)
    ),
    *(
        (
            "coefficients",
            f"a checkerboard of {squares} x {squares} squares, contrast 1e8, {SQUARE}",
            lambda s=squares: Large(unit_square(N), checkerboard(1e8, s)),
            1e-12,
            9,
        )
        for squares in (8, N)
    ),
    *(
        (
            "shape",
            f"rectangle of 1 x {height:g}, N = {N}",
            lambda height=height: flat(stretched(height)(N), height),
            1e-12,
            11,
        )
        for height in (1e3, 1e6)
    ),
    *(
        (
            "shape",
            f"random nodes, flattened to a height of {height:g}, degree {degree}",
            lambda h=height, d=degree: flat(obtuse(3000 // d**2, h), h, degree=d),
            1e-12,
            8,
        )
        for height, degree in ((1.0, 1), (0.1, 1), (0.01, 1), (0.1, 2))
    ),
    ("cells", f"degree 2, N = {N // 2}", lambda: Large(unit_square(N // 2), degree=2), 1e-12, 11),
    ("cells", "degree 3, N = 21", lambda: Large(unit_square(21), degree=3), 1e-12, 11),
    ("cells", "degree 4, N = 16", lambda: Large(unit_square(16), degree=4), 1e-12, 11),
    ("cells", "the unit cube, degree 1, N = 12", lambda: in_space(12, 1), 1e-12, 10),
    ("cells", "the unit cube, degree 2, N = 6", lambda: in_space(6, 2), 1e-12, 10),
    ("contact", f"64 contact parts, {SQUARE}", lambda: parts, 1e-12, 11),
    ("contact", f"at every second node, {SQUARE}", lambda: comb, 1e-12, 11),
    ("contact", f"at one pin, {SQUARE}", lambda: pin, 1e-12, 11),
    ("contact", f"an obstacle with kinks, {SQUARE}", lambda: kink, 1e-11, 10),
    ("contact", f"an obstacle that jumps, {SQUARE}", lambda: jump, 1e-12, 11),
    ("contact", f"narrower than a cell, {SQUARE}", pressed_on_a_needle, 1e-10, 10),
    (
        "contact",
        f"across a re-entrant corner, {SQUARE}",
        lambda: at_the_corner(corner(N)),
        1e-11,
        10,
    ),
    (
        "contact",
        f"on both faces of a slit and its tip, {SQUARE}",
        lambda: at_the_corner(slit(N)),
        1e-11,
        10,
    ),
    *(
        (
            "loads",
            f"no reaction, L(1) = -{rest:g}, {SQUARE}",
            lambda rest=rest: Large(
                unit_square(N), reaction=0.0, load=balanced(rest), obstacle=constant(0.0)
            ),
            1e-11,
            9,
        )
        for rest in (1e-2, 1e-5, 1e-8, 1e-11)
    ),
]


@pytest.mark.parametrize("topic,name,make,rtol,least", CASES, ids=[case[1] for case in CASES])
def test_against_lu(topic, name, make, rtol, least, comm, solve_with_scipy, record):
    case = make()
    if isinstance(case, tuple):
        case = Large(unit_square(N), *case)
    elif not isinstance(case, Large):
        case = Large(unit_square(N), obstacle=case)
    if "random" in name:
        name += f" (angles to {largest_angle(case.domain):.1f} degrees)"
    problem = case.problem()
    u = owned(problem.solve(rtol=rtol))
    digits = digits_against(comm, u, solve_with_scipy(problem))
    result = problem.result
    problem.destroy()
    assert digits >= least
    assert result.active_dofs > 0
    assert problem.unknowns > 20 * 50  # BoomerAMG's levels end at 50
    case = f"{name}: {problem.unknowns} unknowns, rtol {rtol:g}"
    record(topic, case, LU, f"{digits:.1f} digits, {result.active_dofs} active dofs")


def test_where_balance_stops(record):
    """The limit is the one below which a load counts as balanced."""
    with pytest.raises(InputError, match="not unique") as caught:
        Large(unit_square(N), reaction=0.0, load=balanced(1e-14), obstacle=constant(0.0)).problem()
    case = f"no reaction, L(1) = -1e-14, {SQUARE}"
    record("loads", case, "an `InputError` that says why", "refused", str(caught.value))


@pytest.mark.parametrize("height,least", [(1e-3, 7.0), (1e-6, 1.0)])
def test_flat_rectangles(height, least, comm, solve_with_scipy, record):
    """Few dofs in contact on a body so thin that rounding in its matrix is what bends it."""
    problem = flat(stretched(height)(N), height).problem()
    u = owned(problem.solve(rtol=1e-12))
    digits = digits_against(comm, u, solve_with_scipy(problem))
    residual, active = problem.result.natural_residual, problem.result.active_dofs
    problem.destroy()
    assert digits >= least
    case = f"rectangle of 1 x {height:g}, N = {N}: {problem.unknowns} unknowns, rtol 1e-12"
    condition = 4.0 * N**2 / height**2
    stops = (
        f"the condition, about {condition:.0e} with {active} dofs in contact: LU loses these "
        f"digits, too, and the residual, {residual:.0e}, does not show it"
    )
    record("shape", case, LU, digits, stops)


@pytest.mark.parametrize("n", [N, pytest.param(512, marks=pytest.mark.slow)])
def test_an_onset_like_the_root_of_the_fifth_power(n, comm, record):
    """No pressure anywhere; u and its flux vanish on the left half, u = (x - 1/2)^(5/2) then."""
    problem = Large(unit_square(n), obstacle=constant(0.0)).problem()
    known = posed(problem, lambda x: np.maximum(x[0] - 0.5, 0.0) ** 2.5, constant(0.0))
    u = owned(problem.solve(rtol=1e-11))
    digits = digits_against(comm, u, known)
    problem.destroy()
    assert digits >= 9
    case = f"u = max(x - 1/2, 0)^(5/2), N = {n}: {problem.unknowns} unknowns, rtol 1e-11"
    record("biactive", case, "the known u in V_h", digits)


LEVELS = [
    ("N = 4, degree 1", lambda: Large(unit_square(4), options=PRINT)),
    ("N = 64, degree 1", lambda: Large(unit_square(64), options=PRINT)),
    ("N = 32, degree 2", lambda: Large(unit_square(32), degree=2, options=PRINT)),
    ("N = 16, degree 4", lambda: Large(unit_square(16), degree=4, options=PRINT)),
    ("3000 random nodes", lambda: flat(obtuse(3000, 0.1), 0.1, options=PRINT)),
    ("the unit cube, degree 1, N = 12", lambda: Large(unit_cube(12), options=PRINT)),
    ("the unit cube, degree 2, N = 6", lambda: Large(unit_cube(6), degree=2, options=PRINT)),
    pytest.param(
        "N = 512, degree 1",
        lambda: Large(unit_square(512), options=PRINT),
        marks=pytest.mark.slow,
    ),
]


@pytest.mark.parametrize("name,make", LEVELS)
def test_levels_of_multigrid(name, make, capfd, comm, record):
    """What BoomerAMG says about its levels when it is set up for the first time."""
    problem = make().problem()
    problem.solve(rtol=0.1)
    problem.destroy()
    ctypes.CDLL(None).fflush(None)
    text = comm.bcast(capfd.readouterr().out)
    table = text[text.index("Operator Matrix") : text.index("Interpolation Matrix")]
    rows = [int(size) for size in re.findall(r"^ +\d+ +(\d+) +\d+ +\d\.", table, re.MULTILINE)]
    assert rows[0] == problem.unknowns
    assert rows[-1] <= 50
    assert len(rows) >= 3 or problem.unknowns < 1000
    record("levels", name, "what BoomerAMG prints", "unknowns " + ", ".join(map(str, rows)))
