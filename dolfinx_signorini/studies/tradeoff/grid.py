"""The grid of configurations whose speed and accuracy are compared."""

from collections.abc import Sequence
from dataclasses import replace

from dolfinx_signorini.studies.tradeoff.family import (
    GRADED_P2,
    GRADED_P4,
    KINDS,
    UNIFORM_P1,
    UNIFORM_P2,
    Kind,
)
from dolfinx_signorini.studies.tradeoff.runs import Configuration

# Cells across by dimension, mesh and degree, from small to large.
CELLS: dict[int, dict[Kind, tuple[int, ...]]] = {
    2: {
        UNIFORM_P1: (16, 26, 51, 101, 201, 401, 1001),
        UNIFORM_P2: (10, 16, 26, 44, 64, 88, 144, 250),
        Kind("uniform", 3): (6, 10, 16, 26, 40, 64, 100),
        Kind("uniform", 4): (4, 8, 12, 20, 32, 50),
        Kind("graded", 1): (16, 32, 64, 128, 256),
        GRADED_P2: (10, 16, 24, 32, 48, 64, 104, 208),
        Kind("graded", 3): (8, 16, 24, 32, 48, 64),
        GRADED_P4: (8, 16, 24, 32, 48),
    },
    3: {
        UNIFORM_P1: (4, 6, 9, 13, 18, 26, 40),
        UNIFORM_P2: (3, 4, 6, 9, 13, 18),
        Kind("uniform", 3): (2, 3, 4, 6, 9),
    },
}
# Cells across on the first mesh of the adaptive loop: as few as on any mesh, by dimension.
FIRST = {dim: min(map(min, kinds.values())) for dim, kinds in CELLS.items()}
ADAPTED = 30_000  # limit on the unknowns of adapted meshes
REFERENCE = 4  # unknowns of a reference solution over this limit


def grid(max_unknowns: int, dimension: int = 2, sweeps: bool = True) -> list[Configuration]:
    """Return uniform and graded meshes of all degrees, and sweeps of one setting each.

    Args:
        max_unknowns: Limit on the dofs, as if no mesh was graded.
        dimension: The dimension of space; meshes are graded in the plane only.
        sweeps: Whether tolerances, quadrature rules and methods are varied, too.
    """
    found = [Configuration(kind, n) for kind, sizes in CELLS[dimension].items() for n in sizes]
    # From small to large, so that memory left by larger ones does not count as peak memory.
    found.sort(key=lambda c: c.size)
    found += _sweeps() if sweeps else []
    return [c for c in found if (c.size + 1) ** dimension <= max_unknowns]


def ladder(
    kind: Kind, norm: str, accuracies: Sequence[float], max_unknowns: int, dimension: int = 2
) -> list[Configuration]:
    """Return the adaptive loop in a norm for one decreasing accuracy after the other."""
    limit = min(max_unknowns, ADAPTED)
    first = Configuration(kind, FIRST[dimension], norm=norm, max_unknowns=limit)
    return [replace(first, accuracy=accuracy) for accuracy in accuracies]


def adapted_kinds(max_unknowns: int, dimension: int) -> list[Kind]:
    """Return the kinds of adapted meshes whose first meshes, as divided, are within a limit."""
    across = 2 * FIRST[dimension]
    return [
        kind
        for kind in KINDS
        if kind.mesh == "adapted"
        and kind.degree <= max(other.degree for other in CELLS[dimension])
        and 2 * (kind.degree * across + 1) ** dimension <= max_unknowns
    ]


def finer_configuration(max_unknowns: int, dimension: int) -> Configuration:
    """Return a configuration that is more accurate than all of a grid, as a reference."""
    kind, n = Kind("adapted", 3), FIRST[dimension]
    coarsest = 2 * (2 * kind.degree * n + 1) ** dimension
    limit = max(REFERENCE * min(max_unknowns, ADAPTED), coarsest)
    return Configuration(kind, n, norm="H1", max_unknowns=limit)


def _sweeps() -> list[Configuration]:
    """Two configurations with varied tolerance and quadrature, and two with varied method."""
    tolerances, rules = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8), (1, 2, 3, 4, 5, 7, 9, 11)
    found = []
    for c in (Configuration(UNIFORM_P1, 101), Configuration(GRADED_P4, 24)):
        found += [replace(c, rtol=rtol, purpose="tolerance") for rtol in tolerances]
        found += [replace(c, rule=rule, purpose="rule") for rule in rules]
    for n in (51, 101):
        c = Configuration(UNIFORM_P1, n, rtol=1e-6, purpose="method")
        found += [replace(c, method=name) for name in ("cascade", "bqnls", "bncg", "bntr")]
    return found
