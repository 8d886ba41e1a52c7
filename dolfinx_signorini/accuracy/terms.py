"""The identity of the error, term by term, with signs, on the cells of a mesh.

Let u_h be the solution on a mesh, w the solution on the divided mesh, and J a functional. The dual
solution z on the divided mesh has a(z, v) = J(v) + G(v), where z vanishes at the dofs that contact
holds in w and at those with Dirichlet data, and the forces G hold z there. For the interpolation I
on the undivided mesh,

    J(w - u_h) = R(z - I z) - F(I z) - G(w - u_h) + F_w(z) + Q(I z),    R(v) = L(v) - a(u_h, v),

with the contact forces F of u_h and F_w of w. The first term has the residuals in cells, the jumps
of the flux and the conditions on it; the second one the dofs in contact that w has released; the
third one those that w has caught, and the data between the nodes of u_h; the fourth one those that
w has caught, and hardly presses, at which z is free; and Q = R + F what rounding and the quadrature
on the undivided mesh leave of the equations of u_h. All sums are over basis functions, so that each
term is known with its sign where its functions are.

Where both solutions meet obstacles or Dirichlet data that are known between the nodes, nothing is
extrapolated to norms from the third term: the distance of w from the data tells what w leaves
there, see `boundary_defects`.

A norm of w - u_h is J(w - u_h), where J is the derivative of the norm. What w itself leaves, and no
comparison shows, has further terms, among them what quadrature leaves: a rule of a higher degree
gives a load L+ and a form a+, with which w has the residual (L+ - L)(v) - (a+ - a)(w, v). The
iterations of the solve leave the residual R_w(v) = L(v) - a(w, v) at the free dofs.

Sources: Becker and Rannacher, An optimal control approach to a posteriori error estimation in
finite element methods, Acta Numerica 10 (2001) 1-102; Blum and Suttmeier, An adaptive finite
element discretisation for a simplified Signorini problem, Calcolo 37 (2000) 65-77, for contact;
Richter and Wick, Variational localizations of the dual weighted residual estimator, J. Comput.
Appl. Math. 279 (2015) 192-208, for sums over basis functions in place of integrals over cells.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_signorini.accuracy.cells import shared_out
from dolfinx_signorini.accuracy.quadrature_errors import missed_by_quadrature
from dolfinx_signorini.accuracy.targets import Target, size
from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.base.ranks import highest, marked, shared
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.meshes.elements import component_arrays
from dolfinx_signorini.meshes.refinement import Transfer
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, facet_cells, owned_cells
from dolfinx_signorini.norms.power_sums import collected, total
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.problem.dirichlet import data_of_condition
from dolfinx_signorini.solvers.stop import SHARE


@dataclass(frozen=True)
class Solution:
    """What is kept of the solution on the undivided mesh:

        coarse = Solution(problem.u, problem.forces)

    Attributes:
        u: The solution.
        forces: The contact forces on the dofs, as `problem.forces`: not negative for scalars.
    """

    u: fem.Function
    forces: fem.Function


@dataclass(frozen=True)
class Solved:
    """A solution, and the solved problem on the mesh with every cell divided:

        coarse = Solution(problem.u, problem.forces)
        solved = Solved(coarse, fine, refinement.parents, target("L4"))

    Attributes:
        coarse: The solution u_h on the mesh.
        fine: The solved problem on the divided mesh.
        parents: For each owned cell of this mesh the cell of the undivided mesh around the cell.
        target: What is to be accurate.
    """

    coarse: Solution
    fine: BoundConstrainedProblem
    parents: LocalIndices
    target: Target

    @functools.cached_property
    def transfer(self) -> Transfer:
        """Carries functions between the two spaces."""
        return Transfer(self.coarse.u.function_space, self.fine.space, self.parents)

    @functools.cached_property
    def prolonged(self) -> fem.Function:
        """The solution u_h as a function on the divided mesh."""
        return self.transfer.prolong(self.coarse.u)

    @functools.cached_property
    def error(self) -> fem.Function:
        """The difference w - u_h."""
        return difference(self.fine.u, self.prolonged)

    @functools.cached_property
    def distance(self) -> float:
        """The size of this difference, as the target measures it."""
        return size(self.error, self.target)

    @functools.cached_property
    def unit(self) -> float:
        """The size of the quantity that is meant for derivatives of size 1; 1 for the solution."""
        if self.target.of is None:
            return 1.0
        plain = size(self.error, replace(self.target, of=ufl.grad))
        return self.distance / plain if plain > 0.0 else 1.0

    @functools.cached_property
    def loads(self) -> fem.Function:
        """L(v) for each basis function v on the divided mesh."""
        return assembled(self.fine.assembled_forms[1], self.fine.space)

    @functools.cached_property
    def residual(self) -> fem.Function:
        """R(v) = L(v) - a(u_h, v) for each basis function v on the divided mesh."""
        return difference(self.loads, self.acting(self.prolonged))

    @functools.cached_property
    def algebraic_residual(self) -> fem.Function:
        """R_w(v) = L(v) + F_w(v) - a(w, v) for each basis function v on the divided mesh."""
        left = difference(self.loads, self.acting(self.fine.u))
        left.x.array[:] += self.contact_forces.x.array
        return left

    @functools.cached_property
    def contact_forces(self) -> fem.Function:
        """F_w(v), the contact forces on w, for each basis function v on the divided mesh."""
        forces = fem.Function(self.fine.space)
        forces.x.array[:] = self.fine.sense * self.fine.forces.x.array
        return forces

    @functools.cached_property
    def quadrature_defect(self) -> fem.Function:
        """(L+ - L)(v) - (a+ - a)(w, v) for each basis function v, see `quadrature_errors`."""
        result, space = fem.Function(self.fine.space), self.fine.space
        for form in missed_by_quadrature(*self.fine.assembled_forms, self.fine.u):
            result.x.array[:] += assembled(form, space).x.array
        return result

    @functools.cached_property
    def detail(self) -> fem.Function:
        """What w has beyond its interpolation on the undivided mesh."""
        return self.beyond(self.fine.u)

    def beside_data(self, f: fem.Function) -> fem.Function:
        """Return a function of the divided mesh without what it has at known data, see `met`."""
        result, layout = fem.Function(f.function_space), self.fine.system.layout
        result.x.array[:] = f.x.array
        for condition in self.fine.bcs:
            dofs = condition.dof_indices()[0]
            result.x.array[dofs[self.met[dofs]]] = 0.0
        values = layout.turned(result.x.array[: self.fine.system.A.getLocalSize()[0]])
        values[layout.contact_dofs[self.met[layout.contact_dofs]]] = 0.0
        result.x.array[: len(values)] = layout.turned_back(values)
        result.x.scatter_forward()
        return result

    def beyond(self, f: fem.Function) -> fem.Function:
        """Return f - I f for a function on the divided mesh."""
        return difference(f, self.transfer.prolong(self.transfer.restrict(f)))

    def acting(self, f: fem.Function) -> fem.Function:
        """Return a(f, v) for each basis function v on the divided mesh, Dirichlet data or not."""
        placed, form = self._action
        placed.x.array[:] = f.x.array
        return compiled.assembled(form, self.fine.space)

    @functools.cached_property
    def _action(self) -> tuple[fem.Function, fem.Form]:
        f = fem.Function(self.fine.space)
        return f, compiled.form(ufl.action(self.fine.assembled_forms[0], f))

    def on_cells(self, values: fem.Function) -> Array:
        """Return values of dofs on the divided mesh, shared out to the cells of the undivided one.

        Args:
            values: The values as coefficients.

        Returns:
            Their sums and the sums of their sizes, shape (2, cells).
        """
        return self.on_parents(shared_by_cells(values))

    def on_parents(self, values: Array) -> Array:
        """Return the sums of values of the cells of the divided mesh on the undivided cells.

        Args:
            values: The values, shape (n, cells).
        """
        return np.array([np.bincount(self.parents, row, self.count) for row in values])

    @functools.cached_property
    def met(self) -> Mask:
        """Whether both solutions meet data at each dof that are known between the nodes, too.

        These are Dirichlet data that `dirichlet` was given, and obstacles, where all dofs of u_h
        around the dof are in contact or have Dirichlet data.
        """
        fine, dirichlet = self.fine, fem.Function(self.fine.space)
        active = marked(fine.space, fine.active)
        met: Mask = np.repeat(active, fine.space.dofmap.bs)
        for condition in fine.bcs:
            dirichlet.x.array[condition.dof_indices()[0]] = 1.0
        around = self.transfer.restrict(dirichlet)
        known = np.abs(around.x.array - 1.0) < SOLVED
        pressed = np.any([part != 0.0 for part in component_arrays(self.coarse.forces)], axis=0)
        around.x.array[:] = known | np.repeat(pressed, fine.space.dofmap.bs)
        around.x.scatter_forward()
        met &= np.abs(self.transfer.prolong(around).x.array - 1.0) < SOLVED
        for condition in fine.bcs:
            met[condition.dof_indices()[0]] = data_of_condition(condition) is not None
        return met

    @functools.cached_property
    def hardly_pressed(self) -> LocalIndices:
        """The nodes in contact in w whose force is below the gap of u_h, scaled to a force.

        Between u_h and w such a node is nearer to being free than to being held: where contact
        hardly presses, a trifle in the load moves the solution on the whole contact boundary. Where
        contact alone holds the solution, the forces balance the load, and no node is left free.
        """
        system = self.fine.system
        if system.singular:
            return system.layout.contact_nodes[:0]
        w, before = system.vector_of(self.fine.u), system.vector_of(self.prolonged)
        gaps = system.scaled_gap(before.array_r[system.contact_dofs])
        loose = self.fine.touching & (gaps > system.multiplier(w))
        destroy(w, before)
        return system.layout.contact_nodes[loose]

    @functools.cached_property
    def count(self) -> int:
        """The number of owned cells of the undivided mesh."""
        return len(owned_cells(self.coarse.u.function_space.mesh))

    def norms(self, f: fem.Function) -> Array:
        """Return the norm of a function of the divided mesh on each undivided cell; collective."""
        return self.collected(self.target.on_cells(f))

    def felt(self, f: fem.Function) -> Array:
        """Return the norms of a function on the undivided cells as far as the target feels them.

        In a norm of the boundary cells inside of the domain have a share of their norms, see
        `reach`; the call is collective.
        """
        if not self.target.of_facets:
            return self.norms(f)
        inside = self.collected(self.target.in_domain.on_cells(f))
        return np.where(self._at_boundary, self.norms(f), self.reach * inside)

    @functools.cached_property
    def reach(self) -> Array:
        """Which share of the error on each undivided cell reaches the place of the norm.

        In a sup norm of the boundary the difference of the two solutions tells the share of cells
        inside of the domain; otherwise the share is 1.
        """
        if not self.target.of_facets:
            return np.ones(self.count)
        error = self.beside_data(self.error)
        there, inside = size(error, self.target), size(error, self.target.in_domain)
        return np.where(self._at_boundary, 1.0, min(there / (inside or 1.0), 1.0))

    @functools.cached_property
    def _at_boundary(self) -> Mask:
        domain, result = self.coarse.u.function_space.mesh, np.zeros(self.count, dtype=bool)
        result[facet_cells(domain, boundary_facets(domain))[:, 0]] = True
        return result

    def collected(self, parts: Array) -> Array:
        """Put norms on the cells of the divided mesh together for the undivided cells."""
        assert self.target.norm is not None
        return collected(parts, self.parents, self.count, self.target.norm.p)

    def in_norm(self, parts: Array) -> Array:
        """Return a part of the error without a sign as a term, see `Term`; collective.

        Args:
            parts: The norm of the part on each cell of the divided mesh.
        """
        assert self.target.norm is not None
        parts = self.collected(parts)
        if self.target.weighted:  # parts of cells add up as they are
            parts = shared_out(parts, self.target.norm.p, self.fine.comm)
        return np.array([parts, parts])


@dataclass(frozen=True)
class Dual:
    """A dual solution on the divided mesh:

        dual = dual_solution(solved, load)

    Attributes:
        z: The dual solution, which vanishes at the dofs that contact holds and at those with
            Dirichlet data.
        detail: What z has beyond its interpolation on the undivided mesh.
        restricted: This interpolation.
        action: a(z, v) for each basis function v.
        forces: G(v) = a(z, v) - J(v).
        value: J(w - u_h).
    """

    z: fem.Function
    detail: fem.Function
    restricted: fem.Function
    action: fem.Function
    forces: fem.Function
    value: float


# A term of the error: two values for each owned cell of the undivided mesh, the part with its sign,
# and the sum of the sizes of what the basis functions have there, not small by chance. What has no
# sign stands twice. The sizes add up with the power of the target. In W^{1,p} and sup norms, which
# no dual solution weighs, the terms of a dual solution are norms on the cells.
Term: TypeAlias = Callable[[Solved, Dual | None], Array]


def dual_solution(solved: Solved, J: fem.Function, value: float | None = None) -> Dual:
    """Return the dual solution of a functional; the call is collective.

    Args:
        solved: The two solutions.
        J: The functional of each basis function of the divided mesh; scaled to the value.
        value: What J(w - u_h) is, where J is known up to a factor alone.
    """
    count = solved.fine.space.dofmap.index_map.size_local * solved.fine.space.dofmap.bs
    own = float(J.x.array[:count] @ solved.error.x.array[:count])
    found = float(solved.fine.comm.allreduce(own))
    if value is not None and found != 0.0:
        J.x.array[:] *= value / found
        found = value
    z, _ = solved.fine.solve_linearised(J, released=solved.hardly_pressed)
    restricted = solved.transfer.restrict(z)
    action = solved.acting(z)
    forces = difference(action, J)
    detail = difference(z, solved.transfer.prolong(restricted))
    return Dual(z, detail, restricted, action, forces, found)


def residuals(solved: Solved, dual: Dual) -> Array:
    """Return R(z - I z) on each cell: the residuals of the equations with the details of z."""
    return solved.on_cells(product(solved.residual, dual.detail))


def released(solved: Solved, dual: Dual) -> Array:
    """Return -F(I z) on each cell: the contact forces of dofs that w has released."""
    parts = shared_by_cells(product(solved.coarse.forces, dual.restricted))
    return parts * [[-solved.fine.sense], [1.0]]


def held(solved: Solved, dual: Dual) -> Array:
    """Return -G(w - u_h) on each cell at dofs that w has caught and presses, or of unknown data."""
    return _held(solved, dual, ~solved.met)


def met(solved: Solved, dual: Dual) -> Array:
    """Return -G(w - u_h) on each cell at dofs where both solutions meet data that are known."""
    return _held(solved, dual, solved.met)


def _held(solved: Solved, dual: Dual, dofs: Mask) -> Array:
    parts = product(dual.forces, solved.error)
    parts.x.array[~dofs] = 0.0
    return solved.on_cells(parts) * [[-1.0], [1.0]]


def caught(solved: Solved, dual: Dual) -> Array:
    """Return F_w(z) on each cell: dofs that w has caught, and hardly presses."""
    return solved.on_cells(product(solved.contact_forces, dual.z))


# What is extrapolated to norms of the error of w; with `met` the terms add up to J(w - u_h).
TERMS = (residuals, released, held, caught)


def algebra(solved: Solved, dual: Dual) -> Array:
    """Return R_w(z) on each cell: what the iterations of the solve have left of the equations.

    The sum of all cells with their signs tells the error: the error of an iteration is smooth, and
    does not cancel in a functional as that of the elements may do; the residual oscillates.
    """
    return solved.on_cells(product(solved.algebraic_residual, dual.z))


def quadrature(solved: Solved, dual: Dual | None) -> Array:
    """Return (L+ - L)(z) - (a+ - a)(w, z) on each cell, or the norms of what w moves by.

    A functional is wrong by the sum of all cells with their signs. The finer rule is not exact:
    the sum counts as no less than that of random signs, the root of the sum of squares.
    """
    defect, norm = solved.quadrature_defect, solved.target.norm
    if highest(solved.fine.comm, np.abs(defect.x.array)) == 0.0:
        return np.zeros((2, solved.count))
    if dual is None:
        moved = solved.norms(solved.fine.solve_linearised(defect)[0])
        return np.array([moved, moved])
    parts, comm = solved.on_cells(product(defect, dual.z)), solved.fine.comm
    signed, seen = comm.allreduce(parts.sum(axis=1))
    if norm is None:
        parts[1] *= max(abs(signed), total(parts[1], 2.0, comm)) / (seen or 1.0)
        return parts
    if norm.boundary or seen <= SHARE * solved.distance:
        return parts
    # The dual solution may look elsewhere.
    return parts * max(size(solved.fine.solve_linearised(defect)[0], solved.target) / seen, 1.0)


def difference(one: fem.Function, other: fem.Function) -> fem.Function:
    """Return the difference of two functions of a space."""
    result = fem.Function(one.function_space)
    result.x.array[:] = one.x.array - other.x.array
    return result


def product(one: fem.Function, other: fem.Function) -> fem.Function:
    """Return the products of the coefficients of two functions of a space."""
    result = fem.Function(one.function_space)
    result.x.array[:] = one.x.array * other.x.array
    return result


def assembled(form: ufl.Form, space: fem.FunctionSpace) -> fem.Function:
    """Return the values of a linear form for all basis functions, as coefficients; collective."""
    return compiled.assembled(compiled.form(form), space)


def shared_by_cells(values: fem.Function) -> Array:
    """Return the sums of the values of the nodes of each owned cell, and those of their sizes.

    The value of a node is the sum over its components, which does not depend on the axes. Each node
    is shared evenly by the cells of all ranks that have the node; the call is collective.

    Args:
        values: The values as coefficients.
    """
    space = values.function_space
    first, *others = component_arrays(values)
    cells = space.dofmap.list[: len(owned_cells(space.mesh))]
    shares = shared(space.dofmap.index_map, cells, sum(others, first))
    return np.array([shares.sum(axis=1), np.abs(shares).sum(axis=1)])
