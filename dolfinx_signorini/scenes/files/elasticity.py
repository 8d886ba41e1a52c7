"""The table [elasticity] of a scene: the material of a body, with the terms of its equation."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import ufl
from dolfinx import mesh
from ufl.core.expr import Expr
from ufl.domain import extract_unique_domain

from dolfinx_signorini.accuracy.targets import Target, target
from dolfinx_signorini.base.errors import InputError, require
from dolfinx_signorini.data.form_data import with_reciprocal
from dolfinx_signorini.data.formulas import Formula, evaluated
from dolfinx_signorini.meshes.sided_meshes import cell_corners
from dolfinx_signorini.problem.elasticity import stress, von_mises, weighted_strain
from dolfinx_signorini.scenes.domains.domain import Domain
from dolfinx_signorini.scenes.files.condition import Setting
from dolfinx_signorini.scenes.files.toml_table import POSITIVE, Rule, TomlTable, one_of

# The energy norm, and what the names of norms of the stress begin with.
ENERGY, STRESS = "energy", "stress_"
STIFFNESS = "young", "poisson"  # the keys of the formulas that the stiffness depends on
PLANES = one_of(("strain", "stress"))
RATIO: Rule = "must lie between -1 and 1/2", lambda number: (number > -1.0) & (number < 0.5)


@dataclass(frozen=True)
class Elasticity:
    """The material of a linear elastic body, and the force on its volume.

    The table comes from a scene file:

        material = Elasticity.read(top, domain)
        if material is not None:
            print(*material.words(), sep="; ")

    Attributes:
        young, poisson: Young's modulus and Poisson's ratio.
        plane: In the plane "strain" or "stress"; "" in space.
        force: The components of the force per volume; () for none.
        key: The table of a scene file.
    """

    young: Formula
    poisson: Formula
    plane: str
    force: tuple[Formula, ...] = ()
    key: ClassVar = "elasticity"

    @classmethod
    def read(cls, top: TomlTable, domain: Domain) -> "Elasticity | None":
        """Return the material of a scene file; None where the unknown is no displacement.

        Args:
            top: The file, whose unknown has as many components as the domain from now on.
            domain: The domain of the scene.

        Raises:
            InputError: The table has a key that makes no sense, or the constants of the material
                are none.
        """
        if not top.has(cls.key):
            if top.has("traction"):
                raise top.error("traction", "goes with [elasticity]")
            return None
        table, top.file.components = top.table(cls.key), domain.dimension
        if domain.dimension == 3 and table.has("plane"):
            raise table.error("plane", "for bodies in the plane, and the domain is in space")
        found = cls(
            table.formula("young", rule=POSITIVE),
            table.formula("poisson", rule=RATIO),
            table.text("plane", "strain", PLANES) if domain.dimension == 2 else "",
            table.vector("force", domain.dimension, ()),
        )
        table.finish()
        return found

    def words(self) -> list[str]:
        """Return what the table adds to a problem, in words."""
        constants = f"Young's modulus {self.young.text} and Poisson's ratio {self.poisson.text}"
        plane = f", plane {self.plane}" if self.plane else ""
        force = f"body force [{', '.join(f.text for f in self.force)}]"
        return [f"elasticity with {constants}{plane}", *([force] if self.force else [])]

    @property
    def data(self) -> Iterator[tuple[str, Formula, str]]:
        """The names, formulas and measures of the data on cells."""
        for entry in with_reciprocal(self.young):
            yield STIFFNESS[0], entry, "mass"
        yield STIFFNESS[1], self.poisson, "mass"
        for part in self.force:
            yield "the body force", part, "mass"

    def form(self, setting: Setting, u: Expr, v: Expr) -> ufl.Form:
        """Return the bilinear form of the body; collective.

        Args:
            setting: The mesh and the space.
            u, v: The trial and the test function.

        Raises:
            InputError: A formula has values that no material has.
        """
        _check_values(setting.sided.mesh, "young", self.young, POSITIVE)
        _check_values(setting.sided.mesh, "poisson", self.poisson, RATIO)
        return ufl.inner(self.stresses(u)[0], ufl.sym(ufl.grad(v))) * setting.dx

    def load(self, setting: Setting) -> Expr | None:
        """Return the force on the volume; None for no force."""
        if all(part.constant == 0.0 for part in self.force):
            return None
        return ufl.as_vector([part.ufl(setting.x) for part in self.force])

    def target(self, norm: str) -> Target:
        """Return what is to be accurate where an error of a body is asked for in a norm.

        Args:
            norm: The name of a norm of the displacement, see `norm_names.parse_norm`; "stress_L2"
                or another L^p norm of the stress; or "energy", whose square is the integral of
                stress times strain.

        Raises:
            InputError: The name is that of no norm.
        """
        if norm == ENERGY:
            return replace(target("L2", self.weighted_strain), name=norm)
        of = (lambda u: self.stresses(u)[0]) if norm.startswith(STRESS) else None
        try:
            return replace(target(norm.removeprefix(STRESS), of), name=norm)
        except InputError as error:
            more = f"bodies have also {ENERGY} and, with the name of an L^p norm, {STRESS}L2"
            raise InputError(f"{error.message}; {more}", error.subject) from None

    def weighted_strain(self, u: Expr) -> Expr:
        """Return the strain of a displacement whose square is the product of stress and strain."""
        return weighted_strain(u, *self._constants(u))

    def stresses(self, u: Expr) -> tuple[Expr, Expr]:
        """Return the stress of a displacement, a matrix, and its von Mises stress."""
        constants = self._constants(u)
        return stress(u, *constants), von_mises(u, *constants)

    def _constants(self, u: Expr) -> tuple[Expr, Expr, str]:
        """Return Young's modulus, Poisson's ratio and the kind of plane on the mesh of u."""
        x = ufl.SpatialCoordinate(extract_unique_domain(u))
        return self.young.ufl(x), self.poisson.ufl(x), self.plane or "strain"


def _check_values(domain: mesh.Mesh, name: str, formula: Formula, rule: Rule) -> None:
    """Refuse a formula with values, in the middles of cells, that do not obey a rule."""
    words, holds = rule
    middles = cell_corners(domain).mean(axis=1)
    values = evaluated(formula.root, middles)
    wrong = np.flatnonzero(~holds(values))
    told = ""
    if len(wrong):
        place = ", ".join(f"{c:.4g}" for c in middles[wrong[0]])
        told = f"{words}, is {values[wrong[0]]:g} at ({place})"
    require(domain.comm, not told, told, name)
