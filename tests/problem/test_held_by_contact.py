"""Bodies that contact holds: closed forms, the conditions of Karush, Kuhn and Tucker, and refusals.

The conditions are sufficient: the energy is convex. DOLFINx assembles for them by itself.
"""

import dolfinx
import elastic_reference as reference
import gmsh
import numpy as np
import pytest
import ufl
from dolfinx import fem
from elastic_cases import COMM, TIGHT, largest
from elastic_reference import gathered, nodes_of

from dolfinx_signorini import ContactProblem, InputError, elasticity
from dolfinx_signorini.base.compat import gmsh_mesh

E, NU = 7.0, 0.25


class Block:
    """A unit square or cube on walls, turned in the plane, with pressures on the other sides.

    Args:
        walls: The axes i whose side x_i = 0 is in contact.
        pressures: On the sides x_i = 1 for each axis i.
        size: The dimension.
        bend: A load that varies along the first axis, along the last axis.
        slide: A load along the first axis.
    """

    def __init__(self, walls, pressures, size=2, n=4, degree=1, angle=0.0, bend=0.0, slide=0.0):
        create = dolfinx.mesh.create_unit_cube if size == 3 else dolfinx.mesh.create_unit_square
        domain, self.size = create(COMM, *[n] * size), size
        space = fem.functionspace(domain, ("Lagrange", degree, (size,)))
        self.x = nodes_of(space)
        at = np.isclose(self.x[:size], 0.0)
        self.nodes = np.flatnonzero(at[walls].any(axis=0))
        self.normals = np.zeros((len(self.nodes), size))
        facets, corner = [], np.zeros(self.x.shape[1], dtype=bool)
        for axis in walls[::-1]:  # the sides but the first leave out the facets at the sides before
            before = [other for other in walls if other < axis]

            def where(x, axis=axis, before=before):
                clear = np.all(x[before] > 0.5 / n, axis=0) if before else True
                return np.isclose(x[axis], 0.0) & clear

            facets.append(dolfinx.mesh.locate_entities_boundary(domain, size - 1, where))
            touched = at[axis] & np.all(self.x[before] > 0.5 / n, axis=0)
            self.normals[touched[self.nodes]] = -np.eye(size)[axis]
            corner |= touched
        self.normals = self.normals[corner[self.nodes]]
        self.nodes = self.nodes[corner[self.nodes]]
        self.turn = np.eye(size)
        c, s = np.cos(angle), np.sin(angle)
        self.turn[:2, :2] = [[c, -s], [s, c]]
        x = ufl.SpatialCoordinate(domain)
        along = x[0] * c + x[1] * s
        domain.geometry.x[:, :size] = domain.geometry.x[:, :size] @ self.turn.T
        self.pressures = fem.Constant(domain, np.array(pressures, dtype=float))
        self.slide = fem.Constant(domain, float(slide))
        v = ufl.TestFunction(space)
        nothing = fem.Constant(domain, (0.0,) * size)
        numbers = [fem.Constant(domain, value) for value in (E, NU, 0.0)]
        a, _ = reference.elastic(space, *numbers[:2], nothing, nothing, numbers[2])
        tops = [
            dolfinx.mesh.locate_entities_boundary(
                domain, size - 1, lambda y, i=i: np.isclose((y[:size].T @ self.turn)[:, i], 1.0)
            )
            for i in range(size)
        ]
        facets_, values = np.concatenate(tops), np.repeat(np.arange(size), [len(t) for t in tops])
        order = np.argsort(facets_)
        tags = dolfinx.mesh.meshtags(
            domain, size - 1, facets_[order], values[order].astype(np.int32)
        )
        ds, L = ufl.ds(domain, subdomain_data=tags), ufl.inner(nothing, v) * ufl.dx
        for i in range(size):
            down = fem.Constant(domain, -self.turn[:, i])
            L += self.pressures[i] * ufl.inner(down, v) * ds(i)
        last = fem.Constant(domain, self.turn[:, size - 1].copy())
        first = fem.Constant(domain, self.turn[:, 0].copy())
        L += fem.Constant(domain, float(bend)) * (along - 0.5) * ufl.inner(last, v) * ufl.dx
        L += self.slide * ufl.inner(first, v) * ufl.dx
        self.forms, self.domain, self.space = (a, L), domain, space
        self.facets = np.unique(np.concatenate(facets))

    def pose(self, **options):
        return ContactProblem(*self.forms, contact=self.facets, **options)

    def check(self, problem, gap=0.0):
        directions = self.normals @ self.turn.T
        check_kkt(problem, self.forms, self.nodes, directions, gap)


def check_kkt(problem, forms, nodes, directions, gaps, residual=TIGHT):
    """Equilibrium, forces against the directions, no penetration, and forces in contact alone."""
    u, forces = gathered(problem.u), gathered(problem.forces)
    A, b = reference.assembled(*forms)
    reactions = (A @ u.ravel() - b).reshape(u.shape)
    scale = largest(b)
    normal = (reactions[nodes] * directions).sum(axis=1)
    gap = gaps - (u[nodes] * directions).sum(axis=1)
    assert largest(reactions[nodes] - normal[:, None] * directions) <= 1e-8 * scale
    assert normal.max() <= 1e-8 * scale and normal.min() < -1e-3 * scale
    assert gap.min() >= -1e-10 * largest(u)
    assert largest(normal * gap) <= 1e-9 * scale * largest(u)
    away = np.ones(len(u), dtype=bool)
    away[nodes] = False
    assert largest(reactions[away]) <= 1e-8 * scale
    assert largest(forces - np.where(away[:, None], 0.0, reactions)) <= 1e-8 * scale
    total = b.reshape(u.shape).sum(axis=0)
    assert largest(problem.force + total) <= 1e-8 * scale * len(u)
    assert problem.result.natural_residual <= residual


def refused(subject, words, pose):
    with pytest.raises(InputError) as caught:
        pose().solve()
    assert caught.value.subject == subject, str(caught.value)
    assert all(word in str(caught.value) for word in words), str(caught.value)


@pytest.mark.parametrize("size, degree", [(2, 1), (2, 2), (3, 1), (3, 2)])
@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_a_block_in_a_corner(size, degree, angle):
    """Pressures on the free sides, which the walls carry."""
    pressures = np.array([0.3, 0.5, 0.4])[:size]
    block = Block(list(range(size)), pressures, size, 4 // degree, degree, angle)
    problem = block.pose()
    problem.solve(rtol=TIGHT)
    block.check(problem)
    assert problem.force == pytest.approx(block.turn @ pressures, rel=1e-8)  # each wall its own
    problem.destroy()


@pytest.mark.parametrize("degree", [1, 2])
def test_a_block_that_bends_lifts_off_a_part_of_its_corner(degree):
    block = Block([0, 1], (0.3, 0.5), n=16 // degree, degree=degree, bend=-2.0, angle=0.4)
    problem = block.pose()
    problem.solve(rtol=TIGHT)
    block.check(problem)
    assert 0 < problem.result.active_dofs < len(block.nodes)
    problem.destroy()


def test_a_large_block_by_multigrid():
    """Enough unknowns for multigrid, which has a kernel but for the contact."""
    block = Block([0, 1], (0.3, 0.5), n=48, bend=-2.0)
    problem = block.pose()
    problem.solve(rtol=TIGHT)
    block.check(problem)
    assert "multigrid" in problem.result.preconditioner
    assert problem.result.linear_solves <= 12
    problem.destroy()


@pytest.mark.parametrize("degree", [1, 2])
def test_data_and_contact_hold_together(degree):
    """Rollers in place of a floor that is in contact everywhere: the same displacement."""
    corner = Block([0, 1], (0.5, 0.5), n=8 // degree, degree=degree)
    alone = Block([0], (0.5, 0.5), n=8 // degree, degree=degree)
    part, clear = alone.space.sub(1), 0.5 * degree / 8
    floor = dolfinx.mesh.locate_entities_boundary(
        alone.domain, 1, lambda x: np.isclose(x[1], 0.0) & (x[0] > clear)
    )
    rollers = fem.dirichletbc(0.0, fem.locate_dofs_topological(part, 1, floor), part)
    problems = corner.pose(), alone.pose(bcs=[rollers])
    assert all(problem.system.singular for problem in problems)
    first, second = (gathered(problem.solve(rtol=TIGHT)) for problem in problems)
    on_floor = np.isclose(corner.x[1], 0.0) & (corner.x[0] > clear)
    assert gathered(problems[0].gap)[on_floor].max() == 0.0
    assert largest(first - second) <= 1e-9 * largest(first)
    for problem in problems:
        problem.destroy()


@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.parametrize("slide", [0.0, 0.1])
def test_what_slides_is_refused_by_name(size, slide):
    block = Block([size - 1], np.eye(size)[size - 1], size, slide=slide)
    refused("bcs", ["translation along (1, 0" if size == 2 else "is free"], block.pose)


@pytest.mark.parametrize("size, degree", [(2, 1), (2, 2), (3, 1)])
def test_what_slides_may_be_held_weakly(size, degree):
    """The springs carry no force, and the block rests where its free motions have no share."""
    pressures = 0.5 * np.eye(size)[size - 1]
    block = Block([size - 1], pressures, size, 6 // degree, degree, bend=-1.0, angle=0.3)
    problem = block.pose(held_weakly=True)
    problem.solve(rtol=TIGHT)
    block.check(problem)
    u = gathered(problem.u) @ block.turn
    along = [ufl.as_vector(block.turn[:, k].tolist()) for k in range(size - 1)]
    if size == 3:
        x = ufl.dot(ufl.as_matrix(block.turn.T.tolist()), ufl.SpatialCoordinate(block.domain))
        middle = [0.5 * (side.min() + side.max()) for side in block.x[:2]]
        along.append((x[0] - middle[0]) * along[1] - (x[1] - middle[1]) * along[0])
    for motion in along:
        share = fem.assemble_scalar(fem.form(ufl.inner(problem.u, motion) * ufl.dx))
        assert abs(COMM.allreduce(share)) <= 1e-9 * largest(u)
    problem.destroy()


def test_a_load_that_slides_is_refused_although_held_weakly():
    block = Block([1], (0.0, 1.0), slide=0.1)
    refused("load", ["translation along (1, 0)"], lambda: block.pose(held_weakly=True))


@pytest.mark.parametrize(
    "walls, pressures, bend, words",
    [
        ([0, 1], (0.3, -0.5), 0.0, "unbounded"),  # lifted
        ([0, 1], (0.0, 0.5), 0.0, "not unique"),  # may leave the wall
        ([0, 1], (0.3, 0.5), 8.0, "unbounded"),  # tips over its edge
    ],
)
def test_loads_that_do_not_press(walls, pressures, bend, words):
    block = Block(walls, pressures, bend=bend)
    refused("load", [words], block.pose)
    refused("load", [words], lambda: block.pose(held_weakly=True))


def test_a_loop_sees_each_load():
    """Loads that press and loads that do not, one after the other, in one problem."""
    block = Block([0, 1], (0.3, 0.5), n=8, bend=-1.0)
    problem = block.pose()
    for pressures in ((0.3, 0.5), (0.4, 0.2), (0.3, -0.5), (0.2, 0.6)):
        block.pressures.value = pressures
        if min(pressures) < 0.0:
            refused("load", [], lambda: problem)
        else:
            problem.solve(rtol=TIGHT)
            block.check(problem)
    problem.destroy()


def test_a_loop_with_a_body_that_is_held_weakly():
    block = Block([1], (0.0, 0.5), n=8, bend=-1.0)
    problem = block.pose(held_weakly=True)
    for pressure in (0.5, 1.0):
        block.pressures.value = (0.0, pressure)
        problem.solve(rtol=TIGHT)
        block.check(problem)
    block.slide.value = 0.1
    refused("load", [], lambda: problem)
    problem.destroy()


def test_soft_springs_of_a_fine_mesh_hold():
    """The energy of the springs is far below the rounding of the matrix."""
    block = Block([1], (0.0, 1.0), n=64)
    u, v = ufl.TrialFunction(block.space), ufl.TestFunction(block.space)
    a, L = block.forms
    problem = ContactProblem(a + 1e-7 * ufl.inner(u, v) * ufl.dx, L, contact=block.facets)
    assert not problem.system.singular
    problem.destroy()
    block.pose(held_weakly=True).destroy()


def disc(h):
    gmsh.initialize()
    gmsh.option.setNumber("General.Verbosity", 1)
    if COMM.rank == 0:
        gmsh.model.occ.addDisk(0.0, 0.0, 0.0, 1.0, 1.0)
        gmsh.model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", h)
        gmsh.model.addPhysicalGroup(2, [1], 1)
        gmsh.model.mesh.generate(2)
    domain = gmsh_mesh(gmsh.model, COMM, 2)[0]
    gmsh.finalize()
    return domain


@pytest.mark.parametrize("half_angle", [0.6, 1.0])
def test_a_disc_in_a_groove(half_angle):
    """Two walls at an angle: their forces are those of statics, and gravity presses the disc."""
    domain = disc(0.12)
    space = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    weight, nothing = fem.Constant(domain, (0.0, -0.2)), fem.Constant(domain, (0.0, 0.0))
    numbers = [fem.Constant(domain, value) for value in (E, NU, 0.0)]
    forms = reference.elastic(space, *numbers[:2], weight, nothing, numbers[2])
    walls = np.array([[s * np.cos(half_angle), -np.sin(half_angle)] for s in (1.0, -1.0)])

    def direction(x):
        return np.where(x[0] > 0.0, walls[0][:, None], walls[1][:, None])

    def gap(x):
        return 1.0 - (x[:2] * direction(x)).sum(axis=0)

    lower = dolfinx.mesh.locate_entities_boundary(
        domain, 1, lambda x: (np.hypot(x[0], x[1]) > 0.99) & (x[1] < 0.0) & (np.abs(x[0]) > 0.1)
    )
    problem = ContactProblem(*forms, contact=lower, direction=direction, gap=gap)
    problem.solve(rtol=TIGHT)
    x = nodes_of(space)
    nodes = reference.gathered_numbers(space, problem.contact_nodes)
    directions = direction(x[:, nodes]).T
    check_kkt(problem, forms, nodes, directions, gap(x[:, nodes]))
    forces = gathered(problem.forces)
    total = reference.assembled(*forms)[1].reshape(-1, 2).sum(axis=0)
    for sign in (1.0, -1.0):
        carried = np.linalg.norm(forces[sign * x[0] > 0.0].sum(axis=0))
        assert carried == pytest.approx(-total[1] / (2.0 * np.sin(half_angle)), rel=1e-8)
    problem.destroy()


def test_a_disc_in_a_round_seat_turns():
    """Normals that meet in one point leave the turn about that point free."""
    domain = disc(0.2)
    space = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    weight, nothing = fem.Constant(domain, (0.0, -0.2)), fem.Constant(domain, (0.0, 0.0))
    numbers = [fem.Constant(domain, value) for value in (E, NU, 0.0)]
    forms = reference.elastic(space, *numbers[:2], weight, nothing, numbers[2])
    lower = dolfinx.mesh.locate_entities_boundary(
        domain, 1, lambda x: (np.hypot(x[0], x[1]) > 0.97) & (x[1] < 0.1)
    )
    radial = {"contact": lower, "direction": lambda x: x[:2]}
    refused("bcs", ["turn"], lambda: ContactProblem(*forms, **radial))
    problem = ContactProblem(*forms, held_weakly=True, **radial)
    problem.solve(rtol=TIGHT)
    nodes = reference.gathered_numbers(space, problem.contact_nodes)
    x = nodes_of(space)
    check_kkt(problem, forms, nodes, x[:2, nodes].T, 0.0)
    problem.destroy()


def on_a_bump(young, load):
    """A block that nothing but a round bump under its middle holds, and its problem."""
    domain = dolfinx.mesh.create_rectangle(COMM, [(-1.0, 0.0), (1.0, 1.0)], (8, 4))
    space = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    below = dolfinx.mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    return ContactProblem(
        elasticity(u, v, young, 0.3),
        -load * v[1] * ufl.dx,
        contact=below,
        gap=0.2 * x[0] ** 2,
        held_weakly=True,
    )


@pytest.mark.parametrize(("young", "told"), [(10.0, False), (1e4, True)])
def test_a_turn_that_no_force_stops_is_told(young, told, caplog):
    problem = on_a_bump(young, 1.0)
    problem.solve(rtol=1e-9)
    forces = problem.normal_forces.x.array[problem.active]
    pressed = COMM.allreduce(int((forces > 1e-6).sum()))
    assert (pressed == 1) == told
    assert problem.force == pytest.approx([0.0, 2.0], abs=1e-6)
    if COMM.rank == 0:
        assert ("one of many: no node with a contact force stops a turn" in caplog.text) == told
    problem.destroy()


def test_a_derivative_along_a_motion_that_nothing_stops_is_refused():
    problem = on_a_bump(10.0, 1.0)
    problem.solve(rtol=1e-9)
    v = ufl.TestFunction(problem.space)
    with pytest.raises(InputError, match="does work on a translation"):
        problem.solve_linearised(v[0] * ufl.dx)
    z, forces = problem.solve_linearised(-v[1] * ufl.dx, rtol=1e-10)
    own = forces.x.array.reshape(-1, 2)[: problem.space.dofmap.index_map.size_local]
    assert COMM.allreduce(own[:, 1].sum()) == pytest.approx(2.0)
    # z has no part of the free motion: its mean along x.
    share = fem.assemble_scalar(fem.form(z[0] * ufl.dx))
    assert COMM.allreduce(share) == pytest.approx(0.0, abs=1e-9)
    problem.destroy()


@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.parametrize("rollers", [False, True])
def test_linearised_forces_of_a_body_are_difference_quotients(size, rollers):
    """Also at nodes of which rollers hold a component and the obstacle the rest."""
    create = dolfinx.mesh.create_unit_cube if size == 3 else dolfinx.mesh.create_unit_square
    domain = create(COMM, *[4] * size)
    space = fem.functionspace(domain, ("Lagrange", 1, (size,)))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    low, high, left = (
        dolfinx.mesh.locate_entities_boundary(
            domain, size - 1, lambda x, k=k, at=at: np.isclose(x[k], at)
        )
        for k, at in ((size - 1, 0.0), (size - 1, 1.0), (0, 0.0))
    )
    top = fem.locate_dofs_topological(space, size - 1, high)
    bcs = [fem.dirichletbc(np.zeros(size), top, space)]
    if rollers:
        part = space.sub(0)
        dofs = fem.locate_dofs_topological(part, size - 1, left)
        bcs.append(fem.dirichletbc(0.0, dofs, part))
    d = np.array([0.6, 0.2, -1.0])[[0, 2]] if size == 2 else np.array([0.6, 0.2, -1.0])
    scale = fem.Constant(domain, 1.0)
    change = -(1.0 + x[0]) * v[size - 1] * ufl.dx
    a, L = elasticity(u, v, young=10.0, poisson=0.3), scale * change
    known = {"contact": low, "direction": tuple(d), "gap": -0.05}
    problem = ContactProblem(a, L, **known, bcs=bcs)
    problem.solve(rtol=1e-12)
    before, force, active = problem.forces.x.array.copy(), problem.force, problem.active
    _, slopes = problem.solve_linearised(change, rtol=1e-12)
    own = space.dofmap.index_map.size_local
    total = COMM.allreduce(slopes.x.array[: own * size].reshape(-1, size).sum(axis=0))
    step = 1e-3
    scale.value += step
    problem.solve(rtol=1e-12)
    assert np.array_equal(problem.active, active) and COMM.allreduce(len(active)) > 0
    assert largest(slopes.x.array - (problem.forces.x.array - before) / step) <= 1e-6
    assert total == pytest.approx((problem.force - force) / step, abs=1e-6)
    problem.destroy()
