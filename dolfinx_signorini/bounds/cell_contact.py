"""Contact in cells: a feasible function near a solution, and the cells that an obstacle presses on.

Where the discrete solution is not feasible at every point, the feasible function is of higher
degree: its Bernstein coefficients are raised to those of a lower obstacle, and lowered to those of
an upper one. In cells that touch all over the function is the obstacle, and on Dirichlet facets it
has the data.
"""

from dataclasses import dataclass

import basix
import numpy as np
from dolfinx import fem
from mpi4py import MPI
from ufl.algorithms.analysis import extract_coefficients
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import BLOCK, Array, Indices, LocalIndices, Mask
from dolfinx_signorini.base.ranks import highest, marked
from dolfinx_signorini.base.tolerances import ROUNDING
from dolfinx_signorini.bounds.better_fluxes import RAISED
from dolfinx_signorini.bounds.cell_pressure import Pressing
from dolfinx_signorini.bounds.cell_values import BEST, SAMPLED
from dolfinx_signorini.bounds.frames import cells_around, datum
from dolfinx_signorini.bounds.lifting import DATA, Feasible
from dolfinx_signorini.bounds.nearer import nearer
from dolfinx_signorini.bounds.reference_flux import polynomials, rule
from dolfinx_signorini.bounds.remainders import Solved
from dolfinx_signorini.bounds.strong_form import polynomial_degree
from dolfinx_signorini.meshes.elements import is_bernstein, lagrange_space
from dolfinx_signorini.problem.assembly import dofs_on_entities, dofs_on_facets
from dolfinx_signorini.problem.values import Data, evaluator

# By dimension: by how much a function that is feasible everywhere is of higher degree than the
# solution. For P3 on the square with 32 cells per side the bound is 1.74 times the error with 3,
# 1.81 with 2, 1.98 with 1.
HIGHER = {2: 3, 3: 1}
OBSTACLE = "the obstacle is known at points of cells only"
BELOW = "Dirichlet data are below a lower obstacle, or above an upper one, between nodes"


@dataclass(frozen=True)
class _Side:
    """An obstacle, with the signs of a lower obstacle where the only obstacle is an upper one."""

    side: float  # 1 for a lower obstacle, -1 for an upper one
    data: Data
    sign: float  # times the data

    def on(self, space: fem.FunctionSpace, dofs: LocalIndices) -> Array:
        """The obstacle at all dofs of this rank; 0 away from some owned dofs."""
        g = fem.Function(space)
        g.x.array[dofs] = self.sign * evaluator(space, self.data, dofs)()
        g.x.scatter_forward()
        return np.asarray(g.x.array)


def _sides(solved: Solved) -> list[_Side]:
    sign = solved.problem.sign
    return [_Side(sign * each.sign, each.data, sign) for each in solved.problem.obstacles]


@dataclass(frozen=True)
class _Contact:
    """How owned cells touch the obstacles, one row for each obstacle, shape (sides, cells)."""

    touching: Indices  # the number of dofs that touch and may have a force
    closed: Mask  # whether all dofs touch

    @property
    def partly(self) -> Mask:
        """Whether cells touch an obstacle, but not all over."""
        return np.asarray((self.touching > 0).any(axis=0) & ~self.closed.any(axis=0))


def contact_in_cells(solved: Solved) -> tuple[Feasible, Pressing]:
    """Return what makes a solution feasible, and where obstacles press, for obstacles in cells.

    Args:
        solved: The problem, whose obstacles are in the domain; the call is collective.
    """
    sides, contact = _sides(solved), _contact(solved)
    data = [value for value, _ in solved.terms.dirichlet]
    data += [side.data for side in sides]
    degree, tiny = solved.degree, _tiny(solved)
    near = _feasible(solved, sides, contact, degree)
    size = highest(solved.comm, np.abs(near.change.x.array))
    if size > tiny or not all(_known(each, degree) for each in data):
        near = _feasible(solved, sides, contact, degree + HIGHER[solved.dimension])
    else:
        near.change.x.array[:] = 0.0
    number = np.where(contact.touching.any(axis=0), contact.touching.argmax(axis=0), -1)
    pressed = np.array([*(side.side for side in sides), 0.0])[number].astype(np.int64)
    return near, Pressing(pressed, _rises(solved, sides, near.change, number))


def _known(data: Data | None, degree: int) -> bool:
    """Whether data are polynomials of a degree on each cell, and continuous."""
    found = polynomial_degree(data)
    if found is None or found > degree:
        return False
    if isinstance(data, fem.Function):
        element = data.function_space.element.basix_element
        return bool(element.family == basix.ElementFamily.P and not element.discontinuous)
    return not (isinstance(data, Expr) and extract_coefficients(data))


def _tiny(solved: Solved) -> float:
    return ROUNDING * highest(solved.comm, np.abs(solved.problem.u.x.array))


def _contact(solved: Solved) -> _Contact:
    problem, cells, tiny = solved.problem, solved.frames.cells, _tiny(solved)
    space, u = problem.space, np.asarray(problem.sign * problem.u.x.array, dtype=np.float64)
    owned = dofs_on_entities(space, solved.dimension, problem.contact)
    with_obstacle = np.isin(cells, problem.contact)[:, None]
    dofs = space.dofmap.list[cells]
    free = ~marked(space, problem.fixed_dofs)[dofs]
    # Functions whose integral is not positive have forces that tell nothing about contact.
    element = space.element.basix_element
    points, weights = rule(solved.dimension, element.degree)
    heavy = weights @ element.tabulate(0, points)[0, :, :, 0] > ROUNDING
    touching, closed = [], []
    for side in _sides(solved):
        gap = side.side * (u - side.on(space, owned))
        touches = (gap <= tiny)[dofs] & with_obstacle
        touching.append((touches & free & heavy).sum(axis=1))
        closed.append((touches | (free & ~heavy)).all(axis=1) & (touching[-1] > 0))
    return _Contact(np.array(touching), np.array(closed))


def _feasible(solved: Solved, sides: list[_Side], contact: _Contact, degree: int) -> Feasible:
    """What makes a solution feasible, of a degree."""
    problem, frames, d = solved.problem, solved.frames, solved.dimension
    space = problem.space
    if degree > max(1, solved.degree) or not (degree == 1 or is_bernstein(space)):
        space = lagrange_space(space.mesh, degree, basix.LagrangeVariant.bernstein)
    u = fem.Function(space)
    u.interpolate(problem.u)
    u.x.array[:] *= problem.sign
    owned = dofs_on_entities(space, d, problem.contact)
    here = marked(space, owned)
    obstacles = [side.on(space, owned) for side in sides]
    limits = [np.full(len(here), np.inf) * sign for sign in (-1.0, 1.0)]
    for side, g in zip(sides, obstacles, strict=True):
        limits[int(side.side < 0.0)] = np.where(here, g, -side.side * np.inf)
    # Interpolants of obstacles with kinks may cross where the obstacles meet.
    limits = [func(*limits) for func in (np.minimum, np.maximum)]
    around = cells_around(solved.comm, frames.vertices, contact.partly[:, None]) * (
        degree > solved.degree
    )
    cells = np.flatnonzero(around)
    v, changed = nearer(solved, space, cells, u.x.array, (limits[0], limits[1]))
    v = np.clip(v, *limits)
    for g, closed in zip(obstacles, contact.closed, strict=True):
        touching = marked(space, space.dofmap.list[frames.cells[closed]])
        v = np.where(touching & ~changed, g, v)
    for data, facets in solved.terms.dirichlet:
        dofs = dofs_on_facets(space, facets)
        fixed = fem.Function(space)
        fixed.x.array[dofs] = u.x.array[dofs]
        if data is not None:
            fixed.x.array[dofs] = problem.sign * evaluator(space, data, dofs)()
        fixed.x.scatter_forward()
        v = np.where(marked(space, dofs), fixed.x.array, v)
    beyond = [side.side * (g - v)[here] for side, g in zip(sides, obstacles, strict=True)]
    held = highest(solved.comm, np.array(beyond)) > _tiny(solved)
    change = fem.Function(space)
    change.x.array[:] = v - u.x.array
    notes = (OBSTACLE,) * (not all(_known(side.data, degree) for side in sides))
    notes += (DATA,) * (not all(_known(value, degree) for value, _ in solved.terms.dirichlet))
    facet = polynomials(d - 1, solved.degree, np.zeros((1, d - 1)))
    nothing = np.zeros((0, len(facet))), np.zeros(0)
    return Feasible(change, gap=nothing, notes=notes + (BELOW,) * held)


def _rises(solved: Solved, sides: list[_Side], change: fem.Function, number: Indices) -> Array:
    """The means of v - g times polynomial over cells; 0 in cells that nothing presses on.

    Args:
        solved: The problem; the call is collective.
        sides: The obstacles.
        change: What makes the solution feasible.
        number: The number of the obstacle that presses on each cell, or -1.
    """
    comm, d = solved.comm, solved.dimension
    degree = solved.degree + RAISED[d]
    result = np.zeros((len(number), len(polynomials(d, degree, np.zeros((1, d))))))
    order = change.function_space.element.basix_element.degree
    known = all(_known(side.data, order) for side in sides)
    points, weights = rule(d, min(degree + order + (0 if known else SAMPLED[d]), BEST[d]))
    for k, side in enumerate(sides):
        obstacle, cells = datum(solved.frames.domain, side.data), np.flatnonzero(number == k)
        count = comm.allreduce(1 + len(cells) * len(weights) // BLOCK, op=MPI.MAX)
        for some in np.array_split(cells, count):
            frames = solved.frames.some(some)
            at = frames.points(points)
            v = solved.problem.sign * at.values(solved.problem.u)[0] + at.values(change)[0]
            gap = np.maximum(side.side * (v - side.sign * obstacle(at)), 0.0)
            result[some] = side.side * frames.moments(gap, points, weights, degree)
    return result


def target_of(near: Feasible) -> fem.Function | None:
    """Return what is added to a solution for a feasible function, None for nothing; collective."""
    comm = near.change.function_space.mesh.comm
    return near.change if highest(comm, np.abs(near.change.x.array)) > 0.0 else None
