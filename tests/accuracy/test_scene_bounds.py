"""The bound of the energy error for scenes of all kinds of domains and conditions."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
import ufl
from dolfinx import fem

from dolfinx_signorini.scenes import load_scene, pose
from dolfinx_signorini.scenes.bounds import bound_of_scene

DEMOS = Path(__file__).parents[2] / "demos" / "scenes"
# Scenes of square, cube, polygon and file, with cells per side.
SCENES = {"mixed": 12, "obstacle": 12, "paper": 16, "cube": 4, "polygon": 8, "plate": None}
SCENES |= {"thermostat": 8, "osmosis": 12, "layers": 12}
SAMPLED = {"cube"}  # with Dirichlet data in space, which are known at points only


def energy_error(posed):
    """The energy norm of the error, with the formulas of the scene."""
    scene, domain = posed.scene, posed.sided.mesh
    x, e = ufl.SpatialCoordinate(domain), posed.problem.u - posed.exact.u
    slope = ufl.grad(e)
    rows = [[entry.ufl(x) for entry in row] for row in scene.diffusion]
    A = rows[0][0] if len(rows) == 1 else ufl.as_matrix(rows) if rows else 1.0
    c = 0.0 if scene.reaction is None else scene.reaction.ufl(x)
    dx = ufl.dx(metadata={"quadrature_degree": 17 if domain.topology.dim == 2 else 9})
    energy = fem.assemble_scalar(fem.form((ufl.dot(A * slope, slope) + c * e * e) * dx))
    return math.sqrt(domain.comm.allreduce(energy))


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("name", SCENES)
def test_every_scene_has_a_bound(name, degree, comm):
    scene, cells = replace(load_scene(DEMOS / f"{name}.toml"), degree=degree), SCENES[name]
    if cells is not None:
        scene = replace(scene, domain=scene.domain.at(cells))
    posed = pose(scene, comm)
    posed.problem.solve()
    bound = bound_of_scene(posed)
    assert 0.0 < bound.total < math.inf
    assert bound.sampled == (name in SAMPLED)
    topology = posed.sided.mesh.topology
    assert len(bound.cells) == topology.index_map(topology.dim).size_local
    if posed.exact is not None:
        error = energy_error(posed)
        assert error <= bound.total <= 1.3 * error
