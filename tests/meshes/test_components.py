"""Meshes of several bodies: each of them has to be held."""

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from dolfinx_signorini import InputError, SignoriniProblem
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.components import components

N = 12


def squares(comm, places, n=N):
    """Return unit squares side by side as one mesh, at places on the x-axis."""
    k = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (part.ravel() for part in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    cells = np.concatenate([np.stack((a, b, c), axis=1), np.stack((a, c, d), axis=1)])
    x = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, n + 1)] * 2, indexing="ij"), axis=-1)
    x = x.reshape(-1, 2)
    points = np.concatenate([x + np.array([place, 0.0]) for place in places])
    all_cells = np.concatenate([cells + i * (n + 1) ** 2 for i in range(len(places))])
    if comm.rank:
        points, all_cells = points[:0], all_cells[:0]
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    return mesh.create_mesh(comm, all_cells, x=points, e=element)


def on(domain, *conditions):
    """Facets of the boundary where all conditions hold."""
    return mesh.locate_entities_boundary(
        domain, 1, lambda x: np.all([condition(x) for condition in conditions], axis=0)
    )


def bottom(x):
    return np.isclose(x[1], 0.0)


def top(x):
    return np.isclose(x[1], 1.0)


def first(x):
    return x[0] < 1.5


def second(x):
    return x[0] > 1.5


def problem(domain, contact, load=-1.0, fixed=None, reaction=None, obstacle=-0.1, degree=1):
    space = fem.functionspace(domain, ("Lagrange", degree))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    if reaction is not None:
        a += reaction(ufl.SpatialCoordinate(domain)) * u * v * ufl.dx
    bcs = []
    if fixed is not None:
        dofs = fem.locate_dofs_topological(space, 1, fixed)
        bcs = [fem.dirichletbc(0.0, dofs, space)]
    f = load(ufl.SpatialCoordinate(domain)) if callable(load) else fem.Constant(domain, load)
    return SignoriniProblem(a, f * v * ufl.dx, contact=contact, obstacle=obstacle, bcs=bcs)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("places", [(0.0,), (0.0, 2.0), (0.0, 2.0, 5.0), (0.0, 1.0 + 1e-6)])
def test_bodies_are_the_components(comm, places, degree):
    domain = squares(comm, places, 5)
    space = fem.functionspace(domain, ("Lagrange", degree))
    found = components(space)
    owned = space.dofmap.index_map.size_local
    x = space.tabulate_dof_coordinates()[:owned, 0]
    middles = np.add(places, 0.5)
    nearest = np.abs(x[:, None] - middles).argmin(axis=1)
    assert found.count == len(places)
    pairs = set().union(*comm.allgather(set(zip(found.numbers.tolist(), nearest, strict=True))))
    assert len(pairs) == len(places)  # one number for each place, and the other way round
    nodes = (5 * degree + 1) ** 2
    assert (found.counts(np.arange(owned, dtype=np.int32)) == nodes).all()
    assert np.sort(found.sums(x)) == pytest.approx(nodes * middles, rel=1e-9)
    assert sorted(found.names) == sorted(
        f"the body between ({place:.6g}, 0) and ({place + 1.0:.6g}, 1)" for place in places
    )


def test_a_square_on_many_ranks_is_one_body(comm):
    assert components(fem.functionspace(friedrichs_keller(comm, 7), ("Lagrange", 1))).count == 1


@pytest.mark.parametrize(
    ("below", "load", "subject", "message"),
    [
        (first, -1.0, "contact", "empty"),
        (first, 1.0, "contact", "empty"),
        (None, 1.0, "load", "the energy is unbounded"),
        (None, 0.0, "load", "the solution is not unique"),
    ],
)
def test_a_body_that_nothing_holds_is_named(comm, below, load, subject, message):
    domain = squares(comm, (0.0, 2.0))
    contact = on(domain, bottom, *([below] if below else []))
    with pytest.raises(InputError) as refusal:
        problem(domain, contact, load, fixed=on(domain, top, first))
    assert refusal.value.subject == subject
    assert message in str(refusal.value)
    assert "the body between (2, 0) and (3, 1)" in str(refusal.value)


def test_loads_of_two_bodies_do_not_make_up_for_each_other(comm):
    domain = squares(comm, (0.0, 2.0))

    def load(x):
        return ufl.conditional(ufl.lt(x[0], 1.5), -2.0, 1.0)

    with pytest.raises(
        InputError, match="L\\(1\\) = 1 is not negative on the body between \\(2, 0"
    ):
        problem(domain, on(domain, bottom), load)


def test_a_reaction_holds_the_body_that_has_it(comm):
    domain = squares(comm, (0.0, 2.0))
    contact, fixed = on(domain, bottom, first), on(domain, top, first)

    def reaction(x):
        return ufl.conditional(ufl.gt(x[0], 1.5), 1e-6, 0.0)

    held = problem(domain, contact, fixed=fixed, reaction=reaction)
    assert not held.system.singular
    held.destroy()
    with pytest.raises(InputError, match="the body between \\(2, 0\\)"):
        problem(domain, contact, fixed=fixed, reaction=lambda x: 1e-6 - reaction(x))


@pytest.mark.parametrize("method", ["cascade", "bncg"])
def test_each_body_comes_to_rest_as_if_alone(comm, method):
    """Two bodies on two obstacles, which the last body meets without any Dirichlet data."""
    domain = squares(comm, (0.0, 2.0))
    both = problem(
        domain,
        on(domain, bottom),
        fixed=on(domain, top, first),
        obstacle=lambda x: 0.3 * x[0] - 0.7,
    )
    both.solve(method)
    alone = []
    for place, held in ((0.0, True), (2.0, False)):
        part = squares(comm, (place,))
        fixed = on(part, top) if held else None
        alone.append(
            problem(part, on(part, bottom), fixed=fixed, obstacle=lambda x: 0.3 * x[0] - 0.7)
        )
        alone[-1].solve(method)
    one = fem.Constant(domain, 1.0)
    x = ufl.SpatialCoordinate(domain)
    for k, single in enumerate(alone):
        side = ufl.conditional(ufl.lt(x[0], 1.5), 1.0 - k, float(k))
        for power in (1, 2):
            mine = fem.assemble_scalar(fem.form(side * one * both.u**power * ufl.dx))
            its = fem.assemble_scalar(fem.form(single.u**power * ufl.dx))
            assert comm.allreduce(mine) == pytest.approx(comm.allreduce(its), rel=1e-5)
        single.destroy()
    both.destroy()
