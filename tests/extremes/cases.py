"""Discrete problems that have a 50-digit reference, and the digits that the package attains."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import reference
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from mpmath import mpf

from dolfinx_signorini import InputError, NotConvergedError, SignoriniProblem
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets

Array = npt.NDArray[np.float64]
Data = Callable[[Array], Array]


def waves(x: Array) -> Array:
    """A load that presses on some of the boundary of a unit square and pulls on some."""
    return np.cos(7.0 * x[0] + 2.0 * x[1]) - 0.7 * x[0]


def humps(x: Array) -> Array:
    """An obstacle that a unit square touches here and there."""
    return 0.02 * np.cos(9.0 * (x[0] - 0.4 * x[1]))


@dataclass(frozen=True)
class Case:
    """(diffusion grad u, grad v) + reaction (u, v) = (load, v) with u >= obstacle, in P1.

    Attributes:
        domain: The mesh.
        diffusion, reaction: Constants.
        load: Of the coordinates (3, n); linear between its values at the nodes, or, with
            `cell_load`, constant on cells with its value at their midpoints.
        obstacle: Of the coordinates (3, n).
        cell_load: See load.
        where: Tells of coordinates (3, n) whether facets with these vertices are in contact.
    """

    domain: mesh.Mesh
    diffusion: float = 1.0
    reaction: float = 1.0
    load: Data = waves
    obstacle: Data = humps
    cell_load: bool = False
    where: Callable[[Array], npt.NDArray[np.bool_]] | None = None

    def facets(self) -> npt.NDArray[np.int32]:
        if self.where is None:
            return boundary_facets(self.domain)
        return mesh.locate_entities_boundary(self.domain, 1, self.where)

    def problem(self) -> SignoriniProblem:
        """Assemble it with the package."""
        space = fem.functionspace(self.domain, ("Lagrange", 1))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        f = fem.Function(fem.functionspace(self.domain, ("DG", 0)) if self.cell_load else space)
        f.interpolate(self.load)
        d, c = (
            fem.Constant(self.domain, float(value)) for value in (self.diffusion, self.reaction)
        )
        a = (d * ufl.inner(ufl.grad(u), ufl.grad(v)) + c * u * v) * ufl.dx
        return SignoriniProblem(a, f * v * ufl.dx, contact=self.facets(), obstacle=self.obstacle)

    def solution(self, space: fem.FunctionSpace) -> tuple[list[Any], set[int], reference.Nodes]:
        """Solve it with 50 digits: values at the nodes, held nodes, and the nodes."""
        nodes = reference.gather(space)
        x = np.column_stack((nodes.x, np.zeros(len(nodes.x)))).T
        points = x[:, nodes.cells].mean(axis=2) if self.cell_load else x
        contact = nodes.boundary
        if self.where is not None:
            dofs = fem.locate_dofs_topological(space, 1, self.facets())
            found = space.mesh.comm.allgather(nodes.of_dof[dofs])
            contact = np.unique(np.concatenate(found))
        load, obstacle = (
            np.broadcast_to(np.asarray(values, dtype=np.float64), (count,))
            for values, count in (
                (self.load(points), points.shape[1]),
                (self.obstacle(x[:, contact]), len(contact)),
            )
        )
        u, held = reference.solve(nodes, (self.diffusion, self.reaction), load, contact, obstacle)
        return u, held, nodes


def digits_of(error: Any, size: Any) -> float:
    """Return the digits of an error relative to a size; 16 at the most, which is all there are."""
    if error == 0:
        return 16.0
    if not size or not math.isfinite(float(error / size)):
        return 0.0
    return min(16.0, -float(np.log10(float(error / size))))


def attained(
    case: Case, method: str = "cascade", rtol: float | None = None, **limits: int
) -> float:
    """Solve a case and return the correct digits of the largest value, over all nodes.

    Args:
        case: The case.
        method, rtol, limits: See `SignoriniProblem.solve`.

    Raises:
        InputError, NotConvergedError: As the package does.
    """
    problem = case.problem()
    try:
        u = problem.solve(method, rtol=rtol, **limits)
    finally:
        problem.destroy()
    values, _, nodes = case.solution(problem.space)
    have = [mpf(v) for v in u.x.array.tolist()]
    local = max(
        (abs(v - values[k]) for v, k in zip(have, nodes.of_dof, strict=True)), default=mpf(0)
    )
    error = max(case.domain.comm.allgather(local))
    return digits_of(error, max(abs(v) for v in values))


def right_or_refused(case: Case, method: str, least: float) -> tuple[float | str, str]:
    """Solve a case that may be too hard for a method: it is right or it says that it is not.

    Returns:
        What was attained, and where it stops.
    """
    try:
        digits = attained(case, method, max_iterations=3000)
    except NotConvergedError as error:
        return "refused", f"not converged after 3000 iterations, residual {error.residual:.1e}"
    assert digits >= least
    return digits, ""


def square(n: int = 4) -> mesh.Mesh:
    """The unit square with n cells per side, on all ranks."""
    return friedrichs_keller(MPI.COMM_WORLD, n)


def stretched(
    domain: mesh.Mesh, scale: float | tuple[float, float], shift: float = 0.0
) -> mesh.Mesh:
    """Scale and shift the coordinates of a mesh in place."""
    domain.geometry.x[:, :2] = domain.geometry.x[:, :2] * np.asarray(scale) + shift
    return domain


def reach(values: Iterable[float], attempt: Callable[[float], float], least: float) -> str:
    """Tell how far a parameter can go, and how it ends there.

    Args:
        values: The values of the parameter, from harmless to hopeless.
        attempt: Returns the digits attained, or raises as the package does.
        least: The digits that count as working.
    """
    last: float | None = None
    for value in values:
        try:
            digits = attempt(value)
        except InputError as error:
            return f"works to {last:.3g}; {value:.3g} is refused: {error}"
        except NotConvergedError as error:
            residual = f"not converged, residual {error.residual:.1e}"
            return f"works to {last:.3g}; {value:.3g} is refused: {residual}"
        if digits < least:
            return f"works to {last:.3g}; {value:.3g}: {digits:.1f} digits"
        last = value
    return f"not met up to {last:.3g}"


def worst(values: Iterable[float], attempt: Callable[[float], float]) -> float:
    """Return the fewest digits that an attempt attains."""
    return min(attempt(value) for value in values)
