"""Refined meshes: sides, parents, and functions carried between a mesh and its refinement."""

import math

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, geometry, mesh
from mpi4py import MPI
from scipy.spatial import cKDTree

from dolfinx_signorini.accuracy.adaptive import solve_adaptively
from dolfinx_signorini.accuracy.cells import volumes
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.elements import bernstein_space, component_arrays, control_points
from dolfinx_signorini.meshes.refinement import Refinement, Transfer, refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, owned_cells

KINDS = ["square", "cube"]
CASES = [(kind, degree) for kind in KINDS for degree in (1, 2, 3)]
PLANES = {"low x": (0, 0.0), "high x": (0, 1.0), "low y": (1, 0.0), "high y": (1, 1.0)}


def sided_mesh(comm, kind):
    domain = (
        friedrichs_keller(comm, 5) if kind == "square" else mesh.create_unit_cube(comm, 3, 2, 2)
    )
    dim = domain.topology.dim - 1
    sides = {
        name: mesh.locate_entities_boundary(
            domain, dim, lambda x, a=axis, v=at: np.isclose(x[a], v)
        )
        for name, (axis, at) in PLANES.items()
    }
    return SidedMesh(domain, sides)


def middles(domain):
    return mesh.compute_midpoints(domain, domain.topology.dim, owned_cells(domain))


def at_corner(sided, reach=0.4):
    return np.flatnonzero(np.linalg.norm(middles(sided.mesh), axis=1) < reach).astype(np.int32)


def refinements(sided):
    """All cells divided; those at a corner; and these again with their ancestors."""
    local = refined(sided, at_corner(sided))
    again = refined(local.sided, at_corner(local.sided, 0.25))
    return [refined(sided), local, Refinement(again.sided, local.parents[again.parents])]


def angles(domain):
    """The smallest angle of each owned triangle."""
    x = domain.geometry.x[domain.geometry.dofmap[owned_cells(domain)]][:, :, :2]
    sides = np.linalg.norm(np.roll(x, 1, axis=1) - np.roll(x, 2, axis=1), axis=2)
    a, b, c = np.sort(sides, axis=1).T
    return np.arccos((b**2 + c**2 - a**2) / (2.0 * b * c))


def test_a_mesh_is_graded_towards_a_point_by_few_good_cells(comm):
    rounds, sided = 12, sided_mesh(comm, "square")
    point = np.array([0.4, 0.0, 0.0])
    before = comm.allreduce(len(owned_cells(sided.mesh)))
    worst = comm.allreduce(angles(sided.mesh).min(initial=9.0), op=MPI.MIN)
    for _ in range(rounds):
        x = sided.mesh.geometry.x[sided.mesh.geometry.dofmap[owned_cells(sided.mesh)]]
        at = np.linalg.norm(x - point, axis=2).min(axis=1) < 1e-12
        tips = np.flatnonzero(at).astype(np.int32)
        none = np.empty(0, dtype=np.int32)
        sided = refined(sided, none, (tips, np.tile(point, (len(tips), 1)))).sided
    domain = sided.mesh
    x = domain.geometry.x[domain.geometry.dofmap[owned_cells(domain)]]
    at = np.linalg.norm(x - point, axis=2).min(axis=1) < 1e-12
    smallest = comm.allreduce(volumes(domain).min(initial=9.0), op=MPI.MIN)
    assert smallest == pytest.approx(0.04 * 4.0**-rounds, rel=1e-6)
    assert comm.allreduce(np.count_nonzero(at)) <= 6
    # Two more cells for each cell at the point and round, and some that keep the mesh conforming.
    assert comm.allreduce(len(volumes(domain))) <= before + 8 * rounds
    assert comm.allreduce(angles(domain).min(initial=9.0), op=MPI.MIN) > 0.7 * worst


def bisected(sided, cells):
    return refined(sided, np.empty(0, dtype=np.int32), halved=cells).sided


@pytest.mark.parametrize("dimension", [2, 3])
def test_all_cells_of_a_lattice_are_bisected_into_halves(comm, dimension):
    make = mesh.create_unit_square if dimension == 2 else mesh.create_unit_cube
    sided = SidedMesh(make(comm, *[3] * dimension), {})
    first = comm.allreduce(len(owned_cells(sided.mesh)))
    for rounds in range(1, dimension + 1):
        sided = bisected(sided, owned_cells(sided.mesh))
        assert comm.allreduce(len(owned_cells(sided.mesh))) == 2**rounds * first
        size = volumes(sided.mesh) / math.factorial(dimension)
        assert size == pytest.approx(1.0 / (2**rounds * first), rel=1e-12)


def test_bisected_triangles_keep_their_angles(comm):
    """No angle is smaller than half of the smallest one before (Rosenberg and Stenger 1975)."""
    sided = sided_mesh(comm, "square")
    x = sided.mesh.geometry.x
    x[:, :2] += 0.08 * np.sin(5.0 * x[:, [1, 0]] + 9.0 * x[:, [0]])
    worst = comm.allreduce(angles(sided.mesh).min(initial=9.0), op=MPI.MIN)
    for _ in range(8):
        cells = at_corner(sided, 0.5)
        least = comm.allreduce(len(owned_cells(sided.mesh)) + len(cells))
        sided = bisected(sided, cells)
        assert comm.allreduce(len(owned_cells(sided.mesh))) >= least
    assert comm.allreduce(angles(sided.mesh).min(initial=9.0), op=MPI.MIN) >= 0.5 * worst


def random_function(space):
    """A function of a space that all ranks agree on, and that is no polynomial across cells."""
    x = control_points(space).T
    f = fem.Function(space)
    for k, part in enumerate(component_arrays(f)):
        part[:] = np.cos(1e4 * (x[0] + 2.0 * x[1] + 3.0 * x[2] + k))
    f.x.scatter_forward()
    return f


def polynomial(space):
    degree = space.element.basix_element.degree
    f = fem.Function(space)
    f.interpolate(
        lambda x: (1.0 + x[0] - 2.0 * x[1] + 3.0 * x[2]) ** degree - x[0] * x[1] ** (degree - 1)
    )
    return f


def owned(f):
    dofs = f.function_space.dofmap
    return f.x.array[: dofs.index_map.size_local * dofs.bs]


@pytest.mark.parametrize("kind", KINDS)
def test_refined_meshes_keep_their_sides(comm, kind):
    for refinement in refinements(sided_mesh(comm, kind)):
        domain, sides = refinement.sided.mesh, refinement.sided.sides
        for name, (axis, at) in PLANES.items():
            middle = mesh.compute_midpoints(domain, domain.topology.dim - 1, sides[name])
            assert np.abs(middle[:, axis] - at).max(initial=0.0) < 1e-12
            facets = np.sort(sides[name])
            tags = mesh.meshtags(domain, domain.topology.dim - 1, facets, np.ones_like(facets))
            one = fem.Constant(domain, 1.0)
            size = fem.assemble_scalar(
                fem.form(one * ufl.Measure("ds", domain, subdomain_data=tags)(1))
            )
            assert comm.allreduce(size) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_cells_lie_in_their_parents_and_fill_them(comm, kind):
    sided = sided_mesh(comm, kind)
    shape = geometry.bb_tree(sided.mesh, sided.mesh.topology.dim)
    for refinement in refinements(sided):
        inside = middles(refinement.sided.mesh)
        found = geometry.compute_colliding_cells(
            sided.mesh, geometry.compute_collisions_points(shape, inside), inside
        )
        assert all(p in found.links(k) for k, p in enumerate(refinement.parents))
        parts = np.bincount(
            refinement.parents, volumes(refinement.sided.mesh), len(owned_cells(sided.mesh))
        )
        assert parts == pytest.approx(volumes(sided.mesh), rel=1e-12)


@pytest.mark.parametrize(("kind", "degree"), CASES)
def test_polynomials_are_carried_to_and_fro_exactly(comm, kind, degree):
    sided = sided_mesh(comm, kind)
    coarse = fem.functionspace(sided.mesh, ("Lagrange", degree))
    for refinement in refinements(sided):
        fine = fem.functionspace(refinement.sided.mesh, ("Lagrange", degree))
        transfer = Transfer(coarse, fine, refinement.parents)
        up, down = transfer.prolong(polynomial(coarse)), transfer.restrict(polynomial(fine))
        assert up.x.array == pytest.approx(polynomial(fine).x.array, abs=1e-11)
        assert down.x.array == pytest.approx(polynomial(coarse).x.array, abs=1e-11)


@pytest.mark.parametrize(("kind", "degree"), CASES)
def test_prolonged_functions_are_the_same_functions(comm, kind, degree):
    sided = sided_mesh(comm, kind)
    coarse = fem.functionspace(sided.mesh, ("Lagrange", degree))
    u = random_function(coarse)
    for refinement in refinements(sided):
        domain = refinement.sided.mesh
        transfer = Transfer(
            coarse, fem.functionspace(domain, ("Lagrange", degree)), refinement.parents
        )
        up = transfer.prolong(u)
        x = domain.geometry.x[domain.geometry.dofmap[owned_cells(domain)]]
        for weights in (np.ones(x.shape[1]), np.arange(1.0, x.shape[1] + 1.0)):
            points = np.einsum("v,cvi->ci", weights / weights.sum(), x)
            here = u.eval(points, refinement.parents).ravel()
            there = up.eval(points, owned_cells(domain)).ravel()
            assert there == pytest.approx(here, abs=1e-10)
        assert transfer.restrict(up).x.array == pytest.approx(u.x.array, abs=1e-10)


@pytest.mark.parametrize(("kind", "degree"), CASES)
def test_no_dof_is_lost_on_cells_that_are_small_beside_their_coordinates(comm, kind, degree):
    sided = sided_mesh(comm, kind)
    x = sided.mesh.geometry.x[:, : sided.mesh.geometry.dim]
    x[:] = 0.7182 + 1e-7 * x  # rounding is 5e-9 of the width of a cell
    coarse = fem.functionspace(sided.mesh, ("Lagrange", degree))
    u = random_function(coarse)
    for refinement in refinements(sided):
        fine = fem.functionspace(refinement.sided.mesh, ("Lagrange", degree))
        transfer = Transfer(coarse, fine, refinement.parents)
        back = transfer.restrict(transfer.prolong(u))
        assert back.x.array == pytest.approx(u.x.array, abs=1e-5)


@pytest.mark.parametrize(("kind", "degree"), [case for case in CASES if case[1] < 3])
def test_restricted_functions_interpolate(comm, kind, degree):
    sided = sided_mesh(comm, kind)
    refinement = refined(sided)
    coarse = fem.functionspace(sided.mesh, ("Lagrange", degree))
    fine = fem.functionspace(refinement.sided.mesh, ("Lagrange", 2 * degree))
    # Halved cells with twice the degree have nodes at the nodes of the mesh before.
    u = random_function(fine)
    near, place = cKDTree(fine.tabulate_dof_coordinates()).query(
        coarse.tabulate_dof_coordinates()[: coarse.dofmap.index_map.size_local]
    )
    assert near.max(initial=0.0) < 1e-12
    down = Transfer(coarse, fine, refinement.parents).restrict(u)
    assert owned(down) == pytest.approx(u.x.array[place], abs=1e-9)


@pytest.mark.parametrize(("kind", "degree"), CASES)
@pytest.mark.parametrize("shape", [(), (2,)])
def test_functionals_of_interpolations(comm, kind, degree, shape):
    """F(I v) is what the transpose of I makes of F, applied to v."""
    sided = sided_mesh(comm, kind)
    coarse = bernstein_space(sided.mesh, degree, shape)
    for refinement in refinements(sided):
        fine = bernstein_space(refinement.sided.mesh, degree, shape)
        transfer = Transfer(coarse, fine, refinement.parents)
        for interpolate in (transfer.prolong, transfer.restrict):
            source, target = (coarse, fine)[:: 1 if interpolate is transfer.prolong else -1]
            v, tested = random_function(source), random_function(target)
            applied = [
                comm.allreduce(float(owned(one) @ owned(other)))
                for one, other in ((tested, interpolate(v)), (interpolate.transposed(tested), v))
            ]
            assert applied[1] == pytest.approx(applied[0], rel=1e-10, abs=1e-10)


def test_a_mesh_of_which_a_rank_has_no_cell_is_refined(comm):
    domain = friedrichs_keller(comm, 1)
    refinement = refined(SidedMesh(domain, {}))
    assert refinement.sided.mesh.topology.index_map(2).size_global == 8
    own = len(owned_cells(domain))
    assert sorted(refinement.parents) == sorted([*range(own)] * 4)


def second_order_mesh(comm, kind):
    """One triangle or tetrahedron with nodes on its edges."""
    dim = {"triangle": 2, "tetrahedron": 3}[kind]
    element = basix.ufl.element("Lagrange", kind, 2, shape=(dim,))
    nodes = basix.create_element(
        basix.ElementFamily.P, basix.CellType[kind], 2, basix.LagrangeVariant.equispaced
    ).points
    x, cells = nodes, np.arange(len(nodes))[None]
    if comm.rank:
        x, cells = x[:0], cells[:0]
    return mesh.create_mesh(comm, cells, x=x, e=element)


@pytest.mark.parametrize("kind", ["triangle", "tetrahedron"])
def test_a_second_order_mesh_is_refused_before_any_work(comm, kind):
    domain = second_order_mesh(comm, kind)
    sided = SidedMesh(domain, {})

    def pose(sided):
        raise AssertionError("the mesh was used")

    for call in (lambda: refined(sided), lambda: solve_adaptively(pose, sided, accuracy=1.0)):
        with pytest.raises(InputError, match=r"sided.*straight sides, of order 1, not 2"):
            call()
