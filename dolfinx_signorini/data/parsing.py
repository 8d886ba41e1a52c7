"""The reading of formulas from text, such that no text can do harm.

The grammar is Python's, with ^ as another sign for **, and `where(a < b, then, else)` for a choice.
A text is first cut into numbers, names and the signs of arithmetic; any other character is refused.
Python's own parser then finds the structure, and only the nodes of arithmetic, comparisons inside
`where`, and calls of the functions of `formulas` are accepted. Nothing is evaluated by Python.
Constants are folded in floating point, so that no integer grows, and the length, depth and size of
a formula are limited.
"""

import ast
import difflib
import math
import re
from collections.abc import Iterable, Mapping

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.data.formulas import (
    CONSTANTS,
    COORDINATES,
    Formula,
    Node,
    folded,
    shortened,
)
from dolfinx_signorini.data.operations import COMPARISONS, FUNCTIONS, OPERATIONS

OPERATORS = {known.syntax: op for op, known in OPERATIONS.items() if known.syntax is not None}
MAX_DEPTH = 100  # levels of nesting; every operation of a chain is one
MAX_SIZE = 3000  # operations and operands, with all definitions written out
MAX_EXPONENT = 100.0
TOO_DEEP = f"nested deeper than {MAX_DEPTH} levels"
TOO_LARGE = (
    f"a formula of more than {MAX_SIZE} operations or {MAX_DEPTH} levels, its definitions written "
    "out"
)
MISPLACED = (
    "a comparison such as x < 0.5 was expected as the first argument of where, and only there"
)

# What belongs nowhere comes before the signs: Python would take "f(x,)" and "(f)(x)".
_TOKEN = re.compile(
    r"(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<wrong>,\s*\)|\)\s*\(|[^-+*/^()<>,\s])|\*\*|<=|>=|\S",
    re.ASCII,
)


def parse(
    text: str, dimension: int = 2, definitions: Mapping[str, Formula] | None = None
) -> Formula:
    """Read a formula.

    Args:
        text: The formula, for example "sin(pi*x) * where(y < 1/2, 1, y^2)".
        dimension: Space dimension: 2 for x and y, 3 for x, y and z.
        definitions: Names that stand for formulas.

    Raises:
        InputError: The text is not a formula, has no value, or is too large.
    """
    return Formula(text, _Reader(text, dimension, definitions or {}).read())


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return the end of a message about an unknown name: "; did you mean ...?" with the nearest
    known name or, where none is near, the list of all."""
    known = list(known)
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    if near:
        return f"; did you mean {near[0]!r}?"
    return "; known are " + ", ".join(map(str, known)) if known else ""


class _Reader:
    """Reads one text.

    The text given to Python's parser has a blank between tokens, ** for ^, floating-point numbers,
    and an underscore after every name, so that no name is one of Python's own words.
    """

    def __init__(self, text: str, dimension: int, definitions: Mapping[str, Formula]):
        self.text, self.dimension, self.definitions = text, dimension, definitions
        self.places: list[int] = []  # in the text, of each character of the text for Python

    def read(self) -> Node:
        try:
            tree = ast.parse(self._translated(), mode="eval").body
        except SyntaxError as error:  # its offset is 0 where the text ends too early
            message = error.msg if error.offset else "a number, a name or '(' was expected"
            raise self._error(message, (error.offset or 0) - 1) from None
        except (RecursionError, MemoryError):
            raise self._error(TOO_DEEP, 0) from None
        root = self._node(tree, 1)
        if root.op in COMPARISONS:
            raise self._error(MISPLACED, 0)
        return root

    def _translated(self) -> str:
        """Return the text for Python's parser, and note where its characters come from."""
        parts: list[str] = []
        depth = 0
        for match in _TOKEN.finditer(self.text):
            self.places.append(match.start())
            part = "**" if match[0] == "^" else match[0]
            depth += (part == "(") - (part == ")")
            if depth > MAX_DEPTH:
                raise self._error(TOO_DEEP)
            if match["wrong"]:
                raise self._error(f"{part!r} does not belong in a formula")
            if match["number"]:
                if not math.isfinite(float(part)):
                    raise self._error("a number that is too large")
                part = repr(float(part))
            elif match["name"]:
                part += "_"
            parts.append(part)
            self.places += [match.start()] * len(part)
        self.places.append(len(self.text))
        return " ".join(parts)

    def _error(self, message: str, start: int = -1) -> InputError:
        """Return an error with the column of a place in the text for Python; -1 for its end."""
        column = self.places[min(start, len(self.places) - 1)] + 1
        return InputError(f"{message} (column {column} of {shortened(self.text)})")

    def _node(self, tree: ast.expr, depth: int) -> Node:
        """Return the tree of operations that belongs to a node of Python's syntax tree."""
        start = tree.col_offset
        if depth > MAX_DEPTH:
            raise self._error(TOO_DEEP, start)
        operands: list[ast.expr]
        match tree:
            case ast.Constant(value=float(value)):
                return Node("number", value=value)
            case ast.Name(id=name):
                return self._name(name[:-1], start)
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self._node(operand, depth + 1)
            case ast.Call(func=ast.Name(id=name), args=operands, keywords=[]):
                op = self._function(name[:-1], len(operands), start)
            case ast.UnaryOp(op=sign, operand=operand) if type(sign) in OPERATORS:
                op, operands = OPERATORS[type(sign)], [operand]
            case ast.BinOp(left=left, op=sign, right=right) if type(sign) in OPERATORS:
                op, operands = OPERATORS[type(sign)], [left, right]
            case ast.Compare(left=left, ops=[sign], comparators=[right]) if type(sign) in OPERATORS:
                op, operands = OPERATORS[type(sign)], [left, right]
            case _:
                raise self._error("a number, a name or an operation was expected", start)
        return self._operation(op, [self._node(o, depth + 1) for o in operands], start)

    def _name(self, name: str, start: int) -> Node:
        if name in self.definitions:
            return self.definitions[name].root
        if name in CONSTANTS:
            return Node("number", value=CONSTANTS[name])
        if name in COORDINATES[: self.dimension]:
            return Node("coordinate", value=COORDINATES.index(name))
        if name in FUNCTIONS:
            raise self._error(f"'(' was expected after {name!r}", start)
        if name in COORDINATES:
            raise self._error(f"{name!r}: the domain has {self.dimension} dimensions only", start)
        known = (*self.definitions, *CONSTANTS, *FUNCTIONS, *COORDINATES[: self.dimension])
        raise self._error(f"unknown name {shortened(name)}{suggestion(name, known)}", start)

    def _function(self, name: str, count: int, start: int) -> str:
        """Return the name of a function that takes so many arguments."""
        if name not in FUNCTIONS:
            self._name(name, start)  # raises an error where the name means nothing
            raise self._error(f"{name!r} is no function", start)
        wanted = FUNCTIONS[name].arguments
        if count != wanted:
            raise self._error(f"{name} takes {wanted} arguments, not {count}", start)
        return name

    def _operation(self, op: str, args: list[Node], start: int) -> Node:
        """Return an operation, or the value of an operation on numbers."""
        if any((a.op in COMPARISONS) != (op == "where" and k == 0) for k, a in enumerate(args)):
            raise self._error(MISPLACED, start)
        if op == "^" and args[1].op != "number":
            message = "an exponent must be a number; write exp(b*log(a)) for a^b"
            raise self._error(message, start)
        if op == "^" and not abs(args[1].value) <= MAX_EXPONENT:
            message = f"an exponent must lie between -{MAX_EXPONENT:g} and {MAX_EXPONENT:g}"
            raise self._error(message, start)
        try:
            node = folded(op, *args)
        except ArithmeticError:
            raise self._error(f"{op!r} has no finite value here", start) from None
        if node.size > MAX_SIZE or node.depth > MAX_DEPTH:
            raise self._error(TOO_LARGE, start)
        return node
