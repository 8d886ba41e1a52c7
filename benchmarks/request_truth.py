"""The true error of a solution, by NumPy formulas at points that the package does not use.

Cells, or facets of the boundary, are halved towards the places where the solution changes fast.
Integrals are sums over the parts by a rule of high degree, and maxima are those of lattices.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import basix
import numpy as np
from dolfinx import fem, mesh
from request_scenes import NUMPY, Trial

Array = np.ndarray

CHUNK = 200_000  # points at a time
HALVINGS = 40  # per dimension, of cells at a singular point
MOST = 400_000  # parts
SIMPLICES = {1: basix.CellType.interval, 2: basix.CellType.triangle, 3: basix.CellType.tetrahedron}
RULES = {1: 20, 2: 16, 3: 10}  # degrees, by the dimension of the parts
LATTICES = {1: (10, 40), 2: (6, 24), 3: (4, 12)}  # of all parts, and of those of large errors
WORST = 400  # parts of large errors
INSIDE = 1e-6  # of a part: so far from its facets are points of derivatives


@dataclass(frozen=True)
class Functional:
    """A weighted integral of u, or of K grad u . n, over the domain or a side."""

    name: str
    weight: str = "1"
    side: str | None = None
    flux: bool = False


class Truth:
    """The error of a finite element function, or the solution itself where there is none."""

    def __init__(self, trial: Trial, domain: mesh.Mesh, u: fem.Function | None = None):
        self.trial, self.domain, self.u = trial, domain, u
        self.dim = domain.topology.dim
        self.corners = domain.geometry.x[domain.geometry.dofmap][:, :, : self.dim]

    def _whole(self, boundary: bool) -> tuple[Array, Array]:
        """The cells, and the vertices of parts in barycentric coordinates of the cells."""
        if not boundary:
            cells = np.arange(len(self.corners))
            return cells, np.broadcast_to(np.eye(self.dim + 1), (len(cells), *[self.dim + 1] * 2))
        topology, d = self.domain.topology, self.dim
        topology.create_connectivity(d - 1, d)
        topology.create_connectivity(d, d - 1)
        facets = mesh.exterior_facet_indices(topology)
        of_cell, cell_of = topology.connectivity(d, d - 1), topology.connectivity(d - 1, d)
        cells = np.array([cell_of.links(f)[0] for f in facets])
        local = [
            int(np.flatnonzero(of_cell.links(c) == f)[0])
            for c, f in zip(cells, facets, strict=True)
        ]
        opposite = np.array([np.delete(np.arange(d + 1), k) for k in local])
        return cells, np.eye(d + 1)[opposite]

    def parts(self, boundary: bool) -> tuple[Array, Array]:
        """Parts no longer than the length at which u changes; see `_whole`."""
        cells, parts = self._whole(boundary)
        done: list[tuple[Array, Array]] = []
        count = 0
        for _ in range(HALVINGS * (self.dim - boundary)):
            x = np.einsum("pvc,pcd->pvd", parts, self.corners[cells])
            n = x.shape[1]
            pairs = [(i, j) for i in range(n) for j in range(i)]
            lengths = np.stack([np.linalg.norm(x[:, i] - x[:, j], axis=1) for i, j in pairs], 1)
            scale = self.trial.truth.arrays(x.mean(axis=1), "scale")[0]
            long = lengths.max(axis=1) > scale
            done.append((cells[~long], parts[~long]))
            count += int((~long).sum())
            cells, parts, edges = cells[long], parts[long], lengths[long].argmax(axis=1)
            if not len(cells) or count + 2 * len(cells) > MOST:
                break
            ends = np.array(pairs)[edges]
            rows = np.arange(len(cells))
            middle = (parts[rows, ends[:, 0]] + parts[rows, ends[:, 1]]) / 2.0
            halves = [parts.copy(), parts.copy()]
            for k in (0, 1):
                halves[k][rows, ends[:, k]] = middle
            cells, parts = np.concatenate([cells, cells]), np.concatenate(halves)
        done.append((cells, parts))
        return tuple(np.concatenate(item) for item in zip(*done, strict=True))  # type: ignore

    def errors(self, cells: Array, parts: Array, points: Array, slopes: bool) -> Array:
        """Errors and their derivatives, shape (1 or 1 + d, parts, points); points on a simplex."""
        d = self.dim
        inner = np.column_stack([1.0 - points.sum(axis=1), points])
        places = np.einsum("qv,pvc->pqc", inner, parts)
        corners = self.corners[cells]
        x = np.einsum("pqc,pcd->pqd", places, corners).reshape(-1, d)
        names = ["u", *(f"d{k}" for k in range(d) if slopes)]
        found = -np.array(self.trial.truth.raw(x, *names)).reshape(len(names), len(cells), -1)
        known = np.isfinite(found)
        if self.u is None:
            return np.where(known, found, 0.0)
        space = self.u.function_space
        table = space.element.basix_element.tabulate(int(slopes), places[:, :, 1:].reshape(-1, d))
        table = table[..., 0].reshape(len(table), len(cells), len(points), -1)
        values = np.einsum("pb,kpqb->kpq", self.u.x.array[space.dofmap.list[cells]], table)
        found[0] += values[0]
        if slopes:
            jacobian = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
            found[1:] += np.einsum("jpq,pji->ipq", values[1:], np.linalg.inv(jacobian))
        return np.where(known, found, 0.0)  # a singular point itself does not count

    def _each(
        self, cells: Array, parts: Array, points: Array, slopes: bool, what: Callable[..., Array]
    ) -> Array:
        size = max(1, CHUNK // len(points))
        pieces = [slice(k, k + size) for k in range(0, len(cells), size)]
        results = [
            what(self.errors(cells[p], parts[p], points, slopes), cells[p], parts[p])
            for p in pieces
        ]
        return np.concatenate(results) if results else np.zeros(0)

    def _edges(self, cells: Array, parts: Array) -> Array:
        x = np.einsum("pvc,pcd->pvd", parts, self.corners[cells])
        return x[:, 1:] - x[:, :1]

    def _sizes(self, cells: Array, parts: Array) -> Array:
        edges = self._edges(cells, parts)
        gram = np.einsum("pid,pjd->pij", edges, edges)
        return np.sqrt(np.maximum(np.linalg.det(gram), 0.0))

    def norm(self, name: str) -> float:
        """A norm of the error by its name."""
        if name == "H1_2_boundary":
            return math.sqrt(self.norm("L2_boundary") * self.norm("H1_boundary"))
        boundary = name.endswith("_boundary")
        base = name.removesuffix("_boundary")
        slopes = base.startswith(("H1", "W1"))
        p = 2.0 if base == "H1" else float(base.removeprefix("W1_").removeprefix("L"))
        cells, parts = self.parts(boundary)
        dim = self.dim - boundary

        def along(errors: Array, c: Array, q: Array) -> Array:
            """On the boundary the derivatives along the facets."""
            if not (boundary and slopes):
                return errors
            frame = np.linalg.qr(self._edges(c, q).transpose(0, 2, 1))[0]
            return np.concatenate([errors[:1], np.einsum("pdk,dpq->kpq", frame, errors[1:])])

        if math.isinf(p):

            def largest(errors: Array, c: Array, q: Array) -> Array:
                return np.abs(along(errors, c, q)).max(axis=(0, 2))

            kind = basix.LatticeType.equispaced
            for lattice in LATTICES[dim]:
                points = basix.create_lattice(SIMPLICES[dim], lattice, kind, True)
                if slopes:  # which jump across facets that follow a jump of the diffusion
                    points += INSIDE * (points.mean(axis=0) - points)
                sizes = self._each(cells, parts, points, slopes, largest)
                worst = np.argsort(-sizes)[:WORST]
                cells, parts = cells[worst], parts[worst]
            return float(sizes.max())
        points, weights = basix.make_quadrature(SIMPLICES[dim], RULES[dim])

        def powers(errors: Array, c: Array, q: Array) -> Array:
            return (np.abs(along(errors, c, q)) ** p).sum(axis=0) @ weights * self._sizes(c, q)

        return float(self._each(cells, parts, points, slopes, powers).sum() ** (1.0 / p))

    def functional(self, functional: Functional, of: str = "error") -> float:
        """A functional of the "error", the integral of its "sizes", or that of the "weight"."""
        side = functional.side
        cells, parts = self.parts(side is not None)
        dim = self.dim - (side is not None)
        points, weights = basix.make_quadrature(SIMPLICES[dim], RULES[dim])
        inner = np.column_stack([1.0 - points.sum(axis=1), points])
        if side is not None:
            x = np.einsum("pvc,pcd->pvd", parts, self.corners[cells])
            normal = self.trial.domain.normal(side)
            off = (x - self.trial.domain.sides[side][0]) @ normal
            on = (np.abs(off) < 1e-12).all(axis=1)
            cells, parts = cells[on], parts[on]

        def integral(errors: Array, c: Array, q: Array) -> Array:
            x = np.einsum("qv,pvc,pcd->pqd", inner, q, self.corners[c])
            places = dict(zip("xyz", np.moveaxis(x, 2, 0), strict=False))
            value = errors[0]
            if functional.flux:
                K = self.trial.truth.arrays(x.reshape(-1, self.dim), "K")[0].reshape(value.shape)
                value = K * np.einsum("d,dpq->pq", normal, errors[1:])
            value = np.ones_like(value) if of == "weight" else value
            value = value * eval(functional.weight, {}, dict(NUMPY) | places)
            return (np.abs(value) if of == "sizes" else value) @ weights * self._sizes(c, q)

        return abs(float(self._each(cells, parts, points, functional.flux, integral).sum()))
