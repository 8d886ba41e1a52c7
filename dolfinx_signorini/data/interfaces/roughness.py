"""Where formulas are not smooth: the zeros of the parts that choose, and of denominators."""

import numpy as np

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.data.formulas import Formula, Node, evaluated, nodes
from dolfinx_signorini.data.names import Names

POSITIVE = ("exp", "cosh")  # without a zero


def jumps(formula: Formula) -> bool:
    """Return whether a formula may jump or have a kink."""
    return bool(switches(formula))


def rough(formula: Formula) -> bool:
    """Return whether a formula may jump, have a kink, or be infinite."""
    return bool(switches(formula) or poles(formula))


def switches(*formulas: Formula) -> list[Node]:
    """Return the parts of formulas at whose zeros one of the formulas may jump or have a kink.

    A product changes its sign where one of its factors does: the parts are factors. Parts that are
    equal are named once. What is inside of another part comes after that part.
    """
    names, found = Names(), dict[int, Node]()
    for margin in margins(*formulas):
        for part in factors(margin, signs=True):
            if not _is_even(part):
                found.pop(names[part], None)
                found[names[part]] = part
    return list(found.values())


def margins(*formulas: Formula) -> list[Node]:
    """Return what decides by its sign in each choice of formulas, the outer choices first."""
    found = (switch(node) for formula in formulas for node in reversed(nodes(formula.root)))
    return [margin for margin in found if margin is not None]


def switch(node: Node) -> Node | None:
    """Return what decides by its sign what an operation chooses; None for one without a choice."""
    if node.op in ("abs", "sign"):
        return node.args[0]
    if node.op in ("min", "max"):
        return Node("-", node.args)
    return Node("-", node.args[0].args) if node.op == "where" else None


def chosen(node: Node, positive: bool) -> Node:
    """Return what an operation that chooses chooses where its switch is positive, or negative."""
    if node.op == "abs":
        return node.args[0] if positive else Node("negative", node.args)
    if node.op == "sign":
        return Node("number", value=1.0 if positive else -1.0)
    if node.op == "where":
        greater = node.args[0].op in (">", ">=")
        return node.args[1 if positive == greater else 2]
    return node.args[0 if positive == (node.op == "max") else 1]


def slopes(node: Node, x: Array, step: Array) -> Array:
    """Return the gradients of a part of a formula at points, from differences.

    Args:
        node: The part.
        x: The points, shape (..., dimension).
        step: How far each point is from the points of its differences.
    """
    result = np.empty_like(x)
    for k, e in enumerate(np.eye(x.shape[-1])):
        way = step[..., None] * e
        result[..., k] = (evaluated(node, x + way) - evaluated(node, x - way)) / (2.0 * step)
    return result


def poles(formula: Formula) -> list[Node]:
    """Return the parts of a formula at whose zeros the formula may be infinite.

    These are factors of denominators, of arguments of logarithms, and of bases of negative powers:
    r^-0.8 with r = hypot(x, y), for example, has the part r.
    """
    names, found = Names(), dict[int, Node]()
    for node in nodes(formula.root):
        base = None
        if node.op == "/":
            base = node.args[1]
        elif node.op == "log" or (node.op == "^" and node.args[1].value < 0.0):
            base = node.args[0]
        for factor in factors(base) if base is not None else []:
            found.setdefault(names[factor], factor)
    return list(found.values())


def factors(node: Node, signs: bool = False) -> list[Node]:
    """Return the parts at whose zeros a part of a formula vanishes.

    Args:
        node: The part.
        signs: Whether the parts are those that the sign depends on: denominators as well, and even
            powers and absolute values undivided, which are zero or positive.
    """
    operands = list(node.args)
    if node.op == "-":  # a comparison with 0 is such a difference
        operands = [a for a in node.args if a.op != "number" or a.value != 0.0]
    if node.op == "^" or (node.op == "/" and not signs):
        operands = operands[:1]
    single = node.op in ("^", "-", "abs", "sqrt", "negative") and len(operands) == 1
    if (single and not (signs and _is_even(node))) or node.op in ("*", "/"):
        return [factor for a in operands for factor in factors(a, signs)]
    constant = all(part.op != "coordinate" for part in nodes(node))
    return [] if constant or node.op in POSITIVE else [node]


def _is_even(node: Node) -> bool:
    """Whether an operation has the same values for a and -a, none of them negative."""
    return node.op in ("abs", "hypot") or (node.op == "^" and node.args[1].value % 2.0 == 0.0)
