"""Derivatives of formulas as formulas, and the load and the flux that follow from a solution."""

import functools

from dolfinx_signorini.data.formulas import Formula, Node, PerNode, number
from dolfinx_signorini.data.simplification import simplified

ZERO = Node("number")


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
            return number(float(node.op == "coordinate" and node.value == self.k)).root
        slopes = map(self, node.operands)
        found: Node = node.operation.slope(node, *node.operands, *node.exponents, *slopes)
        return found
