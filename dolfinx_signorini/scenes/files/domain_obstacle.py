"""The obstacles in the domain of a scene, or in some of its cells: the table [obstacle]."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.data.formulas import Formula, together
from dolfinx_signorini.meshes.sided_meshes import SidedMesh
from dolfinx_signorini.norms.manufactured import Violation, worst_violation
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.problem.obstacle import ObstacleProblem
from dolfinx_signorini.scenes.domains.domain import Domain
from dolfinx_signorini.scenes.files.condition import Setting
from dolfinx_signorini.scenes.files.toml_table import ALL, TomlTable


@dataclass(frozen=True)
class DomainObstacle:
    """One obstacle, or two, in the domain.

    The obstacles come from a scene file, and an `ObstacleProblem` takes them:

        obstacle, domain = DomainObstacle.read(top, domain, comm)
        print(*obstacle.words(), sep="; ")

    Attributes:
        named: The obstacles with their names, "lower" and "upper".
        cells: The regions that have the obstacles; `ALL` for the whole domain.
        key: The table of a scene file.
    """

    named: tuple[tuple[str, Formula], ...]
    cells: tuple[str, ...] = ALL
    key: ClassVar = "obstacle"

    @classmethod
    def read(
        cls, top: TomlTable, domain: Domain, comm: MPI.Comm
    ) -> tuple["DomainObstacle | None", Domain]:
        """Return the obstacles of a scene file, and the domain with the regions that they need.

        Args:
            top: The file.
            domain: The domain of the scene.
            comm: The communicator that will share the mesh; the call is collective.

        Raises:
            InputError: The table has no obstacle or a key that makes no sense.
        """
        if not top.has(cls.key):
            return None, domain
        table = top.table(cls.key)
        named = tuple((k, table.formula(k)) for k in ("lower", "upper") if table.has(k))
        cells: tuple[str, ...] = ALL
        if table.has("cells"):
            with table.naming("cells"):
                domain = domain.with_regions(comm)
            cells = table.sides(domain.region_names, "cells", "cell tag")
        table.finish()
        if not named:
            raise table.error(None, "'lower' or 'upper' is missing")
        return cls(named, cells), domain

    def problem(
        self,
        setting: Setting,
        a: ufl.Form,
        L: ufl.Form,
        bcs: Sequence[fem.DirichletBC],
        boundary: Mapping[str, Any],
    ) -> BoundConstrainedProblem:
        """Return the problem of forms with these obstacles; collective.

        Args:
            setting: The mesh with the space.
            a, L: The forms.
            bcs: The Dirichlet conditions.
            boundary: The arguments of the problem that give a contact boundary; none without one.
        """
        cells = None if self.cells == ALL else setting.sided.cells(self.cells)
        obstacles = {name: setting.data(formula) for name, formula in self.named}
        return ObstacleProblem(a, L, cells=cells, bcs=bcs, **obstacles, **boundary)

    def violations(self, u: Formula, sided: SidedMesh) -> list[Violation]:
        """Return the obstacles that a function lies beyond, each at the worst vertex.

        Args:
            u: The function.
            sided: A mesh of the domain; the call is collective.
        """
        comm, geometry = sided.mesh.comm, sided.mesh.geometry
        vertices = np.unique(geometry.dofmap[sided.cells(self.cells)])
        points: Array = np.asarray(geometry.x[vertices, : geometry.dim], dtype=np.float64)
        found = []
        for name, formula in self.named:
            order, sign = ("u >= lower", 1.0) if name == "lower" else ("u <= upper", -1.0)
            values = together([u.root, formula.root], points)
            known = np.where(np.isfinite(values).all(axis=0), values, 0.0)
            worst = worst_violation(comm, order, sign * (known[1] - known[0]), points)
            if worst.value > SOLVED * highest(comm, np.abs(known)):
                found.append(worst)
        return found

    def words(self) -> list[str]:
        """Return what the obstacles add to a problem, in words."""
        where = "in the domain" if self.cells == ALL else f"in cells of {', '.join(self.cells)}"
        return [f"{name} obstacle {formula.text} {where}" for name, formula in self.named]
