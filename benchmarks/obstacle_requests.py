"""Requested accuracies against the truth, for obstacles in the domain that the program is not told.

    python3 benchmarks/obstacle_requests.py --seed 1 --requests 60       # the table
    python3 benchmarks/obstacle_requests.py --seed 1 --only 17           # one request

Solutions by chance on the square (-1, 1)^2: above or below a wavy obstacle that they touch in a
disc, over a hemisphere, between two obstacles, and over an obstacle in the domain with another one
on the boundary, where contact ends, too. Asked for are norms. Each truth is found by NumPy, at
points that the program does not use. The exit code is 1 if a true error is above what was asked
for.
"""

import argparse
import json
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from elastic_requests import CHUNK, COLUMNS, parts_of_triangle, summary
from mpi4py import MPI

import dolfinx_signorini as ds
from dolfinx_signorini.base.tables import markdown_table
from dolfinx_signorini.meshes.sided_meshes import facet_cells

Array = np.ndarray
COMM = MPI.COMM_WORLD
# What is asked for, with the decimal digits.
DIGITS = {
    "L2": (1.5, 3.5), "L4": (1.5, 3.5), "Linf": (1.5, 3.0), "H1": (0.5, 1.7), "W1_inf": (0.2, 1.0),
}  # fmt: skip
MORE = 0.6  # digits for each degree: what takes some steps, and not too many unknowns
# The hemisphere: Bueler, PETSc for Partial Differential Equations, SIAM (2021), Chapter 12.
RADIUS, HEIGHT, TANGENT = 0.697965148223372, 0.680259411891713, 0.9


@dataclass(frozen=True)
class Disc:
    """A solution that is max(s, 0)^2 above sin(k.x), with s = |x - c|^2 - R^2."""

    centre: Array
    radius: float
    wave: Array
    height: float

    def parts(self, np: Any, x: Any) -> tuple[Any, Any]:
        """The square of the distance beyond the disc, and the obstacle."""
        s = (x[0] - self.centre[0]) ** 2 + (x[1] - self.centre[1]) ** 2 - self.radius**2
        return s, self.height * np.sin(self.wave[0] * x[0] + self.wave[1] * x[1])

    def u(self, x: Array) -> Array:
        s, floor = self.parts(np, x)
        return np.maximum(s, 0.0) ** 2 + floor

    def gradient(self, x: Array) -> Array:
        s, _ = self.parts(np, x)
        slope = self.height * np.cos(self.wave[0] * x[0] + self.wave[1] * x[1])
        away = np.stack([x[0] - self.centre[0], x[1] - self.centre[1]])
        return 4.0 * np.maximum(s, 0.0) * away + np.multiply.outer(self.wave, slope)

    def load(self, x: Any) -> Any:
        (s, floor), R = self.parts(ufl, x), self.radius
        bent = float(self.wave @ self.wave) * floor
        inside = -8.0 * R**2 * (1.0 - s)
        return bent + ufl.conditional(s < 0.0, inside, -8.0 * (2.0 * s + R**2))

    def bounds(self, x: Any) -> dict[str, Any]:
        return {"lower": self.parts(ufl, x)[1]}


@dataclass(frozen=True)
class Rim(Disc):
    """A disc, and r^{3/2} cos(3t/2) around a point of the lower side: the distance from a rim."""

    place: float = 0.0

    def polar(self, np: Any, x: Any, atan2: Callable[..., Any]) -> tuple[Any, Any]:
        a, b = x[0] - self.place, x[1] + 1.0
        return np.sqrt(a**2 + b**2), atan2(b, a)

    def singular(self, np: Any, x: Any, atan2: Callable[..., Any]) -> Any:
        r, t = self.polar(np, x, atan2)
        return r**1.5 * np.cos(1.5 * t)

    def u(self, x: Array) -> Array:
        return super().u(x) + self.singular(np, x, np.arctan2)

    def gradient(self, x: Array) -> Array:
        r, t = self.polar(np, x, np.arctan2)
        own = 1.5 * np.sqrt(r) * np.stack([np.cos(0.5 * t), -np.sin(0.5 * t)])
        return super().gradient(x) + own

    def bounds(self, x: Any) -> dict[str, Any]:
        s, floor = self.parts(ufl, x)
        above = floor + self.singular(ufl, x, ufl.atan2)
        return {"lower": above, "obstacle": s**2 + floor}

    def flux(self, x: Any) -> Any:
        """What the flux on the lower side has beside the contact pressure."""
        s, _ = self.parts(ufl, x)
        slope = self.height * ufl.cos(self.wave[0] * x[0] + self.wave[1] * x[1])
        return -4.0 * s * (x[1] - self.centre[1]) - self.wave[1] * slope


@dataclass(frozen=True)
class Ball:
    """A hemisphere of a radius, with its tangent cone; outside of contact a logarithm."""

    centre: Array
    size: float

    def distance(self, np: Any, x: Any) -> Any:
        a, b = x[0] - self.centre[0], x[1] - self.centre[1]
        return np.sqrt(a**2 + b**2) / self.size

    def u(self, x: Array) -> Array:
        r = np.maximum(self.distance(np, x), 1e-12)
        top = np.sqrt(np.maximum(1.0 - r**2, 0.0))
        return np.where(r < RADIUS, top, HEIGHT * np.log(2.0 / r))

    def gradient(self, x: Array) -> Array:
        r = np.maximum(self.distance(np, x), 1e-12)
        slope = np.where(r < RADIUS, -r / np.sqrt(np.maximum(1.0 - r**2, 0.1)), -HEIGHT / r)
        away = np.stack([x[0] - self.centre[0], x[1] - self.centre[1]])
        return slope * away / (r * self.size**2)

    def load(self, x: Any) -> Any:
        return 0.0 * x[0]

    def bounds(self, x: Any) -> dict[str, Any]:
        r, h = self.distance(ufl, x), math.sqrt(1.0 - TANGENT**2)
        sphere = ufl.sqrt(abs(1.0 - r**2))
        return {"lower": ufl.conditional(r < TANGENT, sphere, h - TANGENT / h * (r - TANGENT))}


@dataclass(frozen=True)
class Band:
    """A cubic of the distance s from a line between -h and h, with the load K s."""

    normal: Array
    offset: float
    strength: float
    width: float

    @property
    def height(self) -> float:
        return self.strength * self.width**3 / 3.0

    def along(self, x: Any) -> Any:
        return self.normal[0] * x[0] + self.normal[1] * x[1] - self.offset

    def u(self, x: Array) -> Array:
        s = np.clip(self.along(x), -self.width, self.width)
        return self.strength * (0.5 * self.width**2 * s - s**3 / 6.0)

    def gradient(self, x: Array) -> Array:
        s = np.clip(self.along(x), -self.width, self.width)
        return np.multiply.outer(self.normal, 0.5 * self.strength * (self.width**2 - s**2))

    def load(self, x: Any) -> Any:
        return self.strength * self.along(x)

    def bounds(self, x: Any) -> dict[str, Any]:
        return {"lower": -self.height, "upper": self.height}


Case = Disc | Rim | Ball | Band
Rng = np.random.Generator


def case_of(rng: Rng) -> Case:
    centre, kind = rng.uniform(-0.3, 0.3, 2), rng.choice(["disc", "rim", "ball", "band"])
    if kind == "ball":
        return Ball(centre, rng.uniform(0.4, 0.6))
    if kind == "band":
        angle, width = rng.uniform(0.0, math.pi), rng.uniform(0.2, 0.6)
        normal = np.array([math.cos(angle), math.sin(angle)])
        return Band(normal, rng.uniform(-0.3, 0.3), 3.0 / width**3 * rng.uniform(0.2, 1.0), width)
    shape = rng.uniform(0.2, 0.6), rng.uniform(-2.5, 2.5, 2), rng.uniform(0.0, 1.0)
    if kind == "disc":
        return Disc(centre, *shape)
    return Rim(centre + np.array([0.0, 0.2]), *shape, place=rng.uniform(-0.6, 0.6))


@dataclass(frozen=True)
class Request:
    """A request by chance."""

    seed: int
    index: int

    @cached_property
    def drawn(self) -> tuple[Case, str, int, float, int, float]:
        rng = np.random.default_rng([self.seed, self.index])
        case, norm = case_of(rng), str(rng.choice(list(DIGITS)))
        degree, digits = int(rng.integers(1, 4)), rng.uniform(*DIGITS[norm])
        sign = float(rng.choice([-1.0, 1.0]))
        return case, norm, degree, digits + MORE * (degree - 1), int(rng.integers(3, 8)), sign

    def pose(self, sided: ds.SidedMesh) -> ds.ObstacleProblem:
        case, _, degree, *_, sign = self.drawn
        domain = sided.mesh
        V, x = ds.bernstein_space(domain, degree), ufl.SpatialCoordinate(domain)
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        L = (case.load(x) + fem.Constant(domain, 0.0)) * v * ufl.dx
        bounds = case.bounds(x)
        given: dict[str, Any] = {}
        side = "contact" if isinstance(case, Rim) else ""
        if isinstance(case, Rim):
            facets = sided.sides[side]
            pairs = [(1, facet_cells(domain, facets).flatten())]
            L += case.flux(x) * v * ufl.Measure("ds", domain, subdomain_data=pairs)(1)
            given = {"contact": facets, "bound": "lower" if sign > 0.0 else "upper"}
            given["obstacle"] = sign * bounds.pop("obstacle")
        turned = {"lower": "upper", "upper": "lower"}
        given |= {k if sign > 0.0 else turned[k]: sign * g for k, g in bounds.items()}
        held = [facets for name, facets in sided.sides.items() if name != side]
        others = np.unique(np.concatenate(held)).astype(np.int32)
        bc = ds.dirichlet(V, others, lambda x: sign * case.u(x))
        a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
        return ds.ObstacleProblem(a, sign * L, bcs=[bc], **given)

    def mesh(self) -> ds.SidedMesh:
        n = self.drawn[4]
        domain = dolfinx.mesh.create_rectangle(COMM, [(-1.0, -1.0), (1.0, 1.0)], (n, n))
        low = dolfinx.mesh.locate_entities_boundary(domain, 1, lambda x: x[1] < -1.0 + 1e-9)
        others = np.setdiff1d(ds.boundary_facets(domain), low).astype(np.int32)
        return ds.SidedMesh(domain, {"contact": low, "others": others})

    def run(self) -> dict[str, Any]:
        case, norm, degree, digits, *_ = self.drawn
        asked = 10.0**-digits
        found = ds.solve_adaptively(
            self.pose, self.mesh(), norm=norm, accuracy=asked, max_unknowns=150_000
        )
        true = self.error(found.problem.u)
        found.problem.destroy()
        return {
            "index": self.index, "kind": type(case).__name__, "what": norm, "degree": degree,
            "asked": asked, "estimate": found.estimate, "true": true,
            "reached": found.reached, "steps": len(found.steps),
            "unknowns": found.steps[-1].unknowns,
        }  # fmt: skip

    def error(self, u: fem.Function) -> float:
        norm, domain = self.drawn[1], u.function_space.mesh
        found = [
            self._powers(*self._errors(u, k))
            for k in range(0, domain.topology.index_map(2).size_local, CHUNK)
        ]
        if norm in ("Linf", "W1_inf"):
            return float(COMM.allreduce(max(found, default=0.0), op=MPI.MAX))
        return float(COMM.allreduce(sum(found)) ** (0.25 if norm == "L4" else 0.5))

    def _powers(self, weights: Array, e: Array, de: Array) -> float:
        """The integral of the power of the norm over some cells, or the largest error there."""
        norm, slopes = self.drawn[1], np.hypot(*de)
        if norm in ("Linf", "W1_inf"):
            largest = float(np.abs(e).max())
            return largest if norm == "Linf" else max(largest, float(slopes.max()))
        powers = np.abs(e) ** (4.0 if norm == "L4" else 2.0)
        powers += slopes**2 if norm == "H1" else 0.0
        return float((weights * powers).sum())

    def _errors(self, u: fem.Function, first: int) -> tuple[Array, ...]:
        """Weights, errors and their gradients at points of parts of some cells."""
        case, *_, sign = self.drawn
        domain, (points, weights) = u.function_space.mesh, parts_of_triangle()
        cells = slice(first, min(first + CHUNK, domain.topology.index_map(2).size_local))
        x = domain.geometry.x[domain.geometry.dofmap[cells]][:, :, :2]
        edges = (x[:, 1:] - x[:, :1]).transpose(0, 2, 1)
        places = (x[:, :1] + np.einsum("cij,qj->cqi", edges, points)).transpose(2, 0, 1)
        table = u.function_space.element.basix_element.tabulate(1, points)[:, :, :, 0]
        values = u.x.array[u.function_space.dofmap.list[cells]]
        slopes = np.einsum("jqd,cd->cqj", table[1:], values)
        own = np.einsum("cqj,cji->icq", slopes, np.linalg.inv(edges))
        e, de = values @ table[0].T - sign * case.u(places), own - sign * case.gradient(places)
        return np.abs(np.linalg.det(edges))[:, None] * weights, e, de


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--requests", type=int, default=60)
    parser.add_argument("--only", type=int, metavar="INDEX", help="one request")
    args = parser.parse_args()
    rows = []
    for index in range(args.requests) if args.only is None else [args.only]:
        rows.append(Request(args.seed, index).run())
        if COMM.rank == 0:
            print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    if COMM.rank == 0:
        lines = []
        for key in ("kind", "what"):
            names = sorted({r[key] for r in rows})
            lines += [summary(k, [r for r in rows if r[key] == k]) for k in names]
        print(markdown_table(COLUMNS, [*lines, summary("all", rows)]))
    sys.exit(any(r["reached"] and r["true"] > r["asked"] for r in rows))


if __name__ == "__main__":
    main()
