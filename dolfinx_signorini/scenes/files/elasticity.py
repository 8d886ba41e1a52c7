"""The table [elasticity] of a scene, and what a scene of displacements cannot have or do."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.data.formulas import Formula
from dolfinx_signorini.scenes.domains.domain import Domain
from dolfinx_signorini.scenes.files.toml_table import Key, TomlTable

NOT_ESTIMATED = "not with [elasticity]: errors of displacements are not estimated in scenes"
# What a scene of displacements cannot have or do, by keys of its file and options of commands.
REFUSED = {
    "accuracy": NOT_ESTIMATED,
    "budget": NOT_ESTIMATED,
    "norm": NOT_ESTIMATED,
    "max_unknowns": NOT_ESTIMATED,
    "bound": "not with [elasticity]: no bound of the energy error of displacements is proven",
    "tradeoff": "a scene with [elasticity] has no errors that could be compared",
    "solution": "not with [elasticity]: errors of displacements are not measured in scenes",
    "equation": "not with [elasticity], which has the equation: young, poisson and force",
    "obstacle": "not with [elasticity]: a body meets its obstacle on the boundary, [contact]",
    "neumann": "not with [elasticity], where the load on sides is [[traction]]",
}


@dataclass(frozen=True)
class Elasticity:
    """The material of a linear elastic body, and the force on its volume.

    The table comes from a scene file:

        material = Elasticity.read(top, domain)
        if material is not None:
            print(*material.words(), sep="; ")

    Attributes:
        young, poisson: Young's modulus and Poisson's ratio.
        plane: In the plane "strain" or "stress"; "" in space.
        force: The components of the force per volume; () for none.
        key: The table of a scene file.
        subjects: Subjects of errors about elastic bodies, with the keys of a scene file that the
            errors are about.
    """

    young: Formula
    poisson: Formula
    plane: str
    force: tuple[Formula, ...] = ()
    key: ClassVar = "elasticity"
    subjects: ClassVar[dict[str, Key]] = {
        "form a": ("elasticity",),
        "young": ("elasticity", "young"),
        "poisson": ("elasticity", "poisson"),
        "load": ("elasticity", "force"),
        "load and gap": ("elasticity", "force"),
        "gap": ("contact", "gap"),
        "direction": ("contact", "direction"),
        "bcs": ("dirichlet",),
    }

    @classmethod
    def read(cls, top: TomlTable, domain: Domain) -> "Elasticity | None":
        """Return the material of a scene file; None where the unknown is no displacement.

        Args:
            top: The file.
            domain: The domain of the scene.

        Raises:
            InputError: The table has a key that makes no sense, or the constants of the material
                are none.
        """
        if not top.has(cls.key):
            if top.has("traction"):
                raise top.error("traction", "goes with [elasticity]")
            return None
        table = top.table(cls.key)
        young, poisson = table.formula("young"), table.formula("poisson")
        if young.constant is not None and not young.constant > 0.0:
            raise table.error("young", f"must be positive, not {young.constant:g}")
        if poisson.constant is not None and not -1.0 < poisson.constant < 0.5:
            message = f"must lie between -1 and 1/2, not {poisson.constant:g}"
            raise table.error("poisson", message)
        if domain.dimension == 3 and table.has("plane"):
            raise table.error("plane", "for bodies in the plane, and the domain is in space")
        plane = ""
        if domain.dimension == 2:
            plane = table.choice("plane", ("strain", "stress"), "strain")
        force = table.vector("force", domain.dimension) if table.has("force") else ()
        table.finish()
        return cls(young, poisson, plane, force)

    def words(self) -> list[str]:
        """Return what the table adds to a problem, in words."""
        plane = f", plane {self.plane}" if self.plane else ""
        constants = f"Young's modulus {self.young.text} and Poisson's ratio {self.poisson.text}"
        found = [f"elasticity with {constants}{plane}"]
        if self.force:
            found.append(f"body force [{', '.join(f.text for f in self.force)}]")
        return found


def refuse_keys(top: TomlTable) -> None:
    """Refuse the keys of a scene file that make no sense beside [elasticity].

    Raises:
        InputError: The file has such a key.
    """
    if not top.has(Elasticity.key):
        return
    for key in top.data:
        if key in REFUSED:
            raise top.error(key, REFUSED[key])


def refuse_for_displacements(
    elasticity: Elasticity | None, names: Iterable[str], option: bool = False
) -> None:
    """Refuse what is not known of displacements.

    Args:
        elasticity: The material of a scene; of scalars nothing is refused.
        names: Names in `REFUSED`; others are taken.
        option: Whether the names are options of a command.

    Raises:
        InputError: One of the names is refused, which is the subject.
    """
    if elasticity is None:
        return
    for name in names:
        if name in REFUSED:
            raise InputError(REFUSED[name], "--" + name.replace("_", "-") if option else name)
