"""The terms of an elastic body in a scene: its form, the force on its volume, its stress."""

from collections.abc import Sequence

import numpy as np
import ufl
from dolfinx import fem, mesh
from ufl.core.expr import Expr

from dolfinx_signorini.base.errors import require
from dolfinx_signorini.data.formulas import Formula, evaluated
from dolfinx_signorini.data.interfaces.jumps import integrable
from dolfinx_signorini.data.interfaces.rules import CellMeasure, measure_for
from dolfinx_signorini.meshes.quadrature import CELL_RULE
from dolfinx_signorini.meshes.sided_meshes import owned_cells
from dolfinx_signorini.problem.contact import ContactProblem
from dolfinx_signorini.problem.elasticity import stress, von_mises
from dolfinx_signorini.scenes.files.conditions import Setting
from dolfinx_signorini.scenes.files.elastic_conditions import ElasticContact
from dolfinx_signorini.scenes.files.elasticity import Elasticity

Terms = dict[str, tuple[Expr, CellMeasure]]

LOAD = "load"  # the name of the load of the equation among the sources


def elastic_form(material: Elasticity, setting: Setting, u: Expr, v: Expr) -> ufl.Form:
    """Return the bilinear form of an elastic body.

    Args:
        material: The material.
        setting: The mesh and the space; the call is collective.
        u, v: The trial and the test function.

    Raises:
        InputError: A formula has values that no material has.
    """
    domain, degree = setting.sided.mesh, setting.space.element.basix_element.degree
    _check_values(domain, "young", material.young, 0.0, np.inf, "must be positive")
    both = "must lie between -1 and 1/2"
    _check_values(domain, "poisson", material.poisson, -1.0, 0.5, both)
    factor = 2 * (degree - 1)
    young, poisson = (integrable(f, domain, factor) for f in (material.young, material.poisson))
    dx: CellMeasure = ufl.Measure("dx", domain, metadata=CELL_RULE.metadata)
    if material.poisson.constant is not None:
        dx = measure_for(domain, [material.young], factor, degree)
    found = stress(u, young, poisson, material.plane or "strain")
    return ufl.inner(found, ufl.sym(ufl.grad(v))) * dx


def body_force(material: Elasticity, setting: Setting) -> Terms:
    """Return the force on the volume as a source; none where the body has none."""
    domain, degree = setting.sided.mesh, setting.space.element.basix_element.degree
    if all(part.constant == 0.0 for part in material.force):
        return {}
    parts = [integrable(part, domain, degree) for part in material.force]
    return {LOAD: (ufl.as_vector(parts), measure_for(domain, material.force, degree, degree))}


def elastic_problem(
    contact: ElasticContact,
    setting: Setting,
    a: ufl.Form,
    L: ufl.Form,
    bcs: Sequence[fem.DirichletBC],
) -> ContactProblem:
    """Return the problem of an elastic body.

    Args:
        contact: The contact boundary.
        setting: The mesh and the space; the call is collective.
        a, L, bcs: See `ContactProblem`.
    """
    assert contact.value is not None
    return ContactProblem(
        a,
        L,
        contact=setting.sided.facets(contact.sides),
        gap=setting.data(contact.value),
        direction=contact.directions(setting),
        bcs=bcs,
    )


def stresses(material: Elasticity, u: fem.Function) -> tuple[Expr, Expr]:
    """Return the stress of a displacement, a matrix, and its von Mises stress."""
    x = ufl.SpatialCoordinate(u.function_space.mesh)
    constants = material.young.ufl(x), material.poisson.ufl(x), material.plane or "strain"
    return stress(u, *constants), von_mises(u, *constants)


def _check_values(
    domain: mesh.Mesh, name: str, formula: Formula, low: float, high: float, message: str
) -> None:
    """Refuse a formula with values, in the middles of cells, that are not between two numbers."""
    x = np.asarray(domain.geometry.x[:, : domain.geometry.dim], dtype=np.float64)
    middles = x[domain.geometry.dofmap[: len(owned_cells(domain))]].mean(axis=1)
    values = evaluated(formula.root, middles)
    wrong = np.flatnonzero(~((values > low) & (values < high)))
    told = ""
    if len(wrong):
        place = ", ".join(f"{c:.4g}" for c in middles[wrong[0]])
        told = f"{message}, is {values[wrong[0]]:g} at ({place})"
    require(domain.comm, not told, told, name)
