"""The operations of formulas: one entry says all that is known of an operation.

Operators of Python mean the same for floats, UFL, NumPy, intervals and discs. Functions name what
they are of each. Derivatives are written once, for trees and intervals, and enclose functions of
discs that have no form of their own. To add an operation is to add an entry.
"""

import ast
import math
import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from scipy import special

from dolfinx_signorini.base.arrays import Mask
from dolfinx_signorini.data.discs import COSH, COSINE, SINE, SINH, exponential, logarithm, root
from dolfinx_signorini.data.intervals import (
    Interval,
    angle,
    choose,
    cut,
    increasing,
    length,
    outward,
    tangent,
    wave,
)

Function = Callable[..., Any]
LINE, POSITIVE = (-math.inf, math.inf), (0.0, math.inf)  # where functions have values


@dataclass(frozen=True, eq=False)
class Operation:
    """What is known of an operation:

        slope = OPERATIONS["sin"].slope(sine, angle, change_of_angle)

    Attributes:
        value: The function of floats.
        slope: The derivative, by the value, the operands, and their derivatives: trees or
            intervals.
        arguments: The number of operands.
        syntax: The class of an operator in Python's syntax trees.
        ufl, numpy, interval, disc: The function of such numbers, by default that of floats. Without
            one of discs, these are enclosed by the derivative, which is then one of the operands.
        limits: Where the domain of the first operand begins and ends.
        degree: The degree of a polynomial by those of the operands, where it is one.
        vanishes: "with" the first operand, "never", or "" otherwise.
        even: Whether for a and -a there is one value, and none is negative; by the exponent.
        switch: What decides by its sign what is chosen, a tree, by the operands.
        branches: What is chosen for a positive sign, and for a negative one.
        breaks: Whether the values may jump inside of intervals of the operands.
    """

    value: Function
    slope: Function
    arguments: int = 1
    syntax: type[ast.AST] | None = None
    ufl: Function | None = None
    numpy: Function | None = None
    interval: Function | None = None
    disc: Function | None = None
    limits: tuple[float, float] = LINE
    degree: Function = lambda *_: None
    vanishes: str = ""
    even: Function = lambda *_: False
    switch: Function | None = None
    branches: Function | None = None
    breaks: Function | None = None

    def of(self, kind: str) -> Function:
        """Return the function of numbers of a kind: "ufl", "numpy", "interval" or "disc"."""
        return getattr(self, kind) or self.value

    def jumps(self, *operands: Interval) -> Mask:
        """Return whether the values may jump inside of intervals of the operands."""
        return np.asarray(self.breaks is not None and self.breaks(*operands))


def applied(name: str, *operands: Any) -> Any:
    """Return an operation on trees, intervals or discs."""
    last = operands[-1]
    if last.kind == "tree":
        return last.made(name, *operands)
    return OPERATIONS[name].of(last.kind)(*operands)


def _function(
    name: str, slope: Function, interval: Function, disc: Function | None = None, **more: Any
) -> Operation:
    """A function of one operand with the same name everywhere, but where named otherwise."""
    for module in (ufl, np):
        more.setdefault(module.__name__, getattr(module, name, None))

    def chain(v: Any, a: Any, da: Any) -> Any:
        return slope(v, a) * da

    return Operation(getattr(math, name), chain, interval=interval, disc=disc, **more)


def _increasing(
    name: str, function: Function, slope: Function, disc: Function | None = None, **more: Any
) -> Operation:
    """The same for a function of NumPy that is increasing between its limits, if any."""
    interval = increasing(function, *more.get("limits", LINE))
    return _function(name, slope, interval, disc, numpy=function, **more)


def _operator(value: Function, syntax: type[ast.AST], slope: Function, **more: Any) -> Operation:
    return Operation(value, slope, 2, syntax, **{"disc": value} | more)


def _comparison(value: Function, syntax: type[ast.AST], of_ufl: Function) -> Operation:
    return Operation(value, lambda v, a, b, da, db: 0.0 * da, 2, syntax, ufl=of_ufl)


def _extremum(
    value: Function, of_ufl: Function, of_numpy: Function, first: Function, branches: Function
) -> Operation:
    """The minimum or maximum, which is a where a and b compare like this."""
    return Operation(
        value,
        lambda v, a, b, da, db: applied("where", first(a, b), da, db),
        2,
        ufl=of_ufl,
        numpy=of_numpy,
        interval=lambda a, b: Interval(of_numpy(a.ends, b.ends)),
        degree=_greatest,
        switch=operator.sub,
        branches=branches,
    )


def _of_arcsine(a: Any) -> Any:
    return 1.0 / applied("sqrt", 1.0 - a**2.0)


def _share(a: Any, distance: Any) -> Any:
    """a over the length of a vector with the component a."""
    share = a / distance
    return Interval(np.clip(share.ends, -1.0, 1.0)) if share.kind == "interval" else share


def _turn(v: Any, a: Any, b: Any, da: Any, db: Any) -> Any:
    """The derivative of the angle of (b, a)."""
    square = a**2.0 + b**2.0 if a.kind == "disc" else applied("hypot", a, b) ** 2.0
    return (b * da - a * db) / square


def _greatest(*degrees: int) -> int:
    return max(degrees)


OPERATIONS = {
    "+": _operator(operator.add, ast.Add, lambda v, a, b, da, db: da + db, degree=_greatest),
    "-": _operator(operator.sub, ast.Sub, lambda v, a, b, da, db: da - db, degree=_greatest),
    "*": _operator(
        operator.mul,
        ast.Mult,
        lambda v, a, b, da, db: a * db + da * b,
        degree=operator.add,
    ),
    "/": _operator(
        operator.truediv,
        ast.Div,
        lambda v, a, b, da, db: (da - v * db) / b,
        degree=lambda n, k: None if k else n,
    ),
    "^": _operator(
        math.pow,
        ast.Pow,
        lambda v, a, n, da: n * a ** (n - 1.0) * da if n else 0.0 * da,
        degree=lambda n, k: n * int(k) if k >= 0.0 and k % 1.0 == 0.0 else None,
        vanishes="with",
        even=lambda n: n % 2.0 == 0.0,
        **dict.fromkeys(("ufl", "numpy", "interval", "disc"), operator.pow),
    ),
    "negative": Operation(
        operator.neg,
        lambda v, a, da: -da,
        syntax=ast.USub,
        disc=operator.neg,
        degree=_greatest,
        vanishes="with",
    ),
    "<": _comparison(operator.lt, ast.Lt, ufl.lt),
    "<=": _comparison(operator.le, ast.LtE, ufl.le),
    ">": _comparison(operator.gt, ast.Gt, ufl.gt),
    ">=": _comparison(operator.ge, ast.GtE, ufl.ge),
    "sqrt": _increasing(
        "sqrt", np.sqrt, lambda v, a: 0.5 / v, root, limits=POSITIVE, vanishes="with"
    ),
    "exp": _increasing("exp", np.exp, lambda v, a: v, exponential, vanishes="never"),
    "log": _increasing("log", np.log, lambda v, a: 1.0 / a, logarithm, ufl=ufl.ln, limits=POSITIVE),
    "sin": _function("sin", lambda v, a: applied("cos", a), wave(np.sin, 0.5 * math.pi), SINE),
    "cos": _function("cos", lambda v, a: -applied("sin", a), wave(np.cos, 0.0), COSINE),
    "tan": _function("tan", lambda v, a: 1.0 + v**2.0, tangent, lambda a: SINE(a) / COSINE(a)),
    "asin": _increasing("asin", np.arcsin, lambda v, a: _of_arcsine(a), limits=(-1.0, 1.0)),
    "acos": _function(
        "acos",
        lambda v, a: -_of_arcsine(a),
        lambda a: -increasing(lambda b: -np.arccos(b), -1.0, 1.0)(a),
        numpy=np.arccos,
        limits=(-1.0, 1.0),
    ),
    "atan": _increasing("atan", np.arctan, lambda v, a: 1.0 / (1.0 + a**2.0)),
    "sinh": _increasing("sinh", np.sinh, lambda v, a: applied("cosh", a), SINH),
    "cosh": _function(
        "cosh",
        lambda v, a: applied("sinh", a),
        lambda a: outward(*np.cosh(abs(a).ends)),
        COSH,
        vanishes="never",
    ),
    "tanh": _increasing("tanh", np.tanh, lambda v, a: 1.0 - v**2.0, lambda a: SINH(a) / COSH(a)),
    "abs": Operation(
        abs,
        lambda v, a, da: applied("sign", a) * da,
        degree=_greatest,
        vanishes="with",
        even=lambda: True,
        switch=lambda a: a,
        branches=lambda a: (a, -a),
    ),
    "sign": Operation(
        lambda a: math.copysign(1.0, a) if a else 0.0,
        lambda v, a, da: 0.0 * da,
        ufl=ufl.sign,
        numpy=np.sign,
        interval=lambda a: Interval(np.sign(a.ends)),
        switch=lambda a: a,
        branches=lambda a: (a.like(1.0), a.like(-1.0)),
        breaks=lambda a: a.contains(0.0),
    ),
    "atan2": Operation(
        math.atan2, _turn, 2, ufl=ufl.atan2, numpy=np.arctan2, interval=angle, breaks=cut
    ),
    "hypot": Operation(
        math.hypot,
        lambda v, a, b, da, db: _share(a, v) * da + _share(b, v) * db,
        2,
        ufl=lambda a, b: ufl.sqrt(a * a + b * b),
        numpy=np.hypot,
        interval=length,
        disc=lambda a, b: root(a**2.0 + b**2.0),
        even=lambda: True,
    ),
    "min": _extremum(min, ufl.min_value, np.minimum, operator.lt, lambda a, b: (b, a)),
    "max": _extremum(max, ufl.max_value, np.maximum, operator.gt, lambda a, b: (a, b)),
    "where": Operation(
        lambda c, a, b: a if c else b,
        lambda v, c, a, b, dc, da, db: applied("where", c, da, db),
        3,
        ufl=ufl.conditional,
        numpy=np.where,
        interval=choose,
        degree=_greatest,  # of what is chosen
        switch=lambda c, a, b: c.args[0] - c.args[1],
        branches=lambda c, a, b: (a, b) if c.op in (">", ">=") else (b, a),
        breaks=lambda c, a, b: c.low != c.high,
    ),
}
COMPARISONS = ("<", "<=", ">", ">=")
FUNCTIONS = {op: known for op, known in OPERATIONS.items() if not known.syntax}
# Functions whose values alone are known: of formulas with them nothing is enclosed or derived.
VALUES_ALONE = {
    name: Operation(getattr(special, name), lambda *_: None)
    for name in ("erf", "jv", "yv", "iv", "kv")
}
