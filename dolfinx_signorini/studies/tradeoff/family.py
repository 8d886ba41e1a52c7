"""One problem on many meshes, for a search for the right mesh, and the kinds of these meshes.

A family makes, for every number n, a quasi-uniform mesh with about n cells across the domain, and
poses its problem on any mesh of the domain.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

from mpi4py import MPI

from dolfinx_signorini.meshes.elements import HIGHEST_DEGREE
from dolfinx_signorini.meshes.sided_meshes import SidedMesh
from dolfinx_signorini.norms.references import Reference
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.scenes.files.scene import Scene
from dolfinx_signorini.scenes.posing import pose

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


KINDS = tuple(Kind(mesh, degree) for mesh in MESHES for degree in range(1, HIGHEST_DEGREE + 1))
UNIFORM_P1, UNIFORM_P2 = Kind("uniform", 1), Kind("uniform", 2)
GRADED_P2, GRADED_P4 = Kind("graded", 2), Kind("graded", 4)


class Posed(NamedTuple):
    """A problem on one mesh, and its exact solution, or None where that is not known."""

    problem: BoundConstrainedProblem
    exact: Reference | None


@dataclass(frozen=True)
class Family:
    """One problem on any mesh of its domain:

        sided = family.make(comm, 16)
        posed = family.pose(sided, 2)

    Attributes:
        dimension: The dimension of space.
        width: The cell size of the mesh with n = 1: the root of twice the area of a cell.
        make: Makes the mesh with n cells across.
        pose: Assembles the problem on a mesh, for elements of a degree.
        has_ends: Whether contact is on the boundary and ends at points, in the plane: meshes can be
            graded towards them.
    """

    dimension: int
    width: float
    make: Callable[[MPI.Comm, int], SidedMesh]
    pose: Callable[[SidedMesh, int], Posed]
    has_ends: bool = True

    def has_kind(self, kind: Kind) -> bool:
        """Return whether meshes of a kind exist: graded ones in the plane, where contact ends."""
        return kind.mesh != "graded" or (self.has_ends and self.dimension == 2)


def scene_family(scene: Scene) -> Family:
    """Return a scene on quasi-uniform meshes of its domain, whatever its own mesh width is.

    Raises:
        InputError: The scene's mesh is from a file, and is the only one.
    """
    domain = scene.domain

    def on(sided: SidedMesh, degree: int) -> Posed:
        posed = pose(replace(scene, degree=degree), sided.mesh.comm, sided)
        return Posed(posed.problem, posed.exact)

    return Family(
        dimension=domain.dimension,
        width=domain.at(1).size,
        make=lambda comm, n: domain.at(n).make(comm),
        pose=on,
        has_ends=scene.contact is not None,
    )
