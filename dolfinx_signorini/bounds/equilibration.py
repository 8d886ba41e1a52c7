"""Equilibrated fluxes of a mesh that ranks share: each patch belongs to the owner of its vertex.

On contact facets that touch the obstacle, all over or in part, the flux that costs the least energy
is taken first. At vertices of a facet where the sum of these fluxes is negative somewhere, fluxes
of given shapes that are nowhere negative are taken instead.
"""

import numpy as np
from dolfinx import mesh

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.ranks import anywhere, summed
from dolfinx_signorini.bounds.condensation import CLOSED, PARTLY, CellData, joined, vertices_of
from dolfinx_signorini.bounds.patch_groups import FREE, HALF, SPREAD
from dolfinx_signorini.bounds.patches import patch_fluxes
from dolfinx_signorini.bounds.reference_flux import ReferenceFlux
from dolfinx_signorini.meshes.polynomials import lowest, others


def equilibrated(domain: mesh.Mesh, data: CellData, reference: ReferenceFlux) -> Array:
    """Return the moments of the equilibrated flux on the facets of the owned cells.

    The flux is not negative on contact facets. The cells at a vertex of another rank are sent to
    this rank, which sends back the moments of its patches.

    Args:
        domain: The mesh; the call is collective.
        data: The owned cells of this rank.
        reference: The fields.

    Returns:
        Outward fluxes, shape (cells, d + 1, moments).
    """
    patches, d = _SharedPatches(domain, data, reference), reference.dimension
    moments = patches.solve(np.zeros_like(patches.modes))
    while True:  # a vertex has more given in each round, or the search ends
        pulls = data.kinds >= PARTLY
        pulls[pulls] = lowest(d - 1, reference.degree, moments[pulls]) < 0.0
        half = patches.marked(vertices_of(pulls & (data.kinds == PARTLY)))
        spread = patches.marked(vertices_of(pulls & (data.kinds == CLOSED)))
        modes = np.maximum(patches.modes, np.where(spread, SPREAD, np.where(half, HALF, FREE)))
        if not anywhere(domain.comm, modes > patches.modes):
            return moments
        moments = patches.solve(modes)


class _SharedPatches:
    """The cells of this rank, and what other ranks sent for the vertices of this rank."""

    def __init__(self, domain: mesh.Mesh, data: CellData, reference: ReferenceFlux):
        self.comm, self.reference = domain.comm, reference
        self.index_map = domain.topology.index_map(0)
        self.own, self.count = self._local(data.vertices), len(data.vertices)
        rank = self.comm.rank
        owner = np.full(self.index_map.size_local + self.index_map.num_ghosts, rank)
        owner[self.index_map.size_local :] = self.index_map.owners
        owners = owner[self.own]
        self.there = [
            np.flatnonzero((owners == r).any(axis=1) & (r != rank)) for r in range(self.comm.size)
        ]
        received = self.comm.alltoall([data.some(cells) for cells in self.there])
        self.ends = np.cumsum([self.count, *(len(part.vertices) for part in received)])
        self.data = joined([data, *received])
        first, last = self.index_map.local_range
        self.here = (self.data.vertices >= first) & (self.data.vertices < last)
        self.modes: Indices = np.full(len(owner), -1)

    def solve(self, modes: Indices) -> Array:
        """Return the sum of the fields of all patches.

        Args:
            modes: The modes of all vertices that this rank knows, see `patch_fluxes`, which are
                `FREE` the first time; patches whose modes are as before stay as they are.
        """
        reference, (rows, vertices) = self.reference, self.here.shape
        local = np.where(self.here, self.data.vertices - self.index_map.local_range[0], 0)
        changed = self.here & (modes > self.modes)[local]
        if (self.modes < FREE).all():
            guess = np.zeros((rows, vertices, reference.dimension))
            self.fields = patch_fluxes(self.data, reference, changed, modes[local], guess)
            self.free = self.fields[..., 0].copy()
        else:
            cells = np.flatnonzero(changed.any(axis=1))
            here, own = changed[cells], modes[local[cells]]
            new = patch_fluxes(self.data.some(cells), reference, here, own, self.free[cells])
            self.fields[cells] = np.where(here[..., None, None], new, self.fields[cells])
        self.modes = modes
        at = others(reference.dimension)[..., None] == np.arange(vertices)
        at = np.kron(at.reshape(-1, vertices), np.eye(reference.per_facet))
        moments = self.fields.reshape(rows, len(at)) @ at
        moments = moments.reshape(rows, vertices, reference.per_facet)
        back = self.comm.alltoall(np.split(moments, self.ends[:-1])[1:])
        result = moments[: self.count]
        for there, more in zip(self.there, back, strict=True):
            result[there] += more
        return result

    def marked(self, vertices: Mask) -> Mask:
        """Return marks of vertices of cells for all vertices that this rank knows."""
        return np.asarray(summed(self.index_map, self.own[vertices]) > 0.0)

    def _local(self, numbers: Indices) -> Indices:
        return np.asarray(self.index_map.global_to_local(numbers.ravel())).reshape(numbers.shape)
