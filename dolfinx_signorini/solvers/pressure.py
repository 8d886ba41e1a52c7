"""The contact pressure of a discrete solution, and the state that a finer mesh starts from."""

from dataclasses import dataclass

from dolfinx import fem
from petsc4py import PETSc

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.kinds import FUNCTION, check
from dolfinx_signorini.base.ranks import function_with
from dolfinx_signorini.solvers.system import System


@dataclass(frozen=True)
class ContactState:
    """A discrete solution as the solve on another mesh needs it.

    A problem gives its state, and another one starts from the state:

        fine.solve(coarse=problem.contact_state())

    Attributes:
        u: The solution.
        density: The density of the contact force on u, zero away from the contact dofs; where u is
            a vector, of the force along the direction of the obstacle.

    Raises:
        InputError: An attribute is of another kind, or the density lives on another mesh.
    """

    u: fem.Function
    density: fem.Function

    def __post_init__(self) -> None:
        check(u=(self.u, FUNCTION), density=(self.density, FUNCTION))
        if self.u.function_space.mesh != self.density.function_space.mesh:
            raise InputError("lives on another mesh than u", "density")


def contact_state(system: System, x: PETSc.Vec) -> ContactState:
    """Return a solution with the density of its contact pressure.

    Args:
        system: The system.
        x: The solution of the system.
    """
    u = fem.Function(system.space, name="u")
    system.fill(u, x)
    layout, forces = system.layout, system.signs * system.multiplier(x)
    known = function_with(layout.nodal, layout.contact_nodes, forces)
    return ContactState(u=u, density=layout.density(known))
