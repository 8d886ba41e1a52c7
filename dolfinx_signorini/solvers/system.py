"""The discrete problem as arrays in PETSc.

The solvers of this package see one system,

    minimise 1/2 v.A v - b.v  over all v with  v_i >= g_i at the contact dofs,

with the Dirichlet data eliminated symmetrically: a Dirichlet row of A has only its diagonal entry.
An upper obstacle, u <= g, is the system for -u, with -b and -g. What the problem does not mention
is neither assembled nor stored; the obstacle is an array over the contact dofs.
"""

import functools
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.costs import Ledger
from dolfinx_signorini.meshes.sided_meshes import facet_cells
from dolfinx_signorini.solvers.connected_parts import Bodies, bodies
from dolfinx_signorini.solvers.densities import Densities


@dataclass(frozen=True)
class Layout:
    """The dofs of a problem that have a constraint or Dirichlet data; they never change.

    Attributes:
        space: The function space.
        facets: The contact facets that this rank knows.
        boundary_dofs: The owned dofs on the contact boundary, with or without Dirichlet data.
        fixed_dofs: The owned dofs with Dirichlet data.
        ledger: Where the costs of the problem are noted.
    """

    space: fem.FunctionSpace
    facets: LocalIndices
    boundary_dofs: LocalIndices
    fixed_dofs: LocalIndices
    ledger: Ledger = field(repr=False)

    @functools.cached_property
    def free(self) -> npt.NDArray[np.bool_]:
        """Whether a dof on the contact boundary has no Dirichlet data."""
        return ~np.isin(self.boundary_dofs, self.fixed_dofs)

    @functools.cached_property
    def contact_dofs(self) -> LocalIndices:
        """The owned dofs on the contact boundary without Dirichlet data."""
        return self.boundary_dofs[self.free]

    @functools.cached_property
    def bodies(self) -> Bodies:
        """The connected parts of the mesh; the first call is collective."""
        return bodies(self.space)

    @functools.cached_property
    def facet_cells(self) -> LocalIndices:
        """The contact facets that this rank owns as (cell, local facet) pairs."""
        topology = self.space.mesh.topology
        owned = self.facets < topology.index_map(topology.dim - 1).size_local
        return facet_cells(self.space.mesh, self.facets[owned])

    @functools.cached_property
    def _densities(self) -> Densities:
        return Densities(self.space, self.facet_cells)

    @property
    def weights(self) -> Array:
        """The integrals of the basis functions of the contact dofs of this rank, a collective call.

        A weight is the force of the pressure 1 on the dof. Nodal weights may be zero or negative at
        the vertices of tetrahedra, of even degree.
        """
        return self._densities.integrals[self.contact_dofs]

    def density(self, forces: Array) -> fem.Function:
        """Return the density of forces on the contact dofs: its integral is their sum.

        Args:
            forces: The forces on the contact dofs of this rank; the call is collective.
        """
        density = fem.Function(self.space, name="pressure")
        density.x.array[self.contact_dofs] = forces
        density.x.scatter_forward()
        density.x.array[:] = self._densities.of(density.x.array)
        return density


@dataclass(frozen=True)
class System:
    """A discrete problem with a lower obstacle, as every solver of this package takes it.

    A system belongs to a problem, which makes it and frees its PETSc objects:

        system = SignoriniProblem(a, L, contact=facets).system
        gap = x.array_r[system.contact_dofs] - system.obstacle

    Attributes:
        layout: The dofs with a constraint or Dirichlet data.
        A, b: PETSc matrix and vector, with the Dirichlet data eliminated.
        obstacle: The obstacle at the contact dofs.
        contact_diagonal: The diagonal entries of A at the contact dofs.
        fixed_values: The Dirichlet data at the fixed dofs.
        loose: For each body whether the form vanishes on the constants there, so that only contact
            holds the body; empty where the form holds all bodies.
        assembled: How often the matrix has been assembled.
    """

    layout: Layout
    A: PETSc.Mat
    b: PETSc.Vec
    obstacle: Array
    contact_diagonal: Array
    fixed_values: Array
    loose: npt.NDArray[np.bool_]
    assembled: int = 1

    @property
    def singular(self) -> bool:
        """Whether only contact holds some body, so that A has a kernel."""
        return bool(self.loose.any())

    @property
    def space(self) -> fem.FunctionSpace:
        """The function space."""
        return self.layout.space

    @property
    def contact_dofs(self) -> LocalIndices:
        """The owned dofs on the contact boundary that have no Dirichlet data."""
        return self.layout.contact_dofs

    @property
    def fixed_dofs(self) -> LocalIndices:
        """The owned dofs with Dirichlet data."""
        return self.layout.fixed_dofs

    @property
    def ledger(self) -> Ledger:
        """Where the costs of the problem are noted."""
        return self.layout.ledger

    @property
    def comm(self) -> MPI.Comm:
        """The communicator of the mesh."""
        return self.space.mesh.comm

    @property
    def unknowns(self) -> int:
        """The global number of dofs."""
        return int(self.space.dofmap.index_map.size_global)

    def scaled_gap(self, values: Array) -> Array:
        """Return the gaps of the contact dofs times the diagonal of A: forces, as multipliers are.

        Args:
            values: The values at the contact dofs.
        """
        with np.errstate(over="ignore"):  # an obstacle may be so far away that it is none
            return np.asarray(self.contact_diagonal * (values - self.obstacle))

    def start(self, values: Array | None = None) -> PETSc.Vec:
        """Return a feasible new vector: values of the owned dofs, or zero, projected."""
        x = self.A.createVecRight()
        x.array_w[:] = 0.0 if values is None else values[: x.getLocalSize()]
        self.project(x)
        return x

    def vector_of(self, u: fem.Function) -> PETSc.Vec:
        """Return the owned values of a function of the space as a new vector."""
        x = self.A.createVecRight()
        x.array_w[:] = u.x.array[: x.getLocalSize()]
        return x

    def project(self, x: PETSc.Vec, held: npt.NDArray[np.bool_] | None = None) -> bool:
        """Lift x to the obstacle where x lies below, and set the Dirichlet data.

        Args:
            x: The vector, changed in place.
            held: The contact dofs at which x is set to the obstacle, too; one entry each.

        Returns:
            Whether a value was changed on some rank.
        """
        dofs = np.concatenate((self.contact_dofs, self.fixed_dofs))
        old = x.array_r[dofs]
        lifted = np.maximum(old[: len(self.contact_dofs)], self.obstacle)
        if held is not None:
            lifted[held] = self.obstacle[held]
        new = np.concatenate((lifted, self.fixed_values))
        x.array_w[dofs] = new
        return bool(self.comm.allreduce(bool((new != old).any()), op=MPI.LOR))

    def touching(self, x: PETSc.Vec) -> npt.NDArray[np.bool_]:
        """Return whether x is at the obstacle, or below, at each contact dof of this rank."""
        return np.asarray(x.array_r[self.contact_dofs] <= self.obstacle)

    def multiplier(self, x: PETSc.Vec) -> Array:
        """Return A x - b at the contact dofs of this rank: the force on each of them."""
        force = x.duplicate()
        self.A.mult(x, force)
        force.axpy(-1.0, self.b)
        values = force.array_r[self.contact_dofs].copy()
        force.destroy()
        return values
