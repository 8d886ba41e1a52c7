"""Values carried from one mesh to another one whose boundary lies outside of the first."""

import basix.ufl
import dolfinx
import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.meshes import cells_with_dofs
from dolfinx_signorini.solvers.prediction import covering_cells, interpolate_between

COMM = MPI.COMM_WORLD


def disk(edges, scale=1.0):
    """The polygon inscribed in a circle: one ring of triangles around the centre, refined once."""
    angles = 2.0 * np.pi * np.arange(edges) / edges
    x = scale * np.array([(0.0, 0.0), *zip(np.cos(angles), np.sin(angles), strict=True)])
    rim = np.arange(edges)
    cells = np.column_stack((np.zeros(edges), rim + 1, (rim + 1) % edges + 1)).astype(np.int64)
    if COMM.rank:
        x, cells = x[:0], cells[:0]
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    domain = dolfinx.mesh.create_mesh(COMM, cells, x=x, e=element)
    domain.topology.create_entities(1)
    return dolfinx.mesh.refine(domain)[0]


@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e6])
def test_a_fine_boundary_outside_of_the_coarse_mesh_gets_its_values(scale):
    # Corners of the 20-gon lie up to 3 % of the radius outside of the 13-gon in the same circle.
    old, new = (
        fem.Function(fem.functionspace(disk(edges, scale), ("Lagrange", 1))) for edges in (13, 20)
    )
    old.interpolate(lambda x: 2.0 + (3.0 * x[0] - x[1]) / scale)
    topology = new.function_space.mesh.topology
    count = topology.index_map(2).size_local + topology.index_map(2).num_ghosts
    interpolate_between([(old, new)], np.arange(count, dtype=np.int32))
    x = new.function_space.tabulate_dof_coordinates()
    assert new.x.array == pytest.approx(2.0 + (3.0 * x[:, 0] - x[:, 1]) / scale, abs=1e-9)


@pytest.mark.parametrize("degree", [1, 2])
def test_few_cells_have_all_dofs_of_a_side(degree):
    domain = dolfinx.mesh.create_unit_cube(COMM, 8, 8, 8)
    space = fem.functionspace(domain, ("Lagrange", degree))
    for marked in (
        space.tabulate_dof_coordinates()[:, 0] < 1e-9,
        np.zeros(len(space.tabulate_dof_coordinates()), dtype=bool),
    ):
        cells = cells_with_dofs(space, marked)
        few = covering_cells(space, marked, cells)
        dofs = space.dofmap.list
        assert set(dofs[few][marked[dofs[few]]]) == set(dofs[cells][marked[dofs[cells]]])
        assert marked[dofs].any(axis=1)[few].all()
        assert len(set(few)) == len(few) <= 0.3 * len(cells) + 1
