"""Formulas in x, y and z, from text to UFL, such that no text can do harm.

    sum      = product { ("+" | "-") product }
    product  = factor { ("*" | "/") factor }
    factor   = ("+" | "-") factor | atom [ ("^" | "**") factor ]
    atom     = number | name | name "(" sum { "," sum } ")" | "(" sum ")"
             | "where" "(" sum ("<" | "<=" | ">" | ">=") sum "," sum "," sum ")"

Names are the coordinates, pi, the functions below and what the caller defined before. There is no
way to reach Python from here: the parser knows these tokens and nothing else, constants are folded
in floating point (never in integers that grow), and length, depth, exponents and the size of a
formula with its definitions written out are limited.
"""

import math
import re
from collections.abc import Mapping

from dolfinx_signorini.errors import InputError
from dolfinx_signorini.scenes.expressions import (
    COMPARISONS,
    CONSTANTS,
    COORDINATES,
    FUNCTIONS,
    Expression,
    Node,
    operation,
    shortened,
)
from dolfinx_signorini.scenes.suggestions import suggestion

MAX_LENGTH = 2000  # characters
MAX_DEPTH = 100  # levels of nesting, of a chain of operations too
MAX_SIZE = 3000  # operations and operands, with all definitions written out
MAX_EXPONENT = 100.0
MAX_DIGITS = 40  # characters of one number

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
    r"|(?P<name>[A-Za-z_]\w*)|(?P<symbol>\*\*|<=|>=|[-+*/^()<>,]))",
    re.ASCII,
)


def parse(
    text: str, dimension: int = 2, definitions: Mapping[str, Expression] | None = None
) -> Expression:
    """Read a formula.

    Args:
        text: The formula, for example "sin(pi*x) * where(y < 1/2, 1, y^2)".
        dimension: Space dimension: 2 for x and y, 3 for x, y and z.
        definitions: Names that stand for formulas.

    Raises:
        InputError: The text is not a formula, says something that has no value, or is too large.
    """
    if len(text) > MAX_LENGTH:
        raise InputError(f"a formula of {len(text)} characters; at most {MAX_LENGTH} are read")
    return Expression(text, _Parser(text, dimension, definitions or {}).formula())


class _Parser:
    def __init__(self, text: str, dimension: int, definitions: Mapping[str, Expression]):
        self.text, self.dimension, self.definitions = text, dimension, definitions
        self.tokens = _tokens(text)
        self.position = 0
        self.depth = 0

    def formula(self) -> Node:
        node = self.sum()
        if self.peek() != "":
            raise self.error(f"{self.peek()!r} was not expected")
        return node

    def peek(self) -> str:
        return self.tokens[self.position][1]

    def next(self) -> str:
        token = self.peek()
        self.position += 1
        return token

    def expect(self, symbol: str) -> None:
        if self.peek() != symbol:
            raise self.error(f"{symbol!r} was expected" + self.instead())
        self.next()

    def instead(self) -> str:
        return f", not {self.peek()!r}" if self.peek() else " at the end"

    def error(self, message: str) -> InputError:
        column = self.tokens[min(self.position, len(self.tokens) - 1)][2]
        return InputError(f"{message} (column {column} of {shortened(self.text)})")

    def sum(self) -> Node:
        node = self.product()
        while self.peek() in ("+", "-"):
            node = self.node(self.next(), node, self.product())
        return node

    def product(self) -> Node:
        node = self.factor()
        while self.peek() in ("*", "/"):
            node = self.node(self.next(), node, self.factor())
        return node

    def factor(self) -> Node:
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise self.error(f"nested deeper than {MAX_DEPTH} levels")
        if self.peek() in ("+", "-"):
            negative, node = self.next() == "-", self.factor()
            node = self.node("negative", node) if negative else node
        else:
            node = self.atom()
            if self.peek() in ("^", "**"):
                self.next()
                node = self.power(node, self.factor())
        self.depth -= 1
        return node

    def power(self, base: Node, exponent: Node) -> Node:
        if exponent.op != "number":
            raise self.error("an exponent must be a number; write exp(b*log(a)) for a^b")
        if not abs(exponent.value) <= MAX_EXPONENT:
            raise self.error(f"an exponent must lie between -{MAX_EXPONENT:g} and {MAX_EXPONENT:g}")
        return self.node("^", base, exponent)

    def atom(self) -> Node:
        kind, token, _ = self.tokens[self.position]
        if kind == "number":
            if len(token) > MAX_DIGITS or not math.isfinite(float(token)):
                raise self.error("a number that is too long or too large")
            self.next()
            return Node("number", value=float(token))
        if kind == "name":
            return self.name()
        if token == "(":
            self.next()
            node = self.sum()
            self.expect(")")
            return node
        raise self.error("a number, a name or '(' was expected" + self.instead())

    def name(self) -> Node:
        name = self.peek()
        if name in self.definitions:
            self.next()
            return self.definitions[name].root
        if name in CONSTANTS:
            self.next()
            return Node("number", value=CONSTANTS[name])
        if name in COORDINATES[: self.dimension]:
            self.next()
            return Node("coordinate", value=COORDINATES.index(name))
        if name in FUNCTIONS or name == "where":
            return self.call()
        if name in COORDINATES:
            raise self.error(f"{name!r}: the domain has {self.dimension} dimensions only")
        known = (*self.definitions, *CONSTANTS, *FUNCTIONS, "where", *COORDINATES[: self.dimension])
        raise self.error(f"unknown name {name!r}{suggestion(name, known)}")

    def call(self) -> Node:
        name = self.next()
        self.expect("(")
        arguments = [self.condition() if name == "where" else self.sum()]
        while self.peek() == ",":
            self.next()
            arguments.append(self.sum())
        count = 3 if name == "where" else FUNCTIONS[name][0]
        if len(arguments) != count:
            raise self.error(f"{name} takes {count} arguments, not {len(arguments)}")
        self.expect(")")
        return self.node(name, *arguments)

    def condition(self) -> Node:
        left = self.sum()
        if self.peek() not in COMPARISONS:
            raise self.error("a comparison such as x < 0.5 was expected")
        return Node(self.next(), (left, self.sum()))

    def node(self, op: str, *args: Node) -> Node:
        node = Node(op, args)
        if node.size > MAX_SIZE or node.depth > MAX_DEPTH:
            raise self.error(
                f"a formula of more than {MAX_SIZE} operations or {MAX_DEPTH} levels, "
                "its definitions written out"
            )
        if any(a.op != "number" for a in args):
            return node
        try:
            value = float(operation(op)[0](*(a.value for a in args)))
        except (ArithmeticError, ValueError):
            value = math.nan
        if not math.isfinite(value):
            raise self.error(f"{op!r} has no finite value here")
        return Node("number", value=value)


def _tokens(text: str) -> list[tuple[str, str, int]]:
    """Kind, text and column (from 1) of each token; the last one is empty."""
    tokens, position = [], 0
    while text[position:].strip():
        match = _TOKEN.match(text, position)
        if match is None:
            column = position + len(text[position:]) - len(text[position:].lstrip()) + 1
            raise InputError(
                f"{text[column - 1]!r} does not belong in a formula "
                f"(column {column} of {shortened(text)})"
            )
        kind = str(match.lastgroup)
        tokens.append((kind, match[kind], match.start(kind) + 1))
        position = match.end()
    return [*tokens, ("end", "", len(text) + 1)]
