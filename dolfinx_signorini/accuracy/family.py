"""Families of meshes for one problem: what a search for the right mesh needs to know of it.

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
    """A problem on one mesh.

    Attributes:
        problem: The discrete problem.
        exact: The exact solution, if it is known.
        sign: -1 where the problem is one for -u, because the obstacle is an upper one; else 1.
    """

    problem: SignoriniProblem
    exact: Reference | None
    sign: float


@dataclass(frozen=True)
class Family:
    """One problem on any mesh of its domain.

    Attributes:
        name: What to call it.
        dimension: Of space.
        width: The cell size of the mesh with n = 1: the root of twice a cell's area.
        make: Makes the mesh with n cells across.
        pose: Assembles the problem on a mesh, for elements of degree 1 or 2.
    """

    name: str
    dimension: int
    width: float
    make: Callable[[MPI.Comm, int], SidedMesh]
    pose: Callable[[SidedMesh, int], Posed]
