"""Formulas as trees of operations, and what they are in UFL; `grammar` reads them from text."""

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import ufl
from ufl.core.expr import Expr

from dolfinx_signorini.errors import InputError

# name: (number of arguments, value for floats, UFL)
FUNCTIONS: dict[str, tuple[int, Callable[..., float], Callable[..., Expr]]] = {
    "sqrt": (1, math.sqrt, ufl.sqrt),
    "exp": (1, math.exp, ufl.exp),
    "log": (1, math.log, ufl.ln),
    "sin": (1, math.sin, ufl.sin),
    "cos": (1, math.cos, ufl.cos),
    "tan": (1, math.tan, ufl.tan),
    "asin": (1, math.asin, ufl.asin),
    "acos": (1, math.acos, ufl.acos),
    "atan": (1, math.atan, ufl.atan),
    "sinh": (1, math.sinh, ufl.sinh),
    "cosh": (1, math.cosh, ufl.cosh),
    "tanh": (1, math.tanh, ufl.tanh),
    "abs": (1, abs, abs),
    "sign": (1, lambda a: math.copysign(1.0, a) if a else 0.0, ufl.sign),
    "atan2": (2, math.atan2, ufl.atan2),
    "hypot": (2, math.hypot, lambda a, b: ufl.sqrt(a * a + b * b)),
    "min": (2, min, ufl.min_value),
    "max": (2, max, ufl.max_value),
}
OPERATORS: dict[str, tuple[Callable[..., float], Callable[..., Expr]]] = {
    "+": (operator.add, operator.add),
    "-": (operator.sub, operator.sub),
    "*": (operator.mul, operator.mul),
    "/": (operator.truediv, operator.truediv),
    "^": (math.pow, operator.pow),
    "negative": (operator.neg, operator.neg),
    "<": (operator.lt, ufl.lt),
    "<=": (operator.le, ufl.le),
    ">": (operator.gt, ufl.gt),
    ">=": (operator.ge, ufl.ge),
    "where": (lambda c, a, b: a if c else b, ufl.conditional),
}
COMPARISONS = ("<", "<=", ">", ">=")
COORDINATES = ("x", "y", "z")
CONSTANTS = {"pi": math.pi}


@dataclass(frozen=True, eq=False)
class Node:
    """One operation of a formula.

    Attributes:
        op: "number", "coordinate", an operator or a function.
        args: The operands.
        value: The number, or the index of the coordinate.
        size, depth: Of the tree below, shared parts counted as often as they are used.
    """

    op: str
    args: tuple["Node", ...] = ()
    value: float = 0.0
    size: int = field(init=False)
    depth: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", 1 + sum(a.size for a in self.args))
        object.__setattr__(self, "depth", 1 + max((a.depth for a in self.args), default=0))


@dataclass(frozen=True)
class Expression:
    """A formula.

    Attributes:
        text: As it was written.
        root: What it says.
    """

    text: str
    root: Node

    @property
    def constant(self) -> float | None:
        """The value, if the formula does not depend on the coordinates."""
        return self.root.value if self.root.op == "number" else None

    def ufl(self, x: Expr) -> Expr:
        """Return the formula at the coordinates x, a UFL vector.

        Raises:
            InputError: A part has no value anywhere, for example 1/(0*x).
        """
        try:
            return ufl.as_ufl(_build(self.root, x, {}))
        except (ArithmeticError, TypeError, ValueError) as error:
            raise InputError(f"{shortened(self.text)}: {error}") from None


def number(value: float) -> Expression:
    """Return a constant as a formula."""
    return Expression(f"{value:.17g}", Node("number", value=float(value)))


def shortened(text: str) -> str:
    """Return a text for a message."""
    return repr(text if len(text) <= 60 else text[:57] + "...")


def operation(op: str) -> tuple[Callable[..., float], Callable[..., Expr]]:
    """Return what an operation does to numbers, and to UFL."""
    return OPERATORS[op] if op in OPERATORS else FUNCTIONS[op][1:]


def _build(node: Node, x: Expr, done: dict[int, Any]) -> Any:
    """Build UFL, a shared part once."""
    if id(node) not in done:
        if node.op == "number":
            done[id(node)] = node.value
        elif node.op == "coordinate":
            done[id(node)] = x[int(node.value)]
        else:
            done[id(node)] = operation(node.op)[1](*(_build(a, x, done) for a in node.args))
    return done[id(node)]


def any_variable(expressions: Sequence[Expression]) -> bool:
    """Return whether one of the formulas depends on the coordinates."""
    return any(e.constant is None for e in expressions)
