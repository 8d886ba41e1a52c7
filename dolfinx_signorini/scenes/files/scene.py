"""Scenes: one Signorini problem of a scalar or of an elastic body, or obstacles in the domain.

A scene names its parts: the domain, the conditions on its boundary, the coefficients, the load
and, where it is known, the solution. What a scene does not name is neither assembled nor stored.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from dolfinx_signorini.accuracy.targets import Target, target
from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.errors import InputError, option_name
from dolfinx_signorini.data.formulas import Formula
from dolfinx_signorini.scenes.domains.domain import Domain
from dolfinx_signorini.scenes.files.conditions import BoundaryCondition, Contact
from dolfinx_signorini.scenes.files.domain_obstacle import DomainObstacle
from dolfinx_signorini.scenes.files.elasticity import Elasticity

Tensor = tuple[tuple[Formula, ...], ...]

OUTPUTS = {
    "fields": "solution, gap and pressure for ParaView (VTX, or XDMF where ADIOS2 is missing)",
    "boundary": "gap and pressure on the contact boundary, or where the obstacle is, as CSV",
    "pictures": "the solution and the contact boundary, or the contact set, as PNG",
    "report": "one HTML page with all results",
}
# What scenes of displacements cannot have or do, by keys of files and options of commands.
REFUSED = {
    "bound": "not with [elasticity]: no bound of the energy error of displacements is proven",
    "tradeoff": "a scene with [elasticity] has no errors that could be compared",
    "solution": "not with [elasticity]: errors of displacements are not measured in scenes",
    "equation": "not with [elasticity], which has the equation: young, poisson and force",
    "obstacle": "not with [elasticity]: a body meets its obstacle on the boundary, [contact]",
    "neumann": "not with [elasticity], where the load on sides is [[traction]]",
}
OF_BOTH = {"bound": "no bound is known for [contact] and [obstacle] together"}


@dataclass(frozen=True)
class Scene:
    """One problem with obstacles, -div(diffusion grad u) + reaction u = load.

    A scene is read from a file and solved, here on a mesh of another width:

        scene = load_scene(Path("scene.toml"))
        result = solve_scene(replace(scene, domain=scene.domain.at(200)))

    Attributes:
        domain: The domain with its mesh.
        conditions: The conditions on the boundary, one of them `Contact` unless all obstacles are
            in the domain. On sides without a condition the flux is zero or, in a manufactured
            scene, that of the solution.
        diffusion: The rows of a symmetric matrix, with one row and entry for a scalar; () for 1.
        obstacle: The obstacles in the domain; None for an obstacle on the boundary alone.
        elasticity: The material of an elastic body, whose displacement is the unknown; None for a
            scalar unknown.
        reaction: None for none.
        load: None for none.
        solution: The exact solution, where it is known.
        manufactured: Whether load, Dirichlet data and fluxes follow from the solution, and the
            obstacle, too, where the contact boundary has none.
        norms: The norms of the error that are measured where the solution is known, see
            `norm_names.parse_norm`.
        degree: The degree of the elements, from 1 to 4.
        rtol: The natural residual to reach, relative to the data; by default the solve stops where
            the discretisation error hides the rest, see `SignoriniProblem.solve`.
        accuracy: The largest error allowed: mesh, degree and tolerance are chosen for it. None for
            a solution on the domain's mesh.
        norm: The norm of this error, see `target`.
        title: What the scene shows.
        outputs: The names of the `OUTPUTS` that are to be written.
        text: The scene file that the scene is from.
        overrides: The values, written as KEY=VALUE, that stand in place of those of the file.
    """

    domain: Domain
    conditions: tuple[BoundaryCondition, ...]
    obstacle: DomainObstacle | None = None
    elasticity: Elasticity | None = None
    diffusion: Tensor = ()
    reaction: Formula | None = None
    load: Formula | None = None
    solution: Formula | None = None
    manufactured: bool = False
    norms: tuple[str, ...] = ("L2", "Linf", "H1")
    degree: int = 1
    rtol: float | None = None
    accuracy: float | None = None
    norm: str = "L2"
    title: str = ""
    outputs: tuple[str, ...] = ()
    text: str = ""
    overrides: tuple[str, ...] = ()

    @property
    def contact(self) -> Contact | None:
        """The condition on the contact boundary; None where all obstacles are in the domain."""
        return next((c for c in self.conditions if isinstance(c, Contact)), None)

    @property
    def components(self) -> int:
        """The number of components of the unknown."""
        return 1 if self.elasticity is None else self.domain.dimension

    def refuse(self, names: Iterable[str], option: bool = False) -> None:
        """Refuse what is not known of such scenes.

        Args:
            names: Names of what is asked for; names without any limitation are taken.
            option: Whether the names are options of a command.

        Raises:
            InputError: One of the names is refused, which is the subject.
        """
        refused = REFUSED if self.elasticity else OF_BOTH if self.contact and self.obstacle else {}
        for name in names:
            if name in refused:
                raise InputError(refused[name], option_name(name) if option else name)

    def target(self, norm: str) -> Target:
        """Return what is to be accurate where an error is asked for in a norm.

        Args:
            norm: The name, see `norm_names.parse_norm`; of a body see `Elasticity.target`.

        Raises:
            InputError: The name is that of no norm.
        """
        return target(norm) if self.elasticity is None else self.elasticity.target(norm)

    @property
    def diffusion_entries(self) -> list[Formula]:
        """The entries of the diffusion, row by row."""
        return [entry for row in self.diffusion for entry in row]

    @property
    def constant_diffusion(self) -> Array | None:
        """The matrix of a constant diffusion, or its one entry; None for any other, and for 1."""
        return constant_matrix(self.diffusion)

    def levels(self) -> list["Scene"]:
        """Return the scene on the meshes of the cascade, from the coarsest to its own."""
        return [replace(self, domain=domain) for domain in self.domain.levels()]


def constant_matrix(tensor: Tensor) -> Array | None:
    """Return the entries of a constant tensor; None for any other, and where there are none."""
    values: Array = np.array([[e.constant for e in row] for row in tensor], dtype=np.float64)
    return values if values.size and np.isfinite(values).all() else None
