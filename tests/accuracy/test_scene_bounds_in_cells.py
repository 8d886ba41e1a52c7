"""The bound of the energy error for scenes with obstacles in the domain, against exact solutions.

The problems are those of `tests/bounds/test_bounds_in_cells.py` with a wave w on top of solution
and obstacles, so that no datum is a polynomial.
"""

import math

import pytest
import ufl
from dolfinx import fem
from known import sampled_bound

from dolfinx_signorini.scenes import pose
from dolfinx_signorini.scenes.bounds import bound_of_scene

# PETSc's snes ex9, the hemisphere with its tangent; blown down to the unit square.
BALL = """
degree = {degree}
[domain]
shape = "square"
cells = {cells}
[define]
r = "4*hypot(x - 0.5, y - 0.5)"
ball = "where(r < 0.9, sqrt(max(1 - r^2, 0)), sqrt(0.19) - 0.9/sqrt(0.19)*(r - 0.9))"
[obstacle]
{side} = "{sign}(ball)"
[[dirichlet]]
sides = "all"
value = "{sign}0.680259411891713*log(2/r)"
"""
# Nochetto, Siebert and Veeser, Numer. Math. 95 (2003) 163-195, Section 7.2, from (-1, 1)^2.
BOWL = """
degree = {degree}
[domain]
shape = "square"
cells = {cells}
[define]
X = "2*x - 1"
Y = "2*y - 1"
s = "X^2 + Y^2 - 0.49"
w = "{w}"
bowl = "where(s < 0, -15.68*(1 - s), -16*(4*s + 0.98))"
[equation]
diffusion = "{A}"
reaction = "{c}"
load = "({A})*(bowl - 1.25*w) - ({Ax})*(8*max(s, 0)*X + w) + ({c})*(max(s, 0)^2 + w)"
[obstacle]
lower = "{w}"
[[dirichlet]]
sides = "all"
value = "s^2 + w"
"""
# From the lower obstacle on the left to the upper one on the right, with fluxes on all sides.
RAMP = """
degree = {degree}
[domain]
shape = "{shape}"
cells = {cells}
[define]
t = "(2*x - 1)/{b}"
w = "0.2*sin(3*x + y)"
u = "w + where(t < -1, -1, where(t > 1, 1, 1.5*t - 0.5*t^3))"
[equation]
reaction = 1
load = "where(t < -1, -2, where(t > 1, 2, 12*t/{b}^2)) + 10*w + u"
[obstacle]
lower = "-1 + w"
upper = "1 + w"
[[neumann]]
sides = "right"
flux = "0.6*cos(3*x + y)"
[[neumann]]
sides = "left"
flux = "-0.6*cos(3*x + y)"
[[neumann]]
sides = "{top}"
flux = "0.2*cos(3*x + y)"
[[neumann]]
sides = "{bottom}"
flux = "-0.2*cos(3*x + y)"
"""
PLANE = {"shape": "square", "top": "top", "bottom": "bottom"}
SPACE = {"shape": "cube", "top": "back", "bottom": "front"}


NEEDLE = """
[domain]
shape = "square"
cells = 8
[obstacle]
lower = "{obstacle}"
[[dirichlet]]
sides = "left"
value = "{left}"
[[dirichlet]]
sides = ["right"]
value = 0
"""


def hemisphere(x, sign=1.0):
    """No values are needed without a reaction, only their gradient."""
    X = 4.0 * (x - ufl.as_vector([0.5, 0.5]))
    r2 = ufl.inner(X, X)
    near = 1.0 / ufl.sqrt(ufl.max_value(1.0 - r2, 0.01))
    away = 0.680259411891713 / ufl.max_value(r2, 0.01)
    return 0.0, -4.0 * sign * ufl.conditional(ufl.lt(r2, 0.697965148223372**2), near, away) * X


def bowl(x, wave):
    X = 2.0 * x - ufl.as_vector([1.0, 1.0])
    s, w = ufl.max_value(ufl.inner(X, X) - 0.49, 0.0), wave * ufl.exp(x[0] + 0.5 * x[1])
    return s**2 + w, 8.0 * s * X + w * ufl.as_vector([1.0, 0.5])


def ramp(x, b):
    t, phase = (2.0 * x[0] - 1.0) / b, 3.0 * x[0] + x[1]
    inside, wave = ufl.lt(abs(t), 1.0), 0.2 * ufl.cos(phase)
    u = ufl.conditional(inside, 1.5 * t - 0.5 * t**3, ufl.sign(t)) + 0.2 * ufl.sin(phase)
    slope = ufl.conditional(inside, 3.0 * (1.0 - t**2) / b, 0.0)
    return u, ufl.as_vector([slope + 3.0 * wave, wave, 0.0][: len(x)])


def solved(scene, comm):
    posed = pose(scene, comm)
    posed.problem.solve(rtol=1e-10)
    return posed


def checked(scene, comm, exact, most, A=lambda x: 1.0, c=0.0):
    """The bound is proven, not below the error, and at most a multiple of the error."""
    posed = solved(scene, comm)
    x, u_h = ufl.SpatialCoordinate(posed.sided.mesh), posed.problem.u
    u, slope = exact(x)
    g, e = ufl.grad(u_h) - slope, u_h - u
    dx = ufl.dx(metadata={"quadrature_degree": 24 if len(x) == 2 else 12})
    square = fem.assemble_scalar(fem.form((A(x) * ufl.inner(g, g) + c * e * e) * dx))
    bound, error = bound_of_scene(posed), math.sqrt(comm.allreduce(square))
    posed.problem.destroy()
    assert bound.notes == () and not bound.sampled
    assert error <= bound.total <= most * error
    return bound


@pytest.mark.parametrize(("degree", "most"), [(1, 1.5), (2, 2.0), (3, 2.3)])
@pytest.mark.parametrize(("side", "sign"), [("lower", ""), ("upper", "-")])
def test_a_membrane_over_a_ball(side, sign, degree, most, parse, comm):
    scene = parse(BALL.format(degree=degree, cells=16, side=side, sign=sign))
    checked(scene, comm, lambda x: hemisphere(x, -1.0 if sign else 1.0), most)


@pytest.mark.parametrize(("degree", "most"), [(1, 1.25), (2, 1.32), (3, 1.55)])
@pytest.mark.parametrize("wave", [0.0, 0.3])
def test_a_bowl_on_a_wave(wave, degree, most, parse, comm):
    w = f"{wave}*exp(x + 0.5*y)" if wave else "0"
    scene = parse(BOWL.format(degree=degree, cells=16, w=w, A="1", Ax="0", c="0"))
    checked(scene, comm, lambda x: bowl(x, wave), most)


@pytest.mark.parametrize(("degree", "most"), [(1, 1.25), (2, 1.32)])
def test_coefficients_that_are_formulas(degree, most, parse, comm):
    """A feasible function apart from the solution, and a diffusion that is no polynomial."""
    w, A, Ax = "0.3*exp(x + 0.5*y)", "2 + sin(3*x)", "3*cos(3*x)"
    scene = parse(BOWL.format(degree=degree, cells=16, w=w, A=A, Ax=Ax, c="1"))
    diffusion = lambda x: 2.0 + ufl.sin(3.0 * x[0])  # noqa: E731
    checked(scene, comm, lambda x: bowl(x, 0.3), most, diffusion, 1.0)


@pytest.mark.parametrize(("b", "degree", "most"), [(0.5, 1, 1.2), (0.5, 2, 1.2), (0.55, 1, 1.7)])
def test_two_obstacles_and_fluxes(b, degree, most, parse, comm):
    scene = parse(RAMP.format(degree=degree, cells=8, b=b, **PLANE))
    checked(scene, comm, lambda x: ramp(x, b), most, c=1.0)


def test_two_obstacles_in_space(parse, comm):
    scene = parse(RAMP.format(degree=1, cells=4, b=0.5, **SPACE))
    checked(scene, comm, lambda x: ramp(x, 0.5), 1.25, c=1.0)


@pytest.mark.parametrize("width", [0.003, 0.0005])
def test_a_needle_between_all_points_is_in_the_bound(width, parse, comm):
    """The solution is at least 1/4 on a disc, whose capacity in a larger disc is known."""
    obstacle = f"exp(-((x - 0.545)^2 + (y - 0.46)^2)/{width}^2) - 0.5"
    posed = solved(parse(NEEDLE.format(obstacle=obstacle, left=0)), comm)
    radius = width * math.sqrt(math.log(4.0 / 3.0))
    least = 0.25 * math.sqrt(2.0 * math.pi / math.log(0.77 / radius))
    assert sampled_bound(posed).total < 0.5 * least
    bound = bound_of_scene(posed)
    assert least <= bound.total < math.inf and not bound.sampled


SAMPLED = {
    "an obstacle without an enclosure": (
        BALL.replace("{sign}(ball)", "0 - abs(x - 0.31)^(-0.4)"),
        "the obstacle is known at points of cells only",
    ),
    "an obstacle that meets the data": (
        BALL.replace("{sign}(ball)", "{sign}0.680259411891713*log(2/max(r, 0.5))"),
        "an obstacle may be beyond Dirichlet data",
    ),
    "Dirichlet data in space": (
        NEEDLE.replace("square", "cube").replace("8", "2").format(obstacle=-10, left="exp(y)"),
        "Dirichlet data are known at points of facets only",
    ),
}


@pytest.mark.parametrize("name", SAMPLED)
def test_what_is_sampled_is_called_so(name, parse, comm):
    text, note = SAMPLED[name]
    posed = solved(parse(text.format(degree=1, cells=4, side="lower", sign="")), comm)
    bound = bound_of_scene(posed)
    assert bound.sampled and any(note in each for each in bound.notes)


def test_a_needle_of_dirichlet_data_is_in_the_bound(parse, comm):
    """In a half plane the energy of data exp(-t^2) is 1, for any width; in a part of it, more."""
    text = NEEDLE.format(obstacle=-1000, left="exp(-((y - 0.53)/0.002)^2)")
    posed = solved(parse(text), comm)
    assert sampled_bound(posed).total < 0.5
    bound = bound_of_scene(posed)
    assert 1.0 <= bound.total < math.inf and not bound.sampled


def test_dirichlet_data_that_jump_have_no_bound(parse, comm):
    text = NEEDLE.format(obstacle=-10, left=1).replace('["right"]', '["right", "top"]')
    bound = bound_of_scene(solved(parse(text), comm))
    assert bound.total == math.inf and "at a vertex" in bound.notes[0]
