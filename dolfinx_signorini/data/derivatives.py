"""Derivatives of formulas as formulas, and sums of products in which terms cancel.

The load and the flux that follow from a solution are written as sums of products of powers of
atoms: coordinates, functions, distances r = hypot(a, b), and their arguments a and b. Sums are
multiplied out, a^2 becomes r^2 - b^2, and sin^2 becomes 1 - cos^2. So -div grad of
r^1.5 sin(1.5 t) turns out to be 0.
"""

import math
from collections import defaultdict
from functools import lru_cache, reduce

from dolfinx_signorini.base.tolerances import ROUNDING
from dolfinx_signorini.data.coefficients import tensor
from dolfinx_signorini.data.formulas import ONE, ZERO, Formula, Node, PerNode, nodes

Product = frozenset[tuple[Node, float]]  # atoms with exponents
Sum = dict[Product, tuple[float, float]]  # coefficients, and the sizes of what was added for each

MOST = 400  # products


@lru_cache(maxsize=4)  # a scene is posed on many meshes
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
    rows = (zip(row, slopes, strict=True) for row in tensor(diffusion, d))
    current = [sum((a * slope for a, slope in row), ZERO) for row in rows]
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
        slopes = map(self, node.operands)
        found: Node = node.operation.slope(node, *node.operands, *node.exponents, *slopes)
        return found


class _TooLarge(Exception):
    """A sum has too many products."""


def simplified(formula: Formula) -> Formula:
    """Return a formula as a sum of products where that is shorter, with terms cancelled."""
    try:
        expansion = _Expansion(formula.root)
        root = expansion.node(expansion.reduced(expansion(formula.root)))
    except (_TooLarge, ArithmeticError):
        return formula
    shorter = len(nodes(root)) < len(nodes(formula.root))
    return Formula(formula.text, root) if shorter else formula


class _Order(PerNode[int]):
    """The places of nodes in the order in which they are asked for, behind their operands."""

    def find(self, node: Node) -> int:
        for operand in node.args:
            self(operand)
        return len(self._done)


class _Expansion(PerNode[Sum]):
    """The nodes of a formula as sums of products."""

    def __init__(self, root: Node):
        super().__init__()
        self.order, self.atoms = _Order(), set[Node]()
        self.distances: dict[frozenset[Node], Node] = {}
        # a to r and b, of a^2 = r^2 - b^2; no r for 1.
        self.squares: dict[Node, tuple[Node | None, Node]] = {}
        for node in nodes(root):
            self._look_at(node)
        self.order(root)

    def reduced(self, terms: Sum) -> Sum:
        """Replace squares, and leave out what cancels."""
        result: Sum = {}
        open_ = dict(terms)
        for _ in range(MOST**2):
            if not open_:
                break
            term, (factor, size) = open_.popitem()
            powers = dict(term)
            atom = next((a for a in self.squares if powers.get(a, 0.0) >= 2.0), None)
            if atom is None:
                _add(result, term, factor, size)
                continue
            one, other = self.squares[atom]
            rest = self._times(term, frozenset({(atom, -2.0)}))
            positive = self._times(rest, frozenset({(one, 2.0)})) if one else rest
            _add(open_, positive, factor, size)
            _add(open_, self._times(rest, frozenset({(other, 2.0)})), -factor, size)
        if open_:  # squares that replace each other
            raise _TooLarge
        if not all(math.isfinite(most) for _, most in result.values()):
            raise OverflowError
        return {t: v for t, v in result.items() if abs(v[0]) > ROUNDING * v[1]}

    def node(self, terms: Sum) -> Node:
        """Return the tree of a sum."""
        parts = []
        for term, (factor, _) in terms.items():
            node = Node("number", value=factor)
            for atom, exponent in sorted(term, key=lambda power: self.order(power[0])):
                power = Node("^", (atom, Node("number", value=exponent)))
                node = Node("*", (node, atom if exponent == 1.0 else power))
            parts.append(node)
        return reduce(lambda a, b: Node("+", (a, b)), parts) if parts else ZERO

    def _look_at(self, node: Node) -> None:
        """Take down which squares can be replaced."""
        if node.op == "hypot":
            self.order(node)
            r = self.distances.setdefault(frozenset(node.args), node)
            a, b = node.args
            if a != b and a not in self.squares and self.squares.get(b, (r, r))[1] != a:
                self.squares[a] = r, b
                self.atoms |= {a, b, r}
        if node.op == "sin":
            self.order(node)
            cosine = Node("cos", node.args)
            self.squares[node] = None, cosine
            self.atoms |= {node, cosine}
            self.order(cosine)

    def find(self, node: Node) -> Sum:
        if node.op == "number":
            return {Product(): (node.value, abs(node.value))} if node.value else {}
        if node in self.atoms:
            return self._atom(node)
        if node.op in ("negative", "+", "-"):
            parts = [self(a) for a in node.args]
            signs = {"negative": (-1.0,), "+": (1.0, 1.0), "-": (1.0, -1.0)}[node.op]
            result: Sum = {}
            for part, sign in zip(parts, signs, strict=True):
                for term, (factor, size) in part.items():
                    _add(result, term, sign * factor, size)
            return result
        if node.op == "*":
            return self._product(*map(self, node.args))
        if node.op == "/":
            return self._product(self(node.args[0]), self._power(node.args[1], -1.0))
        if node.op == "^":
            return self._power(node.args[0], node.args[1].value)
        return self._power(node.args[0], 0.5) if node.op == "sqrt" else self._atom(node)

    def _atom(self, node: Node, exponent: float = 1.0) -> Sum:
        if node.op == "hypot":
            node = self.distances[frozenset(node.args)]
        return {frozenset({(node, exponent)}): (1.0, 1.0)}

    def _power(self, base: Node, exponent: float) -> Sum:
        terms, whole = self(base), exponent % 1.0 == 0.0
        if len(terms) == 1:
            ((term, (factor, _)),) = terms.items()
            known = all(atom.op == "hypot" for atom, _ in term)  # (a^2)^(1/2) is not a
            known |= [p for _, p in term] == [1.0]
            if whole or (factor > 0.0 and known):
                value = factor**exponent
                return {frozenset((atom, p * exponent) for atom, p in term): (value, abs(value))}
        times = int(exponent) if whole else 0
        # A power of a sum has so many products at most: as many as its terms have multisets.
        if times > 0 and math.comb(len(terms) + times - 1, times) <= MOST:
            return reduce(self._product, [terms] * times)
        return self._atom(base, exponent)

    def _product(self, a: Sum, b: Sum) -> Sum:
        result: Sum = {}
        for one, (factor, size) in a.items():
            for other, (by, more) in b.items():
                _add(result, self._times(one, other), factor * by, size * more)
        if len(result) > MOST:
            raise _TooLarge
        return result

    def _times(self, one: Product, other: Product) -> Product:
        powers: defaultdict[Node, float] = defaultdict(float)
        for atom, exponent in (*one, *other):
            powers[atom] += exponent
        return frozenset((atom, p) for atom, p in powers.items() if p != 0.0)


def _add(terms: Sum, term: Product, factor: float, size: float) -> None:
    before, most = terms.get(term, (0.0, 0.0))
    terms[term] = before + factor, most + size
