"""Reference energies of the benchmark collection, by a way that is not the package's.

    pip install -r benchmarks/requirements.txt
    python3 benchmarks/collection_references.py

The scene `floor` has a way of its own, floor_energy.py. Here: scikit-fem with elements of degree 4
with nodal constraints, on meshes that are halved again and again at the corners, at the changes of
condition and at the ends of contact. The unknowns away from the contact boundary are eliminated by
a sparse factorisation; what is left is a least squares problem for values that are not negative,
which NNLS solves exactly.
"""

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls
from scipy.sparse.linalg import splu
from skfem import Basis, BilinearForm, ElementTriP4, LinearForm, MeshTri
from skfem.helpers import dot, grad

REFERENCES = Path(__file__).parent / "collection" / "references.json"
DEGREE = 4
CELLS = 8, 12  # per unit length, of two first meshes


@dataclass(frozen=True)
class Scene:
    """A scene without an exact solution; u is 0 on the held part of the boundary.

    Attributes:
        mesh: The first mesh.
        load: The load, of the coordinates x, y.
        obstacle: The obstacle, a polynomial of degree 3 at most.
        contact: Whether points lie on the contact boundary.
        held: Whether points lie on the Dirichlet boundary.
        corners: Points at which the solution need not be smooth.
    """

    mesh: MeshTri
    load: Callable[[Any, Any], Any]
    obstacle: Callable[[Any, Any], Any]
    contact: Callable[[Any, Any], Any]
    held: Callable[[Any, Any], Any]
    corners: tuple[tuple[float, float], ...]


def rectangle(x: tuple[float, float], y: tuple[float, float], cells: int) -> MeshTri:
    """Return a mesh of a rectangle between two abscissas and two ordinates."""
    grids = [np.linspace(*ends, round((ends[1] - ends[0]) * cells) + 1) for ends in (x, y)]
    return MeshTri.init_tensor(*grids)


def scenes(cells: int) -> dict[str, Scene]:
    """Return the scenes by the names of their files, with so many cells per unit length."""
    whole = rectangle((-1, 1), (-1, 1), cells)
    middles = whole.p[:, whole.t].mean(axis=1)
    corner = Scene(
        mesh=whole.remove_elements(np.flatnonzero((middles > 0.0).all(axis=0))),
        load=lambda x, y: -2.0 + 0.0 * x,
        obstacle=lambda x, y: -1.2 + 0.0 * x,
        contact=lambda x, y: (y == -1.0) | (x == -1.0),
        held=lambda x, y: ((y == 0.0) & (x >= 0.0)) | ((x == 0.0) & (y >= 0.0)),
        corners=((-1, -1), (1, -1), (1, 0), (0, 0), (0, 1), (-1, 1)),
    )
    change = Scene(
        mesh=rectangle((-1, 1), (0, 1), cells),
        load=lambda x, y: 2.0 * x - 1.2,
        obstacle=lambda x, y: -0.1 + 0.0 * x,
        contact=lambda x, y: (y == 0.0) & (x > 0.0),
        held=lambda x, y: (y == 0.0) & (x <= 0.0),
        corners=((-1, 0), (0, 0), (1, 0), (1, 1), (-1, 1)),
    )
    return {"corner": corner, "change": change}


@BilinearForm
def laplace(u: Any, v: Any, _: Any) -> Any:
    """The form of -div grad u."""
    return dot(grad(u), grad(v))


def minimum(scene: Scene, mesh: MeshTri) -> tuple[float, int, list[Any]]:
    """Return the least energy on a mesh, the unknowns, and between which points contact ends."""
    basis = Basis(mesh, ElementTriP4(), intorder=2 * DEGREE)
    A = laplace.assemble(basis).tocsc()
    b = LinearForm(lambda v, w: scene.load(*w.x) * v).assemble(basis)
    x, y = np.round(basis.doflocs, 14)
    held, boundary = scene.held(x, y), np.zeros(len(b), dtype=bool)
    boundary[basis.get_dofs(mesh.boundary_facets()).flatten()] = True
    contact = np.flatnonzero(scene.contact(x, y) & ~held & boundary)
    free = np.setdiff1d(np.flatnonzero(~(held & boundary)), contact)
    inner, across, between = splu(A[free][:, free]), A[free][:, contact], A[contact][:, contact]
    S = between.toarray() - across.T @ inner.solve(across.toarray())
    g = scene.obstacle(x[contact], y[contact])
    r = b[contact] - across.T @ inner.solve(b[free]) - S @ g
    R = cholesky(0.5 * (S + S.T))
    gap, _ = nnls(R, solve_triangular(R, r, trans="T"), maxiter=100 * len(r))
    u = np.zeros(len(b))
    u[contact] = g + gap
    u[free] = inner.solve(b[free] - across @ u[contact])
    order = np.lexsort((y[contact], x[contact]))
    points, open_ = np.column_stack((x, y))[contact][order], gap[order] > 0.0
    same_side = (points[1:] == points[:-1]).any(axis=1)
    ends = np.flatnonzero(same_side & (open_[1:] != open_[:-1]))
    return float(0.5 * u @ (A @ u) - b @ u), len(b), [points[k : k + 2] for k in ends]


def refined(scene: Scene, mesh: MeshTri, ends: list[Any]) -> MeshTri:
    """Return a mesh that is halved at the corners and where contact ends."""
    p = mesh.p[:, mesh.t]
    low, high = p.min(axis=1) - 1e-14, p.max(axis=1) + 1e-14
    marked = np.zeros(mesh.nelements, dtype=bool)
    for corner in np.array(scene.corners, dtype=float):
        marked |= ((low <= corner[:, None]) & (corner[:, None] <= high)).all(axis=0)
    for pair in ends:
        lower, upper = pair.min(axis=0)[:, None], pair.max(axis=0)[:, None]
        marked |= ((low <= upper) & (lower <= high)).all(axis=0)
    return mesh.refined(np.flatnonzero(marked))


def energies(scene: Scene, steps: int) -> list[tuple[int, float]]:
    """Return unknowns and least energy on each of the meshes."""
    mesh, rows = scene.mesh, []
    for _ in range(steps):
        energy, unknowns, ends = minimum(scene, mesh)
        rows.append((unknowns, energy))
        mesh = refined(scene, mesh, ends)
    return rows


def main() -> None:
    """Print the energies beside the values in references.json."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=24, help="halvings (default %(default)s)")
    steps = parser.parse_args().steps
    known = json.loads(REFERENCES.read_text())
    for cells in CELLS:
        for name, scene in scenes(cells).items():
            for unknowns, energy in energies(scene, steps)[-2:]:
                away = energy - known[name]["reference"]
                print(f"{name:8}{unknowns:7d} unknowns {energy:.11f} {away:+.1e}", flush=True)


if __name__ == "__main__":
    main()
