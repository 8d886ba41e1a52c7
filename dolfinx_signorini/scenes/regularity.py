"""The regularity to expect of a solution, from the angles and conditions of its domain."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from dolfinx import fem, mesh

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.ranks import highest, marked, summed
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.data.formulas import Formula, evaluated
from dolfinx_signorini.meshes.angles import cell_angles
from dolfinx_signorini.meshes.elements import control_points, facet_dofs
from dolfinx_signorini.meshes.sided_meshes import facet_cells, owned_cells
from dolfinx_signorini.norms.orders import SMOOTH, corner_exponents

RATIOS = 1e-4, 1e-6  # of a cell: distances from a corner where the exponent of u is measured
LIPSCHITZ = 0.99  # an exponent of a known solution that is not less is that of a smooth one


@dataclass(frozen=True)
class Corner:
    """A boundary point near which the solution is not smooth.

    Corners print themselves in words:

        print(*singular_corners(domain, {"contact": facets}, None), sep="; ")

    Attributes:
        point: The coordinates of the point.
        angle: The interior angle, in radians.
        kinds: The conditions that meet at the point.
        exponent: The power of the distance that the solution behaves like.
    """

    point: tuple[float, float]
    angle: float
    kinds: tuple[str, ...]
    exponent: float

    def __str__(self) -> str:
        x, y = (round(c, 12) + 0.0 for c in self.point)
        return (
            f"({x:.4g}, {y:.4g}), angle {math.degrees(self.angle):.4g} degrees, "
            f"{' meets '.join(self.kinds)}: u ~ r^{self.exponent:.3g}"
        )


def singular_corners(
    domain: mesh.Mesh, facets: Mapping[str, LocalIndices], diffusion: Array | None
) -> list[Corner]:
    """Return the boundary points with a non-integer exponent below 2, worst first.

    Args:
        domain: A mesh of straight-sided triangles; the call is collective.
        facets: The owned boundary facets of each kind of condition.
        diffusion: A constant diffusion tensor K, shape (2, 2): the exponents are those of the
            Laplacian on the domain K^{-1/2} x. None for the identity.
    """
    space = fem.functionspace(domain, ("Lagrange", 1))
    angles = _vertex_angles(space)
    seen = angles if diffusion is None else _vertex_angles(space, diffusion)
    dofs = {kind: facet_dofs(space, facet_cells(domain, on)) for kind, on in facets.items()}
    meeting = {kind: marked(space, touched)[: len(angles)] for kind, touched in dofs.items()}
    count = np.sum(list(meeting.values()), axis=0)
    exponents, x, found = corner_exponents(angles, seen, count > 1), control_points(space), []
    for i in np.flatnonzero((count > 0) & (exponents < 2.0)):
        kinds = tuple(kind for kind, touched in meeting.items() if touched[i])
        point = float(x[i, 0]), float(x[i, 1])
        found.append(Corner(point, float(angles[i]), kinds, float(exponents[i])))
    everywhere = [c for part in domain.comm.allgather(found) for c in part]
    return sorted(everywhere, key=lambda c: (c.exponent, c.point))


def known_corner(solution: Formula, corner: Corner, domain: mesh.Mesh) -> Corner:
    """Return a corner with the exponent of a known solution, which may be smoother there.

    On points at the distance r the solution varies by about r^a, or by r where it is smooth.

    Args:
        solution: The solution.
        corner: The corner.
        domain: A mesh that has the corner as a vertex; the call is collective.
    """
    count = len(owned_cells(domain))
    x = domain.geometry.x[domain.geometry.dofmap[:count]][:, :3, :2]
    offset = x - np.array(corner.point)
    distances = np.hypot(offset[:, :, 0], offset[:, :, 1])
    edges = offset[(distances <= SOLVED * distances.max(axis=1, keepdims=True)).any(axis=1)]
    middles = edges.mean(axis=1)
    towards = np.concatenate([middles, *(edges[:, k] + middles for k in range(3))])
    variation = []
    for ratio in RATIOS:
        values = evaluated(solution.root, np.array(corner.point) + ratio * towards)
        found = np.concatenate(domain.comm.allgather(values))
        found = found[np.isfinite(found)]
        variation.append(np.ptp(found) if len(found) else 0.0)
    if min(variation) <= 0.0:
        return replace(corner, exponent=SMOOTH)
    slope = math.log(variation[1] / variation[0]) / math.log(RATIOS[1] / RATIOS[0])
    return replace(corner, exponent=slope if slope < LIPSCHITZ else SMOOTH)


def largest_angle(domain: mesh.Mesh) -> float:
    """Return the largest interior angle on the boundary, in radians; the call is collective."""
    space = fem.functionspace(domain, ("Lagrange", 1))
    angles = _vertex_angles(space)
    # Inside the domain the angles add up to 2 pi.
    boundary = angles[angles < 2.0 * math.pi - 1e-6]
    return highest(domain.comm, boundary)


def _vertex_angles(space: fem.FunctionSpace, diffusion: Array | None = None) -> Array:
    """Return the sum of the angles of the cells at each owned vertex, in the domain K^{-1/2} x."""
    cells, index_map = owned_cells(space.mesh), space.dofmap.index_map
    angles = cell_angles(space.mesh, cells, diffusion)
    return summed(index_map, space.dofmap.list[cells], angles)[: index_map.size_local]
