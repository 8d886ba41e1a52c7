"""What elastic contact refuses, and names."""

import dolfinx
import elastic_reference as reference
import numpy as np
import pytest
import ufl
from dolfinx import fem
from elastic_cases import COMM, SAME, TIGHT, Case, Pressed, check, largest, side
from elastic_reference import gathered, nodes_of

from dolfinx_signorini import ContactProblem, InputError
from dolfinx_signorini.meshes.sided_meshes import boundary_facets


def refused(subject, *more, forms=None, **options):
    """Check that a problem is refused with the name of an argument."""
    pressed = Pressed(n=4)
    given = pressed.case.options | options
    forms = forms(pressed) if forms else pressed.case.forms
    with pytest.raises(InputError) as caught:
        ContactProblem(*forms, **given).solve()
    assert caught.value.subject in (subject, *more), str(caught.value)
    pressed.problem.destroy()
    return str(caught.value)


def scalar_forms(pressed):
    space = fem.functionspace(pressed.domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    return ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, fem.Constant(space.mesh, 1.0) * v * ufl.dx


def test_a_scalar_space_is_refused():
    refused("form a", forms=scalar_forms, bcs=[])


@pytest.mark.parametrize(
    "direction",
    [
        (1.0,),
        (0.0, 0.0, -1.0),
        1.0,
        "down",
        (0.0, 0.0),
        (0.0, np.nan),
        (np.inf, 1.0),
        lambda x: -np.ones((1, len(x.T))),
        lambda x: np.stack([0.0 * x[0], 0.0 * x[0]]),
        lambda x: np.stack([0.0 * x[0], x[0] - 0.5]),  # zero at one node
        lambda x: np.full((2, len(x.T)), np.nan),
    ],
)
def test_directions_that_make_no_sense(direction):
    refused("direction", direction=direction)


def test_a_scalar_function_as_direction():
    pressed = Pressed(n=4)
    scalar = fem.Function(fem.functionspace(pressed.domain, ("Lagrange", 1)))
    options = pressed.case.options | {"direction": scalar}
    with pytest.raises(InputError) as caught:
        ContactProblem(*pressed.case.forms, **options)
    assert caught.value.subject == "direction"
    pressed.problem.destroy()


@pytest.mark.parametrize(
    "gap",
    [np.nan, "none", (0.0, 1.0), lambda x: x[:2], lambda x: np.full(len(x.T), np.nan)],
    ids=["not finite", "a text", "a vector", "two rows", "not finite at points"],
)
def test_gaps_that_make_no_sense(gap):
    refused("gap", gap=gap)


def test_normals_at_a_corner_are_none():
    """No average of two normals that are perpendicular is meant; with a direction there is one."""
    pressed = Pressed(n=4)
    both = np.concatenate([side(pressed.space, 1, 0.0), side(pressed.space, 0, 1.0)])
    options = pressed.case.options | {"contact": both}
    with pytest.raises(InputError) as caught:
        ContactProblem(*pressed.case.forms, **options | {"direction": None})
    assert caught.value.subject == "direction"
    ContactProblem(*pressed.case.forms, **options | {"direction": (0.6, -0.8)}).destroy()
    pressed.problem.destroy()


def test_no_facets():
    refused("contact", contact=np.empty(0, dtype=np.int32))


def held_at(pressed, axis, where, component=None):
    """Conditions that hold all components, or one, on a side."""
    space = pressed.space
    if component is None:
        dofs = fem.locate_dofs_topological(space, 1, side(space, axis, where))
        return [fem.dirichletbc(pressed.moved, dofs, space)]
    part = space.sub(component)
    dofs = fem.locate_dofs_topological(part, 1, side(space, axis, where))
    return [fem.dirichletbc(0.0, dofs, part)]


@pytest.mark.parametrize("which", ["nothing", "one translation"])
def test_a_body_that_is_not_held(which):
    """The highest side may slide along itself, and contact below does not stop the motion."""
    pressed = Pressed(n=4)
    bcs = held_at(pressed, 1, 1.0, 1) if which == "one translation" else []
    with pytest.raises(InputError) as caught:
        ContactProblem(*pressed.case.forms, **pressed.case.options | {"bcs": bcs}).solve()
    assert caught.value.subject == "bcs" and "(1, 0)" in str(caught.value)
    pressed.problem.destroy()


def test_a_body_on_springs_needs_no_data():
    """A form that is positive for rigid motions holds the body."""
    domain = dolfinx.mesh.create_unit_square(COMM, 6, 6)
    space = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    numbers = [fem.Constant(domain, c) for c in (1.0, 0.3, 2.0)]
    push, nothing = fem.Constant(domain, (0.0, -1.0)), fem.Constant(domain, (0.0, 0.0))
    forms = reference.elastic(space, *numbers[:2], push, nothing, numbers[2])
    bottom, x = side(space, 1, 0.0), nodes_of(space)
    options = {"contact": bottom, "gap": lambda x: 0.5 * x[0]}
    problem = ContactProblem(*forms, **options)
    problem.solve(rtol=TIGHT)
    nodes = np.flatnonzero(np.isclose(x[1], 0.0))
    held = np.zeros((len(x.T), 2), dtype=bool)
    down = np.tile([0.0, -1.0], (len(nodes), 1))
    check(Case(problem, forms, held, 0.0 * held, nodes, down, 0.5 * x[0, nodes], options))
    problem.destroy()


def test_all_of_the_boundary_may_be_the_argument():
    """Nodes whose components are all held have no constraint, and the others have theirs."""
    pressed = Pressed(n=8)
    options = pressed.case.options | {
        "contact": boundary_facets(pressed.domain),
        "direction": (0.0, -1.0),
        "gap": 0.3,
    }
    pressed.weight.value = (0.0, -3.0)
    problem = ContactProblem(*pressed.case.forms, **options)
    problem.solve(rtol=TIGHT)
    x, case = nodes_of(pressed.space), pressed.case
    on = np.isclose(x[:2], 0.0).any(axis=0) | np.isclose(x[:2], 1.0).any(axis=0)
    nodes = np.flatnonzero(on & ~np.isclose(x[1], 1.0))
    down, gaps = np.tile([0.0, -1.0], (len(nodes), 1)), np.full(len(nodes), 0.3)
    A, b = reference.assembled(*case.forms)
    found = reference.solve(A, b, case.held, case.values, nodes, down, gaps)
    assert (found.multipliers > 0.0).any()
    assert largest(gathered(problem.u) - found.u) <= SAME * largest(found.u)
    assert largest(gathered(problem.forces) - found.forces) <= SAME * found.scale
    for each in (problem, pressed.problem):
        each.destroy()
