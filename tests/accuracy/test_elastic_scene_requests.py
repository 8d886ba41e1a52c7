"""Scene files of elastic bodies to an accuracy, against closed forms that the scene is not told."""

import elastic_known as known
import hertz
import numpy as np
import pytest
import ufl
from known import values_at
from mpi4py import MPI

import dolfinx_signorini as ds
from dolfinx_signorini import InputError
from dolfinx_signorini.norms.references import carried
from dolfinx_signorini.scenes import load_scene, posing, solve_scene

COMM = MPI.COMM_WORLD
HERTZ = hertz.SCENE
ON_A_MESH = HERTZ.replace("[define]", "width = 0.5\n[define]")
# The norm in a file, its name in `elastic_known`, and the accuracy.
REQUESTS = (
    ("L2", "L2", 1e-4),
    ("Linf", "Linf", 2e-4),
    ("W1_4", "W1_4", 5e-3),
    ("energy", "energy", 0.05),
    ("stress_L2", "stress", 0.8),
    ("stress_Linf", "largest stress", 3.0),
)
# A pressed block of which one datum is narrow: wherever the first mesh has no point.
NARROW = """
[domain]
shape = "square"
cells = 8
[elasticity]
young = "{young}"
poisson = 0.3
force = ["{force}", 0]
[contact]
sides = "bottom"
direction = [0, -1]
[[traction]]
sides = "right"
force = ["{traction}", 0]
[[dirichlet]]
sides = "top"
value = [0, -0.1]
"""
SPIKE = "400*exp(-((y - 0.3137)/0.002)^2)"


@pytest.mark.parametrize(("norm", "what", "accuracy"), REQUESTS)
def test_requests_for_hertz(norm, what, accuracy, parse):
    text = f'accuracy = {accuracy}\nnorm = "{norm}"\n{HERTZ}'
    result = solve_scene(parse(text), COMM)
    true = known.true_error(result.u, hertz, what)
    found = result.found
    assert found.reached and true <= found.estimate <= accuracy, (true, found)
    assert found.request.target.name == norm
    assert result.posed.problem.force[1] == pytest.approx(hertz.FORCE, rel=2e-2)
    result.destroy()


def test_a_high_accuracy_takes_a_high_degree(parse):
    text = f'accuracy = 5e-3\nnorm = "energy"\n{HERTZ}'
    result = solve_scene(parse(text), COMM)
    true = known.true_error(result.u, hertz, "energy")
    assert true <= result.found.estimate <= 5e-3
    assert result.u.function_space.element.basix_element.degree > 2
    result.destroy()


def test_a_scene_and_python_do_the_same(parse):
    """The stress of a varying stiffness is that of the file."""
    text = ON_A_MESH.replace("young = 200", 'young = "200 + 50*y"')
    result = solve_scene(parse(text), COMM, accuracy=0.8, norm="stress_L2", degree=2)
    posed = []

    def pose(sided):
        posed[:] = [posing.pose(result.posed.scene, COMM, sided)]
        return posed[0].problem

    def stress(u):
        x = ufl.SpatialCoordinate(ufl.domain.extract_unique_domain(u))
        return ds.stress(u, 200.0 + 50.0 * x[1], 0.3)

    first = result.posed.scene.domain.first().make(COMM)
    found = ds.solve_adaptively(pose, first, norm="L2", of=stress, accuracy=0.8)
    assert [step.unknowns for step in found.steps] == [s.unknowns for s in result.found.steps]
    assert found.estimate == pytest.approx(result.found.estimate, rel=1e-6)
    found.problem.destroy()
    result.destroy()


@pytest.mark.parametrize("seed", range(4))
def test_dirichlet_data_that_are_like_a_root_between_the_nodes(seed, parse):
    """On the top the error is the distance to the data, at points that the estimate has not."""
    random = np.random.default_rng(seed)
    place, power = random.uniform(0.2, 0.8), random.uniform(0.5, 0.9)
    data = f"-0.1 - 0.1*abs(x - {place})^{power}"
    text = NARROW.format(young="100", force="0", traction="0").replace("-0.1]", f'"{data}"]')
    result = solve_scene(parse(text), COMM, accuracy=1e-3, norm="Linf")
    near = place + np.array([-1.0, 1.0])[:, None] * np.geomspace(1e-9, 0.1, 2000)
    x = np.concatenate((np.linspace(0.0, 1.0, 2001), near.ravel()))
    points = np.stack([x, 1.0 + 0.0 * x, 0.0 * x], axis=1)
    values = values_at(result.u, points)[:, 1]
    true = np.abs(values - (-0.1 - 0.1 * np.abs(x - place) ** power)).max()
    assert result.found.reached and true <= result.found.estimate <= 1e-3
    result.destroy()


@pytest.mark.parametrize("narrow", ["young", "force", "traction"])
def test_a_narrow_datum_is_seen_by_the_first_mesh(narrow, parse):
    data = {"young": "100", "force": "0", "traction": "0"}
    spike = SPIKE if narrow != "young" else f"100 + 100*{SPIKE}"
    plain, narrowed = (
        solve_scene(parse(NARROW.format(**given)), COMM, accuracy=3e-2, norm="L2")
        for given in (data, data | {narrow: spike})
    )
    # The cells around the spike are about as wide as the spike.
    domain = narrowed.posed.sided.mesh
    count = domain.topology.index_map(2).size_local
    x = domain.geometry.x[domain.geometry.dofmap[:count]]
    at = (x[..., 1].min(axis=1) <= 0.3137) & (x[..., 1].max(axis=1) >= 0.3137)
    at &= ((x[..., 0] > 1.0 - 1e-9).sum(axis=1) == 2) | (narrow != "traction")
    height = np.ptp(x[at, :, 1], axis=1).max(initial=0.0)
    assert COMM.allreduce(float(height), op=MPI.MAX) <= 0.01
    assert narrowed.found.steps[0].unknowns > 2 * plain.found.steps[0].unknowns
    for result in (plain, narrowed):
        result.destroy()


@pytest.mark.parametrize("name", ["stress", "stress_H1", "stress_L0.5", "energy_L2", "power"])
def test_norms_that_bodies_do_not_have_are_refused(name, parse):
    with pytest.raises(InputError) as error:
        parse(f'accuracy = 0.1\nnorm = "{name}"\n{HERTZ}')
    assert "norm" in str(error.value)
    with pytest.raises(InputError) as error:
        solve_scene(parse(ON_A_MESH), COMM, norm=name)
    assert error.value.subject == "norm"
    assert "stress_L2" in error.value.message


def test_errors_that_come_from_elsewhere(demos):
    """Where a punch ends its stress is infinite, and errors of far cells move the punch's ends."""
    scene = load_scene(demos / "punch.toml")
    rough, fine = (
        solve_scene(scene, COMM, accuracy=accuracy, norm="Linf", max_unknowns=60_000)
        for accuracy in (1.2e-5, 2.4e-6)
    )
    assert rough.found.reached and fine.found.reached
    other = carried(rough.u, fine.u.function_space.mesh)
    assert ds.error_norms(fine.u, other, ["Linf"])["Linf"] <= 1.2e-5 + 2.4e-6
    for result in (rough, fine):
        result.destroy()


@pytest.mark.parametrize(("norm", "finite"), [("stress_Linf", False), ("stress_L4", True)])
def test_a_stress_that_is_infinite_is_told(norm, finite, parse):
    """Where a clamped side ends at a right angle, u ~ r^0.711, and the stress ~ r^-0.289."""
    text = NARROW.format(young="100", force="0", traction="0")
    result = solve_scene(parse(text), COMM, accuracy=0.3, norm=norm)
    found = result.found
    assert found.reached == finite and ("r^0.711" in found.stopped) == (not finite)
    assert found.steps[-1].unknowns < 20_000
    result.destroy()
