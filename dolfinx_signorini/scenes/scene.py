"""Scenes: one Signorini problem as data.

A scene names what there is: the domain, which sides are contact, Dirichlet or Neumann boundary, the
coefficients, the load, the obstacle and, where it is known, the solution. What it does not name is
neither assembled nor stored.
"""

from dataclasses import dataclass, replace

from dolfinx_signorini.scenes.domains import Domain
from dolfinx_signorini.scenes.expressions import Expression
from dolfinx_signorini.solvers.cascade import DEFAULT_RTOL

Sides = tuple[str, ...]
Tensor = tuple[tuple[Expression, ...], ...]

ALL: Sides = ("all",)

OUTPUTS = {
    "fields": "solution, gap and pressure for ParaView (VTX, or XDMF where ADIOS2 is missing)",
    "boundary": "gap and pressure on the contact boundary as CSV",
    "pictures": "the solution and the contact boundary as PNG",
    "report": "one HTML page with all of it",
}


@dataclass(frozen=True)
class Contact:
    """Contact boundary.

    Attributes:
        sides: Where it is.
        obstacle: u >= obstacle, or u <= obstacle if `upper`. None in a manufactured scene for one
            that is made to touch the solution where its flux is not zero.
        upper: See there.
    """

    sides: Sides
    obstacle: Expression | None
    upper: bool = False


@dataclass(frozen=True)
class BoundaryData:
    """Sides with Dirichlet data or a flux; in a manufactured scene without an expression."""

    sides: Sides
    value: Expression | None


@dataclass(frozen=True)
class Scene:
    """One Signorini problem, -div(diffusion grad u) + reaction u = load.

    Attributes:
        domain: The domain with its mesh width.
        contact: The contact boundary.
        dirichlet, neumann: The parts with data u = value and diffusion grad u . n = value. On what
            is in no part the flux is zero.
        diffusion: A formula or, row by row, a symmetric matrix of them; None for 1.
        reaction: None for none.
        load: None for none.
        solution: The exact solution, where it is known.
        manufactured: Whether load, Dirichlet data and fluxes follow from the solution, and the
            obstacle too if it is None.
        norms: Of the error, where the solution is known, see `norms.parse_norm`.
        degree: Of the Lagrange elements, 1 or 2.
        rtol: Natural residual relative to the data.
        accuracy: The largest error allowed: mesh, degree and tolerance are chosen for it. None to
            solve on the domain's mesh.
        norm: The norm of this error, see `norms.parse_norm`.
        title: What the scene shows.
        outputs: Which of `OUTPUTS` are to be written.
        text: The scene file that it is from.
    """

    domain: Domain
    contact: Contact
    dirichlet: tuple[BoundaryData, ...] = ()
    neumann: tuple[BoundaryData, ...] = ()
    diffusion: Expression | Tensor | None = None
    reaction: Expression | None = None
    load: Expression | None = None
    solution: Expression | None = None
    manufactured: bool = False
    norms: tuple[str, ...] = ("L2", "Linf", "H1")
    degree: int = 1
    rtol: float = DEFAULT_RTOL
    accuracy: float | None = None
    norm: str = "L2"
    title: str = ""
    outputs: Sides = ()
    text: str = ""

    @property
    def sign(self) -> float:
        """1 for a lower obstacle; -1 for an upper one, where -u is solved for."""
        return -1.0 if self.contact.upper else 1.0

    def levels(self) -> list["Scene"]:
        """Return the scene on the meshes of the cascade, from the coarsest to its own."""
        return [replace(self, domain=domain) for domain in self.domain.levels()]
