"""Derivatives of formulas as formulas, and the load and the flux that follow from a solution."""

import functools
from collections.abc import Callable

from dolfinx_signorini.data.formulas import Formula, Node, PerNode, number
from dolfinx_signorini.data.simplification import simplified

ZERO, HALF, ONE = (number(value).root for value in (0.0, 0.5, 1.0))

# The derivative of each function of one argument a, where v is the node of the function.
FUNCTIONS: dict[str, Callable[[Node, Node], Node]] = {
    "sqrt": lambda a, v: HALF / v,
    "exp": lambda a, v: v,
    "log": lambda a, v: ONE / a,
    "sin": lambda a, v: Node("cos", (a,)),
    "cos": lambda a, v: -Node("sin", (a,)),
    "tan": lambda a, v: ONE + v * v,
    "asin": lambda a, v: ONE / _of_arcsine(a),
    "acos": lambda a, v: -(ONE / _of_arcsine(a)),
    "atan": lambda a, v: ONE / (ONE + a * a),
    "sinh": lambda a, v: Node("cosh", (a,)),
    "cosh": lambda a, v: Node("sinh", (a,)),
    "tanh": lambda a, v: ONE - v * v,
    "abs": lambda a, v: Node("sign", (a,)),
    "sign": lambda a, v: ZERO,
    "negative": lambda a, v: number(-1.0).root,
}


@functools.lru_cache(maxsize=4)  # a scene is posed on many meshes
def load_and_current(
    solution: Formula,
    diffusion: tuple[tuple[Formula, ...], ...],
    reaction: Formula | None,
    d: int,
) -> tuple[Formula, list[Formula]]:
    """Return f = -div(A grad u) + c u and the components of A grad u, where these have values.

    Args:
        solution: u.
        diffusion: The rows of A; one entry stands for a multiple of the identity, none for 1.
        reaction: c; None for 0.
        d: The dimension of the domain.
    """
    slopes = [Derivative(k)(solution.root) for k in range(d)]
    current = slopes
    if len(diffusion) == 1:
        current = [diffusion[0][0].root * slope for slope in slopes]
    elif diffusion:
        current = []
        for row in diffusion:
            terms = [a.root * s for a, s in zip(row, slopes, strict=True)]
            current.append(sum(terms, ZERO))
    load = -sum((Derivative(k)(w) for k, w in enumerate(current)), ZERO)
    if reaction is not None:
        load = load + reaction.root * solution.root
    parts = [simplified(Formula("the flux", w)) for w in current]
    return simplified(Formula("the load", load)), parts


class Derivative(PerNode[Node]):
    """The derivative in the direction of a coordinate, of the nodes of a formula:

        slope = Derivative(0)(formula.root)

    Args:
        k: The number of the coordinate.
    """

    def __init__(self, k: int):
        super().__init__()
        self.k = k

    def find(self, node: Node) -> Node:
        if node.op in ("number", "coordinate"):
            return ONE if node.op == "coordinate" and node.value == self.k else ZERO
        if node.op == "where":
            return _choice(node.args[0], self(node.args[1]), self(node.args[2]))
        if node.op == "^":
            return self._power(node)
        a, b, da, db = node.args[0], node.args[-1], self(node.args[0]), self(node.args[-1])
        if node.op in FUNCTIONS:
            return FUNCTIONS[node.op](a, node) * da
        if node.op == "+":
            return da + db
        if node.op == "-":
            return da - db
        if node.op == "*":
            return a * db + da * b
        if node.op == "/":
            return (da - node * db) / b
        if node.op == "hypot":
            return (a * da + b * db) / node
        if node.op == "atan2":
            return (b * da - a * db) / Node("hypot", (a, b)) ** 2.0
        return _choice(Node("<" if node.op == "min" else ">", (a, b)), da, db)

    def _power(self, node: Node) -> Node:
        base, exponent = node.args[0], node.args[1].value
        if exponent == 0.0:
            return ZERO
        return number(exponent).root * base ** (exponent - 1.0) * self(base)


def _choice(condition: Node, a: Node, b: Node) -> Node:
    return a if a.op == "number" and b.is_number(a.value) else Node("where", (condition, a, b))


def _of_arcsine(a: Node) -> Node:
    return Node("sqrt", (ONE - a * a,))
