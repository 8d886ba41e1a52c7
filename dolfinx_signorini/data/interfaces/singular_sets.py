"""Singular sets of formulas: the zeros of what switches between branches, and of denominators."""

from dolfinx_signorini.data.formulas import Formula, Node, nodes

NEAR_POLE = 0.5  # of the largest size of a denominator in a piece: smaller ones tell a pole


def jumps(formula: Formula) -> bool:
    """Return whether a formula may jump or have a kink."""
    return bool(switches(formula))


def is_singular(formula: Formula) -> bool:
    """Return whether a formula may jump, have a kink, or be infinite."""
    return bool(switches(formula) or poles(formula))


def switches(*formulas: Formula) -> list[Node]:
    """Return the parts of formulas at whose zeros one of the formulas may jump or have a kink.

    A product changes its sign where one of its factors does: the parts are factors. Parts that are
    equal are named once. What is inside of another part comes after that part.
    """
    found = [part for margin in margins(*formulas) for part in factors(margin, signs=True)]
    odd = [part for part in found if not is_even(part)]
    return list(dict.fromkeys(odd[::-1]))[::-1]


def margins(*formulas: Formula) -> list[Node]:
    """Return the parts whose signs choose the branches of formulas, the outer ones first."""
    found = (node.switch for formula in formulas for node in reversed(nodes(formula.root)))
    return [margin for margin in found if margin is not None]


def poles(formula: Formula) -> list[Node]:
    """Return the parts of a formula at whose zeros the formula may be infinite.

    These are factors of denominators, of arguments of logarithms, and of bases of negative powers:
    r^-0.8 with r = hypot(x, y), for example, has the part r.
    """
    found = []
    for node in nodes(formula.root):
        if node.op == "/":
            found += factors(node.args[1])
        elif node.op == "log" or (node.op == "^" and node.args[1].value < 0.0):
            found += factors(node.args[0])
    return list(dict.fromkeys(found))


def factors(node: Node, signs: bool = False) -> list[Node]:
    """Return the parts at whose zeros a part of a formula vanishes.

    Args:
        node: The part.
        signs: Whether the parts are those that the sign depends on: denominators as well, and even
            powers and absolute values undivided, which are zero or positive.
    """
    if node.op in ("*", "/"):
        operands = node.args if node.op == "*" or signs else node.args[:1]
        return [factor for a in operands for factor in factors(a, signs)]
    vanishes = node.operation.vanishes if node.args else ""
    if vanishes == "with" and not (signs and is_even(node)):
        return factors(node.args[0], signs)
    constant = all(part.op != "coordinate" for part in nodes(node))
    return [] if constant or vanishes == "never" else [node]


def is_even(node: Node) -> bool:
    """Whether an operation has the same values for a and -a, none of them negative."""
    return bool(node.args) and bool(node.operation.even(*node.exponents))
