"""What all tests share: the communicator, a folder that all ranks see, a reference solver."""

import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import numpy.typing as npt
import pytest
import scipy.sparse as sp
from _pytest.config import create_terminal_writer
from hypothesis import settings
from mpi4py import MPI
from scipy.sparse.linalg import splu

from dolfinx_signorini.base import compiled
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.scenes import Scene
from dolfinx_signorini.scenes.files.reading import parse_scene

Array = npt.NDArray[np.float64]

RANKS = MPI.COMM_WORLD.Dup()  # for what the tests themselves tell each other
SETS = 5  # sets of parameters of a test in a run of the suite on one rank
PATIENCE = 120_000  # looks at the other ranks, a millisecond apart
DEMOS = Path(__file__).parents[1] / "demos" / "scenes"

# Without a clock, a random seed or a database all ranks draw the same examples.
settings.register_profile(
    "ranks",
    deadline=None,
    derandomize=True,
    database=None,
    max_examples=25 if MPI.COMM_WORLD.size == 1 else 8,
)
settings.load_profile("ranks")


@pytest.hookimpl(trylast=True)
def pytest_configure(config: pytest.Config) -> None:
    """Let rank 0 alone report."""
    reporter: Any = config.pluginmanager.get_plugin("terminalreporter")
    if MPI.COMM_WORLD.rank and reporter is not None:
        silence = open(os.devnull, "w")  # noqa: SIM115, it stays open until the end
        reporter._tw = create_terminal_writer(config, silence)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Show what fails on a rank at once: other ranks may be waiting for it."""
    if RANKS.size > 1 and report.failed:
        text = f"[rank {RANKS.rank}] {report.nodeid}\n{report.longreprtext}"
        print(text, file=sys.stderr, flush=True)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Wait for the other ranks after each test, asleep: where one rank alone left a test early, the
    others wait in that test for ever, and all ranks end."""
    yield
    all_here = RANKS.Ibarrier()
    for _ in range(PATIENCE):
        if all_here.Test():
            return
        time.sleep(0.001)
    print(f"[rank {RANKS.rank}] alone after {item.nodeid}", file=sys.stderr, flush=True)
    RANKS.Abort(1)


def _is_pure(item: pytest.Item) -> bool:
    """Whether a test of a module that is called pure does not ask for the communicator."""
    names: list[str] = getattr(item, "fixturenames", [])
    return item.get_closest_marker("pure") is not None and "comm" not in names


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add options that run more than some sets of parameters of each test."""
    text = "all tests with all sets of parameters, on several ranks those that have a communicator"
    parser.addoption("--complete", action="store_true", help=text)
    text = "what a run on one rank leaves out"
    parser.addoption("--others", action="store_true", help=text)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out, without `--complete`, what other runs show nearly as well.

    On one rank a test runs with some of its sets of parameters, from the first to the last. On
    several ranks tests without a communicator are left out, and how ranks work together depends
    little on parameters.
    """
    tests: dict[str, list[pytest.Item]] = {}
    for item in items:
        if RANKS.size == 1 or not _is_pure(item):
            tests.setdefault(item.nodeid.split("[")[0], []).append(item)
    chosen = tests.values() if config.getoption("--complete") else _dealt_out(tests)
    kept = {item for same in chosen for item in same}
    if config.getoption("--others"):
        kept = set(items) - kept
    config.hook.pytest_deselected(items=[item for item in items if item not in kept])
    items[:] = [item for item in items if item in kept]


def _dealt_out(tests: dict[str, list[pytest.Item]]) -> list[list[pytest.Item]]:
    """Give each test some of its runs: one on several ranks, a third of the tests on three.

    The name of a test alone decides on how many ranks, whatever other tests are added.
    """
    if RANKS.size == 1:
        return [items if len(items) <= SETS else _spread(items) for items in tests.values()]
    on_three = {name for name in tests if crc32(name.encode()) % 3 == 0}
    if RANKS.size == 2:
        return [items[:1] for name, items in tests.items() if name not in on_three]
    return [items[len(items) // 2 :][:1] for name, items in tests.items() if name in on_three]


def _spread(items: list[pytest.Item]) -> list[pytest.Item]:
    return [items[k * (len(items) - 1) // (SETS - 1)] for k in range(SETS)]


@pytest.fixture(autouse=True)
def _purity(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a test that is called pure fail where it makes a mesh."""
    if _is_pure(request.node):
        monkeypatch.setattr("dolfinx.mesh.Mesh.__init__", _no_mesh)


def _no_mesh(*_: object) -> None:
    raise AssertionError("a pure test makes no mesh")


@pytest.fixture(scope="session", autouse=True)
def _codes_once() -> Iterator[None]:
    """Remember the codes of forms that tests make with DOLFINx alone, which lists the folder of all
    codes for each form."""
    with compiled.remembered():
        yield


@pytest.fixture(scope="session")
def comm() -> MPI.Comm:
    """The communicator of all meshes."""
    return MPI.COMM_WORLD


@pytest.fixture(scope="session")
def demos() -> Path:
    """The folder of the scene files."""
    return DEMOS


@pytest.fixture(scope="session")
def parse(comm: MPI.Comm) -> Callable[[str], Scene]:
    """Make a scene from the text of a scene file."""
    return lambda text: parse_scene(text, DEMOS / "test.toml", comm)


@pytest.fixture
def folder(comm: MPI.Comm) -> Iterator[Path]:
    """An empty folder, the same one on all ranks."""
    path = Path(comm.bcast(tempfile.mkdtemp(prefix="signorini-") if comm.rank == 0 else None))
    yield path
    comm.barrier()
    if comm.rank == 0:
        shutil.rmtree(path, ignore_errors=True)


@pytest.fixture
def serial(comm: MPI.Comm) -> None:
    """Skip a test that starts a process of its own: mpirun does not nest."""
    if comm.size > 1:
        pytest.skip("starts a process of its own")


@pytest.fixture(scope="session")
def solve_with_scipy() -> Callable[[SignoriniProblem], Array]:
    """A solver that shares nothing with the package but the matrix and the load."""
    return _solve_with_scipy


def _solve_with_scipy(problem: SignoriniProblem) -> Array:
    """Return the owned values of the solution: active sets and sparse LU on rank 0."""
    comm = problem.comm
    first = problem.A.getOwnershipRange()[0]
    parts = comm.gather(
        (
            sp.csr_matrix(
                problem.A.getValuesCSR()[::-1], shape=(problem.b.getLocalSize(), problem.unknowns)
            ),
            problem.b.array_r.copy(),
            problem.contact_dofs + first,
            problem.system.obstacle,
        )
    )
    solution = None
    if parts is not None:
        matrices, loads, dofs, obstacles = zip(*parts, strict=True)
        bound = np.full(problem.unknowns, -np.inf)
        bound[np.concatenate(dofs)] = np.concatenate(obstacles)
        solution = _active_sets(sp.vstack(matrices).tocsr(), np.concatenate(loads), bound)
    values: Array = comm.bcast(solution)
    return values[first : first + problem.b.getLocalSize()]


def _active_sets(A: sp.csr_matrix, b: Array, bound: Array) -> Array:
    contact = np.isfinite(bound)
    active, x = contact.copy(), np.where(contact, bound, 0.0)
    for _ in range(50):
        free = ~active
        x[active] = bound[active]
        if free.any():
            rhs = b[free] - A[free][:, active] @ x[active]
            x[free] = splu(A[free][:, free].tocsc()).solve(rhs)
        multiplier = A @ x - b
        defect = np.where(contact, np.minimum(x - bound, multiplier), multiplier)
        if np.abs(defect).max() <= 1e-14 * (abs(A) @ np.abs(x) + np.abs(b)).max():
            return np.maximum(x, bound)
        active = contact & (multiplier > x - np.where(contact, bound, 0.0))
    raise AssertionError("the reference solver does not settle")
