"""(b) The cascade against what else one would use, on the same matrix, in one run.

    python3 -m pip install --target benchmarks/peers --python-version 3.13 \
        --only-binary=:all: --no-deps -r benchmarks/requirements.txt
    PYTHONPATH=benchmarks/peers ./with-dolfinx python3 benchmarks/peers.py [--cells 1024]
    ... benchmarks/peers.py --only cascade "active sets, grid sequence, BoomerAMG"

With --rtol the iterative solvers are asked for another residual: the error of the solution, which
the table has, is hardly felt at 1e-4. With --only the figures of all other solvers stay as an
earlier run with as many cells left them. Every solver runs in a process of its own, which assembles
the paper's problem; the time is that of the solver alone: its set-up, and for the cascade all
coarse levels from their meshes on. It starts cold and is asked for the relative natural residual of
the cascade; what it reached is measured and printed. Those that go through a sequence of grids, see
`grid_sequence.py`, need a number of cells that can be halved down to 8, for example 1024. A solver
that has not finished after --limit seconds is stopped, and the table says so. Whoever needs less
than a fifth of the limit runs --repeats times more, and the table shows the median of these runs:
the first one also pays for memory that the process gets from the machine.
"""

import argparse
import json
import signal
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import scipy.sparse as sp
from common import RESULTS, child, contact_solve, paper, parser, report, write_json
from grid_sequence import GRID_SEQUENCES, can_be_halved
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini import (
    SignoriniProblem,
    christof_haubner,
    error_norms,
    friedrichs_keller,
)
from dolfinx_signorini.problem.signorini import DEFAULT_RTOL
from dolfinx_signorini.solvers.linear.options import options_set
from dolfinx_signorini.solvers.residual import NaturalResidual
from dolfinx_signorini.studies.paper.solution import paper_problem

NORM = "L4"  # of the error beside the exact solution
Peer = Callable[[SignoriniProblem, float], "np.ndarray[Any, Any]"]


def cascade(problem: SignoriniProblem, rtol: float | None) -> Any:
    """The cascade of this package, with all its coarse levels."""
    n = round(np.sqrt(problem.unknowns)) - 1
    contact_solve(problem, partial(paper, problem.comm), n, rtol)
    return problem.u.x.array


def tao(method: str) -> Peer:
    """A TAO type from zero."""
    return lambda problem, rtol: problem.solve(method, rtol=rtol, warm_start=False).x.array


def snes(method: str, ksp: str = "gmres", options: Mapping[str, Any] | None = None) -> Peer:
    """A variational inequality solver of SNES with BoomerAMG; GMRES is PETSc's default.

    Args:
        method: The type of SNES.
        ksp: The type of KSP.
        options: Those of the preconditioner; BoomerAMG as PETSc sets it up by default.
    """

    def solve(problem: SignoriniProblem, rtol: float) -> Any:
        A, b, x = problem.A, problem.b, problem.system.start()
        lower, upper = x.duplicate(), x.duplicate()
        lower.set(PETSc.NINFINITY)
        lower.array_w[problem.contact_dofs] = problem.obstacle
        upper.set(PETSc.INFINITY)

        def residual(snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
            A.mult(x, f)
            f.axpy(-1.0, b)

        snes = PETSc.SNES().create(problem.comm)
        snes.setType(method)
        snes.setFunction(residual, b.duplicate())
        # vinewtonssls changes the matrix in place
        snes.setJacobian(lambda snes, x, J, P: A.copy(J), A.copy())
        snes.setVariableBounds(lower, upper)
        atol = 0.5 * rtol * NaturalResidual(problem.system).scale
        snes.setTolerances(rtol=0.0, stol=0.0, atol=atol, max_it=500)
        snes.getKSP().setType(ksp)
        snes.getKSP().setOptionsPrefix("peer_")
        with options_set("peer_", {"pc_type": "hypre"} | dict(options or {})):
            snes.getKSP().setFromOptions()
            snes.solve(None, x)
        return x.array_r.copy()

    return solve


def _quadratic_program(problem: SignoriniProblem) -> tuple[sp.csc_matrix, Any, Any]:
    """Return A, b and the lower bounds (-inf where there is none)."""
    indptr, indices, data = problem.A.getValuesCSR()
    lower = np.full(problem.unknowns, -np.inf)
    lower[problem.contact_dofs] = problem.obstacle
    return sp.csr_matrix((data, indices, indptr)).tocsc(), problem.b.array_r, lower


def piqp(problem: SignoriniProblem, rtol: float) -> Any:
    """PIQP: proximal interior point."""
    import piqp

    A, b, lower = _quadratic_program(problem)
    solver = piqp.SparseSolver()
    solver.settings.eps_abs = solver.settings.eps_duality_gap_abs = 1e-12
    solver.settings.eps_rel = solver.settings.eps_duality_gap_rel = 1e-12
    solver.setup(P=A, c=-b, x_l=lower)
    solver.solve()
    return np.array(solver.result.x)


def clarabel(problem: SignoriniProblem, rtol: float) -> Any:
    """Clarabel: interior point."""
    import clarabel

    A, b, lower = _quadratic_program(problem)
    bounded = np.flatnonzero(np.isfinite(lower))
    cone = sp.csc_matrix(
        (-np.ones(len(bounded)), (np.arange(len(bounded)), bounded)), (len(bounded), len(b))
    )
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = 1e-12
    solver = clarabel.DefaultSolver(
        sp.triu(A).tocsc(),
        -b,
        cone,
        -lower[bounded],
        [clarabel.NonnegativeConeT(len(bounded))],
        settings,
    )
    return np.array(solver.solve().x)


def highs(problem: SignoriniProblem, rtol: float) -> Any:
    """HiGHS: active set on the quadratic program."""
    import highspy

    A, b, lower = _quadratic_program(problem)
    half = sp.tril(A).tocsc()
    model = highspy.HighsModel()
    lp, hessian, n = model.lp_, model.hessian_, len(b)
    lp.num_col_, lp.num_row_ = n, 0
    lp.col_cost_, lp.col_lower_, lp.col_upper_ = -b, lower, np.full(n, highspy.kHighsInf)
    lp.a_matrix_.start_ = np.zeros(n + 1, dtype=np.int32)
    hessian.dim_, hessian.format_ = n, highspy.HessianFormat.kTriangular
    hessian.start_, hessian.index_, hessian.value_ = half.indptr, half.indices, half.data
    solver = highspy.Highs()
    solver.setOptionValue("output_flag", False)
    solver.passModel(model)
    solver.run()
    return np.array(solver.getSolution().col_value)


def scikit_fem(problem: SignoriniProblem, rtol: float) -> Any:
    """A primal-dual active set loop with scikit-fem's condense and SciPy's sparse LU."""
    import skfem

    A, b, lower = _quadratic_program(problem)
    A, diagonal = A.tocsr(), A.diagonal()
    contact = np.flatnonzero(np.isfinite(lower))
    x, active = np.where(np.isfinite(lower), lower, 0.0), contact
    for _ in range(100):
        x = skfem.solve(*skfem.condense(A, b, x=np.where(np.isfinite(lower), lower, 0.0), D=active))
        force = (A @ x - b)[contact]
        gap = diagonal[contact] * (x - lower)[contact]
        if np.linalg.norm(np.minimum(force, gap)) <= rtol * np.linalg.norm(b):
            break
        active = contact[force > gap]
    return x


PEERS: dict[str, Peer] = {
    "cascade": cascade,
    "cascade, default stop": lambda problem, rtol: cascade(problem, None),
    **GRID_SEQUENCES,
    "TAO bntr": tao("bntr"),
    "SNES vinewtonrsls": snes("vinewtonrsls"),
    "SNES vinewtonrsls, CG": snes("vinewtonrsls", "cg"),
    "SNES vinewtonssls": snes("vinewtonssls"),
    "scikit-fem, SciPy": scikit_fem,
    "Clarabel": clarabel,
    "PIQP": piqp,
    "TAO bqnls": tao("bqnls"),
    "TAO bncg": tao("bncg"),
    "HiGHS": highs,
}


def measure(name: str, n: int, rtol: float, limit: float, repeats: int) -> dict[str, Any]:
    """Run one peer in this process, which the alarm clock ends after the limit."""
    PEERS[name](paper(MPI.COMM_SELF, 16), rtol)  # compiles the forms
    exact = christof_haubner(friedrichs_keller(MPI.COMM_SELF, n))
    problem = paper_problem(exact)
    seconds: list[float] = []
    while len(seconds) <= repeats:
        signal.setitimer(signal.ITIMER_REAL, limit)
        start = time.perf_counter()
        values = PEERS[name](problem, rtol)
        seconds.append(time.perf_counter() - start)
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        if seconds[0] > limit / 5:
            break
    x = problem.system.start(values)
    problem.u.x.array[:] = x.array_r
    return {
        "first": seconds[0],
        "seconds": seconds[1:] or seconds,
        "residual": NaturalResidual(problem.system)(x),
        "error": error_norms(problem.u, exact, [NORM])[NORM],
    }


def suits(name: str, n: int) -> bool:
    """Return whether a peer can solve with n cells per side."""
    return name not in GRID_SEQUENCES or can_be_halved(n)


def earlier(n: int, rtol: float) -> dict[str, dict[str, Any] | None]:
    """Return the runs with n cells per side and a tolerance in the results folder."""
    file = RESULTS / "peers.json"
    found = json.loads(file.read_text()) if file.exists() else {}
    return dict(found["runs"]) if (found.get("cells"), found.get("rtol")) == (n, rtol) else {}


def main() -> None:
    """Measure all peers and print."""
    options = parser(__doc__, 1024)
    options.add_argument("--limit", type=float, default=600.0, help="seconds for one solve")
    options.add_argument("--only", nargs="+", choices=list(PEERS))
    options.add_argument("--rtol", type=float, default=DEFAULT_RTOL, help="natural residual")
    options.add_argument("--measure", choices=list(PEERS), help=argparse.SUPPRESS)
    args = options.parse_args()
    if args.measure:
        run = measure(args.measure, args.cells, args.rtol, args.limit, args.repeats)
        print(json.dumps(run))
        return
    script = str(Path(__file__))
    settings = [f"--{key}={getattr(args, key)}" for key in ("cells", "rtol", "limit", "repeats")]
    results = earlier(args.cells, args.rtol) if args.only else {}
    for name in args.only or [name for name in PEERS if suits(name, args.cells)]:
        results[name] = child(script, "--measure", name, *settings)
        print(f"{name}: {results[name]}", flush=True)
        content = {key: getattr(args, key) for key in ("cells", "rtol", "limit")}
        content["runs"] = results
        write_json(MPI.COMM_WORLD, "peers", content)  # what is known when a later run is stopped
    own = median(results["cascade"]["seconds"]) if results.get("cascade") else 1.0
    rows = []
    for name, run in results.items():
        if run:
            seconds, residual = median(run["seconds"]), run["residual"]
            reached = f"{residual:.1e}" + (" FAILED" if residual > 1e-2 else "")
            error = f"{run['error']:.4e}"
            rows.append((name, f"{seconds:.3g}", f"{seconds / own:.3g}", reached, error))
        else:
            over = f"> {args.limit / own:.3g}"
            rows.append((name, f"> {args.limit:g}", over, "did not finish", ""))
    title = f"paper's problem, N = {args.cells}, to a natural residual of {args.rtol:g}"
    columns = ("solver", "seconds", "/ cascade", "residual", f"{NORM} error")
    report(MPI.COMM_WORLD, "peers", title, columns, rows, content)


if __name__ == "__main__":
    main()
