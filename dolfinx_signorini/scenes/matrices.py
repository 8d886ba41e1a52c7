"""Matrices of formulas with one, two or three rows."""

from collections.abc import Sequence

from dolfinx_signorini.scenes.formulas import Formula, Node, number


def inverse_entries(rows: Sequence[Sequence[Formula]]) -> list[Formula]:
    """Return the entries of the inverse of a matrix of formulas, row by row, by cofactors."""
    n, one = len(rows), number(1.0).root
    matrix = [[entry.root for entry in row] for row in rows]

    def difference(a: Node, b: Node, c: Node, d: Node) -> Node:
        return Node("-", (Node("*", (a, b)), Node("*", (c, d))))

    def cofactor(i: int, j: int) -> Node:
        if n == 1:
            return one
        if n == 2:
            entry = matrix[1 - i][1 - j]
            return entry if i == j else Node("negative", (entry,))
        i, k, j, m = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
        return difference(matrix[i][j], matrix[k][m], matrix[i][m], matrix[k][j])

    terms = [Node("*", (matrix[0][j], cofactor(0, j))) for j in range(n)]
    determinant = terms[0]
    for term in terms[1:]:
        determinant = Node("+", (determinant, term))
    entries = [Node("/", (cofactor(j, i), determinant)) for i in range(n) for j in range(n)]
    return [Formula("an entry of the inverse of the diffusion", entry) for entry in entries]
