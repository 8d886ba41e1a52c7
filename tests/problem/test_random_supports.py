"""Random bodies on random supports that alone hold them: solved, or refused by the laws of statics.

A linear program by itself tells whether forces of the support can balance the load.
"""

import dolfinx
import elastic_reference as reference
import numpy as np
import pytest
from dolfinx import fem
from elastic_cases import COMM
from elastic_reference import nodes_of
from scipy.optimize import linprog
from test_held_by_contact import check_kkt

from dolfinx_signorini import ContactProblem, InputError


def wrench(forces, at):
    """The sum of forces at points, and that of their moments."""
    if forces.shape[1] == 2:
        moments = [(at[:, 0] * forces[:, 1] - at[:, 1] * forces[:, 0]).sum()]
    else:
        moments = np.cross(at, forces).sum(axis=0)
    return np.concatenate([forces.sum(axis=0), moments])


def balanced(load, x, nodes, directions):
    """Whether forces against the directions can carry the load."""
    columns = [wrench(-d[None], x[None, node]) for node, d in zip(nodes, directions, strict=True)]
    total = wrench(load, x)
    scale = np.abs(total).max()
    found = linprog(
        np.zeros(len(nodes)), A_eq=np.array(columns).T, b_eq=-total / scale, method="highs"
    )
    return found.status == 0


def solve(seed):
    """Pose a problem and solve it; whether it was solved."""
    rng = np.random.default_rng(seed)
    size, degree = (2 if rng.random() < 0.7 else 3), int(rng.integers(1, 3))
    n = int(rng.integers(4, 14)) // degree if size == 2 else int(rng.integers(2, 5))
    create = dolfinx.mesh.create_unit_cube if size == 3 else dolfinx.mesh.create_unit_square
    domain = create(COMM, *[n] * size)
    space = fem.functionspace(domain, ("Lagrange", degree, (size,)))
    below = dolfinx.mesh.locate_entities_boundary(
        domain, size - 1, lambda x: np.isclose(x[size - 1], 0.0)
    )
    centre, slope = rng.uniform(0.2, 0.8, size - 1), rng.uniform(0.3, 3.0)
    slope *= 1.0 if rng.random() < 0.6 else -1.0

    def direction(x):
        found = -np.ones((size, x.shape[1]))
        for i in range(size - 1):  # no linear field, whose lines meet in a point
            off = x[i] - centre[i]
            found[i] = slope * off + 4.0 * off**3 + 0.3 * (size - 2) * np.sin(5.0 * x[i - 1])
        return found / np.linalg.norm(found, axis=0)

    def gap(x):
        return 0.1 * ((x[: size - 1].T - centre) ** 2).sum(axis=1)

    modulus = 10.0 ** rng.uniform(-1.0, 2.0)
    push = np.array([*rng.normal(size=size - 1) * 0.1, -1.0]) * rng.uniform(0.01, 0.3) * modulus
    numbers = [fem.Constant(domain, float(c)) for c in (modulus, rng.uniform(0.0, 0.4), 0.0)]
    nothing = fem.Constant(domain, (0.0,) * size)
    forms = reference.elastic(space, *numbers[:2], fem.Constant(domain, push), nothing, numbers[2])
    x = nodes_of(space)
    nodes = np.flatnonzero(np.isclose(x[size - 1], 0.0))
    directions = direction(x[:, nodes]).T
    load = reference.assembled(*forms)[1].reshape(-1, size)
    carried = balanced(load, x[:size].T, nodes, directions)
    try:
        problem = ContactProblem(*forms, contact=below, direction=direction, gap=gap)
    except InputError as error:
        assert error.subject == "load" and not carried, str(error)
        return False
    assert carried
    problem.solve(rtol=1e-10)
    check_kkt(problem, forms, nodes, directions, gap(x[:, nodes]), 1e-10)
    assert problem.result.linear_solves <= 12
    problem.destroy()
    return True


def test_random_supports():
    solved = [solve(seed) for seed in range(24)]
    assert 4 <= sum(solved) <= 20


@pytest.mark.slow
@pytest.mark.parametrize("first", range(1000, 1500, 50))
def test_many_random_supports(first):
    for seed in range(first, first + 50):
        solve(seed)
