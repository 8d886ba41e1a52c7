"""A warning for forms whose diffusion jumps inside of cells, where no polynomial follows."""

import functools

from dolfinx_signorini.base.logs import log
from dolfinx_signorini.data.form_data import choices_in_diffusion
from dolfinx_signorini.data.interfaces.interface import interfaces
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem


def warn_of_cut_coefficients(problem: BoundConstrainedProblem) -> None:
    """Warn, once for each conditional, where the diffusion chooses inside of cells.

    Conditionals that are unreadable, such as those of finite element functions, are passed over.

    Args:
        problem: The problem; the call is collective.
    """
    if problem.space.mesh.topology.cell_name() not in ("triangle", "tetrahedron"):
        return
    for choice, formula, corners in choices_in_diffusion(problem):
        depths = [interface.depths(corners).any() for interface in interfaces(formula)]
        if problem.comm.allreduce(any(depths)):
            _warn_once(str(choice))


@functools.cache
def _warn_once(choice: str) -> None:
    log.warning(
        "a: the coefficient %s chooses inside of cells, which leaves an error of order h^(1/2) in "
        "the energy norm for any degree; let facets follow the jump, and give the coefficient on "
        'cells: the page "Coefficients that jump" (docs/howto/jumps.md)',
        choice,
    )
