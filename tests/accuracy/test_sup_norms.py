"""Errors in sup norms: what the derivatives of a solution tell, and requests that come of it."""

import basix
import dolfinx
import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import dolfinx_signorini as ds
from dolfinx_signorini.accuracy.derivatives import left_by_derivatives
from dolfinx_signorini.meshes.elements import bernstein_space
from dolfinx_signorini.meshes.refinement import Transfer, refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, owned_cells
from dolfinx_signorini.norms.power_sums import collected
from dolfinx_signorini.studies.paper.solution import paper_problem

CELLS = {2: basix.CellType.triangle, 3: basix.CellType.tetrahedron}


def interpolated(space, function):
    """Interpolate in a space of any basis, by its nodal twin."""
    nodal = fem.Function(
        fem.functionspace(space.mesh, ("Lagrange", space.element.basix_element.degree))
    )
    nodal.interpolate(function)
    result = fem.Function(space)
    result.interpolate(nodal)
    return result


@pytest.mark.parametrize("scale", [1.0, 1e-5])
@pytest.mark.parametrize(("derivatives", "p"), [(0, 1.0), (0, 4.0), (0, np.inf), (1, np.inf)])
@pytest.mark.parametrize(("dimension", "degree"), [(2, 1), (2, 2), (2, 3), (2, 4), (3, 1), (3, 2)])
def test_the_next_derivatives_are_about_what_interpolation_leaves(
    comm, dimension, degree, derivatives, p, scale
):
    make = {2: dolfinx.mesh.create_unit_square, 3: dolfinx.mesh.create_unit_cube}[dimension]
    domain = make(comm, *[4 if dimension == 2 else 3] * dimension)
    domain.geometry.x[:] *= scale
    division = refined(SidedMesh(domain, {}))
    coarse, fine = (bernstein_space(m, degree) for m in (domain, division.sided.mesh))
    direction = np.array([1.0, -0.6, 0.8])[:dimension] / scale

    def u(x):
        return np.exp(2.0 * direction @ x[:dimension])

    w = interpolated(fine, u)
    transfer = Transfer(coarse, fine, division.parents)
    detail = fem.Function(fine)
    detail.x.array[:] = w.x.array - transfer.prolong(transfer.restrict(w)).x.array
    found = left_by_derivatives(detail, derivatives, p)

    lattice = basix.create_lattice(CELLS[dimension], 12, basix.LatticeType.equispaced, True)
    weights = np.zeros(len(lattice))
    if np.isfinite(p):
        lattice, weights = basix.make_quadrature(CELLS[dimension], 16)
    cells = owned_cells(fine.mesh)
    corners = fine.mesh.geometry.x[fine.mesh.geometry.dofmap[cells]][:, :, :dimension]
    edges = corners[:, 1:] - corners[:, :1]
    points = corners[:, :1] + np.einsum("qj,cji->cqi", lattice, edges)
    table = fine.element.basix_element.tabulate(1, lattice)[..., 0]
    values = np.einsum("jqd,cd->jcq", table, w.x.array[fine.dofmap.list[cells]])
    exact = np.exp(2.0 * points @ direction)
    if derivatives:
        slopes = np.einsum("jcq,cij->cqi", values[1:], np.linalg.inv(edges))
        slopes -= 2.0 * exact[..., None] * direction
        errors = np.linalg.norm(slopes, axis=2)
    else:
        errors = np.abs(values[0] - exact)
    error = errors.max(axis=1, initial=0.0)
    if np.isfinite(p):
        means = (errors / error[:, None]) ** p @ weights
        error *= (np.abs(np.linalg.det(edges)) * means) ** (1.0 / p)
    # A part in the middle of a cell hardly differs from the mean of all parts.
    error, found = (
        collected(v, division.parents, len(owned_cells(domain)), p) for v in (error, found)
    )
    assert (error <= 1.7 * found).all()
    largest = comm.allreduce(error.max(initial=0.0), op=MPI.MAX)
    # On triangles and tetrahedra interpolation leaves less on average than on edges.
    assert (found <= {1.0: 4.0, 4.0: 2.0, np.inf: 1.6}[p] * largest).all()


@pytest.mark.parametrize(
    ("degree", "norm", "accuracy"),
    [
        (2, "W1_inf", 0.344),
        (3, "Linf", 3e-5),
        (4, "W1_inf", 1e-2),
        pytest.param(4, "Linf", 1e-6, marks=pytest.mark.slow),
        pytest.param(3, "W1_inf", 1e-2, marks=pytest.mark.slow),
        pytest.param(3, "Linf", 1e-6, marks=pytest.mark.slow),
    ],
)
def test_requests_with_the_solution_of_the_paper(comm, degree, norm, accuracy):
    # At the radius where the solution ends its derivatives of high order have a kink.
    exact = {}

    def pose(sided):
        exact["u"] = ds.christof_haubner(sided.mesh)
        return paper_problem(exact["u"], degree)

    first = SidedMesh(ds.friedrichs_keller(comm, 4), {})
    found = ds.solve_adaptively(pose, first, norm=norm, accuracy=accuracy)
    assert found.reached
    error = ds.error_norms(found.problem.u, exact["u"], [norm])[norm]
    assert 0.05 * accuracy < error <= accuracy
    found.problem.destroy()


@pytest.mark.parametrize("bound", ["lower", "upper"])
def test_on_the_boundary_an_error_inside_of_the_domain_counts_as_far_as_it_reaches(
    bound, comm, parse
):
    """A bump of the load in the middle, of which hardly anything is on the boundary."""
    sign = 1 if bound == "lower" else -1
    text = f"""
degree = 2
[domain]
shape = "square"
cells = 8
[define]
s = "((x - 0.45)^2 + (y - 0.55)^2)/0.01"
w = "exp(-s) + {sign}*(2*y + sin(3*x)*exp(3*y)/40)"
[equation]
load = "400*(1 - s)*exp(-s)"
[contact]
sides = "top"
obstacle = "w"
bound = "{bound}"
[[dirichlet]]
sides = ["left", "right", "bottom"]
value = "w"
"""

    def errors(u):
        """The errors on a lattice in each cell, in the domain and on the boundary."""
        space, cells = u.function_space, owned_cells(u.function_space.mesh)
        lattice = basix.create_lattice(CELLS[2], 12, basix.LatticeType.equispaced, True)
        corners = space.mesh.geometry.x[space.mesh.geometry.dofmap[cells]][:, :, :2]
        edges = corners[:, 1:] - corners[:, :1]
        x, y = np.moveaxis(corners[:, :1] + np.einsum("qj,cji->cqi", lattice, edges), -1, 0)
        table = space.element.basix_element.tabulate(0, lattice)[0, ..., 0]
        s = ((x - 0.45) ** 2 + (y - 0.55) ** 2) / 0.01
        exact = np.exp(-s) + sign * (2.0 * y + np.sin(3.0 * x) * np.exp(3.0 * y) / 40.0)
        off = np.abs(u.x.array[space.dofmap.list[cells]] @ table.T - exact)
        at = np.minimum(np.minimum(x, 1.0 - x), np.minimum(y, 1.0 - y)) < 1e-12
        own = off.max(initial=0.0), off[at].max(initial=0.0)
        return np.max(comm.allgather(own), axis=0)

    unknowns = {}
    for k, norm in enumerate(("Linf", "Linf_boundary")):
        result = ds.solve_scene(parse(text), comm, norm=norm, accuracy=1e-4, degree=2)
        found, unknowns[norm] = result.found, result.found.steps[-1].unknowns
        assert found.reached and errors(result.u)[k] <= found.estimate <= 1e-4
        result.destroy()
    assert unknowns["Linf_boundary"] < 0.3 * unknowns["Linf"]
