"""UFL expressions of the coordinates as formulas: what is known of formulas is known of both.

Readable are coordinates, numbers and `fem.Constant`, vectors and matrices of them, arithmetic,
powers, elementary functions, and conditionals. Derivatives are carried out first. Functions of a
finite element space, which differ from cell to cell, are not readable.

UFL's own trees do not replace those of formulas. Their nodes have index notation and tensors in
them, and UFL has no distance hypot(a, b), whose zeros are known where those of sqrt(a^2 + b^2) are
not. So distances are recognised here.
"""

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import reduce
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from ufl import classes
from ufl.algorithms import apply_algebra_lowering, apply_derivatives
from ufl.core.expr import Expr
from ufl.corealg.traversal import unique_post_traversal, unique_pre_traversal

from dolfinx_signorini.base.compat import ELEMENTS
from dolfinx_signorini.data.derivatives import simplified
from dolfinx_signorini.data.enclosures import enclosed_everywhere
from dolfinx_signorini.data.formulas import (
    ZERO,
    Formula,
    Node,
    coordinates,
    folded,
    nodes,
    number,
    shortened,
    squares,
)
from dolfinx_signorini.data.operations import FUNCTIONS, OPERATIONS
from dolfinx_signorini.data.parsing import MAX_SIZE

Component = tuple[int, ...]
Terminals = Mapping[Expr, Any]  # arrays of numbers or nodes, for arguments, normals, functions

_X = ufl.SpatialCoordinate(ufl.Mesh(ELEMENTS[2]))[0]


def _class_of(op: str) -> Any:
    """The class of UFL's node for an operation."""
    known = OPERATIONS[op]
    first = [_X < 0.5] if op == "where" else [_X]
    others = [k * _X for k in range(2, known.arguments + 1)]  # equal ones make no choice
    return type(known.of("ufl")(*first, *others))


# Distances have no node of their own, and UFL has differences as sums.
CLASSES = {_class_of(op): op for op in OPERATIONS if op not in ("hypot", "-", "negative")}
# Functions of UFL by their names in SciPy.
SPECIAL = {
    classes.Erf: "erf",
    classes.BesselJ: "jv",
    classes.BesselY: "yv",
    classes.BesselI: "iv",
    classes.BesselK: "kv",
}
TRANSPARENT = (classes.Variable, classes.Conj, classes.Real)


class Unreadable(Exception):
    """A part of an expression is no formula in the coordinates."""


def formula_of(data: Any) -> Formula | None:
    """Return data as a formula: a number or a scalar UFL expression of the coordinates.

    For example:

        x = ufl.SpatialCoordinate(domain)
        load = formula_of(ufl.exp(-ufl.inner(x, x)) * ufl.conditional(ufl.lt(x[0], 0.5), 1, 2))

    Args:
        data: The data.

    Returns:
        The formula, in which terms that derivatives leave are cancelled; None for other data.
    """
    if isinstance(data, int | float | np.number):
        return number(float(data))
    if not isinstance(data, Expr) or data.ufl_shape != () or data.ufl_free_indices:
        return None
    formula = read(lowered(data), {})
    return simplified(formula) if formula is not None and has_derivatives(data) else formula


def lowered(expression: Any) -> Any:
    """Return an expression or a form with derivatives carried out, in terms that are readable."""
    return apply_derivatives.apply_derivatives(
        apply_algebra_lowering.apply_algebra_lowering(expression)
    )


def has_derivatives(expression: Expr) -> bool:
    """Return whether an expression has derivatives that are not carried out."""
    return any(isinstance(part, classes.Derivative) for part in unique_pre_traversal(expression))


def read(expression: Expr, terminals: Terminals) -> Formula | None:
    """Return a lowered scalar expression as a formula; None where a part is not readable.

    Numbers or nodes may stand for the terminals of the expression, and for other parts.
    """
    try:
        root = _Reader(terminals).node(expression, (), {})
    except (Unreadable, ArithmeticError, RecursionError):
        return None
    if len(nodes(root)) > MAX_SIZE:
        return None
    if root.op == "number":  # the text of a large expression takes longer than all else
        return number(root.value)
    return Formula(shortened(str(expression))[1:-1], root)


def more_coordinates(first: int, terminals: Iterable[Expr]) -> dict[Expr, Any]:
    """Return coordinates that stand for the components of terminals, from a number on."""
    result: dict[Expr, Any] = {}
    for terminal in terminals:
        result[terminal] = coordinates(first, terminal.ufl_shape)
        first += result[terminal].size
    return result


def roots(vector: Expr, terminals: Terminals) -> list[Node]:
    """Return the components of a lowered vector as trees whose common parts are the same nodes.

    The trees are for values alone: functions of which nothing else is known may be in them. For the
    terminals see `read`.

    Raises:
        Unreadable: A part is not readable.
    """
    reader = _Reader(terminals, values_alone=True)
    # From the leaves on: a sum of a thousand terms is deeper than calls in Python may be.
    for part in unique_post_traversal(vector):
        if isinstance(part, classes.MultiIndex | classes.Condition) or part.ufl_free_indices:
            continue
        for component in np.ndindex(part.ufl_shape):
            with suppress(Unreadable):
                reader.node(part, component, {})
    return [reader.node(vector, (k,), {}) for k in range(len(vector))]


class _Reader:
    """The nodes of the components of expressions, each of them once; for terminals see `read`.

    Where values alone are asked for, numbers need not be finite.
    """

    def __init__(self, terminals: Terminals, values_alone: bool = False):
        self.terminals, self.values_alone = terminals, values_alone
        self.fold = Node.made if values_alone else folded
        self.known: dict[tuple[int, Component, Component], Node] = {}

    def node(self, expression: Expr, component: Component, indices: dict[int, int]) -> Node:
        """Return a component of an expression, with values of the free indices by their numbers."""
        free = () if isinstance(expression, classes.Condition) else expression.ufl_free_indices
        key = id(expression), component, tuple(indices[i] for i in free)
        if key not in self.known:
            self.known[key] = self._new(expression, component, indices)
        return self.known[key]

    def _new(self, e: Expr, component: Component, indices: dict[int, int]) -> Node:
        if not isinstance(e, classes.Condition) and e in self.terminals:
            known = np.asarray(self.terminals[e])[component]
            return known if isinstance(known, Node) else Node("number", value=float(known))
        operands = e.ufl_operands
        if isinstance(e, classes.Terminal):
            return _terminal(e, component, not self.values_alone)
        if isinstance(e, TRANSPARENT):
            return self.node(operands[0], component, indices)
        if isinstance(e, classes.Indexed):
            inner = tuple(_value(i, indices) for i in operands[1])
            return self.node(operands[0], inner, indices)
        if isinstance(e, classes.ComponentTensor):
            bound = dict(zip((i.count() for i in operands[1]), component, strict=True))
            return self.node(operands[0], (), indices | bound)
        if isinstance(e, classes.IndexSum):
            i = operands[1][0].count()
            every = range(e.dimension())  # of a tensor where the summand is one
            return sum((self.node(operands[0], component, indices | {i: k}) for k in every), ZERO)
        if isinstance(e, classes.ListTensor):
            return self.node(operands[component[0]], component[1:], indices)
        if isinstance(e, classes.Conditional):
            branches = [self.node(b, component, indices) for b in operands[1:]]
            return self._choice(operands[0], branches[0], branches[1])
        own = component if isinstance(e, classes.Sum) else ()
        arguments = [self.node(a, own, indices) for a in operands]
        op = CLASSES.get(type(e))
        if op == "*":
            return _product(*arguments)
        if op in ("+", "/"):
            return reduce(OPERATIONS[op].value, arguments)
        if op in ("^", "sqrt"):
            exponent = arguments[1] if op == "^" else Node("number", value=0.5)
            return self._power(arguments[0], exponent)
        if self.values_alone and type(e) in SPECIAL:
            return Node(SPECIAL[type(e)], tuple(arguments))
        if op not in FUNCTIONS:
            raise Unreadable(e)
        return self.fold(op, *arguments)

    def _choice(self, condition: Expr, a: Node, b: Node) -> Node:
        """Return a where a condition holds, and b elsewhere."""
        operands = condition.ufl_operands
        if isinstance(condition, classes.NotCondition):
            return self._choice(operands[0], b, a)
        if isinstance(condition, classes.AndCondition):
            return self._choice(operands[0], self._choice(operands[1], a, b), b)
        if isinstance(condition, classes.OrCondition):
            return self._choice(operands[0], a, self._choice(operands[1], a, b))
        left, right = (self.node(o, (), {}) for o in operands)
        if isinstance(condition, classes.EQ | classes.NE):
            a, b = (a, b) if isinstance(condition, classes.EQ) else (b, a)
            below, above = Node("<=", (left, right)), Node(">=", (left, right))
            return Node("where", (below, Node("where", (above, a, b)), b))
        return Node("where", (Node(CLASSES[type(condition)], (left, right)), a, b))

    def _power(self, base: Node, exponent: Node) -> Node:
        if exponent.op != "number":
            return self.fold("exp", exponent * self.fold("log", base))
        parts = squares(base) if exponent.value % 1.0 else []
        if len(parts) > 1:  # the distance is smooth where its square is, and its zeros are known
            distance = reduce(lambda a, b: Node("hypot", (a, b)), parts)
            return distance ** (2.0 * exponent.value)
        return self.fold("sqrt", base) if exponent.value == 0.5 else base**exponent.value


def _value(index: Any, indices: dict[int, int]) -> int:
    return int(index) if isinstance(index, classes.FixedIndex) else indices[index.count()]


def _terminal(e: Expr, component: Component, finite: bool) -> Node:
    if isinstance(e, classes.SpatialCoordinate):
        return Node("coordinate", value=component[0])
    if isinstance(e, fem.Constant):
        value = complex(np.asarray(e.value)[component])
    elif isinstance(e, classes.RealValue):
        value = complex(float(e))
    elif isinstance(e, classes.Zero | classes.Identity):
        value = complex(isinstance(e, classes.Identity) and component[0] == component[1])
    else:
        raise Unreadable(e)
    if value.imag or (finite and not math.isfinite(value.real)):
        raise Unreadable(e)
    return Node("number", value=value.real)


def _product(a: Node, b: Node) -> Node:
    """Return a product; s hypot(a/s, b/s) with s >= 0, as of tiny a and b, is hypot(a, b)."""
    for scale, distance in ((a, b), (b, a)):
        parts = distance.args if distance.op == "hypot" else ()
        scaled = [p.op == "/" and p.args[1] is scale for p in parts]
        if any(scaled) and all(scaled) and enclosed_everywhere(scale).low.min() >= 0.0:
            return Node("hypot", (parts[0].args[0], parts[1].args[0]))
    return a * b
