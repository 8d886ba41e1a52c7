"""What is told of an elastic body: the forces on it, largest values, fields for ParaView."""

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.meshes.elements import (
    lagrange_space,
    nodal_space,
    values_at_control_points,
)
from dolfinx_signorini.meshes.node_values import (
    node_averages,
    values_in_cells,
    vectors_at_nodes,
)
from dolfinx_signorini.pictures.contact_boundary import ContactBoundary
from dolfinx_signorini.problem.contact import ContactProblem
from dolfinx_signorini.scenes.elastic_terms import LOAD, stresses
from dolfinx_signorini.scenes.files.elastic_conditions import Held
from dolfinx_signorini.scenes.posing import PosedScene

Vector = tuple[float, ...]


def forces_on_body(posed: PosedScene) -> dict[str, Vector]:
    """Return what acts on a body: integrals of loads, and the forces of contact and held sides.

    Args:
        posed: A solved scene; the call is collective.
    """
    problem = posed.problem
    assert isinstance(problem, ContactProblem)
    comm, size = problem.comm, problem.space.dofmap.bs

    def integral(form: ufl.Form) -> float:
        if form.empty():
            return 0.0
        return float(comm.allreduce(fem.assemble_scalar(compiled.form(form))))

    forces: dict[str, Vector] = {}
    for name, (integrand, measure) in posed.sources.items():
        told = "body force" if name == LOAD else name
        forces[told] = tuple(integral(integrand[i] * measure) for i in range(size))
    residual = ufl.action(posed.a, problem.u)
    if posed.sources:
        residual -= posed.L
    forces["contact"] = tuple(map(float, problem.force))
    if any(isinstance(condition, Held) for condition in posed.scene.conditions):
        forces[Held.force_name] = tuple(map(float, Held.reaction(problem, residual)))
    return forces


def largest_values(posed: PosedScene, boundary: ContactBoundary | None) -> dict[str, float]:
    """Return the number of nodes in contact, and the largest values of a body, by name.

    Args:
        posed: A solved scene; the call is collective.
        boundary: The contact boundary of the scene, on rank 0.
    """
    problem, material = posed.problem, posed.scene.elasticity
    assert isinstance(problem, ContactProblem) and material is not None
    found = None
    if boundary is not None:
        _, gap, pressure = boundary.values.T
        known = pressure[np.isfinite(pressure)]
        found = float(known.max(initial=0.0)), float(gap.min())
    pressure, gap = problem.comm.bcast(found)
    nodal = problem.gap.function_space
    moved = vectors_at_nodes(nodal, problem.u)
    stress = values_in_cells(nodal, stresses(material, problem.u)[1])
    return {
        "nodes in contact": problem.comm.allreduce(len(problem.active)),
        "largest pressure": pressure,
        "smallest gap": gap,
        "largest displacement": highest(problem.comm, np.linalg.norm(moved, axis=1)),
        "largest von Mises stress": highest(problem.comm, stress),
    }


def fields_of_body(posed: PosedScene) -> list[fem.Function]:
    """Return displacement, stress, von Mises stress, gap, pressure and contact at nodes.

    The stress, which jumps between cells, has the mean of the cells around each node.

    Args:
        posed: A solved scene; the call is collective.
    """
    problem, material = posed.problem, posed.scene.elasticity
    assert isinstance(problem, ContactProblem) and material is not None
    space, size = problem.gap.function_space, problem.space.dofmap.bs
    nodal = nodal_space(space)
    domain, element = nodal.mesh, nodal.element.basix_element

    def function(name: str, shape: tuple[int, ...]) -> fem.Function:
        target = lagrange_space(domain, element.degree, element.lagrange_variant, shape)
        assert np.array_equal(target.dofmap.list, nodal.dofmap.list)
        return fem.Function(target, name=name)

    found = [function("displacement", (size,)), function("stress", (size, size))]
    found[0].x.array[:] = vectors_at_nodes(space, problem.u).ravel()
    tensor, scalar = stresses(material, problem.u)
    found[1].x.array[:] = node_averages(nodal, values_in_cells(nodal, tensor)).ravel()
    scalars = {
        "von_mises_stress": node_averages(nodal, values_in_cells(nodal, scalar))[:, 0],
        "gap": values_at_control_points(space, problem.gap.x.array),
        "pressure": values_at_control_points(space, problem.pressure.x.array),
    }
    for name, values in scalars.items():
        one = fem.Function(nodal, name=name)
        one.x.array[:] = values
        found.append(one)
    for name, nodes in (
        ("contact_boundary", problem.contact_nodes),
        ("in_contact", problem.active),
    ):
        mask = fem.Function(nodal, name=name)
        mask.x.array[nodes] = 1.0
        mask.x.scatter_forward()
        found.append(mask)
    return found
