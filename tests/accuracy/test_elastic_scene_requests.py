"""Scene files of elastic bodies to an accuracy, against closed forms that the scene is not told."""

import elastic_known as known
import hertz
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from known import values_at
from mpi4py import MPI

import dolfinx_signorini as ds
from dolfinx_signorini import InputError
from dolfinx_signorini.data.parsing import parse as parse_formula
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


# A floor with a narrow bump, told by the gap and by the length of the direction; a direction of
# length 1 that is steep on the bump's flank. The body is moved down, in the last case also aside.
BUMP = "exp(-((x - 0.162)/0.01)^2)"
FLOORS = {
    "gap": (f"0.05/(1 + 4*{BUMP})", "0", "-1", 0.0),
    "length": ("0.05", "0", f"-(1 + 4*{BUMP})", 0.0),
    "flank": (
        "0.05",
        f"1.5*{BUMP}/hypot(1, 1.5*{BUMP})",
        f"-1/hypot(1, 1.5*{BUMP})",
        0.1,
    ),
}
FLOOR = """
[domain]
shape = "polygon"
vertices = [[-1, 0], [1, 0], [1, 1], [-1, 1]]
width = 0.25
[elasticity]
young = 1
poisson = 0.3
[contact]
sides = 1
gap = "{gap}"
direction = ["{d}", "{e}"]
[[dirichlet]]
sides = 3
value = [{aside}, -0.1]
"""


def posed_on(sided, gap, d, e, aside):
    """The block of `FLOOR` in Python, of degree 2."""
    V = fem.functionspace(sided.mesh, ("Lagrange", 2, (2,)))
    u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(sided.mesh)
    g, d, e = (parse_formula(text).ufl(x) for text in (gap, d, e))
    above = fem.locate_dofs_topological(V, 1, sided.sides["top"])
    return ds.ContactProblem(
        ds.elasticity(u, v, 1.0, 0.3),
        ufl.inner(fem.Constant(sided.mesh, (0.0, 0.0)), v) * ufl.dx,
        contact=sided.sides["bottom"],
        gap=g,
        direction=ufl.as_vector([d, e]),
        bcs=[fem.dirichletbc(np.array([aside, -0.1]), above, V)],
    )


def force_on_a_fine_mesh(floor):
    """The contact force on a mesh whose cells on the floor are small around the bump."""
    domain = mesh.create_rectangle(COMM, [(-1.0, 0.0), (1.0, 1.0)], (96, 32))
    x = domain.geometry.x
    t = x[:, 0].copy()
    x[:, 0] = 0.162 + np.where(t > 0.0, 1.0 - 0.162, 1.0 + 0.162) * t**3
    x[:, 1] = x[:, 1] ** 2.5
    problem = posed_on(ds.SidedMesh(domain, ends(domain)), *floor)
    problem.solve()
    force = np.array(problem.force)
    problem.destroy()
    return force


def ends(domain):
    return {
        name: mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y))
        for name, y in (("bottom", 0.0), ("top", 1.0))
    }


@pytest.mark.parametrize("name", FLOORS)
def test_a_narrow_direction_is_seen(name, parse):
    gap, d, e, aside = floor = FLOORS[name]
    text = FLOOR.format(gap=gap, d=d, e=e, aside=aside)
    result = solve_scene(parse(text), COMM, accuracy=4e-3, norm="energy", degree=2)
    coarse = mesh.create_rectangle(COMM, [(-1.0, 0.0), (1.0, 1.0)], (8, 4))
    found = ds.solve_adaptively(
        lambda sided: posed_on(sided, *floor),
        ds.SidedMesh(coarse, ends(coarse)),
        norm="L2",
        of=lambda u: ds.weighted_strain(u, 1.0, 0.3),
        accuracy=4e-3,
    )
    expected = force_on_a_fine_mesh(floor)
    assert abs(expected[1] - 0.11565) > 0.01 * expected[1]  # the force of a floor without the bump
    for reached, problem in (
        (result.found.reached, result.posed.problem),
        (found.reached, found.problem),
    ):
        assert reached
        assert np.abs(problem.force - expected).max() <= 4e-3 * np.abs(expected).max()
    result.destroy()
    found.problem.destroy()
