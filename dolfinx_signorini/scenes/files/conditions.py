"""Boundary conditions of scenes: one class for each kind, with all that belongs to the kind.

A class reads the tables of the kind in a scene file, adds terms or Dirichlet data to the problem,
tells the force that the conditions exert, and has the words and the line style of the kind. A new
kind is a subclass of `BoundaryCondition` in the list `CONDITIONS`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.ranks import marked
from dolfinx_signorini.data.formulas import COORDINATES, Formula, number
from dolfinx_signorini.meshes.sided_meshes import cells_with_dofs
from dolfinx_signorini.norms.manufactured import matching_obstacle
from dolfinx_signorini.pictures.palette import COLOURS, CONTACT
from dolfinx_signorini.problem.assembly import restricted
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.problem.contact import ContactProblem
from dolfinx_signorini.problem.dirichlet import dirichlet
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.scenes.domains.domain import Domain
from dolfinx_signorini.scenes.files.condition import BoundaryCondition, Setting
from dolfinx_signorini.scenes.files.toml_table import ALL, TomlTable, one_of

BOUNDS = one_of(("lower", "upper"))


@dataclass(frozen=True)
class Contact(BoundaryCondition):
    """The contact boundary; the value is the obstacle, or the gap below the obstacle of a body.

    Without a value, the obstacle of a manufactured scene touches the solution where the flux of the
    solution is not zero.

    Attributes:
        bound: "lower" for u >= obstacle, "upper" for u <= obstacle and for u.d <= gap.
        direction: The components of d; () for the outward normals, and None for a scalar u.
    """

    bound: str = "lower"
    direction: tuple[Formula, ...] | None = None
    key = "contact"
    value_key = "obstacle"
    name = acts_like = "contact"
    force_name = "contact"
    style: ClassVar = CONTACT

    @classmethod
    def read_all(
        cls, top: TomlTable, domain: Domain, manufactured: bool
    ) -> Sequence[BoundaryCondition]:
        if not top.has(cls.key):
            if top.has("obstacle"):
                return []
            message = "there is no [contact] and no [obstacle]: without any obstacle the problem is"
            raise top.error(cls.key, f"{message} linear, see dolfinx.fem.petsc.LinearProblem")
        return [cls.read(top.table(cls.key), domain, manufactured)]

    @property
    def data(self) -> list[tuple[str, Formula]]:
        return super().data + [("direction", part) for part in self.direction or ()]

    @classmethod
    def read(cls, table: TomlTable, domain: Domain, manufactured: bool) -> "Contact":
        sides, zero = table.sides(domain.side_names), number(0.0)
        if table.file.components > 1:
            direction = table.vector("direction", table.file.components, ())
            found = cls(sides, table.formula("gap", zero), "upper", direction)
        else:
            obstacle = table.formula("obstacle", None if manufactured else zero)
            found = cls(sides, obstacle, table.text("bound", "lower", BOUNDS))
        table.finish()
        return found

    def words(self) -> str:
        text = "that the solution touches" if self.value is None else self.value.text
        if self.direction is None:
            return f"{self.bound} obstacle {text} {self.on_sides()}"
        d = ", ".join(formula.text for formula in self.direction)
        along = f"[{d}]" if d else "the normals"
        return f"rigid obstacle at the gap {text} along {along} {self.on_sides()}"

    def problem(
        self, setting: Setting, a: ufl.Form, L: ufl.Form, bcs: Sequence[fem.DirichletBC]
    ) -> BoundConstrainedProblem:
        """Return the problem of forms with this contact boundary; collective.

        Raises:
            InputError: The data make no sense, see `arguments`.
        """
        if self.direction is None:
            return SignoriniProblem(a, L, bcs=bcs, **self.arguments(setting))
        facets, value = setting.sided.facets(self.sides), setting.data(self.value)
        d = list(map(setting.data, self.direction)) or None
        if any(part.constant is None for part in self.direction):
            d = ufl.as_vector(d)
        return ContactProblem(a, L, contact=facets, gap=value, direction=d, bcs=bcs)

    def arguments(self, setting: Setting) -> dict[str, Any]:
        """Return the contact boundary of a scalar as arguments of a problem; collective.

        Raises:
            InputError: Neither an obstacle nor a manufactured solution is given.
        """
        facets, value = setting.sided.facets(self.sides), setting.data(self.value)
        upper, exact = self.bound == "upper", setting.exact
        if value is None:
            if exact is None:
                message = "an obstacle is made for manufactured solutions only"
                raise InputError(message, "contact")
            value = matching_obstacle(setting.space, facets, exact.u, exact.flux, upper)
        return {"contact": facets, "obstacle": value, "bound": self.bound}


@dataclass(frozen=True)
class Dirichlet(BoundaryCondition):
    """Sides with u = value.

    A table with several components of u is read as several conditions.

    Attributes:
        component: The number of the component that has the value; None for a scalar u.
    """

    component: int | None = None
    key = "dirichlet"
    value_key = "value"
    name = acts_like = "Dirichlet"
    force_name = "Dirichlet sides"
    style: ClassVar = {"color": COLOURS[6], "linewidth": 2.0}

    @classmethod
    def read_all(
        cls, top: TomlTable, domain: Domain, manufactured: bool
    ) -> Sequence[BoundaryCondition]:
        if top.file.components == 1:
            return super().read_all(top, domain, manufactured)
        return [part for table in top.tables(cls.key) for part in cls._parts(table, domain)]

    @classmethod
    def _parts(cls, table: TomlTable, domain: Domain) -> list["Dirichlet"]:
        sides, axes = table.sides(domain.side_names), COORDINATES[: table.file.components]
        names = table.sides(axes, "components", "component", "all")
        names = axes if names == ALL else tuple(dict.fromkeys(names))
        if len(names) == 1 and not isinstance(table.data.get("value"), list):
            values: tuple[Formula, ...] = (table.formula("value"),)
        else:
            values = table.vector("value", len(names))
        table.finish()
        return [cls(sides, v, axes.index(n)) for n, v in zip(names, values, strict=True)]

    @property
    def components(self) -> tuple[int, ...]:
        return () if self.component is None else (self.component,)

    def words(self) -> str:
        text = "of the manufactured solution" if self.value is None else self.value.text
        if self.component is None:
            return f"Dirichlet data {text} {self.on_sides()}"
        return f"u_{COORDINATES[self.component]} = {text} {self.on_sides()}"

    def dirichlet(self, setting: Setting) -> fem.DirichletBC:
        data = setting.data(self.value)
        if data is None:
            if setting.exact is None:
                raise InputError("data follow from manufactured solutions only", "dirichlet")
            data = setting.exact.u
        return dirichlet(setting.space, setting.sided.facets(self.sides), data, self.component)

    @classmethod
    def force(cls, problem: BoundConstrainedProblem, residual: ufl.Form) -> Array:
        space, size, fixed = problem.space, problem.space.dofmap.bs, problem.fixed_dofs
        near = cells_with_dofs(space, marked(space, np.unique(fixed // size)))
        own = compiled.assembled(compiled.form(restricted(residual, space.mesh, near)), space)
        # The obstacle pushes on nodes, too, of which some components are held.
        forces = own.x.array[fixed] - problem.forces.x.array[fixed]
        return np.asarray(problem.comm.allreduce(np.bincount(fixed % size, forces, size)))


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

    @classmethod
    def read_all(
        cls, top: TomlTable, domain: Domain, manufactured: bool
    ) -> Sequence[BoundaryCondition]:
        kind = cls if top.file.components == 1 else Traction
        return [kind.read(table, domain, manufactured) for table in top.tables(kind.key)]

    def words(self) -> str:
        return "" if self.value is None else f"flux {self.value.text} {self.on_sides()}"

    def load(self, setting: Setting) -> Expr | None:
        if self.value is None:
            return None
        return self.value.ufl(setting.x)


@dataclass(frozen=True)
class Traction(Neumann):
    """Sides of a body with a load; the value is a pressure against the outward normal.

    Attributes:
        parts: In place of a pressure, the components of the force per area.
    """

    parts: tuple[Formula, ...] = ()
    key = "traction"
    value_key = "pressure"
    force_name = "traction"

    @classmethod
    def read(cls, table: TomlTable, domain: Domain, manufactured: bool) -> "Traction":
        sides, pressure = table.sides(domain.side_names), table.formula("pressure", None)
        if pressure is not None and table.has("force"):
            raise table.error("pressure", "beside 'force'; give one of the two")
        force = table.vector("force", table.file.components) if pressure is None else ()
        table.finish()
        return cls(sides, pressure, force)

    @property
    def data(self) -> list[tuple[str, Formula]]:
        return super().data + [("force", part) for part in self.parts]

    def words(self) -> str:
        if self.value is not None:
            return f"pressure {self.value.text} {self.on_sides()}"
        return f"traction [{', '.join(part.text for part in self.parts)}] {self.on_sides()}"

    def load(self, setting: Setting) -> Expr:
        pressure = super().load(setting)
        if pressure is not None:
            return -pressure * ufl.FacetNormal(setting.sided.mesh)
        return ufl.as_vector([part.ufl(setting.x) for part in self.parts])


CONDITIONS: tuple[type[BoundaryCondition], ...] = (Contact, Dirichlet, Neumann)


def read_conditions(
    top: TomlTable, domain: Domain, manufactured: bool
) -> tuple[BoundaryCondition, ...]:
    """Return the conditions of a scene file, see `BoundaryCondition.read_all`.

    Raises:
        InputError: A table makes no sense, or a component on a side belongs to two conditions.
    """
    conditions = [c for kind in CONDITIONS for c in kind.read_all(top, domain, manufactured)]
    owner: dict[tuple[str, int], str] = {}
    for condition in conditions:
        for side in domain.side_names if condition.sides == ALL else condition.sides:
            for component in condition.components or range(top.file.components):
                if (side, component) in owner:
                    message = f"side {side!r} belongs to {owner[side, component]} already"
                    raise top.error(condition.key, message)
                owner[side, component] = condition.key
    return tuple(conditions)
