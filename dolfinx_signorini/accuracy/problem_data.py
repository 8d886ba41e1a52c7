"""The data of a problem, as the adaptive loop reads them."""

from functools import partial

import numpy as np
from dolfinx import fem

from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.data.coefficients import Coefficients
from dolfinx_signorini.data.form_data import NAMES, form_data, is_everywhere, on_boundary, on_cells
from dolfinx_signorini.data.reading import formula_of
from dolfinx_signorini.data.readings import Reading
from dolfinx_signorini.data.sampling import Datum
from dolfinx_signorini.meshes.sided_meshes import box
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.problem.dirichlet import data_of_condition

STIFFNESS = NAMES["cell", 2], NAMES["exterior_facet", 2]  # data of a, of which bodies are made


def data_of(problem: BoundConstrainedProblem) -> list[Datum]:
    """Return the data of a problem that depend on the coordinates, as far as they are readable."""
    found = [*form_data(problem.L), *form_data(problem.a)]
    domain, degree = problem.space.mesh, problem.space.element.basix_element.degree
    heights = []
    for zone in problem.zones:
        if zone.in_domain:
            parts = on_cells(domain, zone.owned_entities)
        else:
            parts = on_boundary(domain, zone.contact)
        heights += [("the obstacle", obstacle.data, parts) for obstacle in zone.obstacles]
        heights += [("the direction", part, parts) for part in problem.direction]
    for known in filter(None, map(data_of_condition, problem.bcs)):
        heights.append(("the Dirichlet data", known.value, on_boundary(domain, known.facets)))
    for name, value, parts in heights:
        formula = formula_of(value)
        if formula is not None and formula.constant is None:
            found.append(Datum(name, formula, "height", degree, *parts))
    return found


def unknown_between_nodes(problem: BoundConstrainedProblem) -> tuple[str, ...]:
    """Return a note where Dirichlet data vary and are known at nodes alone; collective."""
    if not any(_varies(problem, bc) for bc in problem.bcs if data_of_condition(bc) is None):
        return ()
    return (
        "the estimate knows Dirichlet data that vary at the nodes alone; given by "
        "dolfinx_signorini.dirichlet, they count between the nodes, too",
    )


def _varies(problem: BoundConstrainedProblem, condition: fem.DirichletBC) -> bool:
    """Whether a component has several values at the nodes of a condition; collective."""
    values = np.full(len(problem.u.x.array), np.nan)
    condition.set(values)
    for part in values.reshape(-1, problem.space.dofmap.bs).T:
        (low,), (high,) = box(problem.comm, part[np.isfinite(part), None])
        if high - low > SOLVED * max(abs(low), abs(high)):
            return True
    return False


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
