"""Kinds of arguments that public functions take: what is of another kind is refused by name."""

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


def instance(kinds: type | tuple[type, ...], words: str) -> Kind:
    """Return the kind of objects of a class.

    Args:
        kinds: The class, or several.
        words: The name of the kind with an article, for messages.
    """
    return lambda value: "" if isinstance(value, kinds) else _not(words, value)


def optional(kind: Kind) -> Kind:
    """Return the kind of which None is, too."""
    return lambda value: "" if value is None else kind(value)


def integer(low: int, high: int | None = None) -> Kind:
    """Return the kind of whole numbers between two others, both included.

    Args:
        low: The smallest.
        high: The largest; None for no limit.
    """
    words = f"an integer of at least {low}" + ("" if high is None else f" and at most {high}")

    def kind(value: Any) -> str:
        whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
        fits = whole and low <= value and (high is None or value <= high)
        return "" if fits else _not(words, value)

    return kind


def sequence(kind: Kind, words: str) -> Kind:
    """Return the kind of lists and other collections whose items are of a kind.

    Args:
        kind: The kind of the items.
        words: What the collection is, with an article.
    """

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
    domain: mesh.Mesh, tensor: bool = False, normals: bool = False, callables: bool = False
) -> Kind:
    """Return the kind of data on a mesh: finite numbers, and scalar UFL expressions.

    Args:
        domain: The mesh.
        tensor: Whether square matrices of its dimension are data, too.
        normals: Whether normals and the like are known where the data are: on facets.
        callables: Whether functions of Python are data, too.
    """
    shapes = [(), *([(domain.geometry.dim,) * 2] if tensor else [])]
    home = domain.ufl_domain()
    seen: set[Expr] = set()  # what one value has in common with another is looked at once

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
    return lambda value: "" if isinstance(value, str) and value in choices else _not(words, value)


def data(value: Any) -> str:
    """The kind of finite numbers, UFL expressions and callables of the coordinates."""
    if isinstance(value, Expr) or _is_number(value) or callable(value):
        return ""
    return _not("a finite number, a UFL expression or a callable", value)


def coordinates(dimension: int) -> Kind:
    """Return the kind of points in the plane or in space.

    Args:
        dimension: The number of coordinates.
    """

    def kind(value: Any) -> str:
        good = isinstance(value, tuple | list | np.ndarray) and len(value) == dimension
        good = good and all(_is_number(coordinate) for coordinate in value)
        return "" if good else _not(f"{dimension} finite coordinates", value)

    return kind


def ball(dimension: int) -> Kind:
    """Return the kind of pairs of a centre and a radius.

    Args:
        dimension: The number of coordinates.
    """

    def kind(value: Any) -> str:
        if not (isinstance(value, tuple | list) and len(value) == 2):
            return _not("a centre and a radius", value)
        return coordinates(dimension)(value[0]) or positive(value[1])

    return kind


def indices(value: Any) -> str:
    """The kind of arrays of indices."""
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        return "facets are given by an array of their indices"
    integers = array.ndim == 1 and (not array.size or np.issubdtype(array.dtype, np.integer))
    return "" if integers else "facets are given by an array of their indices"


def by_text(value: Any) -> str:
    """The kind of mappings from texts, such as options by their names."""
    if not isinstance(value, Mapping):
        return _not("a mapping", value)
    return next(filter(None, map(TEXT, value)), "")


def positive(value: Any) -> str:
    """The kind of finite positive numbers."""
    return "" if _is_number(value) and value > 0.0 else _not("a positive number", value)


def gmsh_model(value: Any) -> str:
    """The kind of models of gmsh, which is not loaded for that."""
    return "" if hasattr(value, "mesh") else f"must be gmsh.model, not {type(value).__name__}"


def callable_(value: Any) -> str:
    """The kind of functions of Python."""
    return "" if callable(value) else _not("a function", value)


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


# Degrees beyond these are of no use, and their tables fill the memory.
LARGEST_DEGREE = 8
MESH = _mesh
FUNCTION = instance(fem.Function, "a function")
COMMUNICATOR = instance(MPI.Comm, "a communicator")
TEXT = instance(str, "a text")
TRUTH = instance(bool, "True or False")
