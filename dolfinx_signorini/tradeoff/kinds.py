"""Kinds of discretisation, between which searches and comparisons choose."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Kind:
    """A kind of mesh together with the degree of the elements:

        print(Kind(graded=True, degree=2))  # graded P2

    Attributes:
        graded: Whether the cells are small at the detachment points, which solutions on coarser
            meshes find; otherwise the mesh is uniform.
        degree: Polynomial degree of the elements.
    """

    graded: bool
    degree: int

    def __str__(self) -> str:
        return f"{'graded' if self.graded else 'uniform'} P{self.degree}"

    def suits(self, dimension: int) -> bool:
        """Return whether there are such meshes: graded ones exist in the plane only."""
        return dimension == 2 or not self.graded


UNIFORM_P1, UNIFORM_P2 = Kind(False, 1), Kind(False, 2)
GRADED_P1, GRADED_P2 = Kind(True, 1), Kind(True, 2)
KINDS = (UNIFORM_P1, UNIFORM_P2, GRADED_P1, GRADED_P2)
