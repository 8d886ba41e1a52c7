"""Boundary conditions of elastic bodies: contact at a gap, held components, tractions."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc
from ufl.core.expr import Expr

from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.ranks import marked
from dolfinx_signorini.data.formulas import COORDINATES, Formula, number
from dolfinx_signorini.data.interfaces.facet_jumps import integrable_on_facets
from dolfinx_signorini.meshes.sided_meshes import cells_with_dofs
from dolfinx_signorini.problem.assembly import restricted
from dolfinx_signorini.problem.contact import ContactProblem
from dolfinx_signorini.problem.values import evaluator
from dolfinx_signorini.scenes.domains.domain import Domain
from dolfinx_signorini.scenes.files.conditions import (
    BoundaryCondition,
    Contact,
    Dirichlet,
    Neumann,
    Setting,
)
from dolfinx_signorini.scenes.files.toml_table import TomlTable


@dataclass(frozen=True)
class ElasticContact(Contact):
    """Sides where u.d <= gap; the value is the gap.

    Attributes:
        direction: The components of d; () for the outward normals.
    """

    direction: tuple[Formula, ...] = ()
    value_key = "gap"
    subjects: ClassVar = {}

    @classmethod
    def read(cls, table: TomlTable, domain: Domain, manufactured: bool) -> "ElasticContact":
        sides = table.sides(domain.side_names)
        gap = table.optional_formula("gap") or number(0.0)
        direction = table.vector("direction", domain.dimension) if table.has("direction") else ()
        table.finish()
        return cls(sides, gap, "upper", direction)

    def words(self) -> str:
        assert self.value is not None
        along = "the normals"
        if self.direction:
            along = f"[{', '.join(formula.text for formula in self.direction)}]"
        return f"rigid obstacle at the gap {self.value.text} along {along} {self.on_sides()}"

    def directions(self, setting: Setting) -> list[float] | Expr | None:
        """Return the direction as a `ContactProblem` takes it."""
        constants = [c for c in (part.constant for part in self.direction) if c is not None]
        if not self.direction or len(constants) == len(self.direction):
            return constants or None
        return ufl.as_vector([part.ufl(setting.x) for part in self.direction])


@dataclass(frozen=True)
class Held(Dirichlet):
    """Sides where one component of the displacement is the value.

    A table with several components is read as several conditions.

    Attributes:
        component: The number of the component.
    """

    component: int = 0

    @classmethod
    def read_all(
        cls, top: TomlTable, domain: Domain, manufactured: bool
    ) -> list[BoundaryCondition]:
        return [held for table in top.tables(cls.key) for held in cls._parts(table, domain)]

    @classmethod
    def _parts(cls, table: TomlTable, domain: Domain) -> list["Held"]:
        sides = table.sides(domain.side_names)
        axes = COORDINATES[: domain.dimension]
        names = axes
        if table.has("components"):
            names = table.sides(axes, "components", "component")
            names = axes if names == ("all",) else tuple(dict.fromkeys(names))
        if len(names) == 1 and not isinstance(table.data.get("value"), list):
            values: tuple[Formula, ...] = (table.formula("value"),)
        else:
            values = table.vector("value", len(names))
        table.finish()
        return [cls(sides, v, axes.index(n)) for n, v in zip(names, values, strict=True)]

    @property
    def components(self) -> tuple[int, ...]:
        return (self.component,)

    def words(self) -> str:
        assert self.value is not None
        return f"u_{COORDINATES[self.component]} = {self.value.text} {self.on_sides()}"

    def dirichlet(self, setting: Setting) -> fem.DirichletBC:
        assert self.value is not None
        nodal, size = setting.nodal, setting.space.dofmap.bs
        fdim, facets = nodal.mesh.topology.dim - 1, setting.sided.facets(self.sides)
        nodes = fem.locate_dofs_topological(nodal, fdim, facets)
        owned = nodes[nodes < nodal.dofmap.index_map.size_local]
        dofs = nodes * size + self.component
        values = fem.Function(setting.space)
        data = setting.data(self.value)
        values.x.array[owned * size + self.component] = evaluator(nodal, data, owned)()
        values.x.scatter_forward()
        component = setting.space.sub(self.component)
        return fem.dirichletbc(values, [dofs, dofs], component)  # type: ignore[arg-type]

    @classmethod
    def reaction(cls, problem: ContactProblem, residual: ufl.Form) -> Array:
        """Return the force that holds the components, without that of the obstacle; collective.

        Args:
            problem: The solved problem.
            residual: The linear form a(u, v) - L(v).
        """
        space, size = problem.space, problem.space.dofmap.bs
        fixed = problem.fixed_dofs
        near = cells_with_dofs(space, marked(space, np.unique(fixed // size)))
        vector = fem_petsc.assemble_vector(compiled.form(restricted(residual, space.mesh, near)))
        vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        left = np.zeros(space.dofmap.index_map.size_local * size)
        left[fixed] = vector.array_r[fixed] - problem.forces.x.array[fixed]
        vector.destroy()
        return np.asarray(problem.comm.allreduce(left.reshape(-1, size).sum(axis=0)))


@dataclass(frozen=True)
class Traction(Neumann):
    """Sides with a load: the stress times the outward normal is the force.

    Attributes:
        parts: The components of the force per area; () for a pressure.
        pressure: The pressure, against the outward normal; None for a force.
    """

    value: Formula | None = None
    parts: tuple[Formula, ...] = ()
    pressure: Formula | None = None
    key = "traction"
    value_key = "force"
    force_name = "traction"

    @classmethod
    def read(cls, table: TomlTable, domain: Domain, manufactured: bool) -> "Traction":
        sides = table.sides(domain.side_names)
        pressure = table.optional_formula("pressure")
        if pressure is not None and table.has("force"):
            raise table.error("pressure", "beside 'force'; give one of the two")
        force = table.vector("force", domain.dimension) if pressure is None else ()
        table.finish()
        return cls(sides, None, force, pressure)

    def words(self) -> str:
        if self.pressure is not None:
            return f"pressure {self.pressure.text} {self.on_sides()}"
        return f"traction [{', '.join(part.text for part in self.parts)}] {self.on_sides()}"

    def load(self, setting: Setting) -> Expr:
        domain, degree = setting.sided.mesh, setting.space.element.basix_element.degree
        facets = setting.sided.facets(self.sides)
        if self.pressure is not None:
            found = integrable_on_facets(self.pressure, domain, facets, degree)
            return -found * ufl.FacetNormal(domain)
        parts = [integrable_on_facets(part, domain, facets, degree) for part in self.parts]
        return ufl.as_vector(parts)


ELASTIC_CONDITIONS: tuple[type[BoundaryCondition], ...] = (ElasticContact, Held, Traction)
