"""What jumps of the diffusion inside of cells leave, for a solution with the same kink in all."""

import math
from pathlib import Path

import basix
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from known import alone
from mpi4py import MPI

from dolfinx_signorini import SignoriniProblem, bernstein_space
from dolfinx_signorini.accuracy.adaptive import coefficients_of, data_in_pieces
from dolfinx_signorini.accuracy.cut_cells import SPREAD, cut_errors
from dolfinx_signorini.accuracy.estimates import Estimator
from dolfinx_signorini.accuracy.marking import SAFETY
from dolfinx_signorini.accuracy.targets import target
from dolfinx_signorini.accuracy.terms import Solution, Solved
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, owned_cells
from dolfinx_signorini.norms.power_sums import total
from dolfinx_signorini.problem.dirichlet import dirichlet
from dolfinx_signorini.scenes import pose
from dolfinx_signorini.scenes.files.reading import parse_scene
from dolfinx_signorini.scenes.posing import coefficients

TEXT = """
degree = {degree}
[domain]
shape = "square"
cells = 8
[equation]
diffusion = "where(x < {place!r}, 1, {high!r})"
[contact]
sides = "bottom"
obstacle = -5
[[dirichlet]]
sides = "left"
value = 0
[[dirichlet]]
sides = "right"
value = 1
"""


def true_size(error, wanted):
    """The size of an error in a norm, or of its integral, by rules of its own."""
    domain, norm = error.ufl_operands[0].function_space.mesh, wanted.norm
    parts = [error.dx(0), error.dx(1)] if norm and norm.derivatives else [error]
    if norm is not None and math.isinf(norm.p):
        points = basix.create_lattice(
            basix.CellType.triangle, 20, basix.LatticeType.equispaced, True
        )
        values = [fem.Expression(f, points).eval(domain, owned_cells(domain)) for f in parts]
        return domain.comm.allreduce(np.abs(values).max(initial=0.0), op=MPI.MAX)
    p = 1.0 if norm is None else norm.p
    power = error if norm is None else sum(abs(f) ** p for f in parts)
    form = fem.form(power * ufl.dx(metadata={"quadrature_degree": 30}))
    return abs(domain.comm.allreduce(fem.assemble_scalar(form))) ** (1.0 / p)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("high", [0.2, 5.0])
@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_a_jump_through_a_column_of_cells(share, high, degree, comm):
    place = (3.0 + share) / 8.0
    text = TEXT.format(degree=degree, place=place, high=high)
    posed = pose(parse_scene(text, Path("x.toml"), comm), comm)
    posed.problem.solve()
    domain, flux = posed.sided.mesh, 1.0 / (place + (1.0 - place) / high)
    x, q = ufl.SpatialCoordinate(domain)[0], fem.Constant(domain, flux)
    slope = fem.Constant(domain, flux / high)
    u = ufl.conditional(x < fem.Constant(domain, place), q * x, 1.0 - slope * (1.0 - x))
    for asked in ("L1", "L2", "Linf", "H1", "W1_4", "W1_inf", lambda v: v * ufl.dx):
        wanted = target(asked)
        found = cut_errors(alone(posed.problem, wanted), coefficients(posed.scene)) / SPREAD
        power = 1.0 if wanted.weighted or wanted.norm is None else wanted.norm.p
        size = true_size(posed.problem.u - u, wanted)
        assert 0.7 * size <= total(found, power, comm) <= 2.0 * size, asked
    posed.problem.destroy()


@pytest.mark.parametrize("asked", ["H1", "Linf"])
def test_what_a_jump_leaves_falls_as_with_elements_of_degree_1(comm, asked):
    """And not with the rate of the cell, which two solutions tell where the solution is smooth."""

    def posed(sided):
        domain, space = sided.mesh, bernstein_space(sided.mesh, 3)
        u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
        diffusion = ufl.conditional(ufl.lt(x[0], 0.43), 1.0, 5.0)
        ends = mesh.locate_entities_boundary(
            domain, 1, lambda x: np.isclose(x[0], 0.0) | np.isclose(x[0], 1.0)
        )
        bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
        return SignoriniProblem(
            diffusion * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
            fem.Constant(domain, 0.0) * v * ufl.dx,
            contact=bottom,
            obstacle=-5.0,
            bcs=[dirichlet(space, ends, x[0])],
        )

    sided = SidedMesh(mesh.create_unit_square(comm, 8, 8), {})
    division, pose_in_pieces = refined(sided), data_in_pieces()(posed)
    coarse, fine = (pose_in_pieces(part) for part in (sided, division.sided))
    coarse.solve()
    fine.solve()
    solved = Solved(Solution(coarse.u, coarse.forces), fine, division.parents, target(asked))
    estimator = Estimator(coarse.space, solved.target, coefficients_of)
    estimator.compare(solved)
    left = estimator.prediction
    cut = cut_errors(solved, coefficients_of(fine)) > 0.9 * left.remaining / SAFETY
    assert comm.allreduce(int(cut.sum())) > 0
    assert left.factors[cut] == pytest.approx(2.0 ** -solved.target.order(1), rel=0.2)
    assert not left.singular[cut].any()
    coarse.destroy()
    fine.destroy()
