"""One problem on many meshes, for a search for the right mesh.

A family makes, for every number n, a quasi-uniform mesh with about n cells across the domain, and
poses its problem on any mesh of the domain.
"""

from collections.abc import Callable
from dataclasses import dataclass

from mpi4py import MPI

from dolfinx_signorini.meshes import SidedMesh
from dolfinx_signorini.problem import SignoriniProblem
from dolfinx_signorini.references import Reference


@dataclass(frozen=True)
class Posed:
    """A problem on one mesh:

        Posed(paper_problem(exact), exact)

    Attributes:
        problem: The discrete problem.
        exact: The exact solution, or None where it is not known.
    """

    problem: SignoriniProblem
    exact: Reference | None


@dataclass(frozen=True)
class Family:
    """One problem on any mesh of its domain:

        sided = family.make(comm, 16)
        posed = family.pose(sided, 2)

    Attributes:
        name: The name of the problem.
        dimension: The dimension of space.
        width: The cell size of the mesh with n = 1: the root of twice the area of a cell.
        make: Makes the mesh with n cells across.
        pose: Assembles the problem on a mesh, for elements of degree 1 or 2.
    """

    name: str
    dimension: int
    width: float
    make: Callable[[MPI.Comm, int], SidedMesh]
    pose: Callable[[SidedMesh, int], Posed]
