"""Compiled forms that are looked up once: their values are those of exact integrals."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, jit, mesh
from mpi4py import MPI
from scipy.special import jv

from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.errors import InputError


def integral(n, power, factor):
    """The integral of factor * x^power over the half of the square with tag 2, by a tagged form."""
    domain = mesh.create_unit_square(MPI.COMM_WORLD, n, n)
    x, c = ufl.SpatialCoordinate(domain), fem.Constant(domain, np.array([1.0, factor]))
    f, count = (
        fem.Function(fem.functionspace(domain, ("Lagrange", power))),
        domain.topology.index_map(2),
    )
    f.interpolate(lambda x: x[0] ** (power - 1))
    cells = np.arange(count.size_local + count.num_ghosts, dtype=np.int32)
    left = mesh.compute_midpoints(domain, 2, cells)[:, 0] < 0.5
    tags = mesh.meshtags(domain, 2, cells, np.where(left, 2, 1).astype(np.int32))
    dx = ufl.Measure("dx", domain, subdomain_data=tags)
    form = compiled.form(c[1] * f * x[0] * dx(2))
    return domain.comm.allreduce(fem.assemble_scalar(form))


@pytest.fixture
def looked_up(monkeypatch):
    """The list of what DOLFINx has looked up."""
    items, look_up = [], compiled._code

    def count(comm, item, **options):
        items.append(item)
        return look_up(comm, item, **options)

    monkeypatch.setattr(compiled, "_code", count)
    monkeypatch.setattr(compiled, "_codes", {})
    return items


def test_forms_with_one_signature_are_looked_up_once_and_keep_their_data(looked_up):
    for n, factor in ((4, 1.0), (6, -3.0)):
        assert integral(n, 2, factor) == pytest.approx(factor / 24.0, rel=1e-12)
    assert len([item for item in looked_up if isinstance(item, ufl.Form)]) == 1
    assert integral(4, 3, 2.0) == pytest.approx(2.0 / 64.0, rel=1e-12)
    assert len([item for item in looked_up if isinstance(item, ufl.Form)]) == 2


def test_a_sweep_over_a_number_is_looked_up_once_and_one_over_an_exponent_is_not(looked_up):
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4)
    x, dx = ufl.SpatialCoordinate(domain), ufl.dx(metadata={"quadrature_degree": 8})
    for power, last in ((2.0, 1), (4.0, 2)):
        for k in (3, 0.25, -1e-300):
            item = (k * x[0] ** power + ufl.conditional(x[1] < 0.5, k, -k)) * dx
            value = domain.comm.allreduce(fem.assemble_scalar(compiled.form(item)))
            assert value == pytest.approx(k / (power + 1.0), rel=1e-12, abs=0.0)
            assert len([found for found in looked_up if isinstance(found, ufl.Form)]) == last


def test_orders_of_bessel_functions_stay():
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)
    x, dx = ufl.SpatialCoordinate(domain), ufl.dx(metadata={"quadrature_degree": 12})
    item = 2.0 * ufl.bessel_J(1, 0.5 * x[0]) * dx
    value = domain.comm.allreduce(fem.assemble_scalar(compiled.form(item)))
    assert value == pytest.approx(4.0 * (1.0 - jv(0, 0.5)), rel=1e-12)


def test_options_have_codes_of_their_own(looked_up):
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)
    area = 1.0 * ufl.dx(domain)
    for options in ({}, {"form_compiler_options": {"sum_factorization": False}}, {}):
        assert fem.assemble_scalar(compiled.form(area, **options)) >= 0.0
    assert len(looked_up) == 2


def test_expressions_are_looked_up_once_and_keep_their_data(looked_up):
    points = np.array([[0.0, 0.0], [0.25, 0.5]])
    for factor in (2.0, 5.0):
        domain = mesh.create_unit_square(MPI.COMM_WORLD, 3, 3)
        x, c = ufl.SpatialCoordinate(domain), fem.Constant(domain, factor)
        with compiled.remembered():
            made = fem.Expression(c * x[0] + c * x[1], points, comm=domain.comm)
        cells = np.arange(domain.topology.index_map(2).size_local, dtype=np.int32)
        corners = domain.geometry.x[domain.geometry.dofmap[cells]]
        places = np.einsum("pv,cvd->cpd", [[1.0, 0.0, 0.0], [0.25, 0.25, 0.5]], corners)
        expected = factor * (places[..., 0] + places[..., 1])
        assert np.allclose(made.eval(domain, cells).reshape(expected.shape), expected, atol=1e-14)
    assert len([item for item in looked_up if isinstance(item, tuple)]) == 1


def test_a_code_that_one_rank_knows_is_looked_up_by_all(looked_up):
    domain = mesh.create_unit_square(MPI.COMM_SELF, 2, 2)
    if MPI.COMM_WORLD.rank == 0:
        assert fem.assemble_scalar(compiled.form(1.0 * ufl.dx(domain))) == pytest.approx(1.0)
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)
    area = domain.comm.allreduce(fem.assemble_scalar(compiled.form(1.0 * ufl.dx(domain))))
    assert area == pytest.approx(1.0)


def test_a_process_that_was_killed_while_it_compiled_stops_nobody(folder, monkeypatch):
    domain, comm = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2), MPI.COMM_WORLD
    options = {"jit_options": {"cache_dir": str(folder)}}
    if comm.rank == 0:  # what such a process leaves
        (folder / "tmpdir").mkdir()
        (folder / "tmpdir" / "code.so").touch()
    for _ in range(2):
        monkeypatch.setattr(compiled, "_codes", {})
        form = compiled.form(3.0 * ufl.dx(domain), **options)
        assert comm.allreduce(fem.assemble_scalar(form)) == pytest.approx(3.0)
    assert len(list(folder.glob("*.so"))) == 1


@pytest.mark.parametrize(
    "compiler,arguments,message",
    [
        ("", ["-no-such-option"], "C compiler: .* could not compile"),
        ("no-such-compiler", [], "C compiler: there is none of the name 'no-such-compiler'"),
    ],
)
def test_errors_of_a_compiler_are_raised_on_all_ranks(
    folder, monkeypatch, compiler, arguments, message
):
    monkeypatch.setattr(compiled, "_codes", {})
    monkeypatch.setenv("CC", compiler)
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)
    options = {"cache_dir": str(folder)}
    if arguments:
        options["cffi_extra_compile_args"] = arguments
    with pytest.raises(InputError, match=message):
        compiled.form(4.0 * ufl.dx(domain), jit_options=options)
    domain.comm.barrier()
    assert not list(folder.iterdir())


def test_a_folder_that_cannot_be_written_is_named(monkeypatch):
    monkeypatch.setattr(compiled, "_codes", {})
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)
    with pytest.raises(InputError, match=r"folder of compiled code /proc/here: .* XDG_CACHE_HOME"):
        compiled.form(5.0 * ufl.dx(domain), jit_options={"cache_dir": "/proc/here"})


def test_dolfinx_looks_up_by_itself_afterwards():
    before = jit.ffcx_jit
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)
    compiled.form(1.0 * ufl.dx(domain))
    nowhere = ufl.Mesh(domain.ufl_domain().ufl_coordinate_element())
    with pytest.raises(RuntimeError, match="Mesh in the form"):
        compiled.form(1.0 * ufl.dx(nowhere))
    assert jit.ffcx_jit is before
