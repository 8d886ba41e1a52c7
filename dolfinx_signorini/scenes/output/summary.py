"""The numbers of a solved scene: size, contact set, forces and their balance, accuracy, time."""

from dataclasses import dataclass

import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.accuracy.report import outcome_lines
from dolfinx_signorini.norms import error_norms
from dolfinx_signorini.quadrature import CELL_RULE
from dolfinx_signorini.scenes.output.boundary import ContactBoundary
from dolfinx_signorini.scenes.solving import SceneResult
from dolfinx_signorini.solvers.pressure import multiplier

MAX_POINTS = 8  # detachment points that are listed


@dataclass(frozen=True)
class Summary:
    """The numbers of a solved scene.

    Attributes:
        cells, unknowns: The size of the finest mesh and of its problem.
        contact_size: Length or area of the contact set: where the gap is zero.
        undecided_size: That of what is not in contact, but with a gap that is too small for the
            mesh to tell.
        boundary_size: That of the whole contact boundary.
        detachment_points: The ends of the contact set in the plane where u leaves the obstacle.
        forces: What acts on u, by name; they add up to zero.
        imbalance: What they do add up to, relative to the sum of their sizes.
        natural_residual: Relative to the data.
        errors: Norms of the error where the solution is known, by name.
        choice: With an accuracy or a budget what was chosen, predicted and reached, by name.
        seconds: Wall-clock seconds of everything.
    """

    cells: int
    unknowns: int
    contact_size: float
    undecided_size: float
    boundary_size: float
    detachment_points: tuple[tuple[float, ...], ...]
    forces: dict[str, float]
    imbalance: float
    natural_residual: float
    errors: dict[str, float]
    choice: dict[str, str]
    seconds: float


def summarise(result: SceneResult, boundary: ContactBoundary | None) -> Summary:
    """Return the numbers of a solved scene; the call is collective.

    Args:
        result: The solved scene.
        boundary: Its contact boundary, on rank 0.
    """
    domain = result.posed.problem.space.mesh
    contact_size, undecided_size, boundary_size, points = domain.comm.bcast(
        None if boundary is None else _contact_set(boundary)
    )
    forces = _forces(result)
    total = sum(abs(force) for force in forces.values())
    exact, norms = result.posed.exact, result.posed.scene.norms
    return Summary(
        cells=domain.topology.index_map(domain.topology.dim).size_global,
        unknowns=result.posed.problem.unknowns,
        contact_size=contact_size,
        undecided_size=undecided_size,
        boundary_size=boundary_size,
        detachment_points=points,
        forces=forces,
        imbalance=abs(sum(forces.values())) / total if total > 0.0 else 0.0,
        natural_residual=result.solve.natural_residual,
        errors=error_norms(result.u, exact, norms) if exact is not None else {},
        choice={} if result.outcome is None else dict(outcome_lines(result.outcome)),
        seconds=result.seconds,
    )


def lines(summary: Summary) -> list[tuple[str, str]]:
    """Return the numbers as pairs of name and text, for people to read."""
    s = summary
    rows = [
        ("unknowns", f"{s.unknowns} ({s.cells} cells)"),
        ("in contact", f"{s.contact_size:.4g} of {s.boundary_size:.4g}"),
    ]
    if s.undecided_size > 0.0:
        text = f"{s.undecided_size:.4g}: the gap there is too small for the mesh to tell"
        rows.append(("undecided", text))
    if s.detachment_points:
        points = [f"({', '.join(f'{c:.4g}' for c in p)})" for p in s.detachment_points[:MAX_POINTS]]
        more = len(s.detachment_points) - len(points)
        rows.append(("detachment", ", ".join(points) + (f" and {more} more" if more else "")))
    rows += [(name, f"{force:.6g}") for name, force in s.forces.items()]
    rows.append(("balance of forces", f"{s.imbalance:.1e} of their sizes"))
    rows.append(("natural residual", f"{s.natural_residual:.1e} of the data"))
    rows += [(f"error {name}", f"{error:.4g}") for name, error in s.errors.items()]
    return [*s.choice.items(), *rows, ("time", f"{s.seconds:.2f} s")]


def _contact_set(
    boundary: ContactBoundary,
) -> tuple[float, float, float, tuple[tuple[float, ...], ...]]:
    sizes = boundary.sizes
    plane = boundary.points.shape[1] == 2
    points = boundary.detachment_points if plane else ()
    return (
        float(sizes[boundary.in_contact].sum()),
        float(sizes[boundary.undecided].sum()),
        float(sizes.sum()),
        tuple(tuple(map(float, point)) for point in points),
    )


def _forces(result: SceneResult) -> dict[str, float]:
    """Load, flux and reaction from integrals, pressure and Dirichlet forces from A u - b."""
    posed, problem = result.posed, result.posed.problem
    comm = problem.comm

    def integral(form: ufl.Form) -> float:
        return float(comm.allreduce(fem.assemble_scalar(fem.form(form)), op=MPI.SUM))

    forces = {
        name: integral(integrand * measure) for name, (integrand, measure) in posed.sources.items()
    }
    if posed.scene.reaction is not None:
        x = ufl.SpatialCoordinate(problem.space.mesh)
        dx = ufl.dx(metadata=CELL_RULE.metadata)
        forces["reaction"] = -integral(posed.scene.reaction.ufl(x) * result.u * dx)
    pressure = float(multiplier(problem, result.solve.u).sum())
    forces["contact pressure"] = posed.scene.sign * comm.allreduce(pressure)
    if posed.scene.dirichlet:
        forces["Dirichlet sides"] = _dirichlet_force(result)
    return forces


def _dirichlet_force(result: SceneResult) -> float:
    """The sum over the Dirichlet dofs of a(u, phi) - L(phi)."""
    posed, problem = result.posed, result.posed.problem
    v = ufl.TestFunction(problem.space)
    residual = ufl.action(problem.a, result.u)
    for integrand, measure in posed.sources.values():
        residual -= integrand * v * measure
    vector = fem_petsc.assemble_vector(fem.form(residual))
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    force = float(vector.array_r[problem.fixed_dofs].sum())
    vector.destroy()
    return float(problem.comm.allreduce(force))
