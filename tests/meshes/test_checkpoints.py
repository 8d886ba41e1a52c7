"""Checkpoints: what one number of ranks writes, another one reads."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_signorini
from dolfinx_signorini import InputError, SignoriniProblem, bernstein_space, boundary_facets
from dolfinx_signorini.meshes.checkpoints import read_checkpoint, read_mesh, write_checkpoint

COMM = MPI.COMM_WORLD
SCRIPT = """
import sys
from pathlib import Path

sys.path.insert(0, sys.argv[1])
import dolfinx_signorini  # which loads the MPI of the dolfinx of PyPI
import test_checkpoints

test_checkpoints.read(Path(sys.argv[2]) / "one.npz", 2)
test_checkpoints.write(Path(sys.argv[2]) / "two.npz", 2)
"""


def domain(dimension):
    if dimension == 2:
        return mesh.create_rectangle(COMM, [(0.0, 0.0), (2.0, 1.0)], (14, 9))
    return mesh.create_unit_cube(COMM, 4, 3, 5)


def truth(x):
    return np.sin(3.0 * x[0]) + x[1] ** 2 * np.cos(x[2]) - 7.0 * x[0] * x[1]


def functions(dimension):
    d = domain(dimension)
    found = {f"p{k}": fem.Function(fem.functionspace(d, ("Lagrange", k))) for k in (1, 2)}
    found["vector"] = fem.Function(fem.functionspace(d, ("Lagrange", 2, (dimension,))))
    return d, found


def components(f):
    """What the function interpolates: a scalar, or a vector with another component each."""
    size = f.function_space.dofmap.bs
    if size == 1:
        return truth
    return lambda x: np.stack([(k + 1.0) * truth(x) + k for k in range(size)])


def write(path, dimension):
    _, found = functions(dimension)
    for f in found.values():
        f.interpolate(components(f))
    write_checkpoint(path, found, time=0.25, step=3)


def read(path, dimension):
    _, found = functions(dimension)
    assert read_checkpoint(path, found) == {"time": 0.25, "step": 3.0}
    for f in found.values():
        expected = components(f)(f.function_space.tabulate_dof_coordinates().T).T.ravel()
        assert np.allclose(f.x.array, expected, rtol=0.0, atol=1e-13)  # ghosts, too
    again = read_mesh(path)
    volume = COMM.allreduce(fem.assemble_scalar(fem.form(fem.Constant(again, 1.0) * ufl.dx)))
    assert volume == pytest.approx(2.0 if dimension == 2 else 1.0)
    on_it = fem.Function(fem.functionspace(again, ("Lagrange", 2)))
    read_checkpoint(path, {"p2": on_it})
    expected = truth(on_it.function_space.tabulate_dof_coordinates().T)
    assert np.allclose(on_it.x.array, expected, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("dimension", [2, 3])
def test_what_was_written_is_read(folder, dimension):
    write(folder / "file.npz", dimension)
    read(folder / "file.npz", dimension)


@pytest.mark.skipif(COMM.size > 1, reason="starts processes of its own")
@pytest.mark.skipif(shutil.which("mpirun") is None, reason="there is no mpirun")
def test_other_numbers_of_ranks_read_it(tmp_path):
    inherited = ("PMIX_", "PRTE_LAUNCHED", "OMPI_COMM_", "OMPI_UNIVERSE_SIZE")
    kept = {k: v for k, v in os.environ.items() if not k.startswith(inherited)}
    kept["PYTHONPATH"] = str(Path(dolfinx_signorini.__file__).parents[1])

    write(tmp_path / "one.npz", 2)
    command = ["mpirun", "-n", "2", sys.executable, "-c", SCRIPT]
    arguments = [str(Path(__file__).parent), str(tmp_path)]
    done = subprocess.run(
        [*command, *arguments], env=kept, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr[-2000:]
    read(tmp_path / "two.npz", 2)


def heat(u):
    """A step of implicit Euler from u, with a floor."""
    space = u.function_space
    trial, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    a = (trial * v + 0.1 * ufl.inner(ufl.grad(trial), ufl.grad(v))) * ufl.dx
    facets = boundary_facets(space.mesh)
    return SignoriniProblem(a, (u - 0.1) * v * ufl.dx, contact=facets, obstacle=-0.15, u=u)


def test_a_time_loop_goes_on(folder):
    space = fem.functionspace(domain(2), ("Lagrange", 1))
    u = fem.Function(space)
    problem = heat(u)
    for step in range(6):
        problem.solve(rtol=1e-12)
        if step == 2:
            write_checkpoint(folder / "step.npz", {"u": u}, step=step)
    again = fem.Function(space)
    assert read_checkpoint(folder / "step.npz", {"u": again})["step"] == 2
    problem_again = heat(again)
    for _ in range(3):
        problem_again.solve(rtol=1e-12)
    assert problem.result.active_dofs == problem_again.result.active_dofs > 0
    assert np.allclose(again.x.array, u.x.array, rtol=0.0, atol=1e-10)
    for p in (problem, problem_again):
        p.destroy()


def test_what_is_no_checkpoint_of_this_mesh_is_refused(folder):
    path = folder / "file.npz"
    write(path, 2)
    other = fem.Function(fem.functionspace(mesh.create_unit_square(COMM, 4, 4), ("Lagrange", 1)))
    with pytest.raises(InputError, match="another mesh"):
        read_checkpoint(path, {"p1": other})
    _, found = functions(2)
    for other in ("p2", "vector"):
        with pytest.raises(InputError, match="in other elements"):
            read_checkpoint(path, {"p1": found[other]})
    with pytest.raises(InputError, match="in other elements"):
        read_checkpoint(path, {"vector": found["p2"]})
    with pytest.raises(InputError, match="no function 'u', but p1, p2, vector"):
        read_checkpoint(path, {"u": found["p1"]})
    with pytest.raises(InputError, match="names no function"):
        write_checkpoint(path, {})
    if COMM.rank == 0:
        (folder / "text.npz").write_text("no checkpoint")
        np.savez(folder / "others.npz", a=1.0)
    COMM.barrier()
    for name, message in (
        ("text", "no checkpoint"),
        ("others", "no checkpoint"),
        ("no", "No such"),
    ):
        with pytest.raises(InputError, match=message):
            read_checkpoint(folder / f"{name}.npz", found)
    with pytest.raises(InputError, match="cannot be written"):
        write_checkpoint(folder / "missing" / "file.npz", found)


def test_two_dofs_at_one_place_are_refused(folder):
    # Two triangles over each other: no point of one belongs to the other.
    x = np.array([[0, 0], [1, 0], [0, 1], [0, 0], [1, 0], [0, 1]], dtype=np.float64)
    cells = np.array([[0, 1, 2], [3, 4, 5]])
    if COMM.rank:
        x, cells = x[:0], cells[:0]
    import basix.ufl

    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    double = mesh.create_mesh(COMM, cells, x=x, e=ufl.Mesh(element))
    f = fem.Function(fem.functionspace(double, ("Lagrange", 1)))
    with pytest.raises(InputError, match="two nodes at the same place"):
        write_checkpoint(folder / "file.npz", {"f": f})


def test_coefficients_of_one_basis_are_no_values_of_another(folder):
    d = domain(2)
    spaces = [bernstein_space(d, 2), fem.functionspace(d, ("Lagrange", 2))]
    for k, space in enumerate(spaces):
        write_checkpoint(folder / f"{k}.npz", {"u": fem.Function(space)})
    for k, space in enumerate(spaces):
        read_checkpoint(folder / f"{k}.npz", {"u": fem.Function(space)})
        with pytest.raises(InputError, match="has the basis"):
            read_checkpoint(folder / f"{1 - k}.npz", {"u": fem.Function(space)})


def test_what_is_no_function_is_refused(folder):
    for job in (write_checkpoint, read_checkpoint):
        with pytest.raises(InputError, match="functions"):
            job(folder / "no.npz", {"u": 3})


def test_what_is_no_number_is_refused_on_all_ranks(folder):
    u, other = functions(2)[1]["p1"], functions(2)[1]["p2"]
    for value in (None, "a", [1, 2], 1j, np.nan, fem.Constant(u.function_space.mesh, 1.0)):
        with pytest.raises(InputError, match="time"):
            write_checkpoint(folder / "no.npz", {"u": u}, time=value)
    with pytest.raises(InputError, match="several meshes"):
        write_checkpoint(folder / "no.npz", {"u": u, "v": other})
    COMM.barrier()
    assert not (folder / "no.npz").exists()


def test_curved_meshes_are_refused(tmp_path):
    shape = basix.ufl.element("Lagrange", "triangle", 2, shape=(2,))
    nodes = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0.5], [0, 0.5], [0.5, 0]], dtype=float)
    cells = np.arange(6, dtype=np.int64)[None]
    if COMM.rank:
        nodes, cells = nodes[:0], cells[:0]
    curved = mesh.create_mesh(COMM, cells, x=nodes, e=shape)
    function = fem.Function(fem.functionspace(curved, ("Lagrange", 1)))
    with pytest.raises(InputError, match="straight edges"):
        write_checkpoint(tmp_path / "curved.npz", {"u": function})
    assert not list(tmp_path.iterdir())
