"""Formulas in x, y and z: trees of operations, and what the operations mean in UFL."""

import ast
import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt
import ufl
from ufl.core.expr import Expr

from dolfinx_signorini.base.errors import InputError

COORDINATES = ("x", "y", "z")
COMPARISONS = ("<", "<=", ">", ">=")
CONSTANTS = {"pi": math.pi}
# For each name: the number of arguments, the function of floats, and the function of UFL.
FUNCTIONS: dict[str, tuple[int, Callable[..., float], Callable[..., Expr]]] = {
    name: (1, getattr(math, name), getattr(ufl, name))
    for name in "sqrt exp sin cos tan asin acos atan sinh cosh tanh".split()  # noqa: SIM905
} | {
    "log": (1, math.log, ufl.ln),
    "abs": (1, abs, abs),
    "sign": (1, lambda a: math.copysign(1.0, a) if a else 0.0, ufl.sign),
    "atan2": (2, math.atan2, ufl.atan2),
    "hypot": (2, math.hypot, lambda a, b: ufl.sqrt(a * a + b * b)),
    "min": (2, min, ufl.min_value),
    "max": (2, max, ufl.max_value),
    "where": (3, lambda c, a, b: a if c else b, ufl.conditional),
}
# For each operator of Python's syntax trees: its sign, and the same two functions.
OPERATORS: dict[type[ast.AST], tuple[str, Callable[..., float], Callable[..., Expr]]] = {
    ast.USub: ("negative", operator.neg, operator.neg),
    ast.Add: ("+", operator.add, operator.add),
    ast.Sub: ("-", operator.sub, operator.sub),
    ast.Mult: ("*", operator.mul, operator.mul),
    ast.Div: ("/", operator.truediv, operator.truediv),
    ast.Pow: ("^", math.pow, operator.pow),
    ast.Lt: ("<", operator.lt, ufl.lt),
    ast.LtE: ("<=", operator.le, ufl.le),
    ast.Gt: (">", operator.gt, ufl.gt),
    ast.GtE: (">=", operator.ge, ufl.ge),
}
NAMES = {
    "asin": "arcsin",
    "acos": "arccos",
    "atan": "arctan",
    "atan2": "arctan2",
    "min": "minimum",
    "max": "maximum",
    "+": "add",
    "-": "subtract",
    "*": "multiply",
    "/": "divide",
    "^": "power",
    "<": "less",
    "<=": "less_equal",
    ">": "greater",
    ">=": "greater_equal",
}  # of operations in NumPy, where they differ
OPERATIONS = {name: functions for name, (_, *functions) in FUNCTIONS.items()}
OPERATIONS |= {sign: functions for sign, *functions in OPERATORS.values()}

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Node:
    """One operation of a formula, equal to nothing but to this very operation.

    For example, the product of 2 and the first coordinate:

        Node("*", (Node("number", value=2.0), Node("coordinate", value=0)))
        number(2.0).root * Node("coordinate", value=0)

    The operators of Python leave out what 0 and 1 make needless, and calculate with numbers.

    Attributes:
        op: "number", "coordinate", or the name of an operator or a function.
        args: The operands.
        value: The number, or the index of the coordinate.
        size: The number of nodes of the tree, shared nodes counted at every use.
        depth: The number of levels of the tree.
    """

    op: str
    args: tuple["Node", ...] = ()
    value: float = 0.0
    size: int = field(init=False)
    depth: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", 1 + sum(a.size for a in self.args))
        object.__setattr__(self, "depth", 1 + max((a.depth for a in self.args), default=0))

    def __neg__(self) -> "Node":
        return self.args[0] if self.op == "negative" else _made("negative", self)

    def __add__(self, other: "Node") -> "Node":
        if self.is_number(0.0) or other.is_number(0.0):
            return other if self.is_number(0.0) else self
        return self - other.args[0] if other.op == "negative" else _made("+", self, other)

    def __sub__(self, other: "Node") -> "Node":
        if self.is_number(0.0) or other.is_number(0.0):
            return -other if self.is_number(0.0) else self
        return self + other.args[0] if other.op == "negative" else _made("-", self, other)

    def __mul__(self, other: "Node") -> "Node":
        for a, b in ((self, other), (other, self)):
            if a.is_number(0.0) or b.is_number(1.0):
                return a
            if b.is_number(-1.0):
                return -a
        return _made("*", self, other)

    def __truediv__(self, other: "Node") -> "Node":
        return self if self.is_number(0.0) or other.is_number(1.0) else _made("/", self, other)

    def __pow__(self, exponent: float) -> "Node":
        if exponent in (0.0, 1.0):
            return self if exponent else number(1.0).root
        return _made("^", self, number(exponent).root)

    def is_number(self, value: float) -> bool:
        """Return whether this is a certain number."""
        return self.op == "number" and self.value == value


class PerNode(ABC, Generic[T]):
    """What is found for the nodes of trees, for a node that is used twice only once.

    For example, the number of levels below each node:

        class Levels(PerNode[int]):
            def find(self, node: Node) -> int:
                return max((1 + self(a) for a in node.args), default=0)

        levels = Levels()(formula.root)
    """

    def __init__(self) -> None:
        self._done: dict[Node, T] = {}

    def __call__(self, node: Node) -> T:
        """Return what is found for a node."""
        if node not in self._done:
            self._done[node] = self.find(node)
        return self._done[node]

    @abstractmethod
    def find(self, node: Node) -> T:
        """Find the result for a node that is new, from the results for the operands."""


def nodes(root: Node) -> list[Node]:
    """Return the nodes of a tree, each of them once, and after all of its operands."""
    found: dict[Node, None] = {}

    def visit(node: Node) -> None:
        if node not in found:
            for argument in node.args:
                visit(argument)
            found[node] = None

    visit(root)
    return list(found)


@dataclass(frozen=True)
class Formula:
    """A formula in the coordinates.

    For example:

        load = parse("sin(pi*x) * y^2")
        L = load.ufl(ufl.SpatialCoordinate(domain)) * v * ufl.dx

    Attributes:
        text: The formula as text.
        root: The formula as a tree.
    """

    text: str
    root: Node

    @property
    def constant(self) -> float | None:
        """The value of a formula that does not depend on the coordinates; None for others."""
        return self.root.value if self.root.op == "number" else None

    def value(self, point: Sequence[float]) -> float:
        """Return the value at a point; NaN where there is none."""
        try:
            return float(_value(self.root, point))
        except (ArithmeticError, ValueError):
            return math.nan

    def ufl(self, x: Expr) -> Expr:
        """Return the formula as a UFL expression of the coordinates x, a UFL vector.

        Raises:
            InputError: A part of the formula has no value anywhere, for example 1/(0*x).
        """
        try:
            return ufl.as_ufl(_Values(x, lambda op: OPERATIONS[op][1])(self.root))
        except (ArithmeticError, TypeError, ValueError) as error:
            raise InputError(str(error), shortened(self.text)) from None


def number(value: float) -> Formula:
    """Return a constant as a formula."""
    return Formula(repr(float(value)).removesuffix(".0"), Node("number", value=float(value)))


def folded(op: str, *args: Node) -> Node:
    """Return an operation, or of numbers the number.

    Args:
        op: The name of the operation.
        args: The operands.

    Raises:
        ArithmeticError: The operation has no finite value.
    """
    if op in COMPARISONS or any(a.op != "number" for a in args):
        return Node(op, args)
    try:
        value = float(OPERATIONS[op][0](*(a.value for a in args)))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ArithmeticError
    return Node("number", value=value)


def _made(op: str, *args: Node) -> Node:
    """An operation, or of numbers the number if that is finite."""
    try:
        return folded(op, *args)
    except ArithmeticError:
        return Node(op, args)


def evaluated(node: Node, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the values of a formula's tree at many points; NaN or infinity where there is none.

    Args:
        node: The root of the tree.
        x: The points, shape (..., dimension).
    """
    with np.errstate(all="ignore"):
        coordinates = np.moveaxis(x, -1, 0)
        values = _Values(coordinates, lambda op: getattr(np, NAMES.get(op, op)))(node)
    return np.broadcast_to(np.asarray(values, dtype=np.float64), x.shape[:-1])


def shortened(text: str) -> str:
    """Return a text for a message: in quotes, and cut to 60 characters."""
    return repr(text if len(text) <= 60 else text[:57] + "...")


def _value(node: Node, point: Sequence[float]) -> Any:
    if node.op == "number":
        return node.value
    if node.op == "coordinate":
        return point[int(node.value)]
    if node.op == "where":
        return _value(node.args[1 if _value(node.args[0], point) else 2], point)
    return OPERATIONS[node.op][0](*(_value(a, point) for a in node.args))


class _Values(PerNode[Any]):
    """The values of the nodes of a formula, of UFL or of NumPy.

    Args:
        coordinates: The values of x, y and z.
        functions: The function of each operation.
    """

    def __init__(self, coordinates: Any, functions: Callable[[str], Callable[..., Any]]):
        super().__init__()
        self.coordinates, self.functions = coordinates, functions

    def find(self, node: Node) -> Any:
        if node.op == "number":
            return node.value
        if node.op == "coordinate":
            return self.coordinates[int(node.value)]
        return self.functions(node.op)(*map(self, node.args))
