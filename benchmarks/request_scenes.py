"""Scenes by chance for `requests.py`: problems with solutions that the program is not told.

A family draws a solution u as an expression of SymPy. Load, fluxes, boundary data and obstacle are
derived from u, and go to the program as a scene file, or as UFL where a scene file has no words for
the problem. On contact sides K grad u . n = h + p and u = g + gap, where p >= 0 and gap >= 0 are
chosen, and p gap = 0. The Laplacian of a harmonic u is 0 by hand: what SymPy leaves of the
derivatives of singular functions cancels in exact arithmetic alone.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import sympy
import ufl
from sympy import Abs, Heaviside, Max, atan, atan2, cos, exp, log, sin, sqrt, tanh
from sympy.printing.str import StrPrinter

Array = np.ndarray
Rng = np.random.Generator
Names = Mapping[str, Any]

x, y, z = COORDINATES = sympy.symbols("x y z", real=True)

NUMPY: Names = {
    **{n: getattr(np, n) for n in ("sqrt", "exp", "log", "sin", "cos", "tan", "tanh", "sign")},
    **{"atan": np.arctan, "atan2": np.arctan2, "abs": np.abs, "max": np.maximum, "pi": np.pi},
    "where": np.where,
}
UFL: Names = {
    **{n: getattr(ufl, n) for n in ("sqrt", "exp", "sin", "cos", "tan", "tanh", "sign", "atan")},
    **{"log": ufl.ln, "atan2": ufl.atan2, "abs": abs, "max": ufl.max_value, "pi": math.pi},
    "where": ufl.conditional,
}


class _Printer(StrPrinter):
    """Prints expressions in the words of scene files, which are those of `NUMPY` and `UFL`, too."""

    def _print_Float(self, expr: Any) -> str:
        return repr(float(expr))

    def _print_Max(self, expr: Any) -> str:
        first, *others = expr.args
        rest = self._print(others[0] if len(others) == 1 else Max(*others, evaluate=False))
        return f"max({self._print(first)}, {rest})"

    def _print_Heaviside(self, expr: Any) -> str:
        return f"where(0 < {self._print(expr.args[0])}, 1, 0)"

    def _print_Abs(self, expr: Any) -> str:
        return f"abs({self._print(expr.args[0])})"


class Formulas:
    """Expressions as texts with the subexpressions that they share, and their values."""

    def __init__(self, **expressions: Any):
        shared, found = sympy.cse(
            [sympy.sympify(e) for e in expressions.values()], sympy.numbered_symbols("q")
        )
        self.shared = {str(name): _Printer().doprint(e) for name, e in shared}
        texts = map(_Printer().doprint, found)
        self.texts = dict(zip(expressions, texts, strict=True))

    def define(self) -> str:
        """The table [define] of a scene file."""
        return "".join(f'{name} = "{text}"\n' for name, text in self.shared.items())

    @cached_property
    def _codes(self) -> list[tuple[str, Any]]:
        return [(name, compile(text, name, "eval")) for name, text in self.shared.items()]

    def __call__(self, language: Names, places: Sequence[Any], *names: str) -> list[Any]:
        """The values of some of the expressions at places, as arrays or as UFL."""
        known = dict(language) | dict(zip("xyz", places, strict=False))
        with np.errstate(all="ignore"):  # derivatives have no value at a singular point
            for name, code in self._codes:
                known[name] = eval(code, {}, known)
            return [eval(self.texts[name], {}, known) for name in names]

    def arrays(self, places: Array, *names: str) -> list[Array]:
        """The values at points, shape (points, dimension), 0 where there is none."""
        return [np.where(np.isfinite(f), f, 0.0) for f in self.raw(places, *names)]

    def raw(self, places: Array, *names: str) -> list[Array]:
        """The same, not finite where there is none: at a singular point, where r = 0."""
        found = self(NUMPY, list(places.T), *names)
        return [np.broadcast_to(np.asarray(f, dtype=float), len(places)) for f in found]


@dataclass(frozen=True)
class Domain:
    """The table [domain] of a scene file, and the corners of its sides, ordered as the file has."""

    table: str
    sides: Mapping[str, Array]

    @property
    def dimension(self) -> int:
        return int(next(iter(self.sides.values())).shape[1])

    def normal(self, side: str) -> Array:
        corners = self.sides[side]
        if self.dimension == 3:
            n = np.cross(corners[1] - corners[0], corners[2] - corners[0])
            n *= np.sign(n @ (corners[0] - 0.5))  # the cube around its middle
        else:
            n = np.array([1.0, -1.0]) * (corners[1] - corners[0])[::-1]
        return n / np.linalg.norm(n)

    def places(self, side: str) -> Array:
        """Points of a side, none of them a corner."""
        t = (np.arange(400) + 0.5) / 400.0
        corners = self.sides[side]
        if self.dimension == 2:
            return corners[0] + t[:, None] * (corners[1] - corners[0])
        s, t = (item.ravel() for item in np.meshgrid(t[::10], t[::10]))
        return (
            corners[0]
            + s[:, None] * (corners[1] - corners[0])
            + t[:, None] * (corners[2] - corners[0])
        )


SQUARE = Domain(
    'shape = "square"\ncells = 8',
    {
        "left": np.array([[0.0, 1.0], [0.0, 0.0]]),
        "right": np.array([[1.0, 0.0], [1.0, 1.0]]),
        "bottom": np.array([[0.0, 0.0], [1.0, 0.0]]),
        "top": np.array([[1.0, 1.0], [0.0, 1.0]]),
    },
)


def _face(axis: int, value: float) -> Array:
    corners = np.zeros((3, 3))
    corners[1, (axis + 1) % 3] = corners[2, (axis + 2) % 3] = 1.0
    corners[:, axis] = value
    return corners


CUBE = Domain(
    'shape = "cube"\ncells = 4',
    {
        name: _face(k // 2, float(k % 2))
        for k, name in enumerate(("left", "right", "front", "back", "bottom", "top"))
    },
)


def wedge_polygon(opening: float, turn: float) -> Domain:
    """The part of the square (-1, 1)^2 between two rays from the origin, turned by an angle."""

    def on_square(angle: float) -> Array:
        point = np.array([math.cos(angle), math.sin(angle)])
        return point / np.abs(point).max()

    middle = [math.pi / 4.0 * k for k in (1, 3, 5, 7) if math.pi / 4.0 * k < opening - 0.1]
    c, s = math.cos(turn), math.sin(turn)
    vertices = [np.zeros(2), *map(on_square, (0.0, *middle, opening))]
    vertices = [np.array([c * a - s * b, s * a + c * b]) for a, b in vertices]
    sides = {
        str(k + 1): np.array([vertices[k], vertices[(k + 1) % len(vertices)]])
        for k in range(len(vertices))
    }
    listed = [v.tolist() for v in vertices]
    return Domain(f'shape = "polygon"\nvertices = {listed}\nwidth = 0.5', sides)


@dataclass(frozen=True)
class Trial:
    """A problem and its solution.

    Attributes:
        what: What was drawn, in words.
        u: The solution.
        domain: The domain.
        contact: The side in contact.
        divergence: div(K grad u); derived from u by default.
        diffusion, reaction: K and c.
        dirichlet: The other sides with Dirichlet data; all other ones without Neumann data.
        neumann: The sides with Neumann data.
        robin: Sides with K grad u . n + k u given, and k.
        flux: K grad u . n of sides where it is known by hand.
        pressure, gap: p and u - g on the contact side; p = K grad u . n and 0 by default, for an
            obstacle below or above u as the sign of p tells.
        upper: Whether the obstacle is above u.
        scale: The length at which u changes, at every point, for the evaluation of the truth.
        exponent: u is like r^exponent at its worst point.
        codimension: The dimension of the space in which r is a distance.
        told: Whether the problem goes to the program as a scene file, and not as UFL.
    """

    what: str
    u: Any
    domain: Domain
    contact: str
    divergence: Any = None
    diffusion: Any = 1
    reaction: Any = 1
    neumann: tuple[str, ...] = ()
    robin: Mapping[str, Any] = field(default_factory=dict)
    flux: Mapping[str, Any] = field(default_factory=dict)
    pressure: Any = None
    gap: Any = 0
    upper: bool = False
    scale: Any = 1
    exponent: float = math.inf
    codimension: int = 2
    told: bool = True

    @property
    def coordinates(self) -> tuple[Any, ...]:
        return COORDINATES[: self.domain.dimension]

    @property
    def dirichlet(self) -> tuple[str, ...]:
        other = (self.contact, *self.neumann, *self.robin)
        return tuple(name for name in self.domain.sides if name not in other)

    def slopes(self) -> list[Any]:
        return [_smooth(sympy.diff(self.u, c)) for c in self.coordinates]

    def flux_through(self, side: str) -> Any:
        """K grad u . n."""
        if side in self.flux:
            return self.flux[side]
        normal = self.domain.normal(side)
        total = sum(float(n) * s for n, s in zip(normal, self.slopes(), strict=True) if n)
        return self.diffusion * total

    def load(self) -> Any:
        """The load f = -div(K grad u) + c u."""
        divergence = self.divergence
        if divergence is None:
            flux = [self.diffusion * s for s in self.slopes()]
            parts = zip(flux, self.coordinates, strict=True)
            divergence = sum(_smooth(sympy.diff(f, c)) for f, c in parts)
        return self.reaction * self.u - divergence

    @cached_property
    def data(self) -> Formulas:
        """What the program is told."""
        sides = {f"flux_{s}": self.flux_through(s) for s in (*self.neumann, *self.robin)}
        sides |= {f"robin_{s}": k for s, k in self.robin.items()}
        sides |= {f"given_{s}": sides[f"flux_{s}"] + k * self.u for s, k in self.robin.items()}
        if self.pressure is not None:
            sides["h"] = self.flux_through(self.contact) - self.pressure
        return Formulas(
            u=self.u if self.dirichlet else 0,
            load=self.load(),
            K=self.diffusion,
            c=self.reaction,
            g=self.u - self.gap,
            **sides,
        )

    @cached_property
    def truth(self) -> Formulas:
        """The solution with its slopes."""
        slopes = {f"d{k}": slope for k, slope in enumerate(self.slopes())}
        return Formulas(u=self.u, scale=self.scale, K=self.diffusion, **slopes)

    def text(self) -> str:
        """The scene file."""
        data, lines = self.data, []
        for side in self.dirichlet:
            lines += ["[[dirichlet]]", f'sides = "{side}"', f'value = "{data.texts["u"]}"']
        for side in self.neumann:
            lines += ["[[neumann]]", f'sides = "{side}"', f'flux = "{data.texts["flux_" + side]}"']
        return f"""
degree = 2
[domain]
{self.domain.table}
[define]
{data.define()}
[equation]
diffusion = "{data.texts["K"]}"
reaction = "{data.texts["c"]}"
load = "{data.texts["load"]}"
[contact]
sides = "{self.contact}"
obstacle = "{data.texts["g"]}"
bound = "{"upper" if self.upper else "lower"}"
{chr(10).join(lines)}
"""


def _smooth(expression: Any) -> Any:
    """Drop what derivatives of jumps add on curves: fluxes do not jump."""
    return expression.replace(sympy.DiracDelta, lambda *args: sympy.Integer(0))


def posed(rng: Rng, trial: Trial) -> Trial:
    """Return a trial with an obstacle of the right side.

    Where the flux of u changes its sign on the contact side, an interval of the side is in contact,
    with a pressure that is chosen, and a flux besides.
    """
    if trial.pressure is not None:
        return replace(trial, told=False)
    q = Formulas(q=trial.flux_through(trial.contact))
    values = q.arrays(trial.domain.places(trial.contact), "q")[0]
    small = 1e-9 * np.abs(values).max(initial=0.0)
    if values.min() >= -small:
        return trial
    if values.max() <= small:
        return replace(trial, upper=True)
    corners = trial.domain.sides[trial.contact]
    centre = corners[0] + _between(rng, 0.3, 0.7) * (corners[1] - corners[0])
    length = float(np.linalg.norm(corners[1] - corners[0]))
    half = _between(rng, 0.1, 0.4) * length
    pairs = zip(trial.coordinates[:2], centre[:2].tolist(), strict=True)
    s = 1 - sum((c - a) ** 2 for c, a in pairs) / half**2
    height = float(np.abs(values).max())
    return replace(
        trial, pressure=height * Max(s, 0), gap=height * half * Max(-s, 0) ** 2, told=False
    )


def _between(rng: Rng, low: float, high: float) -> float:
    return round(float(rng.uniform(low, high)), 6)


def _log_between(rng: Rng, low: float, high: float) -> float:
    return float(f"{math.exp(rng.uniform(math.log(low), math.log(high))):.4g}")


def _others(rng: Rng, domain: Domain, *used: str) -> list[str]:
    left = [s for s in domain.sides if s not in used]
    return [left[k] for k in rng.permutation(len(left))]


def _polar(centre: Sequence[float], axis: float) -> tuple[Any, Any]:
    """The distance from a point, and the angle to a direction, with the cut opposite to it."""
    a, b = x - centre[0], y - centre[1]
    c, s = math.cos(axis), math.sin(axis)
    return sqrt(a**2 + b**2), atan2(c * b - s * a, c * a + s * b)


def _above(a: Any, b: Any) -> Any:
    """The angle of (a, b) with b >= 0, without a cut at b = 0, where b may be -1e-18."""
    return sympy.pi / 2 - atan2(a, b)


def _on_side(rng: Rng, side: str, outside: float = 0.0) -> tuple[list[float], float]:
    """A point next to a side of the square, and the direction of the inner normal."""
    corners, n = SQUARE.sides[side], SQUARE.normal(side)
    point = corners[0] + _between(rng, 0.15, 0.85) * (corners[1] - corners[0]) + outside * n
    return [round(float(c), 9) for c in point], math.atan2(-n[1], -n[0])


def corner(rng: Rng) -> Trial:
    """r^alpha at a vertex: of the homogeneous conditions, or of the data."""
    opening = math.radians(
        _between(rng, 60.0, 150.0) if rng.random() < 0.4 else _between(rng, 190.0, 345.0)
    )
    domain = wedge_polygon(opening, float(rng.choice([0.0, _between(rng, 0.0, 6.0)])))
    first, last = "1", list(domain.sides)[-1]
    d = domain.sides[first][1]
    r, t = _polar((0.0, 0.0), math.atan2(d[1], d[0]) + opening / 2.0)
    kind = str(
        rng.choice(["same", "mixed", "data"] if opening > math.pi else ["mixed", "data", "data"])
    )
    angle, phase = t + opening / 2.0, 0.0
    alpha = {"same": math.pi / opening, "mixed": math.pi / 2.0 / opening}.get(kind)
    if alpha is None:
        alpha, phase = _between(rng, 0.3, 1.5), _between(rng, 0.0, 3.0)
    u = r**alpha * sin(alpha * angle + phase)
    mixed = kind == "mixed"
    return Trial(
        f"r^{alpha:.2f} at {math.degrees(opening):.0f} degrees, {kind}",
        float(rng.choice([1.0, -1.0])) * u,
        domain,
        contact=_others(rng, domain, first, last)[0],
        divergence=0,
        reaction=int(rng.integers(0, 2)),
        neumann=(last,) if mixed else (),
        flux={last: 0} if mixed else {},
        scale=r,
        exponent=min(alpha, math.pi / opening),  # what other data would leave there
    )


def off_vertex(rng: Rng) -> Trial:
    """r^alpha at a point of a Dirichlet side, or inside."""
    if rng.random() < 0.2:
        alpha, place = _between(rng, 1.05, 1.5), [_between(rng, 0.2, 0.8) for _ in range(2)]
        r, _ = _polar(place, 0.0)
        u, divergence = r**alpha, alpha**2 * r ** (alpha - 2)
        contact, what = _others(rng, SQUARE)[0], "inside"
    else:
        alpha = _between(rng, 0.3, 1.5)
        side = str(rng.choice(list(SQUARE.sides)))
        place, axis = _on_side(rng, side)
        r, t = _polar(place, axis)
        u, divergence = r**alpha * cos(alpha * t + _between(rng, -1.0, 1.0)), 0
        contact, what = _others(rng, SQUARE, side)[0], f"on the {side}"
    return Trial(
        f"r^{alpha:.2f} {what} at {place}", u, SQUARE, contact, divergence, scale=r, exponent=alpha
    )


def pole(rng: Rng) -> Trial:
    """log r or 1/r, with the pole outside at a small distance."""
    side, distance = str(rng.choice(list(SQUARE.sides))), _log_between(rng, 0.004, 0.2)
    place, axis = _on_side(rng, side, distance)
    r, _ = _polar(place, axis)
    kind = str(rng.choice(["log", "1/r"]))
    u, divergence = (-log(r), 0) if kind == "log" else (1 / r, 1 / r**3)
    role = str(rng.choice(["Dirichlet", "Dirichlet", "Neumann", "contact"]))
    contact, other = _others(rng, SQUARE, side)[:2]
    return Trial(
        f"{kind} at {distance:g} from the {side}, {role}",
        u,
        SQUARE,
        side if role == "contact" else contact,
        divergence,
        neumann={"Neumann": (side,), "contact": (other,)}.get(role, ()),
        scale=r,
    )


def window(rng: Rng) -> Trial:
    """A narrow feature: an interval in contact, or off contact, or a bump of pressure or load."""
    kind = str(rng.choice(["contact", "no contact", "pressure", "load", "bump at the side"]))
    width = _log_between(rng, 0.002, 0.1)
    a, k = _between(rng, 0.2, 0.8), width / 2.0
    d, common = x - a, {"contact": "bottom", "domain": SQUARE}
    if kind in ("contact", "no contact"):
        r1, r2 = sqrt((d - k) ** 2 + y**2), sqrt((d + k) ** 2 + y**2)
        t, m = (_above(d - k, y) + _above(d + k, y)) / 2, sqrt(r1 * r2)
        if kind == "contact":
            p, q = m * cos(t), m * sin(t)
            u = (d * p - y * q - k**2 * log(sqrt((d + p) ** 2 + (y + q) ** 2) / k)) / 2
        else:
            u = -(m**3) * sin(3 * t) / 3
        size = (r1 + r2 - Abs(r1 - r2)) / 2
        return Trial(
            f"{kind} of width {width:g}", u, divergence=0, gap=u, scale=size, exponent=1.5, **common
        )
    if kind == "pressure":
        u = cos(_between(rng, 1.0, 3.0) * x + 1) * exp(_between(rng, -1.0, 1.0) * y)
        bump = exp(-((d / width) ** 2)) * Heaviside(9 * width**2 - d**2)
        size = sqrt(d**2 + y**2 + width**2)
        height = _between(rng, 0.5, 2.0) / width
        gap = Max(d**2 - 9 * width**2, 0)
        return Trial(
            f"{kind} of width {width:g}", u, pressure=height * bump, gap=gap, scale=size, **common
        )
    b = _between(rng, 0.2, 0.8) if kind == "load" else -_between(rng, 0.1, 0.7) * width
    square = d**2 + (y - b) ** 2
    u = exp(-square / width**2)
    return Trial(f"{kind} of width {width:g}", u, scale=sqrt(square + width**2), **common)


def _curve(rng: Rng) -> tuple[Any, str]:
    """A level set function of a line or a circle through the square."""
    kind = str(rng.choice(["line along the mesh", "line", "circle"]))
    a, b = _between(rng, 0.25, 0.75), _between(rng, 0.25, 0.75)
    if kind == "line along the mesh":
        return x - a, kind
    if kind == "line":
        angle = _between(rng, 0.0, 3.1)
        return round(math.cos(angle), 6) * (x - a) + round(math.sin(angle), 6) * (y - b), kind
    return (x - a) ** 2 + (y - b) ** 2 - _between(rng, 0.15, 0.45) ** 2, kind


def _wave(rng: Rng) -> Any:
    """A smooth function, between 0.5 and about 4."""
    phase = _between(rng, 0.0, 6.0)
    return exp(_between(rng, -0.7, 0.7) * x) * (
        1 + 0.5 * sin(_between(rng, 1.0, 4.0) * y + _between(rng, 1.0, 4.0) * x + phase)
    )


def kink(rng: Rng) -> Trial:
    """A kink: of the obstacle, of Dirichlet data, or of the load."""
    kind = str(rng.choice(["obstacle", "Dirichlet data", "load"]))
    if kind == "load":
        s, curve = _curve(rng)
        contact = _others(rng, SQUARE)[0]
        u = _between(rng, 1.0, 5.0) * Abs(s) ** 3 * _wave(rng) + _wave(rng)
        return Trial(f"{kind}, {curve}", u, SQUARE, contact)
    a = _between(rng, 0.2, 0.8)
    d, r = x - a, sqrt((x - a) ** 2 + y**2)
    u = y * log(r) + d * _above(d, y) - _between(rng, 1.5, 2.5) * y
    contact = "bottom" if kind == "obstacle" else "top"
    if kind == "Dirichlet data":
        u = -u
    return Trial(f"{kind} at {a}", u, SQUARE, contact, 0, scale=r, exponent=1.0)


def jump(rng: Rng) -> Trial:
    """A load, a diffusion or a reaction that jumps across a curve."""
    kind = str(rng.choice(["load", "diffusion", "reaction"]))
    s, curve = _curve(rng)
    contact = _others(rng, SQUARE)[0]
    what = f"{kind}, {curve}"
    if kind == "load":
        u = _between(rng, 2.0, 10.0) * Max(s, 0) ** 2 * _wave(rng) + _wave(rng)
        return Trial(what, u, SQUARE, contact)
    if kind == "reaction":
        c = 1 + _log_between(rng, 3.0, 300.0) * Heaviside(s)
        return Trial(what, _wave(rng), SQUARE, contact, reaction=c)
    ratio = _log_between(rng, 3.0, 1000.0) ** float(rng.choice([1, -1]))
    high, wave = 1 + (ratio - 1) * Heaviside(s), _wave(rng)
    w, u = s * wave, (s + (1 / ratio - 1) * Max(s, 0)) * wave
    flat = sum(sympy.diff(w, c, 2) for c in (x, y))
    normals = {name: SQUARE.normal(name) for name in SQUARE.sides}
    flux = {
        name: float(n[0]) * sympy.diff(w, x) + float(n[1]) * sympy.diff(w, y)
        for name, n in normals.items()
    }
    # Next to a curve that facets follow, derivatives are wrong by their jump on any mesh.
    alpha = 1.0 if curve == "circle" else math.inf
    return Trial(f"{what}, {ratio:.3g}", u, SQUARE, contact, flat, high, flux=flux, exponent=alpha)


def layer(rng: Rng) -> Trial:
    """A boundary layer, exponential or like tanh, at a side of any kind."""
    width = _log_between(rng, 0.001, 0.05)
    kind = str(rng.choice(["exp", "tanh"]))
    side = str(rng.choice(list(SQUARE.sides)))
    d = {"left": x, "right": 1 - x, "bottom": y, "top": 1 - y}[side]
    along = y if side in ("left", "right") else x
    role = str(rng.choice(["Dirichlet", "contact"]))
    contact, other = _others(rng, SQUARE, side)[:2]
    common = {"domain": SQUARE, "contact": side if role == "contact" else contact}
    what = f"{kind}, width {width:g}, {role} {side}"
    if kind == "exp":
        rate = round(1.0 / width)  # of a float SymPy would split the exponential
        u = exp(-rate * d) * (1 + _between(rng, 0.0, 0.9) * sin(3 * along))
        reaction = rate**2
    else:
        u, reaction = tanh(d / width) + _wave(rng), 1
    return Trial(what, u, reaction=reaction, scale=d + width, neumann=(other,), **common)


def front(rng: Rng) -> Trial:
    """A front inside: atan of the distance from a circle or a line."""
    width = _log_between(rng, 0.003, 0.05)
    s, curve = _curve(rng)
    if curve == "circle":
        centre, radius = [_between(rng, -0.2, 0.6) for _ in range(2)], _between(rng, 0.5, 0.8)
        s = sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2) - radius
    contact = _others(rng, SQUARE)[0]
    scale = sqrt(s**2 + width**2)
    return Trial(f"width {width:g}, {curve}", atan(s / width), SQUARE, contact, scale=scale)


def own_forms(rng: Rng) -> Trial:
    """Forms in UFL: variable diffusion and reaction, a Robin side, partial contact."""
    contact, robin, neumann = _others(rng, SQUARE)[:3]
    K = 1 + _between(rng, 0.1, 0.9) * sin(_between(rng, 1.0, 6.0) * x + _between(rng, 1.0, 6.0) * y)
    c = 1 + _between(rng, 0.0, 5.0) * x * y
    rough = str(rng.choice(["smooth", "bump", "r^alpha"]))
    u, scale, alpha, what = _wave(rng), 1, math.inf, rough
    if rough == "bump":
        width = _log_between(rng, 0.02, 0.2)
        square = (x - _between(rng, 0.2, 0.8)) ** 2 + (y - _between(rng, 0.2, 0.8)) ** 2
        u, scale, what = u + exp(-square / width**2), sqrt(square + width**2), f"bump {width:g}"
    if rough == "r^alpha":
        alpha = _between(rng, 1.2, 1.5)
        side = next(s for s in SQUARE.sides if s not in (contact, robin, neumann))
        place, axis = _on_side(rng, side)
        scale, t = _polar(place, axis)
        u, what = u + scale**alpha * cos(alpha * t), f"r^{alpha:.2f} on the {side}"
    t = x if contact in ("bottom", "top") else y
    half = _between(rng, 0.05, 0.35)
    s = 1 - ((t - _between(rng, 0.3, 0.7)) / half) ** 2
    power = int(rng.integers(1, 3))
    return Trial(
        f"{what}, contact of width {2 * half:g}, pressure like d^{power}",
        u,
        SQUARE,
        contact,
        diffusion=K,
        reaction=c,
        neumann=(neumann,),
        robin={robin: _between(rng, 0.5, 5.0)},
        pressure=_between(rng, 1.0, 5.0) * Max(s, 0) ** power,
        gap=half * Max(-s, 0) ** 2,
        scale=scale,
        exponent=alpha,
    )


def space(rng: Rng) -> Trial:
    """A cube: smooth, with a singular edge or line, a bump, or partial contact."""
    kind = str(rng.choice(["smooth", "edge", "bump", "contact"]))
    contact, other = _others(rng, CUBE)[:2]
    wave = exp(_between(rng, -0.7, 0.7) * x) * (
        1 + 0.5 * sin(_between(rng, 1.0, 3.0) * y + _between(rng, 1.0, 3.0) * z)
    )
    if kind == "edge":
        alpha = _between(rng, 0.4, 1.4)
        r, t = sqrt(x**2 + z**2), atan2(z, x)
        u = r**alpha * sin(alpha * t + _between(rng, 0.0, 1.0)) * (1 + _between(rng, 0.0, 0.5) * y)
        side = str(rng.choice(["right", "top", "front", "back"]))
        return Trial(f"{kind}, r^{alpha:.2f}", u, CUBE, side, 0, scale=r + 0.003, exponent=alpha)
    if kind == "bump":
        width, place = _log_between(rng, 0.08, 0.3), [_between(rng, 0.2, 0.8) for _ in range(3)]
        square = sum((c - a) ** 2 for c, a in zip(COORDINATES, place, strict=True))
        u, scale = exp(-square / width**2), sqrt(square + width**2)
        return Trial(f"{kind} of width {width:g}", u, CUBE, contact, neumann=(other,), scale=scale)
    if kind == "contact":
        s = 1 - ((x - 0.5) ** 2 + (y - _between(rng, 0.3, 0.7)) ** 2) / _between(rng, 0.2, 0.5) ** 2
        return Trial(
            kind,
            wave,
            CUBE,
            "bottom",
            neumann=("left",),
            pressure=3 * Max(s, 0),
            gap=Max(-s, 0) ** 2,
        )
    return Trial(kind, wave, CUBE, contact, neumann=(other,))


FAMILIES: dict[str, Callable[[Rng], Trial]] = {
    "corner": corner,
    "off_vertex": off_vertex,
    "pole": pole,
    "window": window,
    "kink": kink,
    "layer": layer,
    "front": front,
    "jump": jump,
    "ufl": own_forms,
    "space": space,
}
