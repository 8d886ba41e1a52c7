"""Scene files: a problem written as TOML. The format is described in docs/scenes.md."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfinx_signorini.errors import InputError
from dolfinx_signorini.norms import parse_norm
from dolfinx_signorini.scenes.domain_table import read_domain
from dolfinx_signorini.scenes.domains import Domain
from dolfinx_signorini.scenes.expressions import (
    CONSTANTS,
    COORDINATES,
    FUNCTIONS,
    Expression,
    number,
)
from dolfinx_signorini.scenes.scene import (
    ALL,
    OUTPUTS,
    BoundaryData,
    Contact,
    Scene,
    Sides,
    Tensor,
)
from dolfinx_signorini.scenes.suggestions import suggestion
from dolfinx_signorini.scenes.toml import MAX_BYTES, Key, Source, Table
from dolfinx_signorini.solvers.cascade import DEFAULT_RTOL

MAX_DEFINITIONS = 50

# Where in a file the data are that an error of the core names.
SUBJECTS: dict[str, Key] = {
    "contact": ("contact",),
    "Dirichlet data": ("dirichlet",),
    "accuracy": ("accuracy",),
    "form a": ("equation",),
    "load": ("equation", "load"),
    "obstacle": ("contact", "obstacle"),
    "solution": ("solution", "u"),
}

Definitions = Mapping[str, Expression]


def load_scene(path: Path, comm: MPI.Comm = MPI.COMM_WORLD) -> Scene:
    """Read a scene file.

    Args:
        path: The file; rank 0 reads it.
        comm: The communicator; the call is collective.

    Raises:
        InputError: The file cannot be read or says something that is no scene; the message names
            file, line and key.
    """
    text, message = comm.bcast(_read(path) if comm.rank == 0 else None)
    if message:
        raise InputError(message)
    return parse_scene(text, path, comm)


def parse_scene(text: str, path: Path, comm: MPI.Comm) -> Scene:
    """Return the scene that a text describes.

    Args:
        text: The text.
        path: The file it is from: for messages, and where its mesh is looked for.
        comm: The communicator that will share the mesh.
    """
    top = Source(path.name, text).load()
    accuracy, norm = _accuracy(top)
    domain = read_domain(top.table("domain"), path.parent, comm, accuracy)
    definitions = _definitions(top.table("define"), domain.dimension)
    equation, solution = top.table("equation"), top.table("solution")
    u, load, reaction = (
        _formula(table, key, domain, definitions)
        for table, key in ((solution, "u"), (equation, "load"), (equation, "reaction"))
    )
    if reaction is not None and reaction.constant is not None and reaction.constant < 0.0:
        raise equation.error("reaction", "must not be negative")
    diffusion = _diffusion(equation, domain, definitions)
    manufactured = solution.flag("manufactured")
    if manufactured and u is None:
        raise solution.error("manufactured", "there is no solution 'u' to make the data from")
    if manufactured and load is not None:
        raise equation.error("load", "follows from the solution, which is manufactured")
    contact = _contact(top.table("contact"), manufactured, domain, definitions)
    dirichlet, neumann = (
        _parts(top, name, key, manufactured, domain, definitions)
        for name, key in (("dirichlet", "value"), ("neumann", "flux"))
    )
    _check_overlap(top, contact, dirichlet, neumann, domain)
    scene = Scene(
        domain=domain,
        contact=contact,
        dirichlet=dirichlet,
        neumann=neumann,
        diffusion=diffusion,
        reaction=reaction,
        load=load,
        solution=u,
        manufactured=manufactured,
        norms=_norms(solution),
        degree=top.integer("degree", 1, 2) if top.has("degree") else 1,
        rtol=_fraction(top, "rtol", 1e-13) if top.has("rtol") else DEFAULT_RTOL,
        accuracy=accuracy,
        norm=norm,
        title=top.text("title") if top.has("title") else path.stem,
        outputs=_outputs(top),
        text=text,
    )
    for table in (equation, solution, top):
        table.finish()
    return scene


@contextmanager
def naming_the_file(path: Path, scene: Scene) -> Iterator[None]:
    """Give what is found wrong when a scene is posed or solved the place in its file.

    Args:
        path: The file.
        scene: What was read from it.
    """
    try:
        yield
    except InputError as error:
        subject, _, message = str(error).partition(": ")
        source = Source(path.name, scene.text)
        if subject not in SUBJECTS:
            raise source.error((), str(error)) from None
        raise source.error(SUBJECTS[subject], message) from None


def _read(path: Path) -> tuple[str, str]:
    """The text of a file, or what is wrong with it."""
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
        return data.decode("utf-8"), ""
    except OSError as error:
        return "", f"{path}: {error.strerror}"
    except (UnicodeDecodeError, ValueError):
        return "", f"{path}: not a text in UTF-8"


def _definitions(table: Table, dimension: int) -> dict[str, Expression]:
    definitions: dict[str, Expression] = {}
    if len(table.data) > MAX_DEFINITIONS:
        raise table.error(None, f"at most {MAX_DEFINITIONS} definitions are read")
    for name in table.data:
        if not re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII):
            raise table.error(name, "a name has letters, digits and '_' only")
        if name in FUNCTIONS or name in CONSTANTS or name in (*COORDINATES, "where"):
            raise table.error(name, "this name has a meaning already")
        definitions[name] = table.formula(name, dimension, definitions)
    return definitions


def _formula(table: Table, key: str, domain: Domain, definitions: Definitions) -> Expression | None:
    return table.formula(key, domain.dimension, definitions) if table.has(key) else None


def _diffusion(
    table: Table, domain: Domain, definitions: Definitions
) -> Expression | Tensor | None:
    if not table.has("diffusion"):
        return None
    rows = table.data["diffusion"]
    if not isinstance(rows, list):
        k = table.formula("diffusion", domain.dimension, definitions)
        if k.constant is not None and not k.constant > 0.0:
            raise table.error("diffusion", "must be positive")
        return k
    size = domain.dimension
    if len(rows) != size or any(not isinstance(r, list) or len(r) != size for r in rows):
        raise table.error("diffusion", f"a tensor has {size} rows of {size} entries here")
    tensor = tuple(
        tuple(table.formula_of("diffusion", entry, size, definitions) for entry in row)
        for row in rows
    )
    constants = np.array(
        [[np.nan if e.constant is None else e.constant for e in r] for r in tensor]
    )
    if np.isfinite(constants).all():
        if (constants != constants.T).any():
            raise table.error("diffusion", "the tensor is not symmetric")
        if not np.linalg.eigvalsh(constants).min() > 0.0:
            raise table.error("diffusion", "the tensor is not positive definite")
    return tensor


def _sides(table: Table, domain: Domain) -> Sides:
    if not table.has("sides"):
        raise table.error(None, "'sides' is missing")
    value = table.data["sides"]
    names = value if isinstance(value, list) else [value]
    if names == ["all"]:
        return ALL
    if not names:
        raise table.error("sides", "names no side")
    sides = []
    for name in names:
        if isinstance(name, bool) or not isinstance(name, str | int):
            raise table.error("sides", "must be names or numbers of sides")
        known = domain.side_names
        if str(name) not in known:
            raise table.error("sides", f"unknown side {str(name)!r}{suggestion(str(name), known)}")
        sides.append(str(name))
    return tuple(sides)


def _contact(table: Table, manufactured: bool, domain: Domain, definitions: Definitions) -> Contact:
    sides = _sides(table, domain)
    upper = table.has("bound") and table.choice("bound", ("lower", "upper")) == "upper"
    obstacle = _formula(table, "obstacle", domain, definitions)
    table.finish()
    if obstacle is None and not manufactured:
        obstacle = number(0.0)
    return Contact(sides, obstacle, upper)


def _parts(
    top: Table, name: str, key: str, manufactured: bool, domain: Domain, definitions: Definitions
) -> tuple[BoundaryData, ...]:
    parts = []
    for table in top.tables(name):
        sides = _sides(table, domain)
        value = _formula(table, key, domain, definitions)
        if manufactured and value is not None:
            raise table.error(key, "follows from the solution, which is manufactured")
        if not manufactured and value is None:
            raise table.error(None, f"{key!r} is missing")
        table.finish()
        parts.append(BoundaryData(sides, value))
    return tuple(parts)


def _check_overlap(
    top: Table,
    contact: Contact,
    dirichlet: tuple[BoundaryData, ...],
    neumann: tuple[BoundaryData, ...],
    domain: Domain,
) -> None:
    """Every side belongs to one part."""
    owner: dict[str, str] = {}
    parts = [("contact", contact.sides)]
    parts += [("dirichlet", p.sides) for p in dirichlet] + [("neumann", p.sides) for p in neumann]
    for name, sides in parts:
        for side in domain.side_names if sides == ALL else sides:
            if side in owner:
                raise top.error(name, f"side {side!r} belongs to {owner[side]} already")
            owner[side] = name


def _accuracy(top: Table) -> tuple[float | None, str]:
    """The error asked for, and its norm."""
    norm = _norm(top, "norm", top.text("norm")) if top.has("norm") else Scene.norm
    if not top.has("accuracy"):
        if "norm" in top.data:
            raise top.error("norm", "there is no 'accuracy' to measure in it")
        return None, norm
    accuracy = top.real("accuracy")
    if not accuracy > 0.0:
        raise top.error("accuracy", "must be positive")
    for key in ("degree", "rtol"):
        if top.has(key):
            raise top.error(key, "follows from 'accuracy'; give one of the two")
    return accuracy, norm


def _fraction(table: Table, key: str, low: float) -> float:
    value = table.real(key)
    if not low <= value < 1.0:
        raise table.error(key, f"must lie between {low:g} and 1")
    return value


def _norms(table: Table) -> tuple[str, ...]:
    if not table.has("norms"):
        return Scene.norms
    if "u" not in table.data:
        raise table.error("norms", "there is no solution 'u' to measure an error against")
    return tuple(_norm(table, "norms", name) for name in table.texts("norms"))


def _norm(table: Table, key: str, name: str) -> str:
    try:
        parse_norm(name)
    except ValueError as error:
        raise table.error(key, str(error)) from None
    return name


def _outputs(top: Table) -> Sides:
    if not top.has("outputs"):
        return ()
    outputs = top.texts("outputs")
    for name in outputs:
        if name not in OUTPUTS:
            raise top.error("outputs", f"unknown {name!r}{suggestion(name, OUTPUTS)}")
    return outputs
