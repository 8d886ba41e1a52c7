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
from dolfinx_signorini.data.formulas import Formula, Node, PerNode, nodes, number
from dolfinx_signorini.data.names import Names, operations

Product = frozenset[tuple[int, float]]  # names of atoms with exponents
Sum = dict[Product, tuple[float, float]]  # coefficients, and the sizes of what was added for each

MOST = 400  # products
LINE = Product()
ZERO = Node("number")


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
            return number(float(node.op == "coordinate" and node.value == self.k)).root
        slopes = map(self, node.operands)
        found: Node = node.operation.slope(node, *node.operands, *node.exponents, *slopes)
        return found


class _TooLarge(Exception):
    """A sum has too many products."""


def simplified(formula: Formula) -> Formula:
    """Return a formula as a sum of products where that is shorter, with terms cancelled."""
    try:
        expansion = _Expansion(formula.root)
        root = expansion.node(expansion.reduced(expansion.sum_of(formula.root)))
    except (_TooLarge, ArithmeticError):
        return formula
    shorter = operations(root) < operations(formula.root)
    return Formula(formula.text, root) if shorter else formula


class _Expansion:
    """The sums of the nodes of a formula, a node that is used twice only once."""

    def __init__(self, root: Node):
        self.names, self.atoms = Names(), dict[int, Node]()
        self.done: dict[int, Sum] = {}
        self.distances: dict[frozenset[int], Node] = {}
        self.squares: dict[int, tuple[int, int]] = {}  # a to r and b, of a^2 = r^2 - b^2
        for node in nodes(root):
            self._look_at(node)

    def sum_of(self, node: Node) -> Sum:
        """Return a node as a sum of products."""
        name = self.names[node]
        if name not in self.done:
            self.done[name] = self._new(node, name)
        return self.done[name]

    def reduced(self, terms: Sum) -> Sum:
        """Replace squares, and leave out what cancels."""
        result: Sum = {}
        open_ = dict(terms)
        for _ in range(MOST**2):
            if not open_:
                break
            term, (factor, size) = open_.popitem()
            powers = dict(term)
            name = next((a for a in self.squares if powers.get(a, 0.0) >= 2.0), None)
            if name is None:
                _add(result, term, factor, size)
                continue
            one, other = self.squares[name]
            rest = self._times(term, frozenset({(name, -2.0)}))
            positive = self._times(rest, frozenset({(one, 2.0)})) if one >= 0 else rest
            _add(open_, positive, factor, size)
            _add(open_, self._times(rest, frozenset({(other, 2.0)})), -factor, size)
        if open_:  # squares that replace each other
            raise _TooLarge
        if not all(math.isfinite(most) for _, most in result.values()):
            raise OverflowError
        return {t: v for t, v in result.items() if abs(v[0]) > ROUNDING * v[1]}

    def node(self, terms: Sum) -> Node:
        """Return the tree of a sum."""
        parts, powers = [], dict[tuple[int, float], Node]()
        for term, (factor, _) in terms.items():
            node = number(factor).root
            for name, exponent in sorted(term):
                base = self.atoms[name]
                power = base if exponent == 1.0 else Node("^", (base, number(exponent).root))
                node = Node("*", (node, powers.setdefault((name, exponent), power)))
            parts.append(node)
        return reduce(lambda a, b: Node("+", (a, b)), parts) if parts else number(0.0).root

    def _look_at(self, node: Node) -> None:
        """Take down which squares can be replaced."""
        if node.op == "hypot":
            key = frozenset(self.names[a] for a in node.args)
            r = self.names[self.distances.setdefault(key, node)]
            a, b = (self.names[argument] for argument in node.args)
            if a != b and a not in self.squares and self.squares.get(b, (-1, -1))[1] != a:
                self.squares[a] = r, b
                self.atoms |= {n: v for n, v in zip((a, b), node.args, strict=True)}
                self.atoms[r] = self.distances[key]
        if node.op == "sin":
            cosine = Node("cos", node.args)
            self.squares[self.names[node]] = -1, self.names[cosine]
            self.atoms |= {self.names[node]: node, self.names[cosine]: cosine}

    def _new(self, node: Node, name: int) -> Sum:
        if node.op == "number":
            return {LINE: (node.value, abs(node.value))} if node.value else {}
        if name in self.atoms:
            return self._atom(node)
        if node.op in ("negative", "+", "-"):
            parts = [self.sum_of(a) for a in node.args]
            signs = {"negative": (-1.0,), "+": (1.0, 1.0), "-": (1.0, -1.0)}[node.op]
            result: Sum = {}
            for part, sign in zip(parts, signs, strict=True):
                for term, (factor, size) in part.items():
                    _add(result, term, sign * factor, size)
            return result
        if node.op == "*":
            return self._product(*(self.sum_of(a) for a in node.args))
        if node.op == "/":
            return self._product(self.sum_of(node.args[0]), self._power(node.args[1], -1.0))
        if node.op == "^":
            return self._power(node.args[0], node.args[1].value)
        return self._power(node.args[0], 0.5) if node.op == "sqrt" else self._atom(node)

    def _atom(self, node: Node, exponent: float = 1.0) -> Sum:
        if node.op == "hypot":
            node = self.distances[frozenset(self.names[a] for a in node.args)]
        self.atoms.setdefault(self.names[node], node)
        return {frozenset({(self.names[node], exponent)}): (1.0, 1.0)}

    def _power(self, base: Node, exponent: float) -> Sum:
        terms, whole = self.sum_of(base), exponent % 1.0 == 0.0
        if len(terms) == 1:
            ((term, (factor, _)),) = terms.items()
            known = all(self.atoms[n].op == "hypot" for n, _ in term)  # (a^2)^(1/2) is not a
            known |= [p for _, p in term] == [1.0]
            if whole or (factor > 0.0 and known):
                value = factor**exponent
                return {frozenset((n, p * exponent) for n, p in term): (value, abs(value))}
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
        powers: defaultdict[int, float] = defaultdict(float)
        for name, exponent in (*one, *other):
            powers[name] += exponent
        return frozenset((name, p) for name, p in powers.items() if p != 0.0)


def _add(terms: Sum, term: Product, factor: float, size: float) -> None:
    before, most = terms.get(term, (0.0, 0.0))
    terms[term] = before + factor, most + size
