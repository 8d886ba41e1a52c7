"""Derivatives of formulas as formulas, and the load and the flux that follow from a solution."""

import functools
from collections.abc import Callable, Sequence

from dolfinx_signorini.data.formulas import Formula, Node, PerNode, number
from dolfinx_signorini.data.simplification import simplified

ZERO, ONE, TWO = (number(value).root for value in (0.0, 1.0, 2.0))

# The derivative of each function of one argument a, where v is the node of the function.
FUNCTIONS: dict[str, Callable[[Node, Node], Node]] = {
    "sqrt": lambda a, v: quotient(number(0.5).root, v),
    "exp": lambda a, v: v,
    "log": lambda a, v: quotient(ONE, a),
    "sin": lambda a, v: Node("cos", (a,)),
    "cos": lambda a, v: negative(Node("sin", (a,))),
    "tan": lambda a, v: total(ONE, product(v, v)),
    "asin": lambda a, v: quotient(ONE, _of_arcsine(a)),
    "acos": lambda a, v: negative(quotient(ONE, _of_arcsine(a))),
    "atan": lambda a, v: quotient(ONE, total(ONE, product(a, a))),
    "sinh": lambda a, v: Node("cosh", (a,)),
    "cosh": lambda a, v: Node("sinh", (a,)),
    "tanh": lambda a, v: difference(ONE, product(v, v)),
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
        current = [product(diffusion[0][0].root, slope) for slope in slopes]
    elif diffusion:
        current = []
        for row in diffusion:
            terms = [product(a.root, s) for a, s in zip(row, slopes, strict=True)]
            current.append(_sum(terms))
    load = negative(_sum([Derivative(k)(w) for k, w in enumerate(current)]))
    if reaction is not None:
        load = total(load, product(reaction.root, solution.root))
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
            return product(FUNCTIONS[node.op](a, node), da)
        if node.op == "+":
            return total(da, db)
        if node.op == "-":
            return difference(da, db)
        if node.op == "*":
            return total(product(a, db), product(da, b))
        if node.op == "/":
            return quotient(difference(da, product(node, db)), b)
        if node.op == "hypot":
            return quotient(total(product(a, da), product(b, db)), node)
        if node.op == "atan2":
            turn = difference(product(b, da), product(a, db))
            return quotient(turn, Node("^", (Node("hypot", (a, b)), TWO)))
        return _choice(Node("<" if node.op == "min" else ">", (a, b)), da, db)

    def _power(self, node: Node) -> Node:
        base, exponent = node.args[0], node.args[1].value
        if exponent == 0.0:
            return ZERO
        lower = Node("^", (base, number(exponent - 1.0).root)) if exponent != 2.0 else base
        factor = ONE if exponent == 1.0 else product(number(exponent).root, lower)
        return product(factor, self(base))


def negative(a: Node) -> Node:
    """Return -a."""
    return ZERO if _is(a, 0.0) else Node("negative", (a,))


def total(a: Node, b: Node) -> Node:
    """Return a + b."""
    return b if _is(a, 0.0) else (a if _is(b, 0.0) else Node("+", (a, b)))


def difference(a: Node, b: Node) -> Node:
    """Return a - b."""
    return negative(b) if _is(a, 0.0) else (a if _is(b, 0.0) else Node("-", (a, b)))


def product(a: Node, b: Node) -> Node:
    """Return a b."""
    if _is(a, 0.0) or _is(b, 0.0):
        return ZERO
    return b if _is(a, 1.0) else (a if _is(b, 1.0) else Node("*", (a, b)))


def quotient(a: Node, b: Node) -> Node:
    """Return a/b."""
    return a if _is(a, 0.0) or _is(b, 1.0) else Node("/", (a, b))


def _choice(condition: Node, a: Node, b: Node) -> Node:
    same = a.op == b.op == "number" and a.value == b.value
    return a if same else Node("where", (condition, a, b))


def _of_arcsine(a: Node) -> Node:
    return Node("sqrt", (difference(ONE, product(a, a)),))


def _sum(terms: Sequence[Node]) -> Node:
    result = ZERO
    for term in terms:
        result = total(result, term)
    return result


def _is(node: Node, value: float) -> bool:
    return node.op == "number" and node.value == value
