"""The discrete Signorini problem solved with 50 digits, by nothing that the package uses.

P1 matrices from the coordinates of the mesh, a Schur complement on the contact nodes, and an active
set that is changed until the signs of gap and pressure are right, which they are for one set only.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpmath import mp, mpf

from dolfinx_signorini.meshes.sided_meshes import owned_cells

DIGITS = 50
ROUNDING = mpf(10) ** -40  # signs below it are zero
SWEEPS = 20  # of changing all wrong nodes at once, before one at a time: that always ends

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Nodes:
    """A mesh gathered on every rank.

    Attributes:
        x: Coordinates of the nodes, shape (nodes, 2).
        cells: Nodes of the cells, shape (cells, 3).
        boundary: Nodes on the boundary.
        of_dof: The node of each P1 dof of this rank, ghosts included.
    """

    x: Array
    cells: npt.NDArray[np.int64]
    boundary: npt.NDArray[np.int64]
    of_dof: npt.NDArray[np.int64]


def gather(space: fem.FunctionSpace) -> Nodes:
    """Return the nodes and cells of a plane mesh with the P1 dofs of this rank."""
    domain = space.mesh
    local = domain.geometry.index_map()
    size = local.size_local + local.num_ghosts
    names = local.local_to_global(np.arange(size, dtype=np.int32))
    dofmap = domain.geometry.dofmap
    parts = domain.comm.allgather(
        (names, domain.geometry.x[:, :2], names[dofmap[owned_cells(domain)]])
    )
    x = np.empty((local.size_global, 2))
    for own, coordinates, _ in parts:
        x[own] = coordinates
    cells = np.concatenate([part[2] for part in parts])
    edges = np.sort(np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [2, 0]]]))
    edges, counts = np.unique(edges, axis=0, return_counts=True)
    of_dof = np.empty(len(space.tabulate_dof_coordinates()), dtype=np.int64)
    of_dof[space.dofmap.list] = names[dofmap]
    return Nodes(x=x, cells=cells, boundary=np.unique(edges[counts == 1]), of_dof=of_dof)


def areas(nodes: Nodes) -> list[Any]:
    """Return the areas of the cells."""
    (ax, ay), (bx, by), (cx, cy) = (_exact(nodes.x[nodes.cells[:, k]]) for k in range(3))
    return [
        abs((bx[i] - ax[i]) * (cy[i] - ay[i]) - (cx[i] - ax[i]) * (by[i] - ay[i])) / 2
        for i in range(len(nodes.cells))
    ]


def matrices(nodes: Nodes) -> tuple[Any, Any]:
    """Return stiffness and mass matrix."""
    count = len(nodes.x)
    stiffness, mass = mp.zeros(count), mp.zeros(count)
    x, y = _exact(nodes.x)
    for cell, area in zip(nodes.cells.tolist(), areas(nodes), strict=True):
        # Edges opposite to the vertices.
        ex = [x[cell[k - 1]] - x[cell[k - 2]] for k in range(3)]
        ey = [y[cell[k - 1]] - y[cell[k - 2]] for k in range(3)]
        for i, a in enumerate(cell):
            for j, b in enumerate(cell):
                stiffness[a, b] += (ex[i] * ex[j] + ey[i] * ey[j]) / (4 * area)
                mass[a, b] += area / (6 if i == j else 12)
    return stiffness, mass


def _exact(x: Array) -> tuple[list[Any], list[Any]]:
    mp.dps = DIGITS
    return [mpf(v) for v in x[:, 0].tolist()], [mpf(v) for v in x[:, 1].tolist()]


def complementary(A: Any, b: Any, contact: list[int], obstacle: list[Any]) -> tuple[Any, set[int]]:
    """Solve A u - b = pressure with gap >= 0, pressure >= 0, gap * pressure = 0 at contact nodes.

    Args:
        A: Symmetric positive definite matrix, or semidefinite where the contact holds u.
        b: Right-hand side.
        contact: The contact nodes.
        obstacle: The obstacle at these.

    Returns:
        u, and the nodes that are held at the obstacle.
    """
    bound = dict(zip(contact, obstacle, strict=True))
    height = max([abs(v) for v in obstacle], default=mpf(0))
    force = max(abs(v) for v in b) + max(A[i, i] for i in range(A.rows)) * height
    held = set(contact)
    for sweep in range(SWEEPS + 2 ** len(contact)):
        u = _solve_held(A, b, {node: bound[node] for node in held})
        pressure = A * u - b
        wrong = [
            node
            for node in contact
            if (node in held and pressure[node] < -ROUNDING * force)
            or (node not in held and u[node] - bound[node] < -ROUNDING * max(map(abs, u)))
        ]
        if not wrong:
            return u, held
        # Changing the first wrong node only (Murty) ends for every positive definite matrix.
        held ^= set(wrong if sweep < SWEEPS else wrong[:1])
    raise AssertionError("no active set has the right signs")


def _solve_held(A: Any, b: Any, values: dict[int, Any]) -> Any:
    free = [node for node in range(A.rows) if node not in values]
    u = mp.zeros(A.rows, 1)
    for node, value in values.items():
        u[node] = value
    if free:
        rhs = b - A * u
        block = mp.matrix([[A[i, j] for j in free] for i in free])
        for node, value in zip(
            free, mp.lu_solve(block, mp.matrix([rhs[i] for i in free])), strict=True
        ):
            u[node] = value
    return u


def solve(
    nodes: Nodes,
    coefficients: tuple[float, float],
    load: Array,
    contact: npt.NDArray[np.int64],
    obstacle: Array,
) -> tuple[list[Any], set[int]]:
    """Solve (diffusion grad u, grad v) + reaction (u, v) = (load, v), u >= obstacle, in P1.

    Args:
        nodes: The mesh.
        coefficients: Diffusion and reaction.
        load: Its values at the nodes, interpolated, or on the cells, constant there.
        contact: The contact nodes.
        obstacle: Its values at these.

    Returns:
        The values at the nodes, and the nodes that are held.
    """
    stiffness, mass = matrices(nodes)
    A = mpf(coefficients[0]) * stiffness + mpf(coefficients[1]) * mass
    values = [mpf(v) for v in load.tolist()]
    if len(values) == len(nodes.x):
        b = mass * mp.matrix(values)
    else:
        b = mp.zeros(len(nodes.x), 1)
        for cell, value, area in zip(nodes.cells.tolist(), values, areas(nodes), strict=True):
            for node in cell:
                b[node] += value * area / 3
    u, held = complementary(A, b, contact.tolist(), [mpf(v) for v in obstacle.tolist()])
    return list(u), held
