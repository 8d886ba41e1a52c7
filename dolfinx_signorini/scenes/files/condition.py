"""What all kinds of boundary conditions of scenes have, and what their data refer to."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.data.formulas import Formula
from dolfinx_signorini.data.interfaces.piecewise_forms import BY_DATA
from dolfinx_signorini.meshes.sided_meshes import SidedMesh
from dolfinx_signorini.norms.manufactured import ManufacturedSolution
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.scenes.domains.domain import Domain
from dolfinx_signorini.scenes.files.toml_table import TomlTable


@dataclass(frozen=True)
class Setting:
    """The mesh, the space and the exact solution that the data of conditions refer to.

    A formula becomes an expression on the mesh of the setting:

        value = formula.ufl(setting.x)

    Attributes:
        sided: The mesh with its sides.
        space: The function space of the problem.
        exact: The exact solution, where it is known.
    """

    sided: SidedMesh
    space: fem.FunctionSpace
    exact: ManufacturedSolution | None

    @property
    def x(self) -> ufl.SpatialCoordinate:
        """The coordinates."""
        return ufl.SpatialCoordinate(self.sided.mesh)

    @property
    def dx(self) -> ufl.Measure:
        """The measure of cells, whose rule follows the data."""
        return ufl.Measure("dx", self.sided.mesh, metadata=BY_DATA)

    def data(self, formula: Formula | None) -> Any:
        """Return a formula as problems take data: a number or an expression; None for None."""
        if formula is None:
            return None
        return formula.ufl(self.x) if formula.constant is None else formula.constant


@dataclass(frozen=True)
class BoundaryCondition(ABC):
    """A condition on some sides of the boundary.

    Conditions come from a scene file, and become terms of a problem:

        for condition in Neumann.read_all(top, domain, manufactured=False):
            print(condition.words(), condition.load(setting))

    Attributes:
        sides: The names of the sides.
        value: The data; None where the data follow from a manufactured solution.
        key, value_key: The table of a scene file that has the condition, and the key of the data.
        name: The name in messages and pictures.
        acts_like: "Dirichlet", "Neumann" or "contact": the condition that decides how smooth the
            solution is at the ends of the sides.
        force_name: The name of the force that the conditions exert, after "force of".
        style: How matplotlib draws the sides.
    """

    sides: tuple[str, ...]
    value: Formula | None
    key: ClassVar[str]
    value_key: ClassVar[str]
    name: ClassVar[str]
    acts_like: ClassVar[str]
    force_name: ClassVar[str]
    style: ClassVar[dict[str, Any]]

    @classmethod
    def read_all(
        cls, top: TomlTable, domain: Domain, manufactured: bool
    ) -> Sequence["BoundaryCondition"]:
        """Return the conditions of this kind in a scene file.

        Args:
            top: The file.
            domain: The domain that has the sides.
            manufactured: Whether the data follow from a manufactured solution.
        """
        return [cls.read(table, domain, manufactured) for table in top.tables(cls.key)]

    @classmethod
    def read(cls, table: TomlTable, domain: Domain, manufactured: bool) -> "BoundaryCondition":
        """Return the condition of one table; see `read_all`."""
        sides = table.sides(domain.side_names)
        if manufactured and table.has(cls.value_key):
            message = "follows from the solution, which is manufactured"
            raise table.error(cls.value_key, message)
        value = None if manufactured else table.formula(cls.value_key)
        table.finish()
        return cls(sides, value)

    @property
    def components(self) -> tuple[int, ...]:
        """The numbers of the components of u that the condition is on; () for all."""
        return ()

    @property
    def data(self) -> list[tuple[str, Formula]]:
        """The data with their keys."""
        return [] if self.value is None else [(self.value_key, self.value)]

    @abstractmethod
    def words(self) -> str:
        """Return what the condition adds to a problem, in words."""

    def load(self, setting: Setting) -> Expr | None:
        """Return the part of K grad u . n, or of the traction, that does not depend on u."""
        return None

    def coefficient(self, setting: Setting) -> Expr | None:
        """Return c, where K grad u . n = load - c u on the sides."""
        return None

    def dirichlet(self, setting: Setting) -> fem.DirichletBC | None:
        """Return the Dirichlet condition on the sides."""
        return None

    @classmethod
    def force(cls, problem: BoundConstrainedProblem, residual: ufl.Form) -> Array | None:
        """Return the force of all conditions of this kind, besides the integrals of load and c u.

        Args:
            problem: The solved problem; the call is collective.
            residual: The linear form a(u, v) - L(v).

        Returns:
            A number for each component.
        """
        return None

    def on_sides(self) -> str:
        """Return the sides, in words."""
        return f"on {', '.join(self.sides)}"
