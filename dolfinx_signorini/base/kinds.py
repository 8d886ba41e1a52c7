"""Kinds of arguments that public functions take: what is of another kind is refused by name."""

import contextlib
import math
from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from ufl.core.expr import Expr
from ufl.corealg.traversal import traverse_unique_terminals
from ufl.geometry import GeometricFacetQuantity

from dolfinx_signorini.base.errors import InputError

# What is wrong with a value, in words; "" where nothing is.
Kind = Callable[[Any], str]


def check(**arguments: tuple[Any, Kind]) -> None:
    """Refuse arguments of the wrong kind, before any work.

    A public function begins with the check of its arguments:

        check(domain=(domain, MESH), degree=(degree, integer(1)))

    Args:
        arguments: Values by name, each with the kind that is needed.

    Raises:
        InputError: The subject is the name of the first argument that is of another kind.
    """
    for name, (value, kind) in arguments.items():
        message = kind(value)
        if message:
            raise InputError(message, name)


def known_by(words: str, holds: Callable[[Any], bool]) -> Kind:
    """Return the kind of values for which a condition holds.

    Args:
        words: The name of the kind with an article, for messages.
        holds: Whether a value is of the kind.
    """
    return lambda value: "" if holds(value) else _not(words, value)


def instance(kinds: type | tuple[type, ...], words: str) -> Kind:
    """Return the kind of objects of a class, or of several; for the words see `known_by`."""
    return known_by(words, lambda value: isinstance(value, kinds))


def optional(kind: Kind) -> Kind:
    """Return the kind of which None is, too."""
    return lambda value: "" if value is None else kind(value)


def integer(low: int, high: int | None = None) -> Kind:
    """Return the kind of whole numbers between two others, both included; None is no limit."""
    words = f"an integer of at least {low}" + ("" if high is None else f" and at most {high}")

    def holds(value: Any) -> bool:
        whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
        return bool(whole and low <= value and (high is None or value <= high))

    return known_by(words, holds)


def sequence(kind: Kind, words: str) -> Kind:
    """Return the kind of lists and other collections whose items are of a kind."""

    def found(value: Any) -> str:
        if isinstance(value, str | bytes) or not isinstance(value, Collection):
            return _not(words, value)
        return next((message for message in map(kind, value) if message), "")

    return found


def simplices(*dimensions: int, straight: bool = False) -> Kind:
    """Return the kind of meshes of triangles or tetrahedra that fill the plane or space.

    Args:
        dimensions: The dimensions that are allowed, among 2 and 3.
        straight: Whether the cells must have straight sides, as in meshes of the first order.
    """
    words = " or ".join({2: "triangles", 3: "tetrahedra"}[d] for d in dimensions)

    def kind(value: Any) -> str:
        if _mesh(value):
            return _mesh(value)
        name, dimension = value.topology.cell_name(), value.geometry.dim
        fits = name in ("triangle", "tetrahedron") and value.topology.dim == dimension
        if not (fits and dimension in dimensions):
            return f"must be a mesh of {words}"
        order = value.geometry.cmap.degree
        curved = f"must be a mesh with straight sides, of order 1, not {order}"
        return curved if straight and order > 1 else ""

    return kind


def on_mesh(
    domain: mesh.Mesh,
    tensor: bool = False,
    normals: bool = False,
    callables: bool = False,
    vectors: bool = False,
) -> Kind:
    """Return the kind of data on a mesh: finite numbers, and scalar UFL expressions.

    Args:
        domain: The mesh.
        tensor: Whether square matrices of its dimension are data, too.
        normals: Whether normals and the like are known where the data are: on facets.
        callables: Whether functions of Python are data, too.
        vectors: Whether vectors of its dimension are data, too.
    """
    dim = domain.geometry.dim
    shapes = [(), *([(dim, dim)] if tensor else []), *([(dim,)] if vectors else [])]
    home = domain.ufl_domain()
    seen: set[Expr] = set()  # what one value has in common with another is checked once

    def kind(value: Any) -> str:
        if isinstance(value, Expr):
            if value.ufl_shape not in shapes:
                return f"must be scalar, has shape {value.ufl_shape}"
            terminals = list(traverse_unique_terminals(value, seen))
            if any(other != home for part in terminals for other in part.ufl_domains()):
                return "lives on another mesh"
            if any(isinstance(part, ufl.Argument) for part in terminals):
                return "has a test or trial function in it"
            normal = any(isinstance(part, GeometricFacetQuantity) for part in terminals)
            return "has the normal of a facet in it" if normal and not normals else ""
        fits = _is_number(value) or (callables and callable(value))
        return "" if fits else _not("a finite number or a UFL expression", value)

    return kind


def choice(*choices: str) -> Kind:
    """Return the kind of some texts."""
    words = " or ".join(map(repr, choices))
    return known_by(words, lambda value: isinstance(value, str) and value in choices)


def coordinates(dimension: int) -> Kind:
    """Return the kind of points in the plane or in space, with so many coordinates."""

    def holds(value: Any) -> bool:
        point = isinstance(value, tuple | list | np.ndarray) and len(value) == dimension
        return point and all(map(_is_number, value))

    return known_by(f"{dimension} finite coordinates", holds)


def ball(dimension: int) -> Kind:
    """Return the kind of pairs of a centre, with so many coordinates, and a radius."""

    def kind(value: Any) -> str:
        if not (isinstance(value, tuple | list) and len(value) == 2):
            return _not("a centre and a radius", value)
        return coordinates(dimension)(value[0]) or positive(value[1])

    return kind


def indices(value: Any, what: str = "facets") -> str:
    """The kind of arrays of indices of facets, or of what else is named."""
    integers = False
    with contextlib.suppress(ValueError):  # rows of different lengths
        array = np.asarray(value)
        integers = array.ndim == 1 and (not array.size or np.issubdtype(array.dtype, np.integer))
    return "" if integers else f"{what} are given by an array of their indices"


def by_text(value: Any) -> str:
    """The kind of mappings from texts, such as options by their names."""
    if not isinstance(value, Mapping):
        return _not("a mapping", value)
    return next(filter(None, map(TEXT, value)), "")


def gmsh_model(value: Any) -> str:
    """The kind of models of gmsh, which is not loaded for that."""
    return "" if hasattr(value, "mesh") else f"must be gmsh.model, not {type(value).__name__}"


def _mesh(value: Any) -> str:
    if not isinstance(value, mesh.Mesh):
        return _not("a mesh", value)
    single = value.geometry.x.dtype != np.float64
    return "must be a mesh with coordinates in double precision" if single else ""


def _is_number(value: Any) -> bool:
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    return bool(number and math.isfinite(value))


def _not(words: str, value: Any) -> str:
    plain = isinstance(value, int | float | str | np.number)
    return f"must be {words}, not {repr(value) if plain else type(value).__name__}"


real = known_by("a finite number", _is_number)
positive = known_by("a positive number", lambda value: _is_number(value) and value > 0.0)
callable_ = known_by("a function", callable)
data = known_by(
    "a finite number, a UFL expression or a callable",
    lambda value: isinstance(value, Expr) or _is_number(value) or callable(value),
)
MESH = _mesh
FUNCTION = instance(fem.Function, "a function")
COMMUNICATOR = instance(MPI.Comm, "a communicator")
TEXT = instance(str, "a text")
TRUTH = instance(bool, "True or False")
