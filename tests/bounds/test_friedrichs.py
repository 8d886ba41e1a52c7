"""Constants of Friedrichs against functions that are known to be large, and exact constants."""

import math
from inspect import signature

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx.fem.petsc import LinearProblem

from dolfinx_signorini.bounds.condensation import DIRICHLET, INTERIOR, NEUMANN
from dolfinx_signorini.bounds.frames import cell_frames, on_frames
from dolfinx_signorini.bounds.friedrichs import friedrichs
from dolfinx_signorini.meshes.sided_meshes import boundary_facets


def constant(domain, fixed, c=None):
    """The constant for the side that a test tells, with a reaction on some cells."""
    frames = cell_frames(domain)
    d = domain.topology.dim
    facets = mesh.locate_entities_boundary(domain, d - 1, fixed)
    kinds = np.where(on_frames(frames, [boundary_facets(domain)]), NEUMANN, INTERIOR)
    kinds[on_frames(frames, [facets])] = DIRICHLET
    lowest = np.ones(len(kinds))
    reaction = np.zeros(len(kinds)) if c is None else c(frames.corners.mean(axis=1).T)
    ends = reaction > 0.0
    return friedrichs(domain.comm, frames, kinds, ends, lowest, reaction), facets


NEEDS_PREFIX = "petsc_options_prefix" in signature(LinearProblem.__init__).parameters


def ratio(domain, facets, c=0.0):
    """The norm of a function without a load of its own, over the energy norm."""
    space = fem.functionspace(domain, ("Lagrange", 2))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    x = ufl.SpatialCoordinate(domain)
    c = c(x) if callable(c) else c
    dofs = fem.locate_dofs_topological(space, domain.topology.dim - 1, facets)
    bcs = [fem.dirichletbc(0.0, dofs, space)]
    a = (ufl.dot(ufl.grad(u), ufl.grad(v)) + c * u * v) * ufl.dx
    # From version 0.10 on DOLFINx asks for a prefix.
    prefix = {"petsc_options_prefix": "ratio_"} if NEEDS_PREFIX else {}
    e = LinearProblem(a, v * ufl.dx, bcs=bcs, petsc_options={"ksp_type": "cg"}, **prefix).solve()
    energy = (ufl.dot(ufl.grad(e), ufl.grad(e)) + c * e * e) * ufl.dx
    squares = [fem.assemble_scalar(fem.form(form)) for form in (e * e * ufl.dx, energy)]
    return math.sqrt(np.divide(*(domain.comm.allreduce(s) for s in squares)))


@pytest.mark.parametrize(
    ("fixed", "exact"),
    [
        (lambda x: np.isclose(x[1], 1.0), 2.0 / math.pi),
        (lambda x: np.isclose(x[1], 1.0) | np.isclose(x[1], 0.0), 1.0 / math.pi),
    ],
)
def test_the_constant_of_a_direction_is_sharp(fixed, exact, comm):
    domain = mesh.create_unit_square(comm, 6, 6)
    found, facets = constant(domain, fixed)
    assert found == pytest.approx(exact)
    assert 0.9 * found < ratio(domain, facets) <= found


@pytest.mark.parametrize("make", [mesh.create_unit_square, mesh.create_unit_cube])
def test_the_constant_of_a_field(make, comm):
    domain = make(comm, *[8] * (2 if make is mesh.create_unit_square else 3))
    found, facets = constant(domain, lambda x: np.isclose(x[1], 1.0) & (x[0] < 0.5 + 1e-9))
    assert ratio(domain, facets) <= found < 12.0


def test_a_reaction_takes_up_what_is_left(comm):
    domain = mesh.create_unit_square(comm, 8, 8)
    found, _ = constant(domain, lambda x: x[0] > 2.0, lambda x: np.where(x[0] < 0.5, 4.0, 0.0))
    none = np.empty(0, dtype=np.int32)
    assert ratio(domain, none, lambda x: ufl.conditional(x[0] < 0.5, 4.0, 0.0)) <= found < 10.0


def test_a_weak_reaction_at_the_end_of_the_domain_leaves_its_constant(comm):
    """The function 1 is as large as that: only the last column of cells has its energy."""
    domain, c = mesh.create_unit_square(comm, 8, 8), 1e-4
    found, _ = constant(domain, lambda x: x[0] > 2.0, lambda x: np.where(x[0] > 0.875, c, 0.0))
    assert 1.0 <= found / math.sqrt(0.875 / (0.125 * c)) <= 1.7


def test_there_is_none_for_neumann_sides_alone(comm):
    domain = mesh.create_unit_square(comm, 4, 4)
    assert math.isinf(constant(domain, lambda x: x[0] > 2.0)[0])
