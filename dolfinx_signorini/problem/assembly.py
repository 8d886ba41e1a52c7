"""Assembly: forms, obstacles and Dirichlet data become a system.

The system is made once, and again from the parts whose data have changed.
"""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import ufl
from dolfinx import fem, mesh
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc

from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.arrays import Array, LocalIndices, union
from dolfinx_signorini.base.changed_values import Watch
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.base.ranks import anywhere, highest
from dolfinx_signorini.base.sums_of_squares import is_sum_of_squares
from dolfinx_signorini.base.timing import Phases
from dolfinx_signorini.base.tolerances import FAR
from dolfinx_signorini.data.interfaces.piecewise_forms import IN_PIECES, by_data
from dolfinx_signorini.problem import checks, held
from dolfinx_signorini.problem.constraint import Constraint
from dolfinx_signorini.problem.directions import Directions, scalar_space
from dolfinx_signorini.problem.values import evaluator
from dolfinx_signorini.solvers.loose import Loose
from dolfinx_signorini.solvers.system import Layout, System


class Assembly:
    """What a system is assembled from.

    An assembly makes a system, and later the system for changed data:

        assembly = Assembly(a, L, constraint, bcs)
        system = assembly.system()
        wind.value = 2.0
        system = assembly.renewed(system)

    Args:
        a: The bilinear form.
        L: The linear form.
        constraint: The obstacles.
        bcs: The Dirichlet conditions.
        form_compiler_options, jit_options: See `dolfinx.fem.form`.

    Attributes:
        layout: The dofs with a constraint or Dirichlet data.
        zone_dofs: For each zone of the constraint the owned dofs, nodes of vectors, that it has.
        obstacles: The bounds of the last system from below and above, as far as there are such
            obstacles, at the owned dofs that have an obstacle: of several obstacles the tightest.
        owners: For each of these bounds the number of the zone that the tightest obstacle is of;
            none where there is one zone.
        phases: The seconds of the phases so far.
        directions: The directions of the obstacle, where the unknowns are vectors; else None.
        total_load: L(1), the sum of the load on all basis functions.
        assembled: The forms a and L that are assembled, see `by_data`: with rules in place of
            those that follow the data, and with pieces where a problem is posed so.
    """

    total_load: float
    assembled: tuple[ufl.Form, ufl.Form]

    def __init__(
        self,
        a: ufl.Form,
        L: ufl.Form,
        constraint: Constraint,
        bcs: Sequence[fem.DirichletBC],
        form_compiler_options: Mapping[str, Any] | None = None,
        jit_options: Mapping[str, Any] | None = None,
    ):
        space = a.arguments()[0].ufl_function_space()
        self.bcs, self.comm, self._forms = list(bcs), space.mesh.comm, (a, L)
        self.phases, self._pieces = Phases(self.comm), IN_PIECES.get()
        with self.phases("forms"):
            zones = constraint.zones
            dim, entities = zones[0].dim, zones[0].entities
            given = [obstacle.sign for obstacle in constraint.obstacles]
            sides = tuple(sign for sign in (1.0, -1.0) if sign in given)
            fixed = _dirichlet_dofs(space, self.bcs)
            self.directions: Directions | None = None
            if constraint.vectors:
                nodal = scalar_space(space)
                self.zone_dofs = [dofs_on_entities(nodal, dim, entities)]
                known = entities, self.zone_dofs[0], fixed, constraint.direction
                self.directions = Directions(space, nodal, *known)
                dofs, frame = self.directions.dofs, self.directions.frame
            else:
                self.zone_dofs = [dofs_on_entities(space, z.dim, z.entities) for z in zones]
                dofs, frame = union(self.zone_dofs), None
            self.layout = Layout(space, dim, entities, sides, dofs, fixed, frame)
            self._options: dict[str, Any] = {
                "form_compiler_options": form_compiler_options,
                "jit_options": jit_options,
            }
            self._take()
            self._given = [(k, each) for k, zone in enumerate(zones) for each in zone.obstacles]
            self._held_weakly = constraint.held_weakly
            self._look_up()
            self._watch_a, self._watch_L = Watch(a), Watch(L)
            self.owners: list[LocalIndices] = []
            self._due = False, False  # whether matrix and load are to be assembled again

    def _look_up(self) -> None:
        """Find where the obstacles are evaluated, on the mesh as it is now."""
        space, dofs = self.layout.nodal, self.zone_dofs
        self._watch_nodes = Watch(space.mesh)
        self._obstacles_at = [evaluator(space, g.data, dofs[k], g.name) for k, g in self._given]

    def _take(self) -> None:
        """Take the forms with the present data, both or none of them."""
        a, L = (by_data(form, self._pieces) for form in self._forms)
        made = (
            compiled.form(a, "form a", **self._options),
            compiled.form(L, "load", **self._options),
        )
        (self._a, self._L), self.assembled = made, (a, L)
        # Whether forms are assembled that were made of the present data.
        self._replaced = any(x is not y for x, y in zip(self.assembled, self._forms, strict=True))

    def system(self) -> System:
        """Assemble the system.

        Raises:
            InputError: The data make no sense, see `SignoriniProblem`.
        """
        return self._assembled(self._bounds())

    def renewed(self, old: System, matrix: bool = False) -> System:
        """Return the system for the present data; the old one must not be used any more.

        What is to be assembled is remembered until it is: data that are refused may be mended.

        Args:
            old: The system so far.
            matrix: Assemble matrix and load in any case, as on a mesh that has moved.

        Raises:
            InputError: The data make no sense, see `SignoriniProblem`. The entries of the old
                system are lost then, and the next call assembles all of them again.
        """
        matrix = matrix or self._has_moved()
        if matrix:  # the shares of the boundary and the places of the dofs are others
            self.layout, self._due = replace(self.layout), (True, True)
            self._look_up()
        obstacle, data = self._bounds()  # first: a refusal must not use up the changes of a and L
        changed = self._changed()
        self._due = self._due[0] or changed[0], self._due[1] or any(changed)
        if self._replaced and (matrix or any(changed)):  # the forms were made of other data
            self._take()
        fresh, load = self._due
        moved = bool((data != old.fixed_values).any())
        if not anywhere(self.comm, load or moved):
            return replace(old, obstacle=obstacle)
        self._due = True, True
        made = self._assembled((obstacle, data), old, fresh)
        old.b.destroy()
        self._due = False, False
        return made

    def has_changed(self) -> bool:
        """Return whether data are others than those of the last system; collective."""
        fresh = self._changed()
        self._due = self._due[0] or fresh[0], self._due[1] or any(fresh)
        if self._has_moved():
            return True
        data = _dirichlet_values(self.layout.space, self.bcs, self.layout.fixed_dofs)
        now = [data, *(at() for at in self._obstacles_at)]
        same = all(np.array_equal(*both) for both in zip(self._read, now, strict=True))
        return any(self._due) or anywhere(self.comm, not same)

    def _has_moved(self) -> bool:
        """Return whether the mesh has moved since the places of the dofs were found; collective."""
        return anywhere(self.comm, self._watch_nodes.differs())

    def _changed(self) -> tuple[bool, bool]:
        """Whether data of a and of L have changed since this was asked; collective."""
        return self._watch_a.changed(self.comm), self._watch_L.changed(self.comm)

    def _bounds(self) -> tuple[Array, Array]:
        """Return the obstacle of each constraint and the Dirichlet data, all of them checked."""
        layout = self.layout
        data = _dirichlet_values(layout.space, self.bcs, layout.fixed_dofs)
        nodes = layout.fixed_dofs // layout.block
        checks.check_finite(layout.nodal, nodes, data, "Dirichlet data")
        read = [data, *(at() for at in self._obstacles_at)]
        self._values = read[1:]
        for (zone, each), found in zip(self._given, self._values, strict=True):
            checks.check_finite(layout.nodal, self.zone_dofs[zone], found, each.name)
        if self.directions is not None:
            ((_, each),), (gaps,) = self._given, self._values
            upper = [(-1.0, gaps / self.directions.lengths)]
            size = functools.partial(self._size_of_solution, data, upper)
            self.obstacles = [self.directions.bounds(gaps, data, each.name, size)]
            self._read = read
            return self.obstacles[0][layout.free], data
        signed = [(each.sign, v) for (_, each), v in zip(self._given, read[1:], strict=True)]
        size = functools.partial(self._size_of_solution, data, signed)
        for k, (zone, each) in enumerate(self._given):
            known = self.zone_dofs[zone], self._values[k], data
            self._values[k] = checks.clamped(layout, each, *known, size)
        self.obstacles = checks.apart(layout, self._tightest(), self._upper_name, size)
        self._read = read
        return np.concatenate([found[layout.free] for found in self.obstacles]), data

    def _tightest(self) -> list[Array]:
        """Return the bounds of the obstacles, `FAR` away where a dof has none on that side."""
        self.owners = []
        if len(self.zone_dofs) == 1:
            return self._values
        layout, bounds = self.layout, []
        for sign in layout.sides:
            bound = np.full(len(layout.obstacle_dofs), -sign * np.inf)
            owner: LocalIndices = np.zeros(len(bound), dtype=np.int32)
            for (zone, each), found in zip(self._given, self._values, strict=True):
                if each.sign == sign:
                    at = np.searchsorted(layout.obstacle_dofs, self.zone_dofs[zone])
                    tighter = sign * (found - bound[at]) >= 0.0
                    bound[at[tighter]], owner[at[tighter]] = found[tighter], zone
            bounds.append(np.clip(bound, -FAR, FAR))
            self.owners.append(owner)
        return bounds

    def _upper_name(self, k: int) -> str:
        """The name of the upper obstacle that is the tightest one at the k-th dof."""
        zone = self.owners[-1][k] if self.owners else 0
        return next(each.name for at, each in self._given if at == zone and each.sign < 0.0)

    def values_in(self, zone: int) -> list[Array]:
        """Return the values of the obstacles of a zone in the last system, at its dofs."""
        both = zip(self._given, self._values, strict=True)
        return [values for (number, _), values in both if number == zone]

    def _size_of_solution(self, data: Array, obstacles: Sequence[tuple[float, Array]]) -> float:
        """Return about how large the solution is, up to a power of the size of the domain.

        The solution is as large as Dirichlet data and load make it, or as obstacles push. An
        obstacle that nothing reaches says nothing, unless there are neither data nor load.

        Args:
            data: The Dirichlet data; the call is collective.
            obstacles: The sign and the values of each obstacle.
        """
        size = max(highest(self.comm, np.abs(data)), self._size_by_load())
        if size > 0.0:
            pushed = (highest(self.comm, sign * values) for sign, values in obstacles)
            return max(size, *pushed)
        return max(highest(self.comm, np.abs(values)) for _, values in obstacles)

    def _size_by_load(self) -> float:
        """Return about how large the solution is without any bounds or data."""
        A = fem_petsc.assemble_matrix(self._a)
        A.assemble()
        diagonal = A.getDiagonal()
        load = compiled.assembled(self._L, self.layout.space).x.array[: diagonal.getLocalSize()]
        reach = float(self.comm.allreduce(np.abs(load).sum())) / _size(diagonal)
        destroy(A, diagonal)
        return reach

    def _assembled(
        self, bounds: tuple[Array, Array], old: System | None = None, matrix: bool = True
    ) -> System:
        """Return the system with obstacle and Dirichlet data, and the old matrix or a new one."""
        kept = None if matrix else old
        A = self._matrix(old) if kept is None else kept.A
        vector, fixed = A.getDiagonal(), self.layout.fixed_dofs
        diagonal = np.array(vector.array_r)
        vector.destroy()
        with self.phases("load"):
            b = fem_petsc.assemble_vector(self._L)
            with b.localForm() as local:
                self.total_load = self.comm.allreduce(float(local.array_r.sum()))
            if self.bcs:
                fem_petsc.apply_lifting(b, [self._a], bcs=[self.bcs])
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            b.array_w[fixed] = diagonal[fixed] * bounds[1]
            b.array_w[:] = self.layout.turned(b.array_r)
        with self.phases("checks"):
            try:
                return self._checked(A, b, diagonal, bounds, old, kept)
            except InputError:
                b.destroy()
                if old is None:
                    A.destroy()
                raise

    def _matrix(self, old: System | None) -> PETSc.Mat:
        with self.phases("matrix"):
            fixed, frame = self.layout.fixed_dofs, self.layout.frame
            known = None if old is None else old.A
            if frame is None:
                return _assembled_matrix(self._a, self.bcs, fixed, known)
            A = _assembled_matrix(self._a, self.bcs, fixed)
            turn = frame.matrix().transpose()
            turned = A.ptap(turn)
            turned.setBlockSize(self.layout.block)
            destroy(A, turn)
            if known is None:
                return turned
            # PETSc reuses a product on several ranks for the same two factors only.
            turned.copy(known, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            turned.destroy()
            return known

    def _checked(
        self,
        A: PETSc.Mat,
        b: PETSc.Vec,
        diagonal: Array,
        bounds: tuple[Array, Array],
        old: System | None,
        kept: System | None,
    ) -> System:
        """Return the system of its parts, after a check of what is new."""
        checks.check_entries(self.comm, diagonal, b.array_r)
        doubtful = kept is None and not is_sum_of_squares(self._forms[0])
        if doubtful:
            checks.check_symmetry(A)
        if kept is None:
            loose, free = self._loose(A, diagonal)
            shares = held.shares_of(free, self.layout)
        else:
            loose, free, shares = kept.loose, kept.free, kept.shares
        before = 0 if old is None else old.assembled
        made = System(
            layout=self.layout,
            A=A,
            b=b,
            obstacle=bounds[0],
            contact_diagonal=diagonal[self.layout.contact_dofs],
            fixed_values=bounds[1],
            loose=loose,
            free=free,
            shares=shares,
            assembled=before + (kept is None),
        )
        checks.check_range(made, diagonal, [each for _, each in self._given])
        if doubtful:
            checks.check_definite(A, self.layout, diagonal)
        (checks if self.layout.frame is None else held).check_held(made)
        return made

    def _loose(self, A: PETSc.Mat, diagonal: Array) -> tuple[Loose, Array]:
        """Return the motions on which the form vanishes: those that contact holds, and others."""
        loose = held.loose_motions(self.assembled[0], A, self.layout, diagonal)
        if self.layout.frame is None or not loose:
            return loose, np.empty((len(diagonal), 0))
        loose, free = held.divided(loose, self.layout, self._held_weakly)
        held.add_springs(A, free)
        return loose, free


def dofs_on_entities(space: fem.FunctionSpace, dim: int, entities: LocalIndices) -> LocalIndices:
    """Return the owned dofs on facets or cells, also on those that only another rank owns.

    Args:
        space: The function space.
        dim: The dimension of the facets or cells.
        entities: Facets or cells that this rank knows; the call is collective.
    """
    space.mesh.topology.create_connectivity(dim, space.mesh.topology.dim)
    dofs = fem.locate_dofs_topological(space, dim, entities)
    return dofs[dofs < space.dofmap.index_map.size_local]


def dofs_on_facets(space: fem.FunctionSpace, facets: LocalIndices) -> LocalIndices:
    """Return the owned dofs on facets, see `dofs_on_entities`."""
    return dofs_on_entities(space, space.mesh.topology.dim - 1, facets)


def _dirichlet_dofs(space: fem.FunctionSpace, bcs: Sequence[fem.DirichletBC]) -> LocalIndices:
    """The owned dofs that some Dirichlet conditions fix."""
    owned = space.dofmap.index_map.size_local * space.dofmap.bs
    dofs = union(bc.dof_indices()[0] for bc in bcs)  # whose own counts are wrong for vectors
    return dofs[dofs < owned]


def _dirichlet_values(
    space: fem.FunctionSpace, bcs: Sequence[fem.DirichletBC], dofs: LocalIndices
) -> Array:
    """The data of Dirichlet conditions at dofs; the last condition on a dof wins."""
    values = np.zeros(len(dofs))
    if bcs:
        index_map = space.dofmap.index_map
        everywhere = np.zeros((index_map.size_local + index_map.num_ghosts) * space.dofmap.bs)
        for bc in bcs:
            bc.set(everywhere)
        values[:] = everywhere[dofs]
    return values


def _assembled_matrix(
    form: fem.Form, bcs: Sequence[fem.DirichletBC], fixed: LocalIndices, A: PETSc.Mat | None = None
) -> PETSc.Mat:
    """The matrix of a form; Dirichlet rows get a diagonal of the size of the other rows."""
    if A is None:
        A = fem_petsc.assemble_matrix(form, bcs=list(bcs))
    else:
        A.zeroEntries()
        fem_petsc.assemble_matrix(A, form, bcs=list(bcs))  # type: ignore[misc, arg-type]
    A.assemble()
    if bcs:
        diagonal = A.getDiagonal()
        diagonal.array_w[fixed] = 0.0  # the largest entry and not 1: the unit of the form is free
        diagonal.array_w[fixed] = _size(diagonal)
        A.setDiagonal(diagonal)
        A.assemble()
        diagonal.destroy()
    return A


def restricted(form: ufl.Form, domain: mesh.Mesh, cells: LocalIndices) -> ufl.Form:
    """Return a form whose integrals over cells are over some of their cells only.

    Args:
        form: A form of integrals over cells and exterior facets.
        domain: The mesh of the form.
        cells: Cells of this rank; ghosts among them are left out.
    """
    owned = cells[cells < domain.topology.index_map(domain.topology.dim).size_local]
    parts: list[tuple[int, LocalIndices]] = []
    integrals = []
    for integral in form.integrals():
        if integral.integral_type() == "cell":
            data, number = integral.subdomain_data(), integral.subdomain_id()
            known = {} if data is None else dict(data)
            here = owned
            if number not in ("everywhere", "otherwise"):
                here = np.intersect1d(owned, known[number]).astype(np.int32)
            parts.append((len(parts), here))
            change = {"subdomain_id": len(parts) - 1, "subdomain_data": parts}
            integral = integral.reconstruct(**change)
        integrals.append(integral)
    return ufl.Form(integrals)


def _size(diagonal: PETSc.Vec) -> float:
    largest = float(diagonal.norm(PETSc.NormType.INFINITY))
    return largest if largest > 0.0 else 1.0
