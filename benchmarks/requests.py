"""Requested accuracies against the truth, on scenes by chance that the program is not told.

    python3 benchmarks/requests.py --seed 1 --requests 500           # the table, in some hours
    python3 benchmarks/requests.py --seed 1 --requests 500 --jobs 2
    python3 benchmarks/requests.py --seed 1 --family corner          # a part of the same requests
    python3 benchmarks/requests.py --seed 1 --only 17                # one request, with its scene
    python3 benchmarks/requests.py --seed 1 --table                  # the table of a run so far
    python3 benchmarks/requests.py --check                           # orders on uniform meshes

Three requests are made of each scene: a norm or a functional, and an accuracy between 1e-2 and
1e-6 of that of the solution, looser where singularities, fronts or space ask for it. The rows are
kept in a file of JSON lines, to which a later call of the same seed adds those that are missing;
`--rows` names another file, for example for another version of the program. Meshes may have as many
unknowns as the loop allows by default, and a request that takes more seconds of the processor than
`--seconds` counts as not reached. What the first mesh reaches tells nothing of where the
loop aims, and is left out of the median of true over asked. The exit code is 1 if a solution
misses its accuracy by more than 5 %, or another goal is missed: a claim below the truth, or no
solution, in 2 % of the requests, and a median of true over asked between 0.3 and 0.8 in each norm.
"""

import argparse
import json
import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from common import RESULTS
from dolfinx import fem, mesh
from mpi4py import MPI
from request_scenes import FAMILIES, UFL, Rng, Trial, posed
from request_truth import Functional, Truth

from dolfinx_signorini import (
    InputError,
    NotConvergedError,
    SidedMesh,
    SignoriniProblem,
    bernstein_space,
    dirichlet,
    solve_adaptively,
    solve_scene,
)
from dolfinx_signorini.base.tables import markdown_table
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.norms.names import Norm, parse_norm
from dolfinx_signorini.norms.orders import eoc
from dolfinx_signorini.scenes.files.reading import parse_scene

COMM = MPI.COMM_SELF
PER_SCENE = 3  # requests of one scene, which share compiled forms
# Decimal digits asked for, relative to the norm of the solution, in the plane and in space.
DIGITS = {
    "L1": ((2.0, 6.0), (1.3, 3.0)),
    "L2": ((2.0, 6.0), (1.3, 3.0)),
    "L4": ((2.0, 6.0), (1.3, 3.0)),
    "L16": ((2.0, 6.0), (1.3, 2.5)),
    "Linf": ((2.0, 5.5), (1.0, 2.5)),
    "H1": ((1.5, 4.0), (0.7, 1.7)),
    "W1_4": ((1.0, 3.0), (0.5, 1.2)),
    "W1_inf": ((0.7, 2.5), (0.3, 1.0)),
    "L2_boundary": ((2.0, 6.0), (1.3, 3.0)),
    "Linf_boundary": ((2.0, 5.5), (1.0, 2.5)),
    "H1_2_boundary": ((1.5, 4.5), (0.7, 2.0)),
    "functional": ((2.0, 6.0), (1.3, 3.5)),
}
ALONG_CURVES = {"layer", "front", "jump"}  # where many cells are needed for a digit
MOST_ALONG_CURVES = 4.5
# The smallest cells are about 1e-8 of the domain: digits at most for each order of convergence.
PER_ORDER = 8.0
# On the boundary and in functionals the solution may be 1e-20: no less than this share of the norm
# over the domain is what accuracies are relative to.
LEAST = 0.01
LOWEST = 2  # degree, with which each loop begins
ABOVE = 1.05  # true over asked, from where on a request is missed
OUTCOMES = ("reached", "not reached", "refused", "crashed")


class TimeUpError(BaseException):
    """The seconds of a request are over; no error that the program could handle."""


@dataclass(frozen=True)
class Request:
    """A request: what is asked of which scene."""

    seed: int
    index: int

    @property
    def scene(self) -> int:
        return self.index // PER_SCENE

    @property
    def family(self) -> str:
        return list(FAMILIES)[self.scene % len(FAMILIES)]

    def _rng(self) -> Rng:
        return np.random.default_rng([self.seed, self.scene])

    @cached_property
    def trial(self) -> Trial:
        rng = self._rng()
        return posed(rng, FAMILIES[self.family](rng))

    @cached_property
    def asked(self) -> tuple[str, float, Functional | None]:
        """The norm, the digits, and the functional."""
        rng = np.random.default_rng([self.seed, self.scene, 1])
        names = [n for n in DIGITS if _rate(self.trial, n) > 0.1]
        chosen = rng.permutation(len(names))[:PER_SCENE]
        drawn, functionals = rng.random(PER_SCENE), _functionals(rng, self.trial)
        k = self.index % PER_SCENE
        name = names[chosen[k]]
        low, high = DIGITS[name][self.trial.domain.dimension - 2]
        if self.family in ALONG_CURVES:
            high = min(high, MOST_ALONG_CURVES)
        high = max(low / 2.0, min(high, PER_ORDER * _rate(self.trial, name)))
        digits = min(low, high) + drawn[k] * (high - min(low, high))
        wanted = functionals[int(rng.integers(len(functionals)))] if name == "functional" else None
        return name, float(digits), wanted

    def command(self) -> str:
        return f"python3 benchmarks/requests.py --seed {self.seed} --only {self.index}"


def _rate(trial: Trial, name: str) -> float:
    """The order in which small cells at the worst point approximate u."""
    if name == "functional":
        return trial.exponent
    norm = parse_norm(name)
    if norm.derivatives == 0.5:
        norm = Norm(1.0, 2.0, boundary=True)
    return trial.exponent - norm.derivatives + (trial.codimension - norm.boundary) / norm.p


def _functionals(rng: Rng, trial: Trial) -> list[Functional]:
    """The mean, an average around a point, and that of a side, and the flux through a side."""
    place = np.mean([c.mean(axis=0) for c in trial.domain.sides.values()], axis=0)
    place = place + rng.uniform(-0.2, 0.2, len(place))
    width = float(rng.uniform(0.05, 0.2))
    distance = " + ".join(f"({c} - {p:.6f})**2" for c, p in zip("xyz", place, strict=False))
    weight = f"exp(-({distance})/{width**2:.6g})"
    found = [Functional("mean"), Functional("average around a point", weight)]
    side = trial.contact
    if not side.isdigit():
        found.append(Functional(f"integral over {side}", side=side))
        if trial.exponent > 1.0:
            found.append(Functional(f"flux through {side}", side=side, flux=True))
    return found


def functional_form(trial: Trial, wanted: Functional, v: Any) -> ufl.Form:
    """The UFL form of a functional."""
    domain = ufl.domain.extract_unique_domain(v)
    at = ufl.SpatialCoordinate(domain)
    known = dict(UFL) | dict(zip("xyz", at, strict=False))
    weight = eval(wanted.weight, {}, known)
    value = v
    if wanted.flux:
        (K,) = trial.data(UFL, at, "K")
        value = K * ufl.inner(ufl.grad(v), ufl.FacetNormal(domain))
    if wanted.side is None:
        return weight * value * ufl.Measure("dx", domain)
    normal = trial.domain.normal(wanted.side)
    start = trial.domain.sides[wanted.side][0]
    off = sum(float(n) * (at[k] - float(start[k])) for k, n in enumerate(normal) if n)
    on = ufl.conditional(ufl.lt(abs(off), 1e-9), 1.0, 0.0)
    return on * weight * value * ufl.Measure("ds", domain)


def pose(trial: Trial, degree: int, sided: SidedMesh) -> SignoriniProblem:
    """Pose a trial by forms in UFL."""
    domain, data = sided.mesh, trial.data
    d = domain.topology.dim
    space, at = bernstein_space(domain, degree), ufl.SpatialCoordinate(domain)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)

    def given(name: str) -> Any:
        (value,) = data(UFL, at, name)
        value = ufl.as_ufl(value)
        return value if ufl.domain.extract_domains(value) else fem.Constant(domain, float(value))

    dx = ufl.Measure("dx", domain)
    marks = [(k, sided.facets((s,))) for k, s in enumerate(trial.domain.sides)]
    facets = np.concatenate([f for _, f in marks])
    values = np.concatenate([np.full(len(f), k) for k, f in marks])
    order = np.argsort(facets)
    tags = mesh.meshtags(domain, d - 1, facets[order], values[order].astype(np.int32))
    ds = {
        s: ufl.Measure("ds", domain, subdomain_data=tags)(k)
        for k, s in enumerate(trial.domain.sides)
    }
    a = given("K") * ufl.inner(ufl.grad(u), ufl.grad(v)) * dx
    if trial.reaction != 0:
        a += given("c") * u * v * dx
    L = given("load") * v * dx
    for side in trial.neumann:
        L += given(f"flux_{side}") * v * ds[side]
    for side in trial.robin:
        a += given(f"robin_{side}") * u * v * ds[side]
        L += given(f"given_{side}") * v * ds[side]
    if trial.pressure is not None:
        L += given("h") * v * ds[trial.contact]
    bcs = []
    if trial.dirichlet:
        held = sided.facets(trial.dirichlet)
        bcs = [dirichlet(space, held, lambda p: data.arrays(p[:d].T, "u")[0])]
    contact = sided.facets((trial.contact,))
    (g,) = data(UFL, at, "g")
    bound = "upper" if trial.upper else "lower"
    return SignoriniProblem(a, L, contact=contact, obstacle=g, bound=bound, bcs=bcs)


def coarse_mesh(trial: Trial) -> SidedMesh:
    """The first mesh of a trial."""
    text = f'degree = 2\n[domain]\n{trial.domain.table}\n[contact]\nsides = "{trial.contact}"\n'
    scene = parse_scene(text + "[equation]\nreaction = 1\n", Path("domain.toml"), COMM)
    return scene.domain.first().make(COMM)


def outcome(request: Request, seconds: float, verbose: bool = False) -> dict[str, Any]:
    """Make a request, and return its row."""
    trial, (name, digits, wanted) = request.trial, request.asked
    coarse = coarse_mesh(trial)
    size = _size(Truth(trial, coarse.mesh), name, wanted)
    accuracy = float(f"{size * 10.0**-digits:.3g}")
    told = trial.told and wanted is None
    row: dict[str, Any] = {
        "index": request.index,
        "family": request.family,
        "scene": trial.what,
        "told": "file" if told else "UFL",
        "norm": name,
        "what": wanted.name if wanted else name,
        "asked": accuracy,
        "digits": round(digits, 2),
    }
    if verbose:
        print(trial.text(), json.dumps(row, indent=1), file=sys.stderr)
    steps: list[Any] = []

    def on_step(step: Any) -> None:
        steps.append(step)
        if verbose:
            print(step, file=sys.stderr, flush=True)

    ended: list[bool] = []

    def up(*args: Any) -> None:
        ended.append(True)
        raise TimeUpError

    before = signal.signal(signal.SIGPROF, up)
    began = time.process_time()
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        found, u = solved(trial, told, name, wanted, accuracy, coarse, on_step)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        row["seconds"] = round(time.process_time() - began, 2)
        # A loop that takes another degree begins again on the first mesh.
        degree = found.problem.space.element.basix_element.degree
        row |= {"steps": len(steps), "unknowns": steps[-1].unknowns}
        row |= {"refinements": len(steps) - 1 - (degree > LOWEST)}
        row |= {"outcome": OUTCOMES[not found.reached], "estimate": found.estimate}
        row |= {"reason": found.stopped, "notes": list(found.notes)}
        truth = Truth(trial, u.function_space.mesh, u)
        row["true"] = truth.functional(wanted) if wanted else truth.norm(name)
        found.problem.destroy()
    except (Exception, TimeUpError) as error:
        known = isinstance(error, InputError | NotConvergedError)
        row |= {"outcome": "refused" if known else "crashed", "reason": f"{error!r}"}
        if ended:  # PETSc turns what is raised inside of its calls into errors of its own
            row |= {"outcome": "not reached", "reason": f"{seconds:g} s are over"}
        row["seconds"] = round(time.process_time() - began, 2)
        if steps:
            row |= {"unknowns": steps[-1].unknowns, "claimed so far": steps[-1].estimate}
        if verbose and not (known or ended):
            raise
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
    return row


def _size(truth: Truth, name: str, wanted: Functional | None) -> float:
    """The norm of the solution, or the size of a functional of it; see `LEAST`."""
    if wanted is not None:
        sizes = truth.functional(wanted, "weight") * truth.norm("Linf")
        signed, absolute = truth.functional(wanted), truth.functional(wanted, "sizes")
        return max(signed, 0.1 * absolute, LEAST * sizes)
    inside = {"H1_2_boundary": "L2"}.get(name, name.removesuffix("_boundary"))
    return max(truth.norm(name), LEAST * truth.norm(inside) if inside != name else 0.0)


def solved(
    trial: Trial,
    told: bool,
    name: str,
    wanted: Functional | None,
    accuracy: float,
    coarse: SidedMesh,
    on_step: Callable[[Any], None],
) -> tuple[Any, fem.Function]:
    """Return what the loop finds for a trial, and its solution, see `outcome`."""
    common = {"accuracy": accuracy, "on_step": on_step}
    if told:
        scene = parse_scene(trial.text(), Path("trial.toml"), COMM)
        result = solve_scene(scene, COMM, norm=name, **common)  # type: ignore[arg-type]
        return result.found, result.u
    degrees = range(2, 5 if trial.domain.dimension == 2 else 3)
    poses = {degree: partial(pose, trial, degree) for degree in degrees}
    norm: Any = partial(functional_form, trial, wanted) if wanted else name
    found = solve_adaptively(poses, coarse, norm=norm, **common)  # type: ignore[arg-type]
    return found, found.problem.u


def check(seed: int, scenes: Iterable[int]) -> None:
    """Print L2 errors and orders on uniform meshes: the data belong to the solution."""
    rows = []
    for scene in scenes:
        request = Request(seed, PER_SCENE * scene)
        trial, errors = request.trial, []
        sided = coarse_mesh(trial)
        plane = trial.domain.dimension == 2
        for _ in range(5 if plane else 3):
            problem = pose(trial, 1, sided)
            problem.solve()
            errors.append(Truth(trial, sided.mesh, problem.u).norm("L2"))
            problem.destroy()
            sided = refined(sided).sided
        size = Truth(trial, sided.mesh).norm("L2")
        orders = eoc([0.5**k for k in range(len(errors))], errors)
        cells = [f"{e / size:.1e}" for e in errors], [f"{o:.2f}" for o in orders]
        rows.append([scene, request.family, trial.what, "  ".join(cells[0]), "  ".join(cells[1])])
        print(*rows[-1], sep="  ", flush=True)


COLUMNS = (
    "", "requests", "above", "by more than 5 %", "worst", "claim below truth", "refused",
    "not reached", "at once", "median true / asked", "median s",
)  # fmt: skip


def _line(name: str, rows: list[dict[str, Any]]) -> list[str]:
    reached = [r for r in rows if r["outcome"] == "reached"]
    shares = [r["true"] / r["asked"] for r in reached]
    adapted = [r["true"] / r["asked"] for r in reached if r["refinements"] > 0]
    below = sum(r["estimate"] < r["true"] for r in rows if "true" in r)
    count = {o: sum(r["outcome"] == o for r in rows) for o in OUTCOMES}
    numbers = [
        len(rows), sum(s > 1.0 for s in shares), sum(s > ABOVE for s in shares),
        f"{max(shares, default=math.nan):.2f}", below, count["refused"] + count["crashed"],
        count["not reached"], len(reached) - len(adapted),
        f"{np.median(adapted) if adapted else math.nan:.3f}",
        f"{np.median([r.get('seconds', math.nan) for r in rows]):.1f}",
    ]  # fmt: skip
    return [name, *map(str, numbers)]


def table(seed: int, rows: list[dict[str, Any]]) -> bool:
    """Print the table and all that is wrong, and return whether the goals are met."""
    rows = sorted(rows, key=lambda row: row["index"])
    for key, order in (("family", FAMILIES), ("norm", DIGITS)):
        lines = [_line(k, [r for r in rows if r[key] == k]) for k in order]
        lines = [line for line in lines if line[1] != "0"]
        print(markdown_table((key, *COLUMNS[1:]), [*lines, _line("all", rows)]))
    wrong = [
        (label, r)
        for label, test in (
            ("above", lambda r: r["outcome"] == "reached" and r["true"] > r["asked"]),
            ("claim below truth", lambda r: "true" in r and r["true"] > r["estimate"]),
            ("no solution", lambda r: r["outcome"] != "reached"),
        )
        for r in rows
        if test(r)
    ]
    for label in dict.fromkeys(label for label, _ in wrong):
        print(f"\n{label}:")
        for r in (r for known, r in wrong if known == label):
            share = f"true {r['true'] / r['asked']:.2f} of asked, " if "true" in r else ""
            claim = f"{r['estimate'] / r['asked']:.2f} claimed, " if "estimate" in r else ""
            print(
                f"  --seed {seed} --only {r['index']}: {r['family']} ({r['scene']}), {r['what']} "
                f"{r['asked']:.2g}: {share}{claim}{r.get('unknowns', 0)} unknowns; {r['reason']}"
            )
    goals = _line("all", rows)
    most = 0.02 * len(rows)
    medians = [float(_line(k, [r for r in rows if r["norm"] == k])[9]) for k in DIGITS]
    medians = [m for m in medians if not math.isnan(m)]
    return (
        goals[3] == "0"
        and int(goals[5]) <= most
        and int(goals[6]) + int(goals[7]) <= most
        and all(0.3 <= m <= 0.8 for m in medians)
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--requests", type=int, default=500)
    parser.add_argument("--family", choices=FAMILIES, help="its requests alone")
    parser.add_argument("--only", type=int, metavar="INDEX", help="one request")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--seconds", type=float, default=60.0, help="of the processor, a request")
    parser.add_argument("--rows", type=Path, help="the file of JSON lines")
    parser.add_argument("--table", action="store_true", help="print the table of the rows so far")
    parser.add_argument("--check", action="store_true", help="errors on uniform meshes instead")
    parser.add_argument("--share", type=int, default=0, help=argparse.SUPPRESS)  # of the jobs
    args = parser.parse_args()
    if args.only is not None:
        print(json.dumps(outcome(Request(args.seed, args.only), args.seconds, True), indent=1))
        return
    wanted = [Request(args.seed, k) for k in range(args.requests)]
    wanted = [r for r in wanted if args.family in (None, r.family)]
    if args.check:
        check(args.seed, dict.fromkeys(r.scene for r in wanted))
        return
    path = args.rows or RESULTS / f"requests_{args.seed}.jsonl"
    path.parent.mkdir(exist_ok=True)
    if args.jobs > 1 and not args.share and not args.table:
        again = [sys.executable, *sys.argv]
        others = [subprocess.Popen([*again, "--share", str(k)]) for k in range(1, args.jobs)]
    else:
        others = []
    kept = _rows(path)
    if not args.table:
        for r in wanted:
            if r.index not in kept and r.scene % args.jobs == args.share:
                row = outcome(r, args.seconds)
                with path.open("a") as file:
                    file.write(json.dumps(row) + "\n")
                print(json.dumps(row), file=sys.stderr, flush=True)
    for other in others:
        other.wait()
    if args.share:
        return
    indices = {r.index for r in wanted}
    rows = [row for index, row in _rows(path).items() if index in indices]
    sys.exit(not table(args.seed, rows))


def _rows(path: Path) -> dict[int, dict[str, Any]]:
    """The rows of a file by their indices."""
    lines = path.read_text().splitlines() if path.exists() else []
    return {row["index"]: row for row in map(json.loads, lines)}


if __name__ == "__main__":
    main()
