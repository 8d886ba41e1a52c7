"""The data of a problem, as the adaptive loop reads and integrates them."""

from functools import partial

from ufl.core.expr import Expr

from dolfinx_signorini.data.coefficients import Coefficients
from dolfinx_signorini.data.form_data import NAMES, form_data, is_everywhere, on_boundary, on_cells
from dolfinx_signorini.data.interfaces.piecewise_forms import piecewise
from dolfinx_signorini.data.reading import formula_of
from dolfinx_signorini.data.readings import Reading
from dolfinx_signorini.data.sampling import Datum
from dolfinx_signorini.meshes.sided_meshes import owned_cells
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem

STIFFNESS = NAMES["cell", 2], NAMES["exterior_facet", 2]  # data of a, of which bodies are made


def data_of(problem: BoundConstrainedProblem) -> list[Datum]:
    """Return the data of a problem that depend on the coordinates, as far as they are readable."""
    found = [*form_data(problem.L), *form_data(problem.a)]
    domain, contact = problem.space.mesh, problem.contact
    for obstacle in problem.obstacles:
        formula = formula_of(obstacle.data) if isinstance(obstacle.data, Expr) else None
        if formula is not None and formula.constant is None:
            own = contact[contact < len(owned_cells(domain))]
            parts = on_cells(domain, own) if problem.in_domain else on_boundary(domain, contact)
            degree = problem.space.element.basix_element.degree
            found.append(Datum("the obstacle", formula, "height", degree, *parts))
    return found


def coefficients_of(problem: BoundConstrainedProblem) -> Coefficients:
    """Return the coefficients of a problem, as far as integrals over all cells are readable.

    Those of a system of equations are not taken apart: nothing is known of the problem then.
    """
    if problem.space.dofmap.bs > 1:
        return Coefficients(None, None, ())
    slopes = range(1, problem.space.mesh.geometry.dim + 1)
    found = []
    for form in (problem.L, problem.a):
        reading, every = Reading(form), enumerate(form.integrals())
        over = [i for i, part in every if part.integral_type() == "cell" and is_everywhere(part)]
        found.append(partial(reading.total, [place for i in over for place in reading.places(i)]))
    load, a = found
    rows = tuple(tuple(a([s, t]) for t in slopes) for s in slopes)
    return Coefficients(load([0]), a([0, 0]), rows)


def integrate_piecewise(problem: BoundConstrainedProblem) -> None:
    """Let a problem have its data integrated piece by piece where they jump inside of cells.

    Args:
        problem: The problem; the call is collective. The stiffness of a body stays as it is.
    """
    domain = problem.space.mesh
    a, L = piecewise(problem.a, domain), piecewise(problem.L, domain)
    if a is not None or L is not None:
        problem.integrate(a, L)
