"""The first mesh of the adaptive loop, which resolves every narrow load, flux and obstacle.

An adaptive loop knows the data from their values at points of a mesh, and data that vanish at all
of these points are not there for the loop. So the first mesh is refined until polynomials on the
cells follow the data. The data are known from samples and enclosures, which no feature escapes.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

import basix
import numpy as np
from dolfinx import mesh

from dolfinx_signorini.accuracy.marking import NOTABLE
from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices, Mask
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.ranks import anywhere, highest
from dolfinx_signorini.base.tolerances import HALF_OF_THE_DIGITS, SOLVED
from dolfinx_signorini.data.coefficients import Coefficients
from dolfinx_signorini.data.formulas import evaluated
from dolfinx_signorini.data.interfaces.fitting import fitted_mesh
from dolfinx_signorini.data.interfaces.jumps import broken_cells
from dolfinx_signorini.data.interfaces.pieces import inside, widths
from dolfinx_signorini.data.interfaces.singular_sets import jumps
from dolfinx_signorini.data.powers import SingularPoint, singular_points
from dolfinx_signorini.data.sampling import HIDDEN, Datum, Samples, sample
from dolfinx_signorini.meshes.points import points_at
from dolfinx_signorini.meshes.polynomials import depths
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, cell_corners, longest_side, owned_cells
from dolfinx_signorini.norms.power_sums import collected

MOST_CELLS = 3_000  # of a first mesh, which one rank fits to jumps, and which no solution tells of
# What the deviation of a datum from polynomials may be, of its norm: in all cells, and
# the height in one. More than 0.02 overlooks narrow diffusions, and less than 0.05 refines
# at each kink of an obstacle (tests/accuracy/test_data_in_python.py and test_narrow_data.py).
MASS, HEIGHT = 0.02, HIDDEN["height"]
JUMP = 1.0 / 32.0  # of the domain: where the values of a datum jump, cells are not made smaller


@dataclass(frozen=True)
class Resolved:
    """A mesh on which polynomials follow some data:

        first = resolved_mesh(data_of(problem), sided, max_cells=3000)
        print(*first.notes, sep="; ")

    Attributes:
        sided: The mesh with its sides.
        notes: What is not known or not resolved, in words.
        singular: Where data make the solution like a power of the distance; the same on all ranks.
    """

    sided: SidedMesh
    notes: tuple[str, ...]
    singular: tuple[SingularPoint, ...] = ()


def first_mesh(
    sided: SidedMesh,
    data: Callable[[SidedMesh], Sequence[Datum]],
    coefficients: Coefficients,
    degree: int,
    max_unknowns: float,
    stiffness: Collection[str],
    subject: str,
) -> Resolved:
    """Return a mesh that resolves data and is fitted to their jumps; the call is collective.

    Args:
        sided: A coarse mesh.
        data: Returns the data on a mesh.
        coefficients: The coefficients of a scalar problem.
        degree: The degree of the elements.
        max_unknowns: The limit on the dofs, with room for the division of all cells.
        stiffness: The names of the data of the stiffness of an elastic body; of a scalar problem
            none.
        subject: The subject of the error.

    Raises:
        InputError: The stiffness of an elastic body jumps or has a kink inside of cells.
    """
    per_cell = (2 * degree) ** sided.mesh.topology.dim
    most = min(MOST_CELLS, int(max_unknowns // per_cell))
    straight = [f for f in (coefficients.load, coefficients.reaction) if f is not None]
    if stiffness:
        straight = [datum.formula for datum in _with_jumps(data(sided))]
    fit = partial(fitted_mesh, formulas=coefficients.entries, max_cells=most, straight=straight)
    fitted = fit(sided)
    known = data(fitted)
    stiff = [datum for datum in known if datum.name in stiffness]
    _require_no_jumps(stiff, fitted, subject)
    resolved = resolved_mesh(known, fitted, most)
    # Narrow layers are found by `resolved_mesh` only.
    singular = () if stiffness else singular_points_of(known, sided)
    made = fit(resolved.sided, points=[point.place for point in singular])
    return replace(resolved, sided=made, singular=singular)


def singular_points_of(data: Sequence[Datum], sided: SidedMesh) -> tuple[SingularPoint, ...]:
    """Return the points where data make a solution like a power of the distance; collective.

    The solution is like given values, and smoother by a power than a flux or a coefficient, and by
    two powers than a load in the domain. Where a datum whose values are taken at nodes has none,
    as x log x has none at 0, a point is to be no node, and does not count.

    Args:
        data: The data of a scalar problem.
        sided: The mesh of the data.
    """
    dimension = sided.mesh.topology.dim
    taken = [datum.formula.root for datum in data if datum.measure == "height"]
    found = []
    for datum in data if dimension == 2 else []:
        smoother = 0.0
        if datum.measure == "mass":
            smoother = 2.0 if datum.corners.shape[1] > dimension else 1.0
        for place, exponent in singular_points(datum.formula, datum.corners):
            if all(np.isfinite(evaluated(root, np.array(place))) for root in taken):
                found.append(SingularPoint(place, exponent + smoother))
    return tuple(sorted(set().union(*sided.mesh.comm.allgather(found))))


def _with_jumps(data: Sequence[Datum]) -> list[Datum]:
    """Return the data that are integrated and that may jump or have a kink."""
    return [datum for datum in data if datum.measure == "mass" and jumps(datum.formula)]


def _require_no_jumps(data: Sequence[Datum], sided: SidedMesh, subject: str) -> None:
    """Refuse a stiffness that jumps inside of cells, where no term of the error sees the jump."""
    found = [d.name for d in _with_jumps(data) if len(broken_cells([d.formula], sided.mesh))]
    names = sorted(set().union(*sided.mesh.comm.allgather(found)))
    if names:
        message = f"{', '.join(names)} of displacements jumps inside of cells of the first mesh"
        advice = "facets are moved to straight jumps alone; let facets of the mesh follow this one"
        raise InputError(f"{message}; {advice}", subject)


def resolved_mesh(data: Sequence[Datum], sided: SidedMesh, max_cells: int = MOST_CELLS) -> Resolved:
    """Refine a mesh until polynomials on the cells follow the data; the call is collective.

    Args:
        data: The data on the mesh.
        sided: The mesh, which should be coarse.
        max_cells: The limit on the number of cells.
    """
    comm = sided.mesh.comm
    size = longest_side(sided.mesh)
    fits = [_Interpolation(datum, sided.mesh, size) for datum in data]
    notes = [fit.doubt for fit in fits if fit.doubt]
    while True:
        marks = np.zeros(len(owned_cells(sided.mesh)), dtype=bool)
        for fit in fits:
            marks |= fit.marks(sided.mesh)
        if not anywhere(comm, marks):
            return Resolved(sided, tuple(notes))
        refinement = refined(sided, np.flatnonzero(marks).astype(np.int32))
        if comm.allreduce(len(refinement.parents)) > max_cells:
            break
        sided = refinement.sided
        for fit in fits:
            fit.follow(sided.mesh, refinement.parents)
    coarse = "is narrower than the cells of the first mesh, which is as fine as its limits allow"
    rough = [fit.name for fit in fits if anywhere(comm, fit.marks(sided.mesh))]
    notes += [f"{name} {coarse}" for name in rough]
    return Resolved(sided, tuple(dict.fromkeys(notes)))


class _Interpolation:
    """The polynomials that interpolate a datum on the cells of a mesh, and their errors.

    Args:
        datum: The datum.
        domain: The mesh.
        size: The width of the domain.

    Attributes:
        name: What the datum is called.
        doubt: What is not known, in words; "" for nothing.
    """

    def __init__(self, datum: Datum, domain: mesh.Mesh, size: float):
        self.datum, self.size, self.name = datum, size, datum.name
        cell = basix.CellType[domain.topology.cell_name()]
        variant = basix.LagrangeVariant.gll_warped
        self.element = basix.create_element(basix.ElementFamily.P, cell, datum.degree, variant)
        self.samples: Samples = sample(datum, domain.comm, size)
        self.deviations = np.zeros(len(self.samples.points))
        self._fit(domain, np.arange(len(self.samples.points)))
        self.doubt = ""
        if self.samples.hidden > HEIGHT:
            self.doubt = f"{self.name} may have features so narrow that they are overlooked"

    def marks(self, domain: mesh.Mesh) -> Mask:
        """Return whether each owned cell is too large for the datum; the call is collective."""
        samples, count = self.samples, len(owned_cells(domain))
        if samples.norm == 0.0:
            return np.zeros(count, dtype=bool)
        shares, wide = self._shares(count), widths(cell_corners(domain)) / self.size
        if self.datum.measure == "height":
            jumping = np.bincount(samples.owners, samples.unclear, count) > 0.0
            return (shares > HEIGHT) & (wide > np.where(jumping, JUMP, HALF_OF_THE_DIGITS))
        if domain.comm.allreduce(float(shares.sum())) <= MASS:
            return np.zeros(count, dtype=bool)
        return (shares > NOTABLE * highest(domain.comm, shares)) & (wide > HALF_OF_THE_DIGITS)

    def follow(self, domain: mesh.Mesh, parents: LocalIndices) -> None:
        """Go on to a refined mesh.

        Args:
            domain: The refined mesh.
            parents: For each of its owned cells the cell of the mesh so far.
        """
        samples, old = self.samples, self.samples.owners
        children = np.argsort(parents, kind="stable")
        count = np.bincount(parents, minlength=1 + old.max(initial=-1))
        first = np.concatenate(([0], np.cumsum(count)))[old]
        samples.owners = children[first]
        moved = np.flatnonzero(count[old] > 1)
        best = np.full(len(moved), -math.inf)
        for k in range(int(count[old].max(initial=0))):
            rows = np.flatnonzero(count[old[moved]] > k)
            candidates = children[first[moved[rows]] + k]
            inner = depths(self._pulled_back(domain, moved[rows], candidates))
            better = inner > best[rows]
            best[rows[better]] = inner[better]
            samples.owners[moved[rows[better]]] = candidates[better]
        self._fit(domain, moved)

    def _fit(self, domain: mesh.Mesh, rows: Indices) -> None:
        """Find the deviations of samples from the interpolation of the datum on their cells."""
        samples, nodes = self.samples, np.asarray(self.element.points, dtype=np.float64)
        # Data may jump across a facet: nodes on facets are moved into their cell.
        nodes = nodes + SOLVED * (nodes.mean(axis=0) - nodes)
        chosen, place = np.unique(samples.owners[rows], return_inverse=True)
        values = evaluated(self.datum.formula.root, inside(cell_corners(domain, chosen), nodes)).T
        values = np.where(np.isfinite(values), values, 0.0)
        points = self._pulled_back(domain, rows, samples.owners[rows])
        basis = np.asarray(self.element.tabulate(0, points))[0, :, :, 0]
        fitted = np.einsum("pn,pn->p", basis, values[place])
        self.deviations[rows] = np.abs(samples.values[rows] - fitted)

    def _pulled_back(self, domain: mesh.Mesh, rows: Indices, cells: Indices) -> Array:
        """The places of samples in the reference cell, each in the cell that is named for it."""
        return points_at(domain, cells.astype(np.int32), self.samples.points[rows, None]).at[:, 0]

    def _shares(self, count: int) -> Array:
        """The deviation in each cell, of the norm of the datum."""
        samples, mass = self.samples, self.datum.measure == "mass"
        values = samples.weights * self.deviations if mass else self.deviations
        found = collected(values, samples.owners, count, 1.0 if mass else math.inf)
        return np.asarray(found / samples.norm)
