"""Requested accuracies against the truth, for elastic contact that the program is not told.

    python3 benchmarks/elastic_requests.py --seed 1 --requests 60       # the table
    python3 benchmarks/elastic_requests.py --seed 1 --only 17           # one request
    python3 benchmarks/elastic_requests.py --seed 1 --choose            # the loop chooses degrees

Blocks by chance are turned by an angle and pressed against a rigid obstacle: with the pressure of
Hertz and its two ends of contact, or with full contact and a smooth solution by a body force. Asked
for are norms of the displacement, its energy, its stress, and weighted integrals of the contact
pressure, wide as the force and narrow as the largest pressure. Each truth is integrated by NumPy,
at points that the program does not use. The exit code is 1 if a true error is above what was asked
for.
"""

import argparse
import json
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import basix
import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_signorini as ds
from dolfinx_signorini.base.tables import markdown_table

Array = np.ndarray
COMM = MPI.COMM_WORLD
# What is asked for, with the decimal digits, relative to the size of the solution.
DIGITS = {
    "L2": (1.5, 4.0), "L4": (1.5, 4.0), "Linf": (1.5, 3.5), "H1": (1.0, 2.3), "energy": (1.0, 2.3),
    "stress": (1.0, 2.3), "force": (1.5, 4.5), "pressure": (1.5, 3.5),
}  # fmt: skip
MORE = 0.8  # digits for each degree: what takes some steps, and not too many unknowns
PARTS, CHUNK = 3, 500  # of the edges of a cell, and cells at a time, for the truth


@dataclass(frozen=True)
class Block:
    """A block -w < x < w, 0 < y < h in local coordinates, in contact at y = 0, and its material."""

    young: float
    poisson: float
    width: float
    height: float
    angle: float

    @property
    def shear(self) -> float:
        return self.young / (2.0 * (1.0 + self.poisson))

    @property
    def volume(self) -> float:
        return self.young * self.poisson / ((1.0 + self.poisson) * (1.0 - 2.0 * self.poisson))

    @property
    def turn(self) -> Array:
        c, s = math.cos(self.angle), math.sin(self.angle)
        return np.array([[c, -s], [s, c]])


@dataclass(frozen=True)
class Hertz(Block):
    """The pressure p0 sqrt(1 - (x - m)^2 / a^2), see tests/problem/hertz.py for the source."""

    middle: float = 0.0
    half: float = 0.5
    largest: float = 10.0

    @property
    def bend(self) -> float:
        """1 / R of the parabola."""
        return 2.0 * self.largest * (1.0 - self.poisson**2) / (self.young * self.half)

    def _potential(self, x: Array) -> tuple[Array, ...]:
        z = x[0] - self.middle + 1j * np.maximum(x[1], 0.0)
        s = np.sqrt(z - self.half) * np.sqrt(z + self.half)
        factor = 0.5j * self.largest / self.half
        phi = 0.5 * factor * (z * s - self.half**2 * np.log(z + s) - z**2)
        return z, s, factor * (s - z), phi

    def u(self, x: Array) -> Array:
        z, _, slope, phi = self._potential(x)
        kappa = 3.0 - 4.0 * self.poisson
        w = kappa * phi - np.conj(phi) - 2j * z.imag * np.conj(slope)
        return np.stack([w.real, w.imag]) / (2.0 * self.shear)

    def gradient(self, x: Array) -> Array:
        z, s, slope, _ = self._potential(x)
        kappa = 3.0 - 4.0 * self.poisson
        with np.errstate(all="ignore"):
            curvature = np.conj(0.5j * self.largest / self.half * (z / s - 1.0))
        along = kappa * slope - np.conj(slope) - 2j * z.imag * curvature
        up = 1j * (kappa * slope - np.conj(slope)) - 2.0 * z.imag * curvature
        rows = np.array([[along.real, up.real], [along.imag, up.imag]]) / (2.0 * self.shear)
        return np.nan_to_num(rows)

    def gap(self, x: Array) -> Array:
        place = x[0] - self.middle
        return 0.5 * self.bend * (place**2 + self.half**2 * math.log(self.half))


@dataclass(frozen=True)
class Smooth(Block):
    """Full contact, and a displacement of sines: see `functions`."""

    push: float = 0.1
    wave: float = 2.0
    phase: float = 0.3

    def functions(self, np: Any, x: Any, y: Any) -> tuple[Any, Any, Any, Any, Any, Any]:
        """The components and their derivatives: along x and y of the first, then the second."""
        k, p, c = self.wave, self.phase, self.push
        g, dg, ddg = 0.02 * np.cos(k * x), -0.02 * k * np.sin(k * x), -0.02 * k**2 * np.cos(k * x)
        first, second = np.sin(2 * x + p), np.sin(3 * x + p)
        u = -y * dg + 0.02 * first * np.cos(y)
        v = g - c * y + 0.02 * y**2 * second
        slopes = (
            -y * ddg + 0.04 * np.cos(2 * x + p) * np.cos(y), -dg - 0.02 * first * np.sin(y),
            dg + 0.06 * y**2 * np.cos(3 * x + p), -c + 0.04 * y * second,
        )  # fmt: skip
        return u, v, *slopes

    def u(self, x: Array) -> Array:
        return np.stack(self.functions(np, x[0], x[1])[:2])

    def gradient(self, x: Array) -> Array:
        slopes = self.functions(np, x[0], x[1])[2:]
        return np.stack(slopes).reshape(2, 2, -1)

    def gap(self, x: Array) -> Array:
        return -0.02 * np.cos(self.wave * x[0])


Rng = np.random.Generator


def block(rng: Rng) -> Block:
    poisson, wide, high = rng.uniform(0.0, 0.42), rng.uniform(1.0, 2.5), rng.uniform(0.8, 2.0)
    shape = 10.0 ** rng.uniform(0.0, 3.0), poisson, wide, high, rng.uniform(-math.pi, math.pi)
    if rng.uniform() < 0.3:
        push = 0.12 + 0.3 * poisson
        return Smooth(*shape, push=push, wave=rng.uniform(1.0, 3.0), phase=rng.uniform(0.0, 3.0))
    half = wide * rng.uniform(0.2, 0.6)
    middle = rng.uniform(-0.5, 0.5) * (0.9 * wide - half)
    return Hertz(*shape, middle=middle, half=half, largest=shape[0] * rng.uniform(0.01, 0.1))


def weight(shape: Block, what: str) -> tuple[float, float, Callable[..., Any], float]:
    """The place, the half-width and the profile of a weight of the pressure, and its depth."""
    if what == "force":
        return 0.0, shape.width, lambda t: (1 - t**2) ** 2, shape.height
    middle = getattr(shape, "middle", 0.2 * shape.width)
    size = 0.5 * getattr(shape, "half", 0.6 * shape.width)
    size = min(size, shape.width - abs(middle))

    def kernel(t: Any) -> Any:  # of order 4: a mean that is right for polynomials of degree 3
        return 105.0 / (64.0 * size) * (1 - t**2) ** 2 * (1 - 3 * t**2)

    return middle, size, kernel, min(size, shape.height)


@dataclass(frozen=True)
class Request:
    """A request by chance."""

    seed: int
    index: int
    chooses: bool = False

    @cached_property
    def drawn(self) -> tuple[Block, str, int, float, int]:
        rng = np.random.default_rng([self.seed, self.index])
        shape, what = block(rng), str(rng.choice(list(DIGITS)))
        degree, digits = int(rng.integers(1, 3)), rng.uniform(*DIGITS[what])
        return shape, what, degree, digits + MORE * (degree - 1), int(rng.integers(2, 5))

    def mesh(self) -> ds.SidedMesh:
        shape, *_, n = self.drawn
        w, h = shape.width, shape.height
        across = max(2, round(2.0 * w / h * n))
        domain = dolfinx.mesh.create_rectangle(COMM, [(-w, 0.0), (w, h)], (across, n))
        bottom = dolfinx.mesh.locate_entities_boundary(domain, 1, lambda x: x[1] < 1e-9)
        others = np.setdiff1d(ds.boundary_facets(domain), bottom).astype(np.int32)
        domain.geometry.x[:, :2] = domain.geometry.x[:, :2] @ shape.turn.T
        return ds.SidedMesh(domain, {"contact": bottom, "held": others})

    def pose(self, degree: int, sided: ds.SidedMesh) -> ds.ContactProblem:
        shape = self.drawn[0]
        V = fem.functionspace(sided.mesh, ("Lagrange", degree, (2,)))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        bcs = [
            ds.dirichlet(
                V,
                sided.sides["held"],
                lambda x, k=k: (shape.turn @ shape.u(shape.turn.T @ x[:2]))[k],
                component=k,
            )
            for k in range(2)
        ]
        E, nu = (fem.Constant(sided.mesh, value) for value in (shape.young, shape.poisson))
        load = fem.Constant(sided.mesh, (0.0, 0.0))
        if isinstance(shape, Smooth):
            Q = ufl.as_matrix(shape.turn)
            X = ufl.dot(ufl.transpose(Q), ufl.SpatialCoordinate(sided.mesh))
            exact = ufl.dot(Q, ufl.as_vector(shape.functions(ufl, X[0], X[1])[:2]))
            load = -ufl.div(ds.stress(exact, E, nu))
        return ds.ContactProblem(
            ds.elasticity(u, v, E, nu),
            ufl.inner(load, v) * ufl.dx,
            contact=sided.sides["contact"],
            gap=lambda x: shape.gap(shape.turn.T @ x[:2]),
            bcs=bcs,
        )

    def functional(self, u: Any) -> ufl.Form:
        shape, what, *_ = self.drawn
        middle, size, profile, depth = weight(shape, what)
        Q = ufl.as_matrix(shape.turn)
        x = ufl.SpatialCoordinate(ufl.domain.extract_unique_domain(u))
        X = ufl.dot(ufl.transpose(Q), x)
        t, s = (X[0] - middle) / size, X[1] / depth
        inside = ufl.And(ufl.lt(abs(t), 1.0), ufl.lt(s, 1.0))
        height = ufl.conditional(inside, profile(t) * (1 - s) ** 2, 0.0)
        psi = height * ufl.dot(Q, ufl.as_vector([0.0, 1.0]))
        sigma = ds.stress(u, shape.young, shape.poisson)
        return ufl.inner(sigma, ufl.grad(psi)) * ufl.dx(metadata={"quadrature_degree": 12})

    def run(self) -> dict[str, Any]:
        shape, what, degree, digits, _ = self.drawn
        size = abs(self.error(None)) or 1.0
        asked = size * 10.0**-digits
        of = {"energy": ds.weighted_strain, "stress": ds.stress}.get(what)
        E, nu = shape.young, shape.poisson
        norm: Any = "L2" if of else self.functional if what in ("force", "pressure") else what
        given = {"of": lambda u: of(u, E, nu)} if of else {}
        degrees = range(2, 5) if self.chooses else [degree]
        poses = {k: partial(self.pose, k) for k in degrees}
        found = ds.solve_adaptively(
            poses, self.mesh(), norm=norm, accuracy=asked, max_unknowns=100_000, **given
        )
        true = abs(self.error(found.problem.u))
        degree = found.problem.space.element.basix_element.degree
        found.problem.destroy()
        return {
            "index": self.index, "kind": type(shape).__name__, "what": what, "degree": degree,
            "asked": asked / size, "estimate": found.estimate / size, "true": true / size,
            "reached": found.reached, "steps": len(found.steps),
            "unknowns": found.steps[-1].unknowns,
        }  # fmt: skip

    def error(self, u: fem.Function | None) -> float:
        """The norm or the functional of the error, or of the solution itself."""
        what = self.drawn[1]
        if what in ("force", "pressure"):
            exact = self._functional_of_solution()
            if u is None:
                return exact
            form = fem.form(self.functional(u))
            return float(COMM.allreduce(fem.assemble_scalar(form))) - exact
        domain = self.mesh().mesh if u is None else u.function_space.mesh
        starts = range(0, domain.topology.index_map(2).size_local, CHUNK)
        found = [self._powers(*self._errors(domain, u, k)) for k in starts]
        if what == "Linf":
            return float(COMM.allreduce(max(found, default=0.0), op=MPI.MAX))
        return float(COMM.allreduce(sum(found)) ** (0.25 if what == "L4" else 0.5))

    def _powers(self, weights: Array, e: Array, de: Array) -> float:
        """The integral of the power of the norm over some cells, or the largest error there."""
        shape, what, *_ = self.drawn
        length = np.hypot(*e)
        if what == "Linf":
            return float(length.max())
        if what in ("energy", "stress"):
            strain = 0.5 * (de + de.swapaxes(0, 1))
            trace = strain[0, 0] + strain[1, 1]
            sigma = 2.0 * shape.shear * strain
            sigma[0, 0] += shape.volume * trace
            sigma[1, 1] += shape.volume * trace
            powers = (sigma * (strain if what == "energy" else sigma)).sum(axis=(0, 1))
        else:
            powers = length ** (4.0 if what == "L4" else 2.0)
            powers += 0.0 if what != "H1" else (de**2).sum(axis=(0, 1))
        return float((weights * powers).sum())

    def _errors(self, domain: Any, u: fem.Function | None, first: int) -> tuple[Array, ...]:
        """Weights, errors and their gradients at points of parts of some cells."""
        shape, Q = self.drawn[0], self.drawn[0].turn
        points, weights = parts_of_triangle()
        cells = slice(first, min(first + CHUNK, domain.topology.index_map(2).size_local))
        x = domain.geometry.x[domain.geometry.dofmap[cells]][:, :, :2]
        edges = (x[:, 1:] - x[:, :1]).transpose(0, 2, 1)
        places = x[:, :1] + np.einsum("cij,qj->cqi", edges, points)
        local = places.reshape(-1, 2) @ Q
        many = places.shape[:2]
        e = -(Q @ shape.u(local.T)).reshape(2, *many)
        de = -np.einsum("ki,ijn,lj->kln", Q, shape.gradient(local.T), Q).reshape(2, 2, *many)
        if u is not None:
            element, dofs = u.function_space.element.basix_element, u.function_space.dofmap.list
            table = element.tabulate(1, points)[:, :, :, 0]
            values = u.x.array.reshape(-1, 2)[dofs[cells]]
            e += np.einsum("qd,cdk->kcq", table[0], values)
            slopes = np.einsum("jqd,cdk->kcqj", table[1:], values)
            de += np.einsum("kcqj,cji->kicq", slopes, np.linalg.inv(edges))
        return np.abs(np.linalg.det(edges))[:, None] * weights, e, de

    def _functional_of_solution(self) -> float:
        shape, what, *_ = self.drawn
        middle, size, profile, depth = weight(shape, what)
        t, w = np.polynomial.legendre.leggauss(400)
        if isinstance(shape, Hertz):  # the balance with the pressure, by the substitution of sines
            x = shape.middle + shape.half * np.sin(0.5 * np.pi * t)
            root = np.cos(0.5 * np.pi * t)
            inner = (x - middle) / size
            heights = np.where(np.abs(inner) < 1.0, profile(inner), 0.0)
            return float((w * heights * root**2).sum() * shape.largest * shape.half * 0.5 * np.pi)
        s, X = 0.5 * (t + 1.0), np.meshgrid(middle + size * t, 0.5 * depth * (t + 1.0))
        along = np.polynomial.Polynomial.fit(t, profile(t), 8).deriv()(t) / size
        psi = np.outer((1 - s) ** 2, along), np.outer(-2.0 * (1 - s) / depth, profile(t))
        (a, b), (c, d) = shape.gradient(np.stack([X[0].ravel(), X[1].ravel()]))
        yx = (shape.shear * (b + c)).reshape(len(t), -1)
        yy = (2.0 * shape.shear * d + shape.volume * (a + d)).reshape(len(t), -1)
        return float(((yx * psi[0] + yy * psi[1]) * np.outer(w, w)).sum() * size * 0.5 * depth)


def parts_of_triangle() -> tuple[Array, Array]:
    """A rule on equal parts of the reference triangle."""
    points, weights = basix.make_quadrature(basix.CellType.triangle, 12)
    found = []
    for i in range(PARTS):
        for j in range(PARTS - i):
            found.append((np.array([i, j]) + points) / PARTS)
            if i + j < PARTS - 1:
                found.append((np.array([i + 1, j + 1]) - points) / PARTS)
    return np.concatenate(found), np.tile(weights / PARTS**2, len(found))


COLUMNS = "", "requests", "not reached", "above", "worst", "claim below truth", "true / asked"


def summary(name: str, rows: list[dict[str, Any]]) -> list[str]:
    shares = [r["true"] / r["asked"] for r in rows if r["reached"]]
    numbers = [
        len(rows), sum(not r["reached"] for r in rows), sum(s > 1.0 for s in shares),
        f"{max(shares, default=math.nan):.2f}", sum(r["estimate"] < r["true"] for r in rows),
        f"{np.median(shares) if shares else math.nan:.3f}",
    ]  # fmt: skip
    return [name, *map(str, numbers)]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--requests", type=int, default=60)
    parser.add_argument("--first", type=int, default=0, help="the index of the first request")
    parser.add_argument("--only", type=int, metavar="INDEX", help="one request")
    parser.add_argument("--choose", action="store_true", help="degrees by the loop, from 2 to 4")
    args = parser.parse_args()
    chosen = range(args.first, args.first + args.requests)
    rows = []
    for index in chosen if args.only is None else [args.only]:
        rows.append(Request(args.seed, index, args.choose).run())
        if COMM.rank == 0:
            print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    if COMM.rank == 0:
        names = list(dict.fromkeys(r["what"] for r in rows))
        lines = [summary(k, [r for r in rows if r["what"] == k]) for k in names]
        print(markdown_table(COLUMNS, [*lines, summary("all", rows)]))
    sys.exit(any(r["reached"] and r["true"] > r["asked"] for r in rows))


if __name__ == "__main__":
    main()
