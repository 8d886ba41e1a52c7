"""Values carried from one mesh to another one whose boundary lies outside of the first."""

import basix.ufl
import dolfinx
import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.meshes.between_meshes import interpolate_between
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.elements import bernstein_space
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import (
    SidedMesh,
    cells_with_dofs,
    covering_cells,
    owned_cells,
)
from dolfinx_signorini.solvers.transfer import Carrier

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
        assert len(set(few)) == len(few)
        assert COMM.allreduce(len(few)) <= 0.3 * COMM.allreduce(len(cells)) + COMM.size


LATTICES = {
    "nested squares": lambda: [friedrichs_keller(COMM, n) for n in (6, 24)],
    "squares that do not match": lambda: [friedrichs_keller(COMM, n) for n in (7, 17)],
    "rectangles": lambda: [
        dolfinx.mesh.create_rectangle(COMM, [(-1.0, 2.0), (3.0, 2.5)], n) for n in ((9, 4), (21, 6))
    ],
    "cubes": lambda: [dolfinx.mesh.create_unit_cube(COMM, n, n, n) for n in (3, 7)],
    "one cell of the coarse mesh": lambda: [friedrichs_keller(COMM, n) for n in (1, 5)],
    "no lattice below": lambda: [disk(13, 2.0), friedrichs_keller(COMM, 5)],
}


@pytest.mark.parametrize("meshes", LATTICES.values(), ids=LATTICES.keys())
def test_a_lattice_knows_the_cells_around_points(meshes):
    coarse, fine = (fem.functionspace(domain, ("Lagrange", 1)) for domain in meshes())
    old, new, found = fem.Function(coarse), fem.Function(fine), fem.Function(fine)
    old.interpolate(lambda x: np.sin(40.0 * x[0]) + np.cos(30.0 * x[1] - 20.0 * x[2]))
    owned = np.arange(fine.dofmap.index_map.size_local, dtype=np.int32)
    chosen = owned[np.abs(np.sin(3.0 * owned)) > 0.3] if COMM.rank == 0 else owned[:0]
    Carrier(coarse, fine)([(old, new)], chosen)
    # The search of DOLFINx for the cells around the same points.
    cells = owned_cells(fine.mesh)
    points = fem.create_interpolation_data(fine, coarse, cells, padding=1e-9)
    found.interpolate_nonmatching(old, cells, points)
    assert new.x.array[chosen] == pytest.approx(found.x.array[chosen], abs=1e-12)


SPACES = {
    "nodal": lambda domain: fem.functionspace(domain, ("Lagrange", 3)),
    "Bernstein": lambda domain: bernstein_space(domain, 4),
}


@pytest.mark.parametrize("kind", ["square", "cube"])
@pytest.mark.parametrize("make", SPACES.values(), ids=SPACES.keys())
def test_a_refined_mesh_knows_the_cells_around_points(kind, make, monkeypatch):
    square = friedrichs_keller(COMM, 5)
    coarse = square if kind == "square" else dolfinx.mesh.create_unit_cube(COMM, 3, 2, 2)
    some = owned_cells(coarse)[::3]
    fine = refined(SidedMesh(coarse, {}), some).sided.mesh
    monkeypatch.setattr(fem, "create_interpolation_data", None)  # no search for cells
    source, target = make(coarse), make(fine)
    old, new, exact = fem.Function(source), fem.Function(target), fem.Function(target)
    for f in (old, exact):
        f.interpolate(lambda x: 1.0 + x[0] ** 3 - 2.0 * x[0] * x[1] ** 2 + x[1] * x[2])
    owned = np.arange(target.dofmap.index_map.size_local, dtype=np.int32)
    for dofs in (owned[::4], owned[:0]):
        Carrier(source, target)([(old, new)], dofs)
        assert new.x.array[dofs] == pytest.approx(exact.x.array[dofs], abs=1e-11)


@pytest.mark.parametrize("length", [1e6, 1e9])
def test_points_are_found_in_cells_of_any_size(length):
    def distorted(n, seed):
        domain = dolfinx.mesh.create_unit_square(MPI.COMM_SELF, n, n)
        x, rng = domain.geometry.x, np.random.default_rng(seed)
        inner = np.minimum(x[:, :2], 1.0 - x[:, :2]).min(axis=1) > 1e-9
        x[inner, :2] += rng.uniform(-0.3, 0.3, (inner.sum(), 2)) / n
        x[:, :2] *= length
        return fem.Function(fem.functionspace(domain, ("Lagrange", 1)))

    for seed in range(20):
        old, new = distorted(4, seed), distorted(9, seed + 100)
        old.interpolate(lambda x: x[0] + 2.0 * x[1])
        cells = np.arange(162, dtype=np.int32)
        before = new.function_space.mesh.geometry.x.copy()
        interpolate_between([(old, new)], cells)
        x = new.function_space.tabulate_dof_coordinates()
        assert new.x.array == pytest.approx(x[:, 0] + 2.0 * x[:, 1], abs=1e-9 * length)
        assert (new.function_space.mesh.geometry.x == before).all()
