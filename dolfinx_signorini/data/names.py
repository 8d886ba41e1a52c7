"""Trees of formulas that are equal, although they are not the same."""

from dolfinx_signorini.data.formulas import Node


class Names:
    """Numbers of trees, which are equal for trees of the same operations:

    names = Names()
    same = names[parse("x + 1").root] == names[parse("x + 1").root]
    """

    def __init__(self) -> None:
        self.known: dict[tuple[object, ...], int] = {}
        self.seen: dict[Node, int] = {}

    def __getitem__(self, node: Node) -> int:
        if node not in self.seen:
            key = (node.op, node.value, *(self[a] for a in node.args))
            self.seen[node] = self.known.setdefault(key, len(self.known))
        return self.seen[node]


def operations(root: Node) -> int:
    """Return the number of different operations of a formula, its operands included."""
    return Names()[root] + 1
