"""The regularity to expect of a solution, from the angles and conditions of its domain."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from dolfinx import mesh

from dolfinx_signorini.accuracy.corners import (
    Sides,
    angles_at_places,
    corners_of,
    exponents_at_places,
)
from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.ranks import highest, summed
from dolfinx_signorini.base.tolerances import ROUNDING, SOLVED
from dolfinx_signorini.data.formulas import Formula, evaluated
from dolfinx_signorini.data.interfaces.facet_jumps import data_jumps
from dolfinx_signorini.data.interfaces.integrability import DISTANCES, power_of
from dolfinx_signorini.data.principal_part import diffusion_part
from dolfinx_signorini.meshes.sided_meshes import (
    SidedMesh,
    boundary_facets,
    cell_corners,
    owned_cells,
)
from dolfinx_signorini.norms.orders import SMOOTH
from dolfinx_signorini.norms.sectors import WHOLE
from dolfinx_signorini.scenes.files.conditions import Dirichlet
from dolfinx_signorini.scenes.files.scene import Scene


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

    point: tuple[float, ...]
    angle: float
    kinds: tuple[str, ...]
    exponent: float

    def __str__(self) -> str:
        return (
            f"{point_text(self.point)}, angle {math.degrees(self.angle):.4g} degrees, "
            f"{' meets '.join(self.kinds)}: u ~ r^{self.exponent:.3g}"
        )


def point_text(point: Sequence[float] | Array, digits: int = 4) -> str:
    """Return the coordinates of a point in words, without digits of rounding."""
    size = max(map(abs, point))
    numbers = (c if abs(c) > ROUNDING * size else 0.0 for c in point)
    return f"({', '.join(f'{c:.{digits}g}' for c in numbers)})"


def singular_corners(
    domain: mesh.Mesh,
    facets: Mapping[str, LocalIndices],
    diffusion: Sequence[Sequence[Formula]] = (),
) -> list[Corner]:
    """Return the boundary points with a non-integer exponent below 2, worst first.

    Args:
        domain: A mesh of straight-sided triangles; the call is collective.
        facets: The owned boundary facets by what their conditions act like, all facets together:
            "Dirichlet", "contact", and others without given values.
        diffusion: The rows of a constant diffusion tensor; see `diffusion_part`.
    """
    part, every = diffusion_part(domain, diffusion), np.concatenate([*facets.values()])
    of_kind = [np.full((len(on), 1, 1), kind) for kind, on in facets.items()]
    given, stopped = (np.concatenate(of_kind) == kind for kind in ("Dirichlet", "contact"))
    # Contact sides may be in contact, or not.
    states = (np.full(len(every), state) for state in (False, True))
    sides = [Sides(every, given.astype(float), stopped.astype(float), state) for state in states]
    exponents = np.min([exponents_at_places(domain, part, known) for known in sides], axis=0)
    places = domain.topology.index_map(0)
    angles = angles_at_places(domain, owned_cells(domain))
    ends = corners_of(domain, 1)
    meeting = {kind: summed(places, ends[on]) > 0.0 for kind, on in facets.items()}
    owned = np.arange(places.size_local, dtype=np.int32)
    x = mesh.compute_midpoints(domain, 0, owned)
    found = []
    for i in np.flatnonzero(exponents[owned] < 2.0):
        kinds = tuple(kind for kind, touched in meeting.items() if touched[i])
        point = float(x[i, 0]), float(x[i, 1])
        found.append(Corner(point, float(angles[i]), kinds, float(exponents[i])))
    everywhere = [c for parts in domain.comm.allgather(found) for c in parts]
    return sorted(everywhere, key=lambda c: (c.exponent, c.point))


def dirichlet_jumps(scene: Scene, sided: SidedMesh) -> list[tuple[float, ...]]:
    """Return the points at which the Dirichlet data of a scene jump; the call is collective."""
    given: dict[int | None, list[tuple[Formula, LocalIndices]]] = {}
    for c in scene.conditions:
        if isinstance(c, Dirichlet) and c.value is not None:
            given.setdefault(c.component, []).append((c.value, sided.facets(c.sides)))
    found = {point for same in given.values() for point in data_jumps(sided.mesh, same)}
    return sorted(found)


def known_corner(solution: Formula, corner: Corner, domain: mesh.Mesh) -> Corner:
    """Return a corner with the exponent of a known solution, which may be smoother there.

    On points at the distance r the solution varies by about r^a, or by r where it is smooth.

    Args:
        solution: The solution.
        corner: The corner.
        domain: A mesh that has the corner as a vertex; the call is collective.
    """
    offset = cell_corners(domain)[:, :3, :2] - np.array(corner.point)
    distances = np.hypot(offset[:, :, 0], offset[:, :, 1])
    edges = offset[(distances <= SOLVED * distances.max(axis=1, keepdims=True)).any(axis=1)]
    middles = edges.mean(axis=1)
    towards = np.concatenate([middles, *(edges[:, k] + middles for k in range(3))])
    variation = []
    for distance in DISTANCES:
        values = evaluated(solution.root, np.array(corner.point) + distance * towards)
        found = np.concatenate(domain.comm.allgather(values))
        found = found[np.isfinite(found)]
        variation.append(np.ptp(found) if len(found) else 0.0)
    if min(variation) <= 0.0:
        return replace(corner, exponent=SMOOTH)
    slope = float(power_of(*variation))
    return replace(corner, exponent=slope if slope < 1.0 - WHOLE else SMOOTH)


def largest_angle(domain: mesh.Mesh) -> float:
    """Return the largest interior angle on the boundary, in radians; the call is collective."""
    ends = corners_of(domain, 1)[boundary_facets(domain)]
    return highest(domain.comm, angles_at_places(domain, owned_cells(domain))[ends])
