"""Equilibrated fluxes of a mesh that ranks share: each patch belongs to the owner of its vertex.

On contact facets that touch the obstacle, all over or in part, the flux that costs the least energy
is taken first. At vertices of a facet where the sum of these fluxes is negative somewhere, fluxes
of given shapes that are nowhere negative are taken instead.
"""

import numpy as np
from dolfinx import mesh
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.ranks import summed
from dolfinx_signorini.bounds.condensation import CLOSED, PARTLY, CellData
from dolfinx_signorini.bounds.patches import FREE, HALF, SPREAD, patch_fluxes
from dolfinx_signorini.bounds.reference_flux import ReferenceFlux, lowest


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
    moments = patches.sum(None)
    while True:  # a vertex has more given in each round, or the search ends
        pulls = lowest(d - 1, reference.degree, moments) < 0.0
        half = patches.marked(_at_vertices(pulls & (data.kinds == PARTLY)))
        spread = patches.marked(_at_vertices(pulls & (data.kinds == CLOSED)))
        modes = np.maximum(patches.modes, np.where(spread, SPREAD, np.where(half, HALF, FREE)))
        if not domain.comm.allreduce(bool((modes > patches.modes).any()), op=MPI.LOR):
            return moments
        moments += patches.sum(modes)


def _at_vertices(facets: Mask) -> Mask:
    """The vertices of cells that are on one of some facets of the cell."""
    count = facets.sum(axis=1, keepdims=True)
    return np.asarray(count - facets > 0)


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
        rows = data.packed()
        received = self.comm.alltoall([rows[cells] for cells in self.there])
        self.ends = np.cumsum([self.count, *map(len, received)])
        self.rows = np.concatenate((rows, *received))
        self.vertices = CellData.unpacked(self.rows, reference).vertices
        first, last = self.index_map.local_range
        self.here = (self.vertices >= first) & (self.vertices < last)
        self.modes: Indices = np.zeros(len(owner), dtype=np.int64)

    def sum(self, modes: Indices | None) -> Array:
        """Return the sum of the fields of all patches, with all contact fluxes free.

        Args:
            modes: For a change of the sum, the modes of all vertices that this rank knows from now
                on, see `patch_fluxes`.
        """
        chosen, moments = self.here, np.zeros((len(self.rows), *self._shape))
        local = np.where(self.here, self.vertices - self.index_map.local_range[0], 0)
        if modes is not None:
            chosen = self.here & (modes > self.modes)[local]
        cells = np.flatnonzero(chosen.any(axis=1))
        part, here = CellData.unpacked(self.rows[cells], self.reference), chosen[cells]
        moments[cells] = patch_fluxes(part, self.reference, here, self.modes[local][cells])
        if modes is not None:
            new = patch_fluxes(part, self.reference, here, modes[local][cells])
            moments[cells] = new - moments[cells]
            self.modes = modes
        back = self.comm.alltoall(np.split(moments, self.ends[:-1])[1:])
        result = moments[: self.count]
        for there, more in zip(self.there, back, strict=True):
            result[there] += more
        return result

    def marked(self, vertices: Mask) -> Mask:
        """Return marks of vertices of cells for all vertices that this rank knows."""
        return np.asarray(summed(self.index_map, self.own[vertices]) > 0.0)

    @property
    def _shape(self) -> tuple[int, int]:
        return self.reference.dimension + 1, self.reference.per_facet

    def _local(self, numbers: Indices) -> Indices:
        return np.asarray(self.index_map.global_to_local(numbers.ravel())).reshape(numbers.shape)
