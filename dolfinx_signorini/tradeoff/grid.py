"""The grid of configurations whose speed and accuracy are compared."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from mpi4py import MPI

from dolfinx_signorini.quadrature import CELL_RULE
from dolfinx_signorini.tradeoff.kinds import GRADED_P1, GRADED_P2, UNIFORM_P1, UNIFORM_P2, Kind
from dolfinx_signorini.tradeoff.runs import Configuration

# Cells across by dimension and kind, from small to large.
CELLS: dict[int, dict[Kind, tuple[int, ...]]] = {
    2: {
        UNIFORM_P1: (16, 26, 51, 101, 201, 401, 701, 1001),
        UNIFORM_P2: (10, 16, 26, 38, 64, 88, 104, 144, 250),
        GRADED_P1: (16, 26, 40, 64, 104, 160, 256, 400),
        GRADED_P2: (10, 16, 22, 24, 32, 48, 64, 104, 160, 208),
    },
    3: {UNIFORM_P1: (4, 6, 9, 13, 18, 26, 40), UNIFORM_P2: (3, 4, 6, 9, 13, 18)},
}
GRID_RTOL = 1e-5  # the rows report the algebraic error that this tolerance leaves
SWEEP_RTOL = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
SWEEP_RULE = (1, 2, 3, 4, 5, 7, 9)
SWEEP_METHOD = ("cascade", "bqnls", "bncg", "bntr")
FINER = 1.6  # cells across of a reference solution over those of the finest P2 mesh


@dataclass(frozen=True)
class Item:
    """One point of the grid:

        Item(Configuration(UNIFORM_P1, 101), rule=3, purpose="rule")

    Attributes:
        configuration: Mesh, elements, method and tolerance.
        rule: Degree of the Gauss-Jacobi rule of the load.
        purpose: "main" for the comparison of meshes and elements, else the name of a sweep.
    """

    configuration: Configuration
    rule: int = CELL_RULE.degree
    purpose: str = "main"

    @property
    def size(self) -> int:
        """The dofs across the domain, as if the mesh was not graded."""
        return self.configuration.kind.degree * self.configuration.n

    def key(self, comm: MPI.Comm) -> dict[str, Any]:
        """Return the entries that identify the row of the item among all rows."""
        c = self.configuration
        own = {"graded": c.kind.graded, "n": c.n, "degree": c.kind.degree}
        solver = {"method": c.method, "rtol": c.rtol, "rule": self.rule}
        return own | solver | {"purpose": self.purpose, "ranks": comm.size}


def grid(max_unknowns: int, dimension: int = 2, sweeps: bool = True) -> list[Item]:
    """Return the grid: uniform and graded meshes, P1 and P2, and sweeps of one setting each.

    Args:
        max_unknowns: Limit on the dofs, as if no mesh was graded.
        dimension: The dimension of space; meshes are graded in the plane only.
        sweeps: Whether tolerances, quadrature rules and methods are varied, too.
    """
    items = [
        Item(Configuration(kind, n, rtol=GRID_RTOL))
        for kind, sizes in CELLS[dimension].items()
        for n in sizes
    ]
    items = [item for item in items if (item.size + 1) ** dimension <= max_unknowns]
    # From small to large, so that memory left by larger items does not count as peak memory.
    items.sort(key=lambda item: item.size)
    if not sweeps:
        return items
    return [item for item in [*items, *_sweeps()] if item.size**2 < max_unknowns]


def finer_configuration(items: Sequence[Item]) -> Configuration:
    """Return a finer P2 configuration than all of a grid, as a reference for its errors."""
    configurations = [item.configuration for item in items]
    n = max(c.n for c in configurations if c.kind.degree == 2)
    graded = any(c.kind.graded for c in configurations)
    return Configuration(GRADED_P2 if graded else UNIFORM_P2, int(FINER * n))


def _sweeps() -> list[Item]:
    """Two configurations with varied tolerance and quadrature, and two with varied method."""
    items = []
    for c in (Configuration(UNIFORM_P1, 101), Configuration(GRADED_P2, 48)):
        items += [Item(replace(c, rtol=rtol), purpose="tolerance") for rtol in SWEEP_RTOL]
        items += [Item(c, rule=rule, purpose="rule") for rule in SWEEP_RULE]
    for n in (51, 101):
        for method in SWEEP_METHOD:
            c = Configuration(UNIFORM_P1, n, method=method, rtol=1e-6)
            items.append(Item(c, purpose="method"))
    return items
