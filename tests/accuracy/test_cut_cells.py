"""What jumps of the diffusion inside of cells leave, for a solution with the same kink in all."""

import math
from pathlib import Path

import basix
import numpy as np
import pytest
import ufl
from dolfinx import fem
from known import alone
from mpi4py import MPI

from dolfinx_signorini.accuracy.cut_cells import SPREAD, cut_errors
from dolfinx_signorini.accuracy.targets import target
from dolfinx_signorini.meshes.sided_meshes import owned_cells
from dolfinx_signorini.norms.power_sums import total
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
