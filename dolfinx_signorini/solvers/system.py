"""The discrete problem as arrays in PETSc.

The solvers of this package see one system,

    minimise 1/2 v.A v - b.v  over all v with  s_c (v_i(c) - g_c) >= 0 for each constraint c,

with the Dirichlet data eliminated symmetrically: a Dirichlet row of A has only its diagonal entry.
A constraint c is a contact dof i(c) with an obstacle g_c, whose sign s_c is 1 for a lower obstacle
and -1 for an upper one. A dof between two obstacles has two constraints, of which one at most is
active. Where the unknowns are vectors, a node has several dofs, and a `Frame` turns those of the
contact nodes into directions of which one has the obstacle: v is the vector in these directions.
What the problem does not mention is neither assembled nor stored: gaps, forces and active sets are
arrays over the constraints of a rank.
"""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base import kernels
from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.ranks import anywhere
from dolfinx_signorini.base.tolerances import FAR
from dolfinx_signorini.meshes.components import Components, components
from dolfinx_signorini.meshes.sided_meshes import facet_cells
from dolfinx_signorini.solvers.densities import Densities
from dolfinx_signorini.solvers.frames import Frame
from dolfinx_signorini.solvers.loose import Loose


@dataclass(frozen=True)
class Layout:
    """The dofs of a problem that have a constraint or Dirichlet data; they never change.

    Attributes:
        space: The function space.
        dim: The dimension of the facets or cells that have an obstacle.
        entities: These facets or cells, as far as this rank knows them.
        sides: The signs of the obstacles: 1 for a lower one, -1 for an upper one.
        obstacle_dofs: The owned dofs of these entities, with or without Dirichlet data.
        fixed_dofs: The owned dofs with Dirichlet data.
        frame: The directions of the contact nodes, where the unknowns are vectors; nodes are then
            the dofs of the scalar space of one component.
    """

    space: fem.FunctionSpace
    dim: int
    entities: LocalIndices
    sides: tuple[float, ...]
    obstacle_dofs: LocalIndices
    fixed_dofs: LocalIndices
    frame: Frame | None = None

    @property
    def block(self) -> int:
        """The number of dofs of a node."""
        return int(self.space.dofmap.bs)

    @functools.cached_property
    def nodal(self) -> fem.FunctionSpace:
        """The scalar space of the nodes: that of one component where the unknowns are vectors."""
        return self.space if self.frame is None else self.frame.nodal

    @functools.cached_property
    def free(self) -> Mask:
        """Whether an obstacle's dof has no Dirichlet data, or its node a free direction."""
        if self.frame is not None:
            return self.frame.free
        return ~np.isin(self.obstacle_dofs, self.fixed_dofs)

    @property
    def obstacle_nodes(self) -> LocalIndices:
        """The owned nodes with an obstacle, dofs of `nodal`."""
        return self.obstacle_dofs // self.block

    @property
    def held_nodes(self) -> LocalIndices:
        """The nodes with an obstacle that Dirichlet data hold: all their dofs, or the direction."""
        return self.obstacle_nodes[~self.free]

    @functools.cached_property
    def free_dofs(self) -> LocalIndices:
        """The owned dofs with an obstacle and without Dirichlet data, each of them once."""
        return self.obstacle_dofs[self.free]

    @functools.cached_property
    def contact_dofs(self) -> LocalIndices:
        """The dof of each constraint: the constraints of the first obstacle come first."""
        return np.tile(self.free_dofs, len(self.sides))

    @functools.cached_property
    def contact_nodes(self) -> LocalIndices:
        """The node of each constraint, a dof of `nodal`."""
        return self.contact_dofs // self.block

    @functools.cached_property
    def signs(self) -> Array:
        """The sign of each constraint: 1 for a lower obstacle, -1 for an upper one."""
        return np.repeat(self.sides, len(self.free_dofs))

    @functools.cached_property
    def components(self) -> Components:
        """The connected parts of the mesh; the first call is collective."""
        return components(self.nodal)

    @property
    def in_domain(self) -> bool:
        """Whether the obstacle is in the domain, and not on the boundary alone."""
        return self.dim == self.space.mesh.topology.dim

    @functools.cached_property
    def owned_entities(self) -> LocalIndices:
        """The entities that this rank owns: facets as (cell, local facet) pairs, or cells."""
        count = self.space.mesh.topology.index_map(self.dim).size_local
        owned = self.entities[self.entities < count]
        return owned if self.in_domain else facet_cells(self.space.mesh, owned)

    @property
    def cells(self) -> LocalIndices:
        """The cells of these entities."""
        return self.owned_entities if self.in_domain else np.unique(self.owned_entities[:, 0])

    @functools.cached_property
    def _densities(self) -> Densities:
        return Densities(self.nodal, self.owned_entities)

    def turned(self, values: Array) -> Array:
        """Return values of the owned dofs in the directions of the contact nodes."""
        return values if self.frame is None else self.frame.turned(values)

    def turned_back(self, values: Array) -> Array:
        """Return values in the directions of the contact nodes as those of the owned dofs."""
        return values if self.frame is None else self.frame.turned(values, back=True)

    @property
    def weights(self) -> Array:
        """The integral of the basis function of each constraint's dof, a collective call.

        A weight is the force of the pressure 1 on the dof. Nodal weights may be zero or negative at
        the vertices of triangles and tetrahedra, of even degree.
        """
        return self._densities.integrals[self.contact_nodes]

    def forces_at(self, forces: Array) -> fem.Function:
        """Return the function whose coefficients are forces on u, 0 without an obstacle.

        Args:
            forces: The force of each constraint, in the direction of its sign; collective.
        """
        result = fem.Function(self.nodal, name="forces")
        np.add.at(result.x.array, self.contact_nodes, self.signs * forces)
        result.x.scatter_forward()
        return result

    def density(self, forces: fem.Function) -> fem.Function:
        """Return the density of forces on the dofs with an obstacle: its integral is their sum.

        Args:
            forces: The forces; the call is collective.
        """
        density = fem.Function(self.nodal, name="pressure")
        density.x.array[:] = self._densities.of(forces.x.array)
        return density


@dataclass(frozen=True)
class System:
    """A discrete problem with obstacles, as every solver of this package takes it.

    A system belongs to a problem, which makes it and frees its PETSc objects:

        system = SignoriniProblem(a, L, contact=facets).system
        in_contact = system.contact_dofs[system.touching(x)]

    Attributes:
        layout: The dofs with a constraint or Dirichlet data.
        A, b: PETSc matrix and vector, with the Dirichlet data eliminated.
        obstacle: The obstacle of each constraint.
        contact_diagonal: The diagonal entry of A of each constraint's dof.
        fixed_values: The Dirichlet data at the fixed dofs.
        loose: The motions on which the form vanishes, so that only contact holds them.
        free: Motions that nothing holds, and on which the load does no work: orthonormal columns,
            shape (dofs, motions). Springs in A hold them where they carry no force.
        shares: The weights with which the values of a function tell the motion that is nearest to
            the function in L2, likewise; `fill` leaves this motion out.
        assembled: How often the matrix has been assembled.
    """

    layout: Layout
    A: PETSc.Mat
    b: PETSc.Vec
    obstacle: Array
    contact_diagonal: Array
    fixed_values: Array
    loose: Loose
    free: Array
    shares: Array
    assembled: int = 1

    @property
    def singular(self) -> bool:
        """Whether only contact holds some motion, so that A has a kernel."""
        return bool(self.loose)

    @property
    def space(self) -> fem.FunctionSpace:
        """The function space."""
        return self.layout.space

    @property
    def contact_dofs(self) -> LocalIndices:
        """The owned dof of each constraint, see `Layout`."""
        return self.layout.contact_dofs

    @property
    def signs(self) -> Array:
        """The sign of each constraint: 1 for a lower obstacle, -1 for an upper one."""
        return self.layout.signs

    @property
    def fixed_dofs(self) -> LocalIndices:
        """The owned dofs with Dirichlet data."""
        return self.layout.fixed_dofs

    def known_dofs(self, held: Mask) -> LocalIndices:
        """Return the owned dofs of some constraints that hold, and those with Dirichlet data."""
        return np.concatenate((self.contact_dofs[held], self.fixed_dofs))

    @property
    def comm(self) -> MPI.Comm:
        """The communicator of the mesh."""
        return self.space.mesh.comm

    @property
    def unknowns(self) -> int:
        """The global number of dofs."""
        return int(self.space.dofmap.index_map.size_global * self.layout.block)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """The lower and upper bounds of the owned dofs, infinite where there is no obstacle."""
        return self._bounds(1.0), self._bounds(-1.0)

    @functools.cached_property
    def bounds_with_data(self) -> tuple[Array, Array]:
        """The bounds, both of them the Dirichlet data at fixed dofs."""
        lower, upper = self.bounds
        lower[self.fixed_dofs] = upper[self.fixed_dofs] = self.fixed_values
        return lower, upper

    def _bounds(self, sign: float) -> Array:
        bounds = np.full(self.A.getLocalSize()[0], -sign * np.inf)
        chosen = (self.signs == sign) & (np.abs(self.obstacle) < FAR)
        bounds[self.contact_dofs[chosen]] = self.obstacle[chosen]
        return bounds

    def scaled_gap(self, values: Array) -> Array:
        """Return the gaps of the constraints times the diagonal of A: forces, as multipliers are.

        Args:
            values: The value at the dof of each constraint.
        """
        with np.errstate(over="ignore"):  # an obstacle may be so far away that it is none
            return np.asarray(self.contact_diagonal * self.signs * (values - self.obstacle))

    def start(self, values: Array | None = None) -> PETSc.Vec:
        """Return a feasible new vector: values of the owned dofs, or zero, projected."""
        x = self.A.createVecRight()
        x.array_w[:] = 0.0 if values is None else self.layout.turned(values[: x.getLocalSize()])
        self.project(x)
        return x

    def vector_of(self, u: fem.Function) -> PETSc.Vec:
        """Return the owned values of a function of the space as a new vector."""
        x = self.A.createVecRight()
        x.array_w[:] = self.layout.turned(u.x.array[: x.getLocalSize()])
        return x

    def fill(self, u: fem.Function, x: PETSc.Vec) -> None:
        """Set a function of the space to a vector, the reverse of `vector_of`; collective."""
        values = x.array_r
        if self.free.shape[1]:
            values = values - self.free @ self.comm.allreduce(self.shares.T @ values)
        u.x.array[: x.getLocalSize()] = self.layout.turned_back(values)
        u.x.scatter_forward()

    def project(self, x: PETSc.Vec, held: Mask | None = None) -> bool:
        """Move x to an obstacle where x lies beyond, and set the Dirichlet data.

        Args:
            x: The vector, changed in place.
            held: The constraints at whose dofs x is set to the obstacle, too; one entry each.

        Returns:
            Whether a value was changed on some rank.
        """
        return self.place(x, held, bool(self._loop("moves", x, x.array_w)))

    def place(self, x: PETSc.Vec, held: Mask | None, moved: bool = False) -> bool:
        """Set x to the obstacle at the dofs of some constraints, and to the Dirichlet data.

        Args:
            x: The vector, changed in place.
            held: The constraints, one entry each; the two constraints of a dof exclude each other.
                None for no constraint.
            moved: Whether a value of x on this rank has been changed before.

        Returns:
            Whether a value was changed on some rank.
        """
        if held is not None:
            moved = bool(self._loop("places", x, held, x.array_w)) or moved
        moved = moved or bool((x.array_r[self.fixed_dofs] != self.fixed_values).any())
        x.array_w[self.fixed_dofs] = self.fixed_values
        return anywhere(self.comm, moved)

    def touching(self, x: PETSc.Vec) -> Mask:
        """Return whether x is at the obstacle, or beyond, for each constraint of this rank."""
        found = np.empty(len(self.obstacle), dtype=bool)
        self._loop("touches", x, found)
        return found

    def touching_once(self, x: PETSc.Vec) -> Mask:
        """As `touching`, but where both obstacles of a dof meet the first of them alone."""
        touching = self.touching(x).reshape(len(self.layout.sides), -1)
        touching[1:] &= ~touching[:1]
        return touching.ravel()

    def natural(self, x: PETSc.Vec, multiplier: Array, residual: Array) -> Array:
        """Turn a copy of A x - b into the natural residual, and return the pressure that holds x.

        Args:
            x: The vector.
            multiplier: A x - b, the rows of this rank.
            residual: The copy, changed in place.

        Returns:
            The force of each constraint where the force exceeds the scaled gap, 0 elsewhere.
        """
        pressing = np.empty(len(self.obstacle))
        self._loop("natural", x, multiplier, residual, pressing)
        return pressing

    def defect(self, x: PETSc.Vec, multiplier: Array) -> Array:
        """Return force minus scaled gap of each constraint, for the rows of A x - b."""
        found = np.empty(len(self.obstacle))
        self._loop("defects", x, multiplier, found)
        return found

    def _loop(self, name: str, x: PETSc.Vec, *given: Array | Mask) -> Any:
        """Run a compiled loop over the constraints."""
        constraints = self.contact_dofs, self.signs, self.obstacle, self.contact_diagonal
        return kernels.run(name, len(self.obstacle), *constraints, x.array_r, *given)

    def set_forces(self, x: PETSc.Vec, result: PETSc.Vec) -> None:
        """Set a vector to A x - b."""
        self.A.mult(x, result)
        result.axpy(-1.0, self.b)

    def multiplier(self, x: PETSc.Vec) -> Array:
        """Return the force of each constraint of this rank: its sign times A x - b at its dof."""
        force = x.duplicate()
        self.set_forces(x, force)
        values = self.signs * force.array_r[self.contact_dofs]
        force.destroy()
        return np.asarray(values)
