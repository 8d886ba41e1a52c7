"""Checks of the arguments of a problem: each refusal names the argument, before any long work."""

from collections.abc import Collection
from typing import Any

import numpy as np
import ufl
from dolfinx import fem, mesh
from ufl import classes
from ufl.corealg.traversal import unique_pre_traversal

from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.errors import InputError, require
from dolfinx_signorini.base.kinds import (
    FUNCTION,
    MESH,
    Kind,
    check,
    indices,
    instance,
    integer,
    sequence,
)
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, facet_count

CELLS = ("interval", "triangle", "tetrahedron", "quadrilateral", "hexahedron")
SCOPE = 'the page "What this is not" (docs/scope.md) solves such problems by SNES'
OF_VECTORS = "ContactProblem has displacements (docs/howto/elastic.md)"
IN_CELLS = "ObstacleProblem has obstacles in cells and on curves (docs/howto/which_problem.md)"


def checked_space(a: Any, L: Any, vectors: bool = False) -> fem.FunctionSpace:
    """Return the space of a bilinear and a linear form.

    Args:
        a: What should be a bilinear form on a continuous Lagrange space.
        L: What should be a linear form on the same space.
        vectors: Whether the functions should be vectors, and not scalars.

    Raises:
        InputError: The subject is "form a" or "load".
    """
    for form, subject in ((a, "form a"), (L, "load")):
        if not isinstance(form, ufl.Form):
            raise InputError(f"must be a UFL form, not {type(form).__name__}", subject)
    arguments = a.arguments()
    if len(arguments) != 2:
        message = f"needs a trial and a test function, has {len(arguments)}"
        message += f"; if the operator is not linear, {SCOPE}" if len(arguments) == 1 else ""
        raise InputError(message, "form a")
    space = arguments[0].ufl_function_space()
    if not isinstance(space, fem.FunctionSpace):
        raise InputError("its space must be one of dolfinx", "form a")
    if space.component():
        raise InputError("its space is a part of another one; take `collapse()[0]` of it", "form a")
    check(**{"form a": (space.mesh, MESH)})
    cell = space.mesh.topology.cell_name()
    if cell not in CELLS:
        raise InputError(f"known on meshes of {', '.join(CELLS)}, not of {cell} cells", "form a")
    element = space.ufl_element()
    size = space.mesh.geometry.dim if vectors else 1
    if space.dofmap.bs != size and vectors:
        message = f"the space must be one of vectors with {size} components, a displacement"
        raise InputError(f"{message}; SignoriniProblem has scalars", "form a")
    if space.dofmap.bs != 1 and not vectors:
        message = (
            f"the space has vectors of {space.dofmap.bs} components, and the unknown is a scalar"
        )
        raise InputError(f"{message}; {OF_VECTORS}", "form a")
    if element.family_name != "P" or element.discontinuous:
        raise InputError("the space must be a continuous Lagrange space", "form a")
    if not _same_space(arguments[1].ufl_function_space(), space):
        raise InputError("trial and test function belong to different spaces", "form a")
    if len(L.arguments()) != 1:
        raise InputError(f"the form L needs one test function, has {len(L.arguments())}", "load")
    if not _same_space(L.arguments()[0].ufl_function_space(), space):
        raise InputError("its test function belongs to another space than the form a", "load")
    for form, subject in ((a, "form a"), (L, "load")):
        _check_mesh(form, space.mesh, subject)
    return space


def checked_facets(domain: mesh.Mesh, contact: Any) -> LocalIndices:
    """Return the facets that an argument `contact` names.

    Args:
        domain: The mesh.
        contact: LocalIndices of facets, or MeshTags of facets, alone or in a pair with values.

    Raises:
        InputError: The subject is "contact".
    """
    facets = _entities(domain, domain.topology.dim - 1, contact, "contact")
    index_map = domain.topology.index_map(domain.topology.dim - 1)
    owned = facets[facets < index_map.size_local]
    outer = np.zeros(index_map.size_local, dtype=bool)
    outer[boundary_facets(domain)] = True
    inner = np.sort(owned[~outer[owned]])
    message = f"facet {inner[0]} lies inside of the domain" if len(inner) else ""
    message = f"{message}, and not on the boundary; {IN_CELLS}" if message else ""
    require(domain.comm, not message, message, "contact")
    return facets


def checked_cells(domain: mesh.Mesh, cells: Any) -> LocalIndices:
    """Return the cells that an argument `cells` names, ghosts included.

    Args:
        domain: The mesh.
        cells: Indices of cells, or MeshTags of cells, alone or in a pair with values; None for all.

    Raises:
        InputError: The subject is "cells".
    """
    if cells is None:
        index_map = domain.topology.index_map(domain.topology.dim)
        return np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
    return _entities(domain, domain.topology.dim, cells, "cells")


def has_choices(form: ufl.Form) -> bool:
    """Return whether integrands over cells choose by conditions, of which UFL makes signs, too.

    Args:
        form: The form, whose expressions are traversed once.
    """
    return any(
        isinstance(part, classes.Conditional)
        for integral in form.integrals_by_type("cell")
        for part in unique_pre_traversal(integral.integrand())
    )


def conditions_of(space: fem.FunctionSpace) -> Kind:
    """Return the kind of Dirichlet conditions of a space."""
    condition = instance(fem.DirichletBC, "a list of Dirichlet conditions")

    def kind(value: Any) -> str:
        wrong = condition(value)
        if wrong or space._cpp_object.contains(value.function_space):
            return wrong
        return "a Dirichlet condition belongs to another function space than the form a"

    return kind


def functions_of(space: fem.FunctionSpace) -> Kind:
    """Return the kind of functions of a space."""

    def kind(value: Any) -> str:
        wrong = FUNCTION(value)
        if wrong or _same_space(value.function_space, space):
            return wrong
        return "belongs to another function space than the form a"

    return kind


def _same_space(one: Any, other: Any) -> bool:
    """Whether two Python objects stand for the same function space, dof for dof."""
    return isinstance(one, fem.FunctionSpace) and one._cpp_object == other._cpp_object


def _check_mesh(form: ufl.Form, domain: mesh.Mesh, subject: str) -> None:
    others = [found for found in form.ufl_domains() if found != domain.ufl_domain()]
    functions = [c for c in form.coefficients() if isinstance(c, fem.Function)]
    if others or any(f.function_space.mesh != domain for f in functions):
        raise InputError("lives on another mesh than the form a", subject)


def _entities(domain: mesh.Mesh, dim: int, given: Any, subject: str) -> LocalIndices:
    """The facets or cells that an argument names, each once and in order; collective."""
    kind = "cell" if dim == domain.topology.dim else "facet"
    found, message = _named(domain, dim, given, kind)
    require(domain.comm, not message, message, subject)
    count = facet_count(domain)
    if kind == "cell":
        index_map = domain.topology.index_map(dim)
        count = index_map.size_local + index_map.num_ghosts
    bad = found[(found < 0) | (found >= count)]
    message = f"{bad[0]} is no {kind}, the mesh has {count} of them here" if len(bad) else ""
    require(domain.comm, not message, message, subject)
    message = f"there is no {kind}: the problem is linear, see dolfinx.fem.petsc.LinearProblem"
    require(domain.comm, domain.comm.allreduce(len(found)) > 0, message, subject)
    return np.unique(found).astype(np.int32)


def _named(domain: mesh.Mesh, dim: int, given: Any, kind: str) -> tuple[LocalIndices, str]:
    """The facets or cells, and what is wrong with the argument on this rank."""
    nothing = np.empty(0, dtype=np.int32)
    pair = isinstance(given, tuple) and len(given) == 2
    tags, values = given if pair else (given, None)
    if isinstance(tags, mesh.MeshTags):
        if tags.dim != dim:
            message = f"tags of dimension {tags.dim}, not of {kind}s, which have {dim}"
            return nothing, f"{message}; {IN_CELLS}" if tags.dim > dim else message
        if tags.topology != domain.topology._cpp_object:
            return nothing, "the tags belong to another mesh"
        if values is None:
            return np.asarray(tags.indices, dtype=np.int32), ""
        plain = values.tolist() if isinstance(values, np.ndarray | np.generic) else values
        several = isinstance(plain, Collection) and not isinstance(plain, str | bytes)
        wanted = list(plain) if several else [plain]
        if sequence(integer(-(2**31)), "numbers")(wanted):
            return nothing, "the values of tags are integers"
        return np.asarray(tags.indices[np.isin(tags.values, wanted)], dtype=np.int32), ""
    message = indices(given, f"{kind}s")
    if message:
        finder = "locate_entities" if kind == "cell" else "locate_entities_boundary"
        return nothing, f"{message} (dolfinx.mesh.{finder}), or by MeshTags"
    return np.asarray(given).astype(np.int64), ""
