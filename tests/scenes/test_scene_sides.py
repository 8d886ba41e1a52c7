"""Scenes: where the sides lie, how large cells are, and on which side an obstacle is made."""

from pathlib import Path

import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI

from dolfinx_signorini.meshes.elements import control_points
from dolfinx_signorini.scenes.domains.kinds import Cube, Square
from dolfinx_signorini.scenes.files.reading import parse_scene
from dolfinx_signorini.scenes.posing import pose
from dolfinx_signorini.studies.tradeoff.family import scene_family

COMM = MPI.COMM_WORLD
PLACES = {"left": (0, 0.0), "right": (0, 1.0), "bottom": (-1, 0.0), "top": (-1, 1.0)}
SCENE = """
domain = {{ shape = "square", cells = 8 }}
solution = {{ u = "{u}", manufactured = true }}
contact = {{ sides = ["left", "right", "bottom"], bound = "{bound}" }}
"""


def scene(u, bound):
    return parse_scene(SCENE.format(u=u, bound=bound), Path("made-up.toml"), COMM)


@pytest.mark.parametrize("domain", [Square(4), Cube(3)], ids=["square", "cube"])
def test_sides_lie_where_their_names_say(domain):
    sided = domain.make(COMM)
    dim, places = domain.dimension, dict(PLACES)
    if dim == 3:
        places |= {"front": (1, 0.0), "back": (1, 1.0)}
    assert set(places) == set(domain.side_names)
    for name, (axis, value) in places.items():
        middles = mesh.compute_midpoints(sided.mesh, dim - 1, sided.sides[name])[:, :dim]
        assert middles[:, axis] == pytest.approx(value, abs=1e-12), name
        assert COMM.allreduce(len(middles)) > 0


@pytest.mark.parametrize("n", [1, 4, 10])
def test_the_width_of_a_family_is_that_of_its_cells(n):
    family = scene_family(scene("2 + x", "lower"))
    sided = family.make(COMM, n)
    count = sided.mesh.topology.index_map(2).size_global
    assert np.sqrt(2.0 / count) == pytest.approx(family.width / n)


@pytest.mark.parametrize(
    ("u", "bound", "sign"), [("x*x-x", "lower", 1.0), ("x-x*x", "upper", -1.0)]
)
def test_an_obstacle_that_is_made_lies_on_the_side_of_the_bound(u, bound, sign):
    # The flux presses on the left and on the right, and vanishes at the bottom.
    posed = pose(scene(u, bound), COMM)
    problem = posed.problem
    x, y = control_points(problem.space)[problem.contact_dofs, :2].T
    gap = (x * x - x) - sign * problem.obstacle
    pressed = np.minimum(x, 1.0 - x) < 1e-12
    assert gap[pressed] == pytest.approx(0.0, abs=1e-14)
    assert (gap[~pressed] > 0.1).all() and (y[~pressed] == 0.0).all()
    problem.destroy()
