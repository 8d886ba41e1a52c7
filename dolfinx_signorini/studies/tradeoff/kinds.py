"""Kinds of discretisation whose speed and accuracy are compared."""

from dataclasses import dataclass

from dolfinx_signorini.meshes.elements import HIGHEST_DEGREE

MESHES = ("uniform", "graded", "adapted")


@dataclass(frozen=True)
class Kind:
    """A kind of mesh together with the degree of the elements:

        print(Kind("graded", 2))  # graded P2

    Attributes:
        mesh: "uniform"; "graded", with small cells at the detachment points, which solutions on
            coarser meshes find; or "adapted" by the adaptive loop.
        degree: Polynomial degree of the elements.
    """

    mesh: str
    degree: int

    def __str__(self) -> str:
        return f"{self.mesh} P{self.degree}"

    def suits(self, dimension: int) -> bool:
        """Return whether meshes of the kind exist: graded ones do so in the plane only."""
        return dimension == 2 or self.mesh != "graded"


KINDS = tuple(Kind(mesh, degree) for mesh in MESHES for degree in range(1, HIGHEST_DEGREE + 1))
UNIFORM_P1, UNIFORM_P2 = Kind("uniform", 1), Kind("uniform", 2)
GRADED_P2, GRADED_P4 = Kind("graded", 2), Kind("graded", 4)
