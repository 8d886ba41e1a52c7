"""Boundary conditions of scenes: one class for each kind, with all that belongs to the kind.

A class reads the tables of the kind in a scene file, adds terms or Dirichlet data to the problem,
tells the force that the conditions exert, and has the words and the line style of the kind. A new
kind is a subclass of `BoundaryCondition` in the list `CONDITIONS`.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc
from ufl.core.expr import Expr

from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.ranks import marked
from dolfinx_signorini.data.formulas import Formula, number
from dolfinx_signorini.data.interfaces.facet_jumps import integrable_on_facets
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, cells_with_dofs
from dolfinx_signorini.norms.manufactured import ManufacturedSolution, matching_obstacle
from dolfinx_signorini.pictures.palette import COLOURS, CONTACT
from dolfinx_signorini.problem.assembly import restricted
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.problem.directions import scalar_space
from dolfinx_signorini.problem.dirichlet import dirichlet
from dolfinx_signorini.scenes.domains.domain import Domain
from dolfinx_signorini.scenes.files.toml_table import ALL, TomlTable

Sides = tuple[str, ...]


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

    @cached_property
    def nodal(self) -> fem.FunctionSpace:
        """The scalar space of one component, where the space has vectors."""
        return scalar_space(self.space)

    @property
    def x(self) -> ufl.SpatialCoordinate:
        """The coordinates."""
        return ufl.SpatialCoordinate(self.sided.mesh)

    def data(self, formula: Formula) -> float | Expr:
        """Return a formula as problems take data."""
        return formula.ufl(self.x) if formula.constant is None else formula.constant

    def optional_data(self, formula: Formula | None) -> float | Expr | None:
        """Return a formula as problems take data; None for None."""
        return None if formula is None else self.data(formula)


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
        subjects: Subjects of errors about such conditions, with the keys of a scene file that the
            errors are about.
        name: The name in messages and pictures.
        acts_like: "Dirichlet", "Neumann" or "contact": the condition that decides how smooth the
            solution is at the ends of the sides.
        force_name: The name of the force that the conditions exert, after "force of".
        style: How matplotlib draws the sides.
    """

    sides: Sides
    value: Formula | None
    key: ClassVar[str]
    value_key: ClassVar[str]
    subjects: ClassVar[dict[str, tuple[str, ...]]] = {}
    name: ClassVar[str]
    acts_like: ClassVar[str]
    force_name: ClassVar[str]
    style: ClassVar[dict[str, Any]]

    @classmethod
    def read_all(
        cls, top: TomlTable, domain: Domain, manufactured: bool
    ) -> list["BoundaryCondition"]:
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
        value = table.optional_formula(cls.value_key)
        if manufactured and value is not None:
            message = "follows from the solution, which is manufactured"
            raise table.error(cls.value_key, message)
        if not manufactured and value is None:
            raise table.error(None, f"{cls.value_key!r} is missing")
        table.finish()
        return cls(sides, value)

    @property
    def components(self) -> tuple[int, ...]:
        """The numbers of the components of u that the condition is on; () for all."""
        return ()

    @abstractmethod
    def words(self) -> str:
        """Return what the condition adds to a problem, in words."""

    def load(self, setting: Setting) -> Expr | None:
        """Return the part of K grad u . n on the sides that does not depend on u."""
        return None

    def coefficient(self, setting: Setting) -> Expr | None:
        """Return c, where K grad u . n = load - c u on the sides."""
        return None

    def dirichlet(self, setting: Setting) -> fem.DirichletBC | None:
        """Return the Dirichlet condition on the sides."""
        return None

    @classmethod
    def force(cls, problem: BoundConstrainedProblem, residual: ufl.Form) -> float | None:
        """Return the force of all conditions of this kind, besides the integrals of load and c u.

        Args:
            problem: The solved problem; the call is collective.
            residual: The linear form a(u, v) - L(v).
        """
        return None

    def on_sides(self) -> str:
        """Return the sides, in words."""
        return f"on {', '.join(self.sides)}"


@dataclass(frozen=True)
class Contact(BoundaryCondition):
    """The contact boundary; the value is the obstacle.

    Without a value, the obstacle of a manufactured scene touches the solution where the flux of the
    solution is not zero.

    Attributes:
        bound: "lower" for u >= obstacle, "upper" for u <= obstacle.
    """

    bound: str = "lower"
    key = "contact"
    value_key = "obstacle"
    subjects: ClassVar = {"obstacle": ("contact", "obstacle"), "bound": ("contact", "bound")}
    name = acts_like = "contact"
    force_name = "contact"
    style: ClassVar = CONTACT

    @classmethod
    def read_all(
        cls, top: TomlTable, domain: Domain, manufactured: bool
    ) -> list[BoundaryCondition]:
        if top.has("obstacle"):
            return []
        if not top.has(cls.key):
            message = "there is no [contact] and no [obstacle]: without any obstacle the problem is"
            raise top.error(cls.key, f"{message} linear, see dolfinx.fem.petsc.LinearProblem")
        return [cls.read(top.table(cls.key), domain, manufactured)]

    @classmethod
    def read(cls, table: TomlTable, domain: Domain, manufactured: bool) -> "Contact":
        sides = table.sides(domain.side_names)
        bound = table.choice("bound", ("lower", "upper"), "lower")
        obstacle = table.optional_formula("obstacle")
        table.finish()
        if obstacle is None and not manufactured:
            obstacle = number(0.0)
        return cls(sides, obstacle, bound)

    def words(self) -> str:
        text = "that the solution touches" if self.value is None else self.value.text
        return f"{self.bound} obstacle {text} {self.on_sides()}"

    def obstacle(self, setting: Setting) -> float | Expr | fem.Function:
        """Return the obstacle as a `SignoriniProblem` takes it.

        Raises:
            InputError: Neither an obstacle nor a manufactured solution is given.
        """
        if self.value is not None:
            return setting.data(self.value)
        exact, facets = setting.exact, setting.sided.facets(self.sides)
        if exact is None:
            raise InputError("an obstacle is made for manufactured solutions only", "contact")
        upper = self.bound == "upper"
        return matching_obstacle(setting.space, facets, exact.u, exact.flux, upper)


@dataclass(frozen=True)
class Dirichlet(BoundaryCondition):
    """Sides with u = value."""

    key = "dirichlet"
    value_key = "value"
    subjects: ClassVar = {"Dirichlet data": ("dirichlet",)}
    name = acts_like = "Dirichlet"
    force_name = "Dirichlet sides"
    style: ClassVar = {"color": COLOURS[6], "linewidth": 2.0}

    def words(self) -> str:
        text = "of the manufactured solution" if self.value is None else self.value.text
        return f"Dirichlet data {text} {self.on_sides()}"

    def dirichlet(self, setting: Setting) -> fem.DirichletBC:
        if self.value is not None:
            data = setting.data(self.value)
        elif setting.exact is not None:
            data = setting.exact.u
        else:
            raise InputError("data follow from manufactured solutions only", "dirichlet")
        return dirichlet(setting.space, setting.sided.facets(self.sides), data)

    @classmethod
    def force(cls, problem: BoundConstrainedProblem, residual: ufl.Form) -> float | None:
        cells = cells_with_dofs(problem.space, marked(problem.space, problem.fixed_dofs))
        near = compiled.form(restricted(residual, problem.space.mesh, cells))
        vector = fem_petsc.assemble_vector(near)
        vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        force = float(vector.array_r[problem.fixed_dofs].sum())
        vector.destroy()
        return float(problem.comm.allreduce(force))


@dataclass(frozen=True)
class Neumann(BoundaryCondition):
    """Sides with K grad u . n = value.

    Sides without any condition count as Neumann sides: with the flux of a manufactured solution, or
    else with flux 0.
    """

    key = "neumann"
    value_key = "flux"
    name = acts_like = "Neumann"
    force_name = "flux"
    style: ClassVar = {"color": COLOURS[5], "linewidth": 1.5, "linestyle": "--"}

    def words(self) -> str:
        return "" if self.value is None else f"flux {self.value.text} {self.on_sides()}"

    def load(self, setting: Setting) -> Expr | None:
        if self.value is None:
            return None
        degree = setting.space.element.basix_element.degree
        facets = setting.sided.facets(self.sides)
        return integrable_on_facets(self.value, setting.sided.mesh, facets, degree)


CONDITIONS: tuple[type[BoundaryCondition], ...] = (Contact, Dirichlet, Neumann)


def read_conditions(
    top: TomlTable,
    domain: Domain,
    manufactured: bool,
    kinds: Sequence[type[BoundaryCondition]] | None = None,
) -> tuple[BoundaryCondition, ...]:
    """Return the conditions of a scene file, see `BoundaryCondition.read_all`.

    Args:
        top, domain, manufactured: See `BoundaryCondition.read_all`.
        kinds: The kinds of condition that the file may have; those of scalars by default.

    Raises:
        InputError: A table makes no sense, or a component on a side belongs to two conditions.
    """
    known = CONDITIONS if kinds is None else kinds
    conditions = [c for kind in known for c in kind.read_all(top, domain, manufactured)]
    owner: dict[tuple[str, int], str] = {}
    for condition in conditions:
        for side in domain.side_names if condition.sides == ALL else condition.sides:
            for component in condition.components or range(domain.dimension):
                if (side, component) in owner:
                    message = f"side {side!r} belongs to {owner[side, component]} already"
                    raise top.error(condition.key, message)
                owner[side, component] = condition.key
    return tuple(conditions)
