"""Scenes whose solutions only the tests know, and errors evaluated by code of the tests."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import basix
import numpy as np
from dolfinx import fem, geometry
from mpi4py import MPI

from dolfinx_signorini.accuracy.targets import Target
from dolfinx_signorini.accuracy.terms import Solution, Solved
from dolfinx_signorini.bounds import remainders
from dolfinx_signorini.bounds.energy_bound import EnergyBound, bound_by_flux
from dolfinx_signorini.bounds.frames import cell_frames
from dolfinx_signorini.bounds.strong_form import strong_form
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.scenes import PosedScene

Array = np.ndarray
Accuracies = dict[str, tuple[float, ...]]

CHUNK = 100_000  # cells that errors are evaluated on at a time


@dataclass(frozen=True)
class Known:
    """A scene file, its solution, and accuracies to ask for by norm."""

    text: str
    u: Callable[..., Array]
    gradient: Callable[..., tuple[Array, ...]]
    accuracies: Accuracies


def alone(problem: SignoriniProblem, target: Target) -> Solved:
    """Return a solved problem without a coarser one, for terms that look at one solution."""
    count = problem.space.mesh.topology.index_map(problem.space.mesh.topology.dim).size_local
    coarse = Solution(problem.u, problem.forces)
    return Solved(coarse, problem, np.arange(count, dtype=np.int32), target)


def power(x: Array, y: Array, exponent: float, start: float) -> tuple[Array, Array, Array]:
    """Return r^s sin(s t) with its gradient, where the angle t begins at a direction."""
    r = np.hypot(x, y)
    middle = start + 0.75 * math.pi  # the cut is opposite to this direction
    c, d = math.cos(middle), math.sin(middle)
    t = np.arctan2(y * c - x * d, x * c + y * d) + 0.75 * math.pi
    with np.errstate(divide="ignore", invalid="ignore"):
        f = exponent * r ** (exponent - 1.0)
        angle = (exponent - 1.0) * t - start
        return r**exponent * np.sin(exponent * t), f * np.sin(angle), f * np.cos(angle)


def corner(degrees: float, accuracies: Accuracies) -> Known:
    """A re-entrant corner at the origin, between the x-axis and another direction."""
    omega = math.radians(degrees)
    s = math.pi / omega
    half = omega / 2.0
    a, b = math.cos(omega), math.sin(omega)
    scale = 1.0 / max(abs(a), abs(b))
    text = f"""
degree = 2
[domain]
shape = "polygon"
vertices = [[0, 0], [1, 0], [1, 1], [-1, 1], [-1, -1], [{a * scale!r}, {b * scale!r}]]
width = 0.5
[define]
X = "x*{math.cos(half)!r} + y*{math.sin(half)!r}"
Y = "y*{math.cos(half)!r} - x*{math.sin(half)!r}"
w = "hypot(x, y)^{s!r} * sin({s!r}*(atan2(Y, X) + {half!r}))"
[equation]
reaction = 1
load = "w"
[contact]
sides = 4
obstacle = "w"
[[dirichlet]]
sides = [1, 2, 3, 5, 6]
value = "w"
"""

    def at(x: Array, y: Array) -> tuple[Array, Array, Array]:
        return power(x, y, s, 0.0)

    return Known(text, lambda x, y: at(x, y)[0], lambda x, y: at(x, y)[1:], accuracies)


def change(contact: bool, accuracies: Accuracies) -> Known:
    """u = -r^(1/2) sin(t/2): no flux for x < 0 on a straight side, u = 0 or contact for x > 0."""
    held, obstacle = (2, 0) if contact else (3, '"w"')
    sides = [3, 4, 5] if contact else [2, 4, 5]
    text = f"""
degree = 2
[domain]
shape = "polygon"
vertices = [[-1, 0], [0, 0], [1, 0], [1, 1], [-1, 1]]
width = 0.5
[define]
w = "0 - sqrt(hypot(x, y))*sin(0.5*atan2(y, x))"
[equation]
reaction = 1
load = "w"
[contact]
sides = {held}
obstacle = {obstacle}
[[dirichlet]]
sides = {sides}
value = "w"
"""

    def at(x: Array, y: Array) -> tuple[Array, ...]:
        return tuple(-value for value in power(x, y, 0.5, 0.0))

    return Known(text, lambda x, y: at(x, y)[0], lambda x, y: at(x, y)[1:], accuracies)


def interval(centre: float, half: float, accuracies: Accuracies) -> Known:
    """Contact on an interval of the bottom, with a detachment point at each end: u = Re F, with
    F' the square root of (z - a) (z - b)."""
    text = f"""
degree = 2
[domain]
shape = "square"
cells = 8
[define]
X = "x - {centre!r}"
k = "{half!r}"
t = "0.5*(atan2(y, X - k) + atan2(y, X + k))"
m = "sqrt(hypot(X - k, y)*hypot(X + k, y))"
p = "m*cos(t)"
q = "m*sin(t)"
w = "0.5*(X*p - y*q - k^2*log(hypot(X + p, y + q)/k))"
[equation]
reaction = 1
load = "w"
[contact]
sides = "bottom"
obstacle = 0
[[dirichlet]]
sides = ["left", "right", "top"]
value = "w"
"""

    def parts(x: Array, y: Array) -> tuple[Array, Array]:
        z = x - centre + 1j * np.abs(y)
        root = np.sqrt(np.abs(z - half) * np.abs(z + half)) * np.exp(
            0.5j * (np.angle(z - half) + np.angle(z + half))
        )
        return z, root

    def u(x: Array, y: Array) -> Array:
        z, root = parts(x, y)
        return 0.5 * np.real(z * root - half**2 * np.log((z + root) / half))

    def gradient(x: Array, y: Array) -> tuple[Array, Array]:
        root = parts(x, y)[1]
        return root.real, -root.imag

    return Known(text, u, gradient, accuracies)


def bump(width: float, accuracies: Accuracies) -> Known:
    """A narrow bump inside of the square, away from everything."""
    text = f"""
degree = 2
[domain]
shape = "square"
cells = 8
[define]
d = "(x - 0.37)^2 + (y - 0.61)^2"
e = "exp(0 - d/{width**2!r})"
[equation]
reaction = 1
load = "e*(1 + {4 / width**2!r} - {4 / width**4!r}*d)"
[contact]
sides = "bottom"
obstacle = 0
[[dirichlet]]
sides = "top"
value = 0
"""

    def u(x: Array, y: Array) -> Array:
        return np.exp(-((x - 0.37) ** 2 + (y - 0.61) ** 2) / width**2)

    def gradient(x: Array, y: Array) -> tuple[Array, Array]:
        e = -2.0 / width**2 * u(x, y)
        return e * (x - 0.37), e * (y - 0.61)

    return Known(text, u, gradient, accuracies)


def points(accuracies: Accuracies) -> Known:
    """Three detachment points, one on each of three sides, in supports that do not meet."""
    places = (
        (0.3137, 0.0, "x", "y"),
        (1.0, 0.6271, "y", "(1 - x)"),
        (0.2893, 1.0, "(1 - x)", "(1 - y)"),
    )
    define, names = [], []
    for i, (x0, y0, along, inward) in enumerate(places):
        start = {"x": x0, "y": y0, "(1 - x)": 1.0 - x0}[along]
        define += [
            f'X{i} = "{along} - {start!r}"',
            f'r{i} = "hypot(X{i}, {inward})"',
            f'c{i} = "max(1 - (r{i}/0.28)^2, 0)^4"',
            f'w{i} = "0 - c{i}*r{i}^1.5*sin(1.5*atan2({inward}, X{i}))"',
        ]
        names.append(f"w{i}")
    text = f"""
degree = 2
[domain]
shape = "square"
cells = 8
[define]
{chr(10).join(define)}
[contact]
sides = ["bottom", "right", "top"]
obstacle = 0
[equation]
reaction = 1
[[dirichlet]]
sides = "left"
[solution]
u = "{" + ".join(names)}"
manufactured = true
"""

    def one(X: Array, Y: Array) -> tuple[Array, Array, Array]:
        value, dx, dy = power(X, np.abs(Y), 1.5, 0.0)
        r2 = (X**2 + Y**2) / 0.28**2
        c = np.where(r2 < 1.0, (1.0 - r2) ** 4, 0.0)
        slope = np.where(r2 < 1.0, -8.0 * (1.0 - r2) ** 3, 0.0) / 0.28**2
        return -c * value, -c * dx - slope * X * value, -c * dy - slope * Y * value

    def at(x: Array, y: Array) -> list[Array]:
        a = one(x - 0.3137, y)
        b = one(y - 0.6271, 1.0 - x)
        c = one(1.0 - x - (1.0 - 0.2893), 1.0 - y)
        return [a[0] + b[0] + c[0], a[1] - b[2] - c[1], a[2] + b[1] - c[2]]

    return Known(text, lambda x, y: at(x, y)[0], lambda x, y: tuple(at(x, y)[1:]), accuracies)


def layer(accuracies: Accuracies) -> Known:
    """A boundary layer of width 1e-3 at a side in contact."""
    text = """
degree = 2
[domain]
shape = "square"
cells = 8
[equation]
reaction = 1e6
[contact]
sides = "left"
obstacle = 1
[[dirichlet]]
sides = "right"
value = 0
"""

    def u(x: Array, y: Array) -> Array:
        return np.exp(-1000.0 * x)

    return Known(text, u, lambda x, y: (-1000.0 * u(x, y), 0.0 * x), accuracies)


def jump(accuracies: Accuracies) -> Known:
    """The diffusion jumps from 1 to 1000 across x = 1/3, which is no line of the mesh."""
    text = """
degree = 2
[domain]
shape = "square"
cells = 8
[equation]
diffusion = "where(3*x < 1, 1, 1000)"
load = "(x - 1/3)*cos(y)"
[contact]
sides = "right"
obstacle = "(2/3)*cos(y)/1000"
[[dirichlet]]
sides = "left"
value = "0 - cos(y)/3"
[[neumann]]
sides = "top"
flux = "(1/3 - x)*sin(1)"
"""

    def k(x: Array) -> Array:
        return np.where(3.0 * x < 1.0, 1.0, 1000.0)

    return Known(
        text,
        lambda x, y: (x - 1.0 / 3.0) / k(x) * np.cos(y),
        lambda x, y: (np.cos(y) / k(x), (1.0 / 3.0 - x) / k(x) * np.sin(y)),
        accuracies,
    )


def circle(accuracies: Accuracies) -> Known:
    """The diffusion jumps from 1 to 1000 across a circle: u = s (1 + sin(2 y)/2)/k, s = 0 there."""
    text = """
degree = 2
[domain]
shape = "square"
cells = 8
[define]
s = "(x - 0.5)^2 + (y - 0.45)^2 - 0.09"
p = "1 + 0.5*sin(2*y)"
k = "where(s < 0, 1, 1000)"
w = "s*p/k"
[equation]
diffusion = "k"
load = "0 - 4*p - 4*(y - 0.45)*cos(2*y) + 2*s*sin(2*y)"
[contact]
sides = "bottom"
obstacle = "w"
[[dirichlet]]
sides = ["left", "right", "top"]
value = "w"
"""

    def parts(x: Array, y: Array) -> tuple[Array, Array, Array]:
        s = (x - 0.5) ** 2 + (y - 0.45) ** 2 - 0.09
        return s, 1.0 + 0.5 * np.sin(2.0 * y), np.where(s < 0.0, 1.0, 1000.0)

    def u(x: Array, y: Array) -> Array:
        s, p, k = parts(x, y)
        return s * p / k

    def gradient(x: Array, y: Array) -> tuple[Array, Array]:
        s, p, k = parts(x, y)
        return 2.0 * (x - 0.5) * p / k, (2.0 * (y - 0.45) * p + s * np.cos(2.0 * y)) / k

    return Known(text, u, gradient, accuracies)


def kink(accuracies: Accuracies) -> Known:
    """Contact everywhere with an obstacle that has a kink: u = Im(z log z) - 2 y."""
    text = """
degree = 2
[domain]
shape = "square"
cells = 8
[define]
X = "x - 0.4137"
w = "y*log(hypot(X, y)) + X*atan2(y, X) - 2*y"
[equation]
reaction = 1
load = "where(hypot(X, y) > 0, y*log(hypot(X, y) + 1e-300) + X*atan2(y, X) - 2*y, 0)"
[contact]
sides = "bottom"
obstacle = "pi*min(X, 0)"
[[dirichlet]]
sides = ["left", "right", "top"]
value = "w"
"""

    def at(x: Array, y: Array) -> tuple[Array, Array, Array]:
        X = x - 0.4137
        with np.errstate(divide="ignore", invalid="ignore"):
            r, t = np.hypot(X, y), np.arctan2(y, X)
            log = np.log(np.maximum(r, 1e-300))
            return y * log + X * t - 2.0 * y, t, log + 1.0 - 2.0

    return Known(text, lambda x, y: at(x, y)[0], lambda x, y: at(x, y)[1:], accuracies)


def strip(accuracies: Accuracies) -> Known:
    """A load that jumps by 20 y along the line s = 0: u = cos 2x cosh y - 10 y max(s, 0)^2.

    On meshes of squares all cells along the line are cut at the same share of their width. The
    obstacle has its corner where contact ends.
    """
    text = """
degree = 2
[domain]
shape = "square"
cells = 8
[define]
s = "x - 4/11"
w = "cos(2*x)*cosh(y) - 10*y*max(s, 0)^2"
[equation]
reaction = 3
load = "6*cos(2*x)*cosh(y) - 30*y*max(s, 0)^2 + where(s < 0, 0, 20*y)"
[contact]
sides = "bottom"
obstacle = "cos(2*x) - 2*max(4/11 - x, 0)"
[[dirichlet]]
sides = ["left", "right", "top"]
value = "w"
"""

    def beyond(x: Array) -> Array:
        return np.maximum(x - 4.0 / 11.0, 0.0)

    def u(x: Array, y: Array) -> Array:
        return np.cos(2.0 * x) * np.cosh(y) - 10.0 * y * beyond(x) ** 2

    def gradient(x: Array, y: Array) -> tuple[Array, Array]:
        dx = -2.0 * np.sin(2.0 * x) * np.cosh(y) - 20.0 * y * beyond(x)
        return dx, np.cos(2.0 * x) * np.sinh(y) - 10.0 * beyond(x) ** 2

    return Known(text, u, gradient, accuracies)


def bent(
    circle: tuple[float, float, float], rate: float, exponent: int, accuracies: Accuracies
) -> Known:
    """The load jumps or has a kink across a circle: u = max(s, 0)^2 e^(rate x) + 20 y, or s^3."""
    a, b, square = circle
    text = f"""
[domain]
shape = "square"
cells = 8
[define]
s = "(x - {a!r})^2 + (y - {b!r})^2 - {square!r}"
[contact]
sides = "top"
[[dirichlet]]
sides = ["left", "right", "bottom"]
[solution]
u = "where(s > 0, s^{exponent}*exp({rate!r}*x), 0) + 20*y"
manufactured = true
"""

    def parts(x: Array, y: Array) -> tuple[Array, Array]:
        return np.maximum((x - a) ** 2 + (y - b) ** 2 - square, 0.0), np.exp(rate * x)

    def u(x: Array, y: Array) -> Array:
        s, growth = parts(x, y)
        return s**exponent * growth + 20.0 * y

    def gradient(x: Array, y: Array) -> tuple[Array, Array]:
        s, growth = parts(x, y)
        slope = 2.0 * exponent * s ** (exponent - 1) * growth
        return slope * (x - a) + rate * s**exponent * growth, slope * (y - b) + 20.0

    return Known(text, u, gradient, accuracies)


def edge(accuracies: Accuracies) -> Known:
    """A cube whose bottom is in contact, with a singularity r^0.63 along an edge of the bottom."""
    c, s = 0.8, 0.6
    start = -math.asin(c)
    exponent = math.pi / 2.0 / (math.pi / 2.0 + math.asin(c))
    text = f"""
degree = 2
[domain]
shape = "cube"
cells = 4
[define]
Z = "(z - {c!r}*x)/{s!r}"
w = "0 - hypot(x, Z)^{exponent!r}*sin({exponent!r}*(atan2(Z, x) - {start!r}))"
[equation]
diffusion = [[1, 0, {c!r}], [0, 1, 0], [{c!r}, 0, 1]]
reaction = 1
load = "w"
[contact]
sides = "bottom"
obstacle = 0
[[dirichlet]]
sides = ["right", "top"]
value = "w"
"""

    def at(x: Array, z: Array) -> tuple[Array, Array, Array]:
        value, dx, dz = power(x, (z - c * x) / s, exponent, start)
        with np.errstate(invalid="ignore"):  # the gradient has no value at the edge
            return -value, -dx + dz * c / s, -dz / s

    return Known(
        text,
        lambda x, y, z: at(x, z)[0],
        lambda x, y, z: (at(x, z)[1], 0.0 * y, at(x, z)[2]),
        accuracies,
    )


def true_error(u: fem.Function, known: Known, norm: str) -> float:
    """Return a norm of the error, by a lattice or a rule that the package does not use."""
    order, p = {
        "L1": (0, 1.0), "L2": (0, 2.0), "L4": (0, 4.0), "L16": (0, 16.0), "Linf": (0, math.inf),
        "H1": (1, 2.0), "W1_4": (1, 4.0), "W1_inf": (1, math.inf),
    }[norm]  # fmt: skip
    space, domain = u.function_space, u.function_space.mesh
    dim, comm = domain.topology.dim, domain.comm
    count = domain.topology.index_map(dim).size_local
    element = space.element.basix_element
    if math.isinf(p):
        degree = 15 if dim == 2 else 9
        kind = basix.LatticeType.equispaced
        points, weights = basix.create_lattice(element.cell_type, degree, kind, True), None
    else:
        points, weights = basix.make_quadrature(element.cell_type, 15 if dim == 2 else 9)
    table, largest, total = element.tabulate(1, points)[:, :, :, 0], 0.0, 0.0
    for first in range(0, count, CHUNK):
        cells = slice(first, min(first + CHUNK, count))
        values = u.x.array[space.dofmap.list[cells]]
        x = domain.geometry.x[domain.geometry.dofmap[cells]][:, :, :dim]
        jacobian = (x[:, 1:] - x[:, :1]).transpose(0, 2, 1)
        places = np.moveaxis(x[:, :1] + np.einsum("cij,qj->cqi", jacobian, points), 2, 0)
        errors = [values @ table[0].T - known.u(*places)]
        if order:
            slopes = np.einsum("cd,jqd->cqj", values, table[1:])
            slopes = np.einsum("cqj,cji->icq", slopes, np.linalg.inv(jacobian))
            errors += [a - b for a, b in zip(slopes, known.gradient(*places), strict=True)]
        sizes = np.nan_to_num(np.abs(np.array(errors)), posinf=0.0)  # at the singular point itself
        if weights is None:
            largest = max(largest, float(sizes.max(initial=0.0)))
        else:
            powers = (sizes**p).sum(axis=0) @ weights * np.abs(np.linalg.det(jacobian))
            total += float(powers.sum())
    if weights is None:
        return float(comm.allreduce(largest, op=MPI.MAX))
    return float(comm.allreduce(total) ** (1.0 / p))


SCENES = {
    "corner of 240 degrees": corner(
        240.0,
        {
            "L2": (1e-3, 1e-4, 1e-5),
            "L4": (1e-3, 1e-4, 1e-5),
            "Linf": (1e-2, 1e-3, 1e-4),
            "H1": (3e-2, 1e-2, 1e-3),
            "W1_4": (3e-1, 1e-1, 3e-2),
        },
    ),
    "corner of 300 degrees": corner(
        300.0,
        {
            "L2": (1e-2, 1e-3, 1e-4),
            "L4": (1e-2, 1e-3, 1e-4),
            "Linf": (1e-1, 1e-2, 1e-3),
            "H1": (1e-1, 1e-2, 3e-3),
            "W1_4": (3e-1, 1e-1, 5e-2),
        },
    ),
    "Dirichlet to Neumann": change(
        False,
        {
            "L2": (1e-2, 1e-3, 1e-4),
            "L4": (1e-2, 1e-3, 1e-4),
            "Linf": (1e-1, 1e-2, 1e-3),
            "H1": (1e-1, 1e-2, 3e-3),
        },
    ),
    "contact to Neumann": change(
        True,
        {
            "L2": (1e-2, 1e-3, 1e-4),
            "L4": (1e-2, 1e-3, 1e-4),
            "Linf": (1e-1, 1e-2, 1e-3),
            "H1": (1e-1, 1e-2, 3e-3),
        },
    ),
    "two detachment points": interval(
        0.4637,
        0.2213,
        {
            "L2": (1e-4, 1e-5, 1e-6),
            "L4": (1e-4, 1e-5, 1e-6),
            "Linf": (1e-3, 1e-4, 1e-5),
            "H1": (1e-2, 1e-3, 3e-4),
            "W1_4": (3e-2, 1e-2, 1e-3),
        },
    ),
    "three detachment points": points(
        {
            "L2": (1e-3, 1e-4, 1e-5),
            "L4": (1e-3, 1e-4, 1e-5),
            "Linf": (1e-2, 1e-3, 1e-4),
            "H1": (1e-1, 1e-2, 3e-3),
            "W1_4": (1e-1, 3e-2, 1e-2),
        }
    ),
    "narrow bump": bump(
        0.03,
        {
            "L2": (1e-2, 1e-3, 1e-4),
            "L4": (1e-2, 1e-3, 1e-4),
            "Linf": (1e-1, 1e-2, 1e-3),
            "H1": (1e-1, 1e-2, 3e-3),
            "W1_4": (1.0, 1e-1, 3e-2),
        },
    ),
    "layer": layer(
        {
            "L2": (1e-3, 1e-4, 1e-5),
            "L4": (1e-2, 1e-3, 1e-4),
            "Linf": (1e-1, 1e-2, 1e-3),
            "H1": (1.0, 0.3, 0.1),
            "W1_4": (10.0, 3.0, 1.0),
        }
    ),
    "jump of the diffusion": jump(
        {
            "L2": (1e-10, 1e-11, 1e-12),
            "L4": (1e-10, 1e-11, 1e-12),
            "Linf": (1e-9, 1e-10, 1e-11),
            "H1": (1e-8, 1e-9, 1e-10),
            "W1_4": (1e-7, 1e-8, 1e-9),
        }
    ),
    "jump across a circle": circle(
        {
            "L2": (3e-4, 1e-4, 3e-5),
            "L4": (3e-4, 1e-4, 3e-5),
            "Linf": (1e-3, 3e-4, 1e-4),
            "H1": (3e-2, 1e-2, 3e-3),
            "W1_4": (1e-1, 5e-2, 3e-2),
        }
    ),
    "kink of the obstacle": kink(
        {
            "L2": (1e-3, 1e-4, 1e-5),
            "L4": (1e-3, 1e-4, 1e-5),
            "Linf": (1e-2, 1e-3, 1e-4),
            "H1": (1e-1, 1e-2, 1e-3),
            "W1_4": (1e-1, 3e-2, 1e-2),
        }
    ),
    "strip of load": strip(
        {
            "L2": (1e-2, 1e-3, 1e-4),
            "L4": (1e-2, 1e-3, 1e-4),
            "Linf": (1e-2, 1e-3, 1e-4),
            "H1": (5e-2, 5e-3, 5e-4),
            "W1_4": (7e-2, 7e-3, 7e-4),
        }
    ),
    "tiny contact set": interval(
        0.4637,
        0.0031,
        {
            "L2": (1e-4, 1e-5, 1e-6),
            "L4": (1e-4, 1e-5, 1e-6),
            "Linf": (1e-3, 1e-4, 1e-5),
            "H1": (1e-2, 1e-3, 1e-4),
            "W1_4": (3e-2, 1e-2, 1e-3),
        },
    ),
    "edge of a cube": edge(
        {
            "L2": (1e-2, 1e-3),
            "L4": (1e-2, 3e-3),
            "Linf": (1e-1, 3e-2),
            "H1": (3e-1, 1e-1),
        }
    ),
}


def values_at(u, points):
    """The values of a function at points in the plane, by DOLFINx, the same on all ranks."""
    domain = u.function_space.mesh
    near = geometry.compute_collisions_points(geometry.bb_tree(domain, 2), points)
    cells = geometry.compute_colliding_cells(domain, near, points)
    here = np.flatnonzero(np.diff(cells.offsets))
    values = np.full((len(points), u.function_space.dofmap.bs), -np.inf)
    if len(here):
        values[here] = u.eval(points[here], cells.array[cells.offsets[here]])
    return np.max(domain.comm.allgather(values), axis=0)


def sampled_bound(posed: PosedScene) -> EnergyBound:
    """Return the bound of a solved scene without enclosures: data are known at points."""
    frames = cell_frames(posed.problem.space.mesh)
    return bound_by_flux(remainders.Solved(posed.problem, strong_form(posed.problem), frames))
