"""One problem on many meshes, for a search for the right mesh.

A family makes, for every number n, a quasi-uniform mesh with about n cells across the domain, and
poses its problem on any mesh of the domain.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

from mpi4py import MPI

from dolfinx_signorini.meshes.sided_meshes import SidedMesh
from dolfinx_signorini.norms.references import Reference
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.scenes.files.scene import Scene
from dolfinx_signorini.scenes.posing import pose
from dolfinx_signorini.studies.tradeoff.kinds import Kind


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
        """Return whether meshes of a kind exist."""
        return kind.suits(self.dimension) and (self.has_ends or kind.mesh != "graded")


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
