"""The coefficients of a bilinear form on first derivatives, at corners of cells.

In the integrand of a(u, v) the derivatives d_b u_j and d_a v_i have a coefficient C_iajb: the
entries of a diffusion tensor, or the stiffness of an elastic body.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import basix
import numpy as np
import ufl
from dolfinx import fem, mesh

from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.data.coefficients import tensor
from dolfinx_signorini.data.form_data import cells_of
from dolfinx_signorini.data.formulas import ZERO, Formula, Node, nodes, together
from dolfinx_signorini.data.reading import more_coordinates
from dolfinx_signorini.data.readings import Reading
from dolfinx_signorini.meshes.points import Points

Entries: TypeAlias = Any  # an array of nodes, shape (n, d, n, d)


@dataclass(frozen=True)
class PrincipalPart:
    """Coefficients C on first derivatives, as formulas in the cells of one or several integrals:

        part = principal_part(problem.a)
        C = part.at_corners(cells)

    Attributes:
        domain: The mesh.
        entries: The coefficients in each integral.
        cells: The owned cells of each integral; None for all of them.
        functions: The functions whose components are the coordinates of formulas behind those of
            space, each with whether 0 stands in their places.
    """

    domain: mesh.Mesh
    entries: tuple[Entries, ...]
    cells: tuple[LocalIndices | None, ...]
    functions: tuple[tuple[fem.Function, bool], ...] = ()

    @property
    def size(self) -> int:
        """The number of unknowns."""
        return int(self.entries[0].shape[0])

    @property
    def is_constant(self) -> bool:
        """Whether the coefficients are the same everywhere."""
        everywhere = all(cells is None for cells in self.cells)
        return everywhere and all(n.op == "number" for part in self.entries for n in part.flat)

    def at_corners(self, cells: LocalIndices) -> Array:
        """Return the limits at corners of cells, vertices in the plane and edges in space.

        Args:
            cells: Owned cells.

        Returns:
            Shape (cells, corners, n, d, n, d).
        """
        shape = self.entries[0].shape
        result = np.zeros((*shape, len(cells), len(self._corners)))
        for inside, place, values in self._at_corners(cells):
            result[place][inside] += values
        return np.moveaxis(result, (4, 5), (0, 1))

    def mixed_at_corners(self, cells: LocalIndices) -> Array:
        """Return one linear combination of all coefficients at corners, shape (cells, corners).

        Where coefficients differ, so do their combinations, but for unlikely coincidences.
        """
        weights = mixing(self.entries[0].shape)
        result = np.zeros((len(cells), len(self._corners)))
        for inside, place, values in self._at_corners(cells):
            result[inside] += weights[place] * values
        return result

    @property
    def _corners(self) -> Array:
        """The vertices of the reference triangle, or the middles of the tetrahedron's edges."""
        cell, dim = basix.CellType[self.domain.topology.cell_name()], self.domain.topology.dim
        corners = np.asarray(basix.geometry(cell))
        return np.array([corners[list(v)].mean(axis=0) for v in basix.topology(cell)[dim - 2]])

    def _at_corners(self, cells: LocalIndices) -> Iterator[tuple[Mask, tuple[int, ...], Array]]:
        """Yield the values of each entry, with the cells that have the entry."""
        points = Points(self.domain, cells, self._corners)
        coordinates = list(points.inside)
        zero = np.zeros_like(coordinates[0])
        for f, is_zero in self.functions:
            coordinates += [zero] * math.prod(f.ufl_shape) if is_zero else points.values(f)
        x = np.stack(coordinates, axis=2)
        for entries, own in zip(self.entries, self.cells, strict=True):
            inside: Mask = np.isin(cells, own) if own is not None else np.ones(len(cells), bool)
            distinct: list[Node] = list(dict.fromkeys(entries.flat))
            found = dict(zip(distinct, together(distinct, x[inside]), strict=True))
            for place in np.ndindex(entries.shape):
                yield inside, place, found[entries[place]]


def mixing(shape: tuple[int, ...]) -> Array:
    """Return weights of a linear combination that tells different tensors of a shape apart."""
    return np.sqrt(2.0 + np.arange(math.prod(shape))).reshape(shape)


def principal_part(a: ufl.Form) -> PrincipalPart | None:
    """Return the coefficients of a form on first derivatives; None where they are not readable."""
    space, reading = a.arguments()[0].ufl_function_space(), Reading(a)
    size, dim = space.dofmap.bs, space.mesh.geometry.dim
    found, cells = [], []
    for i, integral in enumerate(a.integrals()):
        if integral.integral_type() != "cell":
            continue
        entries = np.empty((size, dim, size, dim), dtype=object)
        for place in np.ndindex(entries.shape):
            chosen = [place[0] + size * (1 + place[1]), place[2] + size * (1 + place[3])]
            read = [reading.formula(p, chosen, functions=True) for p in reading.places(i)]
            known = [formula.root for formula in read if formula is not None]
            if len(known) < len(read):
                return None
            entries[place] = sum(known, ZERO)
        found.append(entries)
        cells.append(cells_of(space.mesh, integral))
    if not found:
        return None
    leaves = {n for part in found for root in set(part.flat) for n in nodes(root)}
    used = {int(n.value) for n in leaves if n.op == "coordinate"}
    functions = tuple(
        (f, used.isdisjoint(int(n.value) for n in components.flat))
        for f, components in more_coordinates(dim, a.coefficients()).items()
    )
    part = PrincipalPart(space.mesh, tuple(found), tuple(cells), functions)
    try:  # values of functions in other spaces are not known
        part.at_corners(np.empty(0, dtype=np.int32))
    except InputError:
        return None
    return part


def diffusion_part(domain: mesh.Mesh, rows: Sequence[Sequence[Formula]]) -> PrincipalPart:
    """Return the coefficients of a diffusion tensor.

    Args:
        domain: The mesh.
        rows: The rows of the tensor; one entry stands for a multiple of the identity, none for 1.
    """
    entries = np.array(tensor(rows, domain.geometry.dim), dtype=object)
    return PrincipalPart(domain, (entries[None, :, None],), (None,))
