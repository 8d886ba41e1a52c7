"""The constraint of a problem: obstacles below or above, on the boundary, in cells, or on both."""

from dataclasses import dataclass
from typing import Any

from dolfinx.mesh import Mesh

from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.kinds import check, choice, on_mesh
from dolfinx_signorini.problem.values import Data


@dataclass(frozen=True)
class Obstacle:
    """An obstacle, as users give it:

        Obstacle(1.0, g, "obstacle")

    Attributes:
        sign: 1 for a lower obstacle, u >= g, and -1 for an upper one, u <= g.
        data: The obstacle g.
        name: The name of the argument that gave the obstacle.
    """

    sign: float
    data: Data
    name: str


@dataclass(frozen=True)
class Zone:
    """Facets or cells on which one obstacle acts, or two:

        Zone(domain.topology.dim, cells, (Obstacle(1.0, 0.0, "lower"),))

    Attributes:
        dim: The dimension of the facets or cells.
        entities: These facets or cells, as far as this rank knows them.
        obstacles: The obstacles, a lower one first.
    """

    dim: int
    entities: LocalIndices
    obstacles: tuple[Obstacle, ...]


@dataclass(frozen=True)
class Constraint:
    """What bounds the solution: obstacles on a part of the boundary or in the domain, or on both.

    For example:

        Constraint((Zone(domain.topology.dim, cells, (Obstacle(1.0, 0.0, "lower"),)),))

    Attributes:
        zones: Where the obstacles act; cells come before facets.
        vectors: Whether the unknowns are vectors, which the obstacle meets in a direction.
        direction: This direction; None for the averaged normal.
        held_weakly: Whether springs hold what nothing else does, see `ContactProblem`.
    """

    zones: tuple[Zone, ...]
    vectors: bool = False
    direction: Any = None
    held_weakly: bool = False

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """All obstacles, in the order of the zones."""
        return tuple(obstacle for zone in self.zones for obstacle in zone.obstacles)


def is_default(obstacle: Data, bound: str) -> bool:
    """Whether two arguments `obstacle` and `bound` are those that nobody gave: 0 from below."""
    return isinstance(obstacle, int | float) and obstacle == 0.0 and bound == "lower"


def one_obstacle(mesh: Mesh, obstacle: Data, bound: str) -> Obstacle:
    """Return the obstacle that two arguments `obstacle` and `bound` give.

    Args:
        mesh: The mesh of the problem.
        obstacle: The obstacle.
        bound: "lower" or "upper".

    Raises:
        InputError: The obstacle is of no known kind, or the bound is another word.
    """
    check(
        bound=(bound, choice("lower", "upper")),
        obstacle=(obstacle, on_mesh(mesh, callables=True)),
    )
    return Obstacle(1.0 if bound == "lower" else -1.0, obstacle, "obstacle")


def obstacles_of(mesh: Mesh, lower: Data | None, upper: Data | None) -> tuple[Obstacle, ...]:
    """Return the obstacles that two arguments `lower` and `upper` give.

    Args:
        mesh: The mesh of the problem.
        lower, upper: The obstacles; None where there is none.

    Raises:
        InputError: An obstacle is of no known kind, or there is none.
    """
    given = [(1.0, lower, "lower"), (-1.0, upper, "upper")]
    found = tuple(Obstacle(sign, data, name) for sign, data, name in given if data is not None)
    check(**{each.name: (each.data, on_mesh(mesh, callables=True)) for each in found})
    if not found:
        message = "give one of them, or both; without any obstacle the problem is linear, see "
        raise InputError(f"{message}dolfinx.fem.petsc.LinearProblem", "lower, upper")
    return found
