"""Scene files: a problem written as TOML. The format is described in docs/scenes.md."""

import re
import stat
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfinx_signorini.accuracy.targets import target
from dolfinx_signorini.base.errors import InputError, option_name
from dolfinx_signorini.base.kinds import COMMUNICATOR, TEXT, TRUTH, check, instance, sequence
from dolfinx_signorini.base.tolerances import ROUNDING
from dolfinx_signorini.data.formulas import CONSTANTS, COORDINATES
from dolfinx_signorini.data.operations import FUNCTIONS
from dolfinx_signorini.meshes.elements import HIGHEST_DEGREE
from dolfinx_signorini.norms.names import parse_norm
from dolfinx_signorini.scenes.domains.kinds import read_domain
from dolfinx_signorini.scenes.files.conditions import read_conditions
from dolfinx_signorini.scenes.files.domain_obstacle import DomainObstacle
from dolfinx_signorini.scenes.files.elasticity import Elasticity
from dolfinx_signorini.scenes.files.scene import OUTPUTS, REFUSED, Scene, Tensor, constant_matrix
from dolfinx_signorini.scenes.files.toml_file import MAX_BYTES, TomlFile
from dolfinx_signorini.scenes.files.toml_table import POSITIVE, Rule, TomlTable, one_of

NOT_NEGATIVE: Rule = "must not be negative", lambda number: number >= 0.0
SHARE: Rule = "must lie between 0 and 1", lambda number: 0.0 < number < 1.0

# Keys that errors of solves are about: the subject of such an error is the last part of the key.
KEYS = (
    *("accuracy", "contact", "degree", "dirichlet", "domain", "neumann", "norm", "rtol"),
    *("contact.bound", "contact.direction", "contact.gap", "contact.obstacle", "equation.load"),
    *("elasticity.poisson", "elasticity.young", "solution.norms"),
    *("obstacle.cells", "obstacle.lower", "obstacle.upper"),
)
# The keys for other subjects, and for those of elastic bodies.
OTHERS = {
    "bcs": "dirichlet",
    "Dirichlet data": "dirichlet",
    "form a": "equation",
    "geometry": "domain.curves",
    "solution": "solution.u",
}
OF_BODIES = {"form a": "elasticity", "load": "elasticity.force"}


def load_scene(
    path: Path | str,
    comm: MPI.Comm = MPI.COMM_WORLD,
    overrides: Sequence[str] = (),
    adapted: bool = False,
) -> Scene:
    """Read a scene file.

    Args:
        path: The file; rank 0 reads it.
        comm: The communicator; the call is collective.
        overrides: Values in place of those of the file, each as "domain.cells=200".
        adapted: Whether the file need not say how fine the mesh is, because the scene will be
            solved to an accuracy or with a budget.

    Raises:
        InputError: The file cannot be read, or says something that is no scene; the message names
            file, line and key.
    """
    check(path=(path, instance((str, Path), "a path")), comm=(comm, COMMUNICATOR))
    check(overrides=(overrides, sequence(TEXT, "a list of texts")), adapted=(adapted, TRUTH))
    path = Path(path)
    text, message = comm.bcast(_read(path) if comm.rank == 0 else None)
    if message:
        raise InputError(message, str(path))
    return parse_scene(text, path, comm, overrides, adapted)


def parse_scene(
    text: str, path: Path, comm: MPI.Comm, overrides: Sequence[str] = (), adapted: bool = False
) -> Scene:
    """Return the scene that a text describes.

    Args:
        text: The text.
        path: The file that the text is from: for messages, and where a mesh file is looked for.
        comm: The communicator that will share the mesh.
        overrides, adapted: See `load_scene`.

    Raises:
        InputError: The text is no scene.
    """
    file = TomlFile(path.name, text, overrides)
    top = TomlTable(file.data, file)
    for key in top.data if top.has(Elasticity.key) else ():
        if key in REFUSED:
            raise top.error(key, REFUSED[key])
    accuracy = top.real("accuracy", POSITIVE, None)
    top.check_needed("norm", "accuracy", "there is no 'accuracy' to measure in it")
    domain = read_domain(top.table("domain"), path.parent, comm, accuracy is None, adapted)
    file.dimension = domain.dimension
    _read_definitions(top.table("define"))
    equation, solution = top.table("equation"), top.table("solution")
    solution.check_needed("norms", "u", "there is no solution 'u' to measure an error against")
    obstacle, domain = DomainObstacle.read(top, domain, comm)
    manufactured = _manufactured(solution, equation, obstacle)
    material = Elasticity.read(top, domain)
    scene = Scene(
        domain=domain,
        elasticity=material,
        conditions=read_conditions(top, domain, manufactured),
        obstacle=obstacle,
        diffusion=_diffusion(equation, domain.dimension),
        reaction=equation.formula("reaction", None, NOT_NEGATIVE),
        load=equation.formula("load", None),
        solution=solution.formula("u", None),
        manufactured=manufactured,
        norms=solution.texts("norms", Scene.norms, parse_norm),
        degree=top.integer("degree", 1, HIGHEST_DEGREE, Scene.degree),
        rtol=top.real("rtol", SHARE, Scene.rtol),
        accuracy=accuracy,
        norm=top.text("norm", Scene.norm, target if material is None else material.target),
        title=top.text("title", path.stem),
        outputs=top.texts("outputs", Scene.outputs, one_of(OUTPUTS)),
        text=text,
        overrides=tuple(overrides),
    )
    for table in (equation, solution, top):
        table.finish()
    return scene


@contextmanager
def naming_the_file(path: Path, scene: Scene, options: Collection[str] = ()) -> Iterator[None]:
    """Give errors of a scene that is posed or solved their place in the file of the scene.

    Args:
        path: The file.
        scene: The scene.
        options: What options of the command line give in place of the file: errors name them.
    """
    try:
        yield
    except InputError as error:
        if error.subject in options:
            raise InputError(error.message, option_name(error.subject)) from None
        file = TomlFile(path.name, scene.text, scene.overrides)
        known = {key.split(".")[-1]: key for key in KEYS} | OTHERS
        known |= {} if scene.elasticity is None else OF_BODIES
        key = known.get(error.subject.partition(" and ")[0])
        if key is None:
            raise file.error((), str(error)) from None
        raise file.error(tuple(key.split(".")), error.message) from None


def _read(path: Path) -> tuple[str, str]:
    """Return the text of a file, or what is wrong with the file."""
    try:
        mode = path.stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):  # nobody may ever write to a pipe
            return "", "not a regular file"
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:  # the last bytes may be a part of a character
            return "", f"a scene file has at most {MAX_BYTES} bytes"
        return data.decode("utf-8-sig"), ""
    except OSError as error:
        return "", str(error.strerror)
    except ValueError:
        return "", "not a text in UTF-8"


def _read_definitions(table: TomlTable) -> None:
    """Define names that stand for formulas, for all formulas of the file from now on."""
    for name in table.data:
        if not re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII):
            raise table.error(name, "a name has letters, digits and '_' only")
        if name in (*FUNCTIONS, *CONSTANTS, *COORDINATES):
            raise table.error(name, "this name has a meaning already")
        table.file.definitions[name] = table.formula(name)


def _diffusion(table: TomlTable, dimension: int) -> Tensor:
    if not table.has("diffusion"):
        return ()
    rows = table.data["diffusion"]
    if not isinstance(rows, list):
        return ((table.formula("diffusion", rule=POSITIVE),),)
    if len(rows) != dimension or any(not isinstance(r, list) or len(r) != dimension for r in rows):
        message = f"a tensor has {dimension} rows of {dimension} entries here"
        raise table.error("diffusion", message)
    tensor = tuple(tuple(table.parsed("diffusion", entry) for entry in row) for row in rows)
    constants = constant_matrix(tensor)
    if constants is not None:
        if np.abs(constants - constants.T).max() > ROUNDING * np.abs(constants).max():
            raise table.error("diffusion", "the tensor is not symmetric")
        axes = range(dimension)
        tensor = tuple(tuple(tensor[min(i, j)][max(i, j)] for j in axes) for i in axes)
        if not np.linalg.eigvalsh(constants).min() > 0.0:
            raise table.error("diffusion", "the tensor is not positive definite")
    return tensor


def _manufactured(
    solution: TomlTable, equation: TomlTable, obstacle: DomainObstacle | None
) -> bool:
    """Return whether the data follow from the solution."""
    manufactured = bool(solution.value("manufactured", bool, "true or false", False))
    if manufactured and not solution.has("u"):
        raise solution.error("manufactured", "there is no solution 'u' to make the data from")
    if manufactured and equation.has("load"):
        raise equation.error("load", "follows from the solution, which is manufactured")
    if manufactured and obstacle is not None:
        message = "not with [obstacle]: from u alone, the load under an obstacle is not known"
        raise solution.error("manufactured", message)
    return manufactured
