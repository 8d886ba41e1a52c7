"""Formulas in x, y and z: trees of operations."""

import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, TypeVar
from weakref import WeakValueDictionary

import numpy as np
import numpy.typing as npt
import ufl
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.data.arithmetic import Number
from dolfinx_signorini.data.operations import (
    COMPARISONS,
    LINE,
    OPERATIONS,
    POSITIVE,
    VALUES_ALONE,
    Operation,
)

COORDINATES = ("x", "y", "z")
CONSTANTS = {"pi": math.pi}

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Node(Number):
    """One operation of a formula. There is one node for all equal trees:

        parse("x + 1").root is parse("x + 1").root

    For example, the product of 2 and the first coordinate:

        Node("*", (Node("number", value=2.0), Node("coordinate", value=0)))
        2.0 * Node("coordinate", value=0)

    The operators of Python leave out what 0 and 1 make needless, and calculate with numbers.

    Attributes:
        op: "number", "coordinate", or the name of an operation.
        args: The operands.
        value: The number, or the index of the coordinate.
        size: The number of nodes of the tree, shared nodes counted at every use.
        depth: The number of levels of the tree.
    """

    kind = "tree"
    op: str
    args: tuple["Node", ...] = ()
    value: float = 0.0
    size: int = field(init=False)
    depth: int = field(init=False)
    _known: ClassVar[WeakValueDictionary[tuple[object, ...], "Node"]] = WeakValueDictionary()

    def __new__(cls, op: str, args: tuple["Node", ...] = (), value: float = 0.0) -> "Node":
        key = op, args, value, math.copysign(1.0, value)  # -0.0 is not 0.0
        return cls._known.setdefault(key, super().__new__(cls))

    def __reduce__(self) -> tuple[Any, ...]:
        return Node, (self.op, self.args, self.value)

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", 1 + sum(a.size for a in self.args))
        object.__setattr__(self, "depth", 1 + max((a.depth for a in self.args), default=0))

    def like(self, value: float) -> "Node":
        """Return a number as a node."""
        return Node("number", value=float(value))

    @staticmethod
    def made(op: str, *args: "Node") -> "Node":
        """Return an operation, or of numbers the number if that is finite."""
        if op == "where" and args[1].op == "number" and args[2].is_number(args[1].value):
            return args[1]
        try:
            return folded(op, *args)
        except ArithmeticError:
            return Node(op, args)

    def __neg__(self) -> "Node":
        return self.args[0] if self.op == "negative" else self.made("negative", self)

    def __add__(self, other: "Node") -> "Node":
        if self.is_number(0.0) or other.is_number(0.0):
            return other if self.is_number(0.0) else self
        return self - other.args[0] if other.op == "negative" else self.made("+", self, other)

    def __sub__(self, other: "Node") -> "Node":
        if self.is_number(0.0) or other.is_number(0.0):
            return -other if self.is_number(0.0) else self
        return self + other.args[0] if other.op == "negative" else self.made("-", self, other)

    def __mul__(self, other: "Node") -> "Node":
        for a, b in ((self, other), (other, self)):
            if a.is_number(0.0) or b.is_number(1.0):
                return a
            if b.is_number(-1.0):
                return -a
        return self.made("*", self, other)

    def __truediv__(self, other: "Node") -> "Node":
        if self.is_number(0.0) or other.is_number(1.0):
            return self
        return self.made("/", self, other)

    def __pow__(self, exponent: float) -> "Node":
        if exponent in (0.0, 1.0):
            return self if exponent else self.like(1.0)
        return self.made("^", self, self.like(exponent))

    def __lt__(self, other: "Node") -> "Node":
        return Node("<", (self, other))

    def __gt__(self, other: "Node") -> "Node":
        return Node(">", (self, other))

    def is_number(self, value: float) -> bool:
        """Return whether this is a certain number."""
        return self.op == "number" and self.value == value

    @property
    def operation(self) -> Operation:
        """What is known of the operation."""
        return OPERATIONS.get(self.op) or VALUES_ALONE[self.op]

    @property
    def operands(self) -> tuple["Node", ...]:
        """The operands but for exponents."""
        return self.args[:1] if self.op == "^" else self.args

    @property
    def exponents(self) -> tuple[float, ...]:
        """The exponent of a power; nothing for other operations."""
        return (self.args[1].value,) if self.op == "^" else ()

    @property
    def limits(self) -> tuple[float, float]:
        """Where the domain of the first operand begins and ends."""
        if self.op == "^" and self.args[1].value % 1.0:
            return POSITIVE
        return self.operation.limits if self.args else LINE

    @functools.cached_property
    def switch(self) -> "Node | None":
        """What decides by its sign what the operation chooses; None for one without a choice."""
        known = OPERATIONS.get(self.op)
        return known.switch(*self.args) if known and known.switch else None

    def chosen(self, positive: bool) -> "Node":
        """Return what is chosen where the switch is positive, or negative."""
        assert self.operation.branches is not None
        branches: tuple[Node, Node] = self.operation.branches(*self.args)
        return branches[0 if positive else 1]


ZERO, ONE = Node("number"), Node("number", value=1.0)


def coordinates(first: int, shape: tuple[int, ...]) -> npt.NDArray[np.object_]:
    """Return coordinates from a number on, as an array of nodes."""
    every = range(first, first + math.prod(shape))
    return np.array([Node("coordinate", value=k) for k in every], dtype=object).reshape(shape)


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


class Values(PerNode[T]):
    """The values of the nodes of formulas in numbers of a kind:

    expression = Values("ufl", ufl.SpatialCoordinate(domain), float)(formula.root)

    Args:
        kind: The kind, see `Operation.of`.
        coordinates: The values of x, y and z.
        number: Returns such a number for a float.
    """

    def __init__(self, kind: str, coordinates: Sequence[T], number: Callable[[float], T]):
        super().__init__()
        self.kind, self.coordinates, self.number = kind, coordinates, number

    def find(self, node: Node) -> T:
        if node.op == "number":
            return self.number(node.value)
        if node.op == "coordinate":
            return self.coordinates[int(node.value)]
        function: Callable[..., T] = node.operation.of(self.kind)
        return function(*map(self, node.operands), *node.exponents)


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


def squares(node: Node) -> list[Node]:
    """Return a, b, ... of a sum a^2 + b^2 + ...; nothing for other nodes."""
    if node.op == "+":
        parts = [squares(a) for a in node.args]
        return [a for part in parts for a in part] if all(parts) else []
    if node.op == "*" and node.args[0] is node.args[1]:
        return [node.args[0]]
    return [node.args[0]] if node.op == "^" and node.args[1].value == 2.0 else []


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
        value = float(evaluated(self.root, np.asarray(point, dtype=np.float64)))
        return value if math.isfinite(value) else math.nan

    def ufl(self, x: Expr) -> Expr:
        """Return the formula as a UFL expression of the coordinates x, a UFL vector.

        Raises:
            InputError: A part of the formula has no value anywhere, for example 1/(0*x).
        """
        try:
            return ufl.as_ufl(Values("ufl", x, float)(self.root))
        except (ArithmeticError, TypeError, ValueError) as error:
            raise InputError(str(error), shortened(self.text)) from None


def number(value: float) -> Formula:
    """Return a constant as a formula."""
    return Formula(repr(float(value)).removesuffix(".0"), Node("number", value=float(value)))


def folded(op: str, *args: Node) -> Node:
    """Return an operation, or of numbers the number.

    Raises:
        ArithmeticError: The operation has no finite value.
    """
    if op in COMPARISONS or any(a.op != "number" for a in args):
        return Node(op, args)
    try:
        value = float(OPERATIONS[op].value(*(a.value for a in args)))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ArithmeticError
    return Node("number", value=value)


def evaluated(root: Node, x: Array) -> Array:
    """Return the values of a tree at points, shape (..., dimension); NaN or infinity for none."""
    return together([root], x)[0]


@np.errstate(all="ignore")
def together(roots: Sequence[Node], x: Array) -> list[Array]:
    """Return the values of trees, whose common nodes are evaluated once; see `evaluated`."""
    leaves, steps, ends = _program(tuple(roots))
    values = [x[..., leaf] if isinstance(leaf, int) else leaf for leaf in leaves]
    for function, operands, exponents in steps:
        values.append(function(*[values[k] for k in operands], *exponents))
    found = [np.asarray(values[k], dtype=np.float64) for k in ends]
    return [np.broadcast_to(array, x.shape[:-1]) for array in found]


@functools.lru_cache
def _program(
    roots: tuple[Node, ...],
) -> tuple[list[int | np.float64], list[tuple[Callable[..., Any], list[int], Any]], list[int]]:
    """What the evaluation of trees does: coordinates and numbers, operations on results, and ends.

    On the few pieces that most calls are for, to walk the tree takes longer than all operations.
    """
    every = dict.fromkeys(node for root in roots for node in nodes(root))
    order = sorted(every, key=lambda node: bool(node.args))
    place = {node: k for k, node in enumerate(order)}
    leaves = [
        int(node.value) if node.op == "coordinate" else np.float64(node.value)
        for node in order
        if not node.args
    ]
    steps = [
        (node.operation.of("numpy"), [place[a] for a in node.operands], node.exponents)
        for node in order[len(leaves) :]
    ]
    return leaves, steps, [place[root] for root in roots]


def shortened(text: str) -> str:
    """Return a text for a message: in quotes, and cut to 60 characters."""
    return repr(text if len(text) <= 60 else text[:57] + "...")
