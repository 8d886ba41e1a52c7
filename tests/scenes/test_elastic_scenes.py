"""Scenes of elastic bodies: exact solutions, KKT conditions, the same problems in Python."""

import csv
import json
from pathlib import Path

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini import ContactProblem, InputError, bernstein_space, elasticity, von_mises
from dolfinx_signorini.commands.main import main
from dolfinx_signorini.data.node_values import values_in_cells
from dolfinx_signorini.scenes import load_scene, pose, solve_scene
from dolfinx_signorini.scenes.expectations import expect
from dolfinx_signorini.scenes.output.fields import fields_of
from dolfinx_signorini.scenes.output.pictures import scene_boundaries
from dolfinx_signorini.scenes.output.summary import force_columns, forces_on, lines, summarise

COMM = MPI.COMM_WORLD
# A block between planes, with a pressure on a side: all strains are constant.
BLOCK = """
degree = {degree}
rtol = 1e-12
[domain]
shape = "{shape}"
cells = 4
[elasticity]
young = {young}
poisson = {poisson}
{plane}
[contact]
sides = "bottom"
gap = 0.01
[[dirichlet]]
sides = "top"
components = "{last}"
value = -0.05
[[dirichlet]]
sides = "left"
components = "x"
value = 0
[[traction]]
sides = "right"
pressure = 3
{more}
"""
FRONT = """
[[dirichlet]]
sides = "front"
components = ["y"]
value = [0]
"""
YOUNG, POISSON, SIDE, SQUEEZE = 200.0, 0.3, 3.0, 0.04


def block(degree=1, shape="square", young=YOUNG, poisson=POISSON, plane="strain"):
    solid = shape == "cube"
    return BLOCK.format(
        degree=degree,
        shape=shape,
        young=young,
        poisson=poisson,
        plane="" if solid else f'plane = "{plane}"',
        last="z" if solid else "y",
        more=FRONT if solid else "",
    )


def stresses_of_block(plane):
    """Strains and principal stresses of the block, the last ones those of the squeezed axis.

    Hooke's law E e_i = s_i - nu (s_j + s_k), for the unknowns among six numbers.
    """
    law = (1.0 + POISSON) * np.eye(3) - POISSON
    # The axes are x, the one at right angles, and the squeezed one, whose strain is known.
    s_x, e_last = -SIDE, -SQUEEZE
    if plane == "strain":  # no strain at right angles
        rest = np.linalg.solve(law[1:, 1:], np.array([0.0, YOUNG * e_last]) - law[1:, 0] * s_x)
        s = np.array([s_x, *rest])
    else:  # no stress at right angles
        s = np.array([s_x, 0.0, (YOUNG * e_last - law[2, 0] * s_x) / law[2, 2]])
    return law @ s / YOUNG, s


def mises(s):
    return np.sqrt(0.5 * ((s[0] - s[1]) ** 2 + (s[1] - s[2]) ** 2 + (s[2] - s[0]) ** 2))


def values(u):
    """Coordinates and values at the owned nodes of this rank."""
    space, size = u.function_space, u.function_space.dofmap.bs
    count = space.dofmap.index_map.size_local
    return space.tabulate_dof_coordinates()[:count], u.x.array[: count * size].reshape(count, size)


def largest(found):
    return COMM.allreduce(float(np.abs(found).max(initial=0.0)), op=MPI.MAX)


def write(folder, text, name="scene"):
    if COMM.rank == 0:
        (folder / f"{name}.toml").write_text(text)
    COMM.barrier()
    return str(folder / f"{name}.toml")


@pytest.mark.parametrize(
    ("shape", "plane", "degree"),
    [
        *(("square", plane, degree) for plane in ("strain", "stress") for degree in (1, 2, 3, 4)),
        *(("cube", "", degree) for degree in (1, 2)),
    ],
)
def test_a_block_between_planes_has_constant_stresses(parse, degree, shape, plane):
    result = solve_scene(parse(block(degree, shape, plane=plane or "strain")), COMM)
    strains, s = stresses_of_block("strain" if plane == "strain" else "stress")
    displacement, stress, scalar, *_ = fields_of(result)
    x, u = values(displacement)
    size = u.shape[1]
    rates = strains[[0, 2]] if size == 2 else strains
    exact = rates * x[:, :size]
    exact[:, -1] -= 0.01
    assert largest(u - exact) <= 1e-10
    tensor = np.diag(s[[0, 2]] if size == 2 else s)
    assert largest(values(stress)[1] - tensor.ravel()) <= 1e-7
    assert largest(values(scalar)[1] - mises(s)) <= 1e-7
    summary = summarise(result, scene_boundaries(result))
    assert summary.body["largest von Mises stress"] == pytest.approx(mises(s), rel=1e-8)
    assert summary.body["largest pressure"] == pytest.approx(-s[2], rel=1e-7)
    assert summary.body["smallest gap"] == pytest.approx(0.0, abs=1e-12)
    assert summary.body["largest displacement"] == pytest.approx(
        np.linalg.norm([*rates[:-1], -0.05]), rel=1e-8
    )
    assert summary.contact_size == pytest.approx(1.0)
    up = np.eye(size)[-1]
    forces = {name: np.array(force) for name, force in summary.forces.items()}
    assert forces["contact"] == pytest.approx(-s[2] * up, abs=1e-7)
    assert forces["traction"] == pytest.approx(-SIDE * np.eye(size)[0], abs=1e-9)
    rest = -forces["contact"] - forces["traction"]
    assert forces["Dirichlet sides"] == pytest.approx(rest, abs=1e-9)
    assert summary.imbalance <= 1e-9
    result.destroy()


def test_layers_take_the_strain_that_their_modulus_asks_for(parse):
    """Without Poisson's ratio a stack of layers is a row of springs."""
    text = block(young='"where(y < 0.5, 100, 300)"', poisson=0)
    text = text.replace("pressure = 3", "pressure = 0")
    result = solve_scene(parse(text), COMM)
    pressure = 0.04 / (0.5 / 100.0 + 0.5 / 300.0)
    x, u = values(fields_of(result)[0])
    low = -0.01 - pressure * np.minimum(x[:, 1], 0.5) / 100.0
    assert largest(u[:, 1] - (low - pressure * np.maximum(x[:, 1] - 0.5, 0.0) / 300.0)) <= 1e-10
    summary = summarise(result, scene_boundaries(result))
    assert summary.body["largest pressure"] == pytest.approx(pressure)
    assert summary.body["largest von Mises stress"] == pytest.approx(pressure)
    result.destroy()


def test_layers_between_walls_have_the_stiffness_of_their_poissons_ratio(parse):
    """Nothing moves sidewards: the modulus is E (1 - nu) / ((1 + nu) (1 - 2 nu)) in each layer."""
    text = block(poisson='"where(y < 0.5, 0.2, 0.4)"')
    wall = text.index("[[traction]]")
    text = text[:wall] + '[[dirichlet]]\nsides = "right"\ncomponents = "x"\nvalue = 0\n'
    result = solve_scene(parse(text), COMM)

    def modulus(nu):
        return YOUNG * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu))

    pressure = 0.04 / (0.5 / modulus(0.2) + 0.5 / modulus(0.4))
    x, u = values(fields_of(result)[0])
    below, above = np.minimum(x[:, 1], 0.5), np.maximum(x[:, 1] - 0.5, 0.0)
    assert (
        largest(u[:, 1] + 0.01 + pressure * (below / modulus(0.2) + above / modulus(0.4))) <= 1e-10
    )
    summary = summarise(result, scene_boundaries(result))
    assert summary.body["largest pressure"] == pytest.approx(pressure)
    # Sidewards the stress is nu / (1 - nu) of the pressure, in and at right angles to the plane.
    assert summary.body["largest von Mises stress"] == pytest.approx(pressure * 0.6 / 0.8)
    result.destroy()


def test_the_summary_knows_where_contact_with_a_cylinder_ends(parse):
    """On a half-plane the half-width is 2 sqrt(R F (1 - nu^2) / (pi E)), with the force F."""
    text = """
degree = 2
[domain]
shape = "square"
cells = 40
[elasticity]
young = 200
poisson = 0.3
[contact]
sides = "bottom"
gap = "0.125*(x - 0.5)^2"
direction = [0, -1]
[[dirichlet]]
sides = "top"
value = [0, -0.002]
"""
    result = solve_scene(parse(text), COMM)
    summary = summarise(result, scene_boundaries(result))
    (left, low), (right, _) = summary.detachment_points
    assert abs(low) <= 1e-12 and left + right == pytest.approx(1.0, abs=sum(summary.uncertainties))
    width = 2.0 * np.sqrt(4.0 * summary.forces["contact"][1] * (1.0 - 0.3**2) / (np.pi * 200.0))
    assert 0.5 * (right - left) == pytest.approx(width, rel=0.05)
    assert summary.contact_size == pytest.approx(right - left, rel=1e-9)
    assert dict(lines(summary))["detachment"].count("+-") == 2
    result.destroy()


@pytest.mark.parametrize("poisson", [0.0, 0.3])
def test_the_summary_knows_where_the_stress_is_infinite(parse, poisson):
    """Below the edges of a flat punch, and where a clamped side ends: Williams (1952) for 0.3."""
    text = f"""
[domain]
shape = "polygon"
vertices = [[-1, 0], [1, 0], [1, 1], [0.25, 1], [-0.25, 1], [-1, 1]]
width = 0.2
[elasticity]
young = 1000
poisson = {poisson}
[contact]
sides = 4
gap = -0.01
direction = [0, 1]
[[dirichlet]]
sides = 1
value = [0, 0]
"""
    result = solve_scene(parse(text), COMM)
    summary = summarise(result, scene_boundaries(result))
    expected = "r^-0.5 at (-0.25, 1), (0.25, 1)"
    if poisson > 0.0:
        expected += "; r^-0.289 at (-1, 0), (1, 0)"
    assert summary.infinite_stress == dict(lines(summary))["infinite stress"] == expected
    result.destroy()


# Everything at once, with polynomials that all rules integrate exactly.
WHOLE = """
rtol = 1e-11
degree = {degree}
[domain]
shape = "square"
cells = {cells}
[define]
bump = "0.2*(x - 0.4)^2"
[elasticity]
young = "100 + 50*x"
poisson = 0.25
plane = "stress"
force = ["y", "-3*x"]
[contact]
sides = ["bottom", "right"]
gap = "bump*(2 + y) + 0.3*y^3"
direction = ["0.3 + 0.2*x", "-2 - y"]
[[dirichlet]]
sides = "top"
value = ["0.02*x", "-0.15 + 0.01*x"]
[[traction]]
sides = "left"
force = [2, "-y"]
"""


def whole(cells, degree):
    """The same problem in Python."""
    domain = dolfinx.mesh.create_unit_square(COMM, cells, cells)
    space = bernstein_space(domain, degree, (2,))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)

    def on(axis, end):
        return dolfinx.mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[axis], end))

    left = on(0, 0.0)
    tags = dolfinx.mesh.meshtags(domain, 1, np.sort(left), np.ones(len(left), dtype=np.int32))
    ds = ufl.Measure("ds", domain, subdomain_data=tags)
    data = fem.Function(space)  # linear: values at control points are coefficients
    nodal = fem.Function(fem.functionspace(domain, ("Lagrange", degree, (2,))))
    nodal.interpolate(lambda x: np.stack([0.02 * x[0], -0.15 + 0.01 * x[0]]))
    data.interpolate(nodal)
    return ContactProblem(
        elasticity(u, v, 100.0 + 50.0 * x[0], 0.25, "stress"),
        ufl.inner(ufl.as_vector([x[1], -3.0 * x[0]]), v) * ufl.dx
        + ufl.inner(ufl.as_vector([2.0, -x[1]]), v) * ds(1),
        contact=np.union1d(on(1, 0.0), on(0, 1.0)),
        gap=0.2 * (x[0] - 0.4) ** 2 * (2.0 + x[1]) + 0.3 * x[1] ** 3,
        direction=ufl.as_vector([0.3 + 0.2 * x[0], -2.0 - x[1]]),
        bcs=[fem.dirichletbc(data, fem.locate_dofs_topological(space, 1, on(1, 1.0)))],
    )


def by_place(u):
    """Rows of coordinates and values at all nodes, in the order of the places, on all ranks."""
    rows = np.concatenate(COMM.allgather(np.column_stack(values(u))))
    return rows[np.lexsort(np.round(rows[:, :2], 9).T)]


@pytest.mark.parametrize(("cells", "degree"), [(12, 1), (8, 2), (70, 1)])
def test_a_scene_is_the_problem_of_the_python_class(parse, cells, degree):
    result = solve_scene(parse(WHOLE.format(cells=cells, degree=degree)), COMM)
    assert len(result.levels) == (2 if cells > 64 else 1)
    problem = whole(cells, degree)
    problem.solve(rtol=1e-11)
    ours, theirs = result.posed.problem, problem
    assert ours.force == pytest.approx(theirs.force, rel=1e-7)
    assert COMM.allreduce(len(ours.active)) == COMM.allreduce(len(theirs.active)) > 3
    if degree == 1:
        for one, other in ((ours.u, theirs.u), (ours.pressure, theirs.pressure)):
            first, second = by_place(one), by_place(other)
            assert first == pytest.approx(second, abs=1e-7 * np.abs(second[:, 2:]).max())
    x = ufl.SpatialCoordinate(theirs.space.mesh)
    stress = von_mises(theirs.u, 100.0 + 50.0 * x[0], 0.25, "stress")
    both = [
        largest(values_in_cells(p.gap.function_space, s))
        for p, s in ((ours, result.posed.scene.elasticity.stresses(ours.u)[1]), (theirs, stress))
    ]
    assert both[0] == pytest.approx(both[1], rel=1e-6)
    result.destroy()
    problem.destroy()


@pytest.mark.parametrize("cells", [12, 72])
def test_forces_balance_where_contact_meets_a_held_component(parse, cells):
    """The obstacle pushes sidewards on the corner node, too, whose sidewards component is held."""
    held = '[[dirichlet]]\nsides = "left"\ncomponents = "x"\nvalue = 0'
    text = WHOLE.format(cells=cells, degree=1).split("[[traction]]")[0].replace("rtol", "# rtol")
    text = text.replace('["bottom", "right"]', '"bottom"').replace('"0.02*x"', "0")
    text = text.replace("x - 0.4", "x") + held
    result = solve_scene(parse(text), COMM)
    forces = fem.Function(result.posed.problem.space)
    forces.x.array[:] = result.posed.problem.forces.x.array
    x, values_there = values(forces)
    corner = np.isclose(x[:, 0], 0.0) & np.isclose(x[:, 1], 0.0)
    assert COMM.allreduce(float(np.abs(values_there[corner, 0]).sum())) > 1e-3
    summary = summarise(result, scene_boundaries(result))
    assert summary.imbalance <= 1e-6
    result.destroy()


def test_the_scene_of_the_docs_is_one(parse):
    page = Path(__file__).parents[2] / "docs" / "scenes.md"
    blocks = [part.split("```")[0] for part in page.read_text().split("```toml\n")[1:]]
    (text,) = [block for block in blocks if "[elasticity]" in block]
    result = solve_scene(parse(text), COMM)
    assert result.solve.active_dofs > 3 and result.posed.problem.force[1] > 0.0
    result.destroy()


def test_elements_of_degree_1_are_too_stiff_near_poissons_ratio_one_half(parse):
    text = block(poisson=0.495)
    for degree, told in ((1, True), (2, False)):
        scene = parse(text.replace("degree = 1", f"degree = {degree}"))
        notes = expect(scene, scene.domain.make(COMM)).notes
        assert any("too stiff for Poisson's ratio 0.495" in note for note in notes) == told
    assert not expect(parse(block()), parse(block()).domain.make(COMM)).notes


def test_von_mises_stress_of_known_states(comm):
    """Tension, shear and pressure, for gradients that are known."""
    domain = dolfinx.mesh.create_unit_cube(comm, 1, 1, 1)
    x = ufl.SpatialCoordinate(domain)
    cases = {
        # Uniaxial tension of 2, shear of 3 (G = E / 2 / (1 + nu)), a uniform expansion.
        2.0: ufl.as_vector([0.02 * x[0], -0.005 * x[1], -0.005 * x[2]]),
        3.0 * np.sqrt(3.0): ufl.as_vector([3.0 * 2.5 / 100.0 * x[1], 0.0 * x[0], 0.0 * x[0]]),
        0.0: ufl.as_vector([0.1 * x[0], 0.1 * x[1], 0.1 * x[2]]),
    }
    for wanted, u in cases.items():
        found = fem.form(von_mises(u, 100.0, 0.25) * ufl.dx(domain))
        assert comm.allreduce(fem.assemble_scalar(found)) == pytest.approx(wanted, abs=1e-12)


@pytest.mark.parametrize("degree", [1, 2])
def test_what_is_written_satisfies_the_conditions_of_contact(folder, degree):
    out = folder / "out"
    text = WHOLE.format(cells=12, degree=degree)
    assert main(["solve", write(folder, text), "--out", str(out)]) == 0
    COMM.barrier()
    with (out / "boundary.csv").open() as file:
        table = [{k: float(v or "nan") for k, v in row.items()} for row in csv.DictReader(file)]
    column = {name: np.array([row[name] for row in table]) for name in table[0]}
    x, y = column["x"], column["y"]
    g = 0.2 * (x - 0.4) ** 2 * (2.0 + y) + 0.3 * y**3
    held = np.isclose(y, 1.0)
    assert held.sum() == 1 and column["pressure"][held] == 0.0  # the data are above the obstacle
    # Control points of degree 2 do not see the product of u with a direction that varies.
    near = 1e-12 if degree == 1 else 2e-3
    assert column["gap"] == pytest.approx(g - column["u.d"], abs=near)
    assert column["gap"].min() >= -1e-12 and column["pressure"][~held].min() >= -1e-12
    if degree == 1:
        product = column["gap"] * column["pressure"]
        assert np.abs(product[~held]).max() <= 1e-10
    record = json.loads((out / "record.json").read_text())
    names = {"boundary.csv", "contact.png", "record.json", "report.html", "solution.png"}
    assert names <= {path.name for path in out.iterdir()}
    assert names - {"record.json"} < set(record["files"])
    page = (out / "report.html").read_text()
    assert page.count("<img") == 2 and "largest von Mises stress" in page
    assert page.count("The deformed body with its von Mises stress") == 2
    forces = np.array(list(record["summary"]["forces"].values()))
    assert set(record["summary"]["forces"]) == {
        "body force", "traction", "contact", "Dirichlet sides",
    }  # fmt: skip
    assert np.abs(forces.sum(axis=0)).max() <= 1e-8 * np.abs(forces).max()
    assert record["summary"]["forces"]["body force"] == pytest.approx([0.5, -1.5])
    assert record["summary"]["forces"]["traction"] == pytest.approx([2.0, -0.5])


def test_a_pressure_acts_against_the_outward_normal(parse):
    pytest.importorskip("gmsh")
    text = """
    [domain]
    shape = "polygon"
    vertices = [[0, 0], [2, 0], [1, 1], [0, 1]]
    width = 0.3
    [elasticity]
    young = 100
    poisson = 0.2
    [contact]
    sides = 1
    gap = 1
    [[dirichlet]]
    sides = 4
    value = [0, 0]
    [[traction]]
    sides = 2
    pressure = "2*y"
    """
    posed = pose(parse(text), COMM)
    posed.problem.solve()
    forces = forces_on(posed)
    # The side has the normal (1, 1) / sqrt(2), and the pressure the mean 1 over sqrt(2).
    assert forces["traction"] == pytest.approx((-1.0, -1.0))
    assert forces["contact"] == (0.0, 0.0)
    assert forces["Dirichlet sides"] == pytest.approx((1.0, 1.0), rel=1e-5)
    posed.problem.destroy()


def test_components_of_one_side_may_have_conditions_of_their_own(parse):
    """u_x and u_y on the top from two tables are those of one table with both."""
    apart = """[[dirichlet]]
    sides = "top"
    components = "y"
    value = "-0.15 + 0.01*x"
    [[dirichlet]]
    sides = "top"
    components = "x"
    value = "0.02*x"
    """
    one = WHOLE.format(cells=8, degree=1)
    together = '[[dirichlet]]\nsides = "top"\nvalue = ["0.02*x", "-0.15 + 0.01*x"]\n'
    assert together in one
    turned = together.replace("value", 'components = ["y", "x"]\nvalue')
    turned = turned.replace('["0.02*x", "-0.15 + 0.01*x"]', '["-0.15 + 0.01*x", "0.02*x"]')
    results = [
        solve_scene(parse(text), COMM)
        for text in (one, one.replace(together, apart), one.replace(together, turned))
    ]
    first, *others = (by_place(result.u) for result in results)
    for other in others:
        assert other == pytest.approx(first, abs=1e-10)
    for result in results:
        result.destroy()


def test_the_fields_tell_where_contact_is(parse):
    result = solve_scene(parse(WHOLE.format(cells=10, degree=2)), COMM)
    fields = fields_of(result)
    assert [field.name for field in fields] == [
        "displacement", "stress", "von_mises_stress", "gap", "pressure", "contact_boundary",
        "in_contact",
    ]  # fmt: skip
    x, boundary = values(fields[5])
    on = np.isclose(x[:, 1], 0.0) | np.isclose(x[:, 0], 1.0)
    assert (boundary[:, 0] == on).all()
    touching = values(fields[6])[1][:, 0] == 1.0
    assert 0 < COMM.allreduce(int(touching.sum())) <= result.solve.active_dofs
    assert (boundary[touching] == 1.0).all() and not values(fields[3])[1][touching].any()
    top = np.isclose(x[:, 1], 1.0)
    assert largest(values(fields[0])[1][top][:, 0] - 0.02 * x[top, 0]) <= 1e-12
    result.destroy()


@pytest.mark.skipif(not dolfinx.has_adios2, reason="VTX needs ADIOS2")
def test_paraview_gets_displacement_and_stress(folder):
    out = folder / "out"
    arguments = ["--outputs", "fields", "--out", str(out)]
    assert main(["solve", write(folder, block()), *arguments]) == 0
    COMM.barrier()
    data = b"".join(path.read_bytes() for path in (out / "fields.bp").iterdir())
    for name in (b"displacement", b"stress", b"von_mises_stress", b"gap", b"pressure"):
        assert name in data


def test_without_adios2_paraview_gets_xdmf(folder, monkeypatch):
    monkeypatch.setattr(dolfinx, "has_adios2", False)
    out = folder / "out"
    text = block(degree=2)
    assert main(["solve", write(folder, text), "--outputs", "fields", "--out", str(out)]) == 0
    COMM.barrier()
    described = (out / "fields.xdmf").read_text()
    for name in ("displacement", "stress", "von_mises_stress", "gap", "pressure", "in_contact"):
        assert f'Name="{name}"' in described
    assert 'AttributeType="Vector"' in described and 'AttributeType="Tensor"' in described


def test_costs_name_the_terms_of_bodies(folder, capsys):
    assert main(["solve", write(folder, block()), "--costs"]) == 0
    printed = capsys.readouterr().out
    if COMM.rank == 0:
        assert "form a: elasticity on cells" in printed
        assert "form L: traction on the boundary" in printed


def test_a_sweep_has_the_components_of_the_force(folder):
    path, out = write(folder, block()), folder / "sweep"
    arguments = ["contact.gap", "0.01", "0.03", "--out", str(out)]
    assert main(["sweep", path, *arguments]) == 0
    COMM.barrier()
    with (out / "sweep.csv").open() as file:
        rows = list(csv.DictReader(file))
    forces = [float(row["force of contact, y"]) for row in rows]
    # E e / (1 - nu^2) + nu / (1 - nu) q in plane strain, for the strain e and the pressure q.
    wanted = [
        YOUNG * e / (1.0 - POISSON**2) + POISSON / (1.0 - POISSON) * SIDE for e in (0.04, 0.02)
    ]
    assert forces == pytest.approx(wanted, rel=1e-7)
    assert (out / "sweep.png").exists()


def test_the_summary_prints_vectors(parse):
    result = solve_scene(parse(block()), COMM)
    summary = summarise(result, scene_boundaries(result))
    texts = dict(lines(summary))
    assert texts["force of traction"] == "(-3, 0)"
    assert texts["force of contact"] == f"(0, {summary.forces['contact'][1]:.6g})"
    assert force_columns({"a": 1.0, "b": (2.0, 3.0)}) == {
        "force of a": 1.0, "force of b, x": 2.0, "force of b, y": 3.0,
    }  # fmt: skip
    result.destroy()


# The gallery, on coarse meshes.


def gallery(demos, name, *overrides):
    pytest.importorskip("gmsh")
    scene = load_scene(demos / f"{name}.toml", COMM, [*overrides, "rtol=1e-9"])
    result = solve_scene(scene, COMM)
    summary = summarise(result, scene_boundaries(result))
    result.destroy()
    assert summary.imbalance <= 1e-6
    return summary


def test_the_block_on_a_cylinder_has_the_pressure_of_hertz(demos):
    summary = gallery(demos, "hertz", "domain.width=0.08")
    force = summary.forces["contact"][1]
    half_width = 2.0 * np.sqrt(4.0 * force * (1.0 - 0.3**2) / (np.pi * 200.0))
    assert summary.body["largest pressure"] == pytest.approx(
        2.0 * force / (np.pi * half_width), rel=0.05
    )
    assert summary.contact_size == pytest.approx(2.0 * half_width, abs=2.0 * 0.08)


def test_the_punch_has_the_pressure_of_a_rigid_punch_in_its_middle(demos):
    pytest.importorskip("gmsh")
    result = solve_scene(load_scene(demos / "punch.toml", COMM, ["domain.width=0.05"]), COMM)
    force, boundary = -result.posed.problem.force[1], scene_boundaries(result)[0]
    if boundary is not None:
        x, pressure = boundary.points[:, 0], boundary.values[:, 2]
        middle = np.abs(x) < 0.13
        wanted = force / (np.pi * np.sqrt(0.25**2 - x[middle] ** 2))
        assert pressure[middle] == pytest.approx(wanted, rel=0.05)
    result.destroy()


def test_the_beam_rests_on_the_bump_and_on_the_floor(demos):
    pytest.importorskip("gmsh")
    result = solve_scene(load_scene(demos / "beam.toml", COMM, ["domain.width=0.15"]), COMM)
    boundary = scene_boundaries(result)[0]
    if boundary is not None:
        x = boundary.points[boundary.touching, 0]
        assert ((x > 3.5) & (x < 4.8)).any() and x.max() == pytest.approx(10.0)
        assert not ((x > 5.0) & (x < 6.5)).any() and not (x < 3.5).any()
    result.destroy()


def test_the_ring_and_the_ball_are_symmetric(demos):
    ring = gallery(demos, "ring", "domain.refinements=1")
    assert abs(ring.forces["contact"][0]) <= 1e-6 * ring.forces["contact"][1]
    ball = gallery(demos, "ball", "domain.refinements=0")
    x, y, z = ball.forces["contact"]
    assert (x, y) == (0.0, 0.0) and z > 0.0


def test_a_material_that_is_none_inside_of_the_body_is_refused(parse):
    for key, formula in (("young", "x - 0.5"), ("poisson", "0.6*x")):
        text = WHOLE.format(cells=8, degree=1).replace(
            'young = "100 + 50*x"' if key == "young" else "poisson = 0.25", f'{key} = "{formula}"'
        )
        with pytest.raises(InputError) as error:
            pose(parse(text), COMM)
        assert error.value.subject == key


STEEP = """
[domain]
shape = "square"
cells = 6
[elasticity]
young = "{young}"
poisson = 0.3
[contact]
sides = "bottom"
gap = 0.01
direction = [0, -1]
[[dirichlet]]
sides = "top"
value = [0, -0.05]
"""


@pytest.mark.parametrize(
    ("young", "places"),
    [
        ("100", "r^-0.289 at (0, 1), (1, 1)"),
        # Integrated piece by piece near its pole, which is outside of the domain.
        ("100/(x + 0.01)", "r^-0.289 at (0, 1), (1, 1)"),
        ("where(x < 1/3, 100, 100)", "r^-0.289 at (0, 1), (1, 1)"),
    ],
)
def test_projections_of_a_modulus_make_no_stress_infinite(young, places, parse):
    result = solve_scene(parse(STEEP.format(young=young)), COMM)
    summary = summarise(result, scene_boundaries(result))
    assert summary.infinite_stress == places
    result.destroy()
