"""Checks of the arguments of a problem: each refusal names the argument, before any long work."""

from collections.abc import Collection
from typing import Any

import numpy as np
import ufl
from dolfinx import fem, mesh

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


def checked_space(a: Any, L: Any) -> fem.FunctionSpace:
    """Return the space of a bilinear and a linear form.

    Args:
        a: What should be a bilinear form on a scalar, continuous Lagrange space.
        L: What should be a linear form on the same space.

    Raises:
        InputError: The subject is "form a" or "load".
    """
    for form, subject in ((a, "form a"), (L, "load")):
        if not isinstance(form, ufl.Form):
            raise InputError(f"must be a UFL form, not {type(form).__name__}", subject)
    arguments = a.arguments()
    if len(arguments) != 2:
        raise InputError(f"needs a trial and a test function, has {len(arguments)}", "form a")
    space = arguments[0].ufl_function_space()
    if not isinstance(space, fem.FunctionSpace):
        raise InputError("its space must be one of dolfinx", "form a")
    check(**{"form a": (space.mesh, MESH)})
    cell = space.mesh.topology.cell_name()
    if cell not in CELLS:
        raise InputError(f"known on meshes of {', '.join(CELLS)}, not of {cell} cells", "form a")
    element = space.ufl_element()
    if space.dofmap.bs != 1 or element.family_name != "P" or element.discontinuous:
        raise InputError("the space must be a scalar, continuous Lagrange space", "form a")
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
    facets, message = _named_facets(domain, contact)
    require(domain.comm, not message, message, "contact")
    count = facet_count(domain)
    index_map = domain.topology.index_map(domain.topology.dim - 1)
    bad = facets[(facets < 0) | (facets >= count)]
    message = f"{bad[0]} is no facet, the mesh has {count} of them here" if len(bad) else ""
    require(domain.comm, not message, message, "contact")
    owned = facets[facets < index_map.size_local]
    outer = np.zeros(index_map.size_local, dtype=bool)
    outer[boundary_facets(domain)] = True
    inner = np.sort(owned[~outer[owned]])
    message = f"facet {inner[0]} is not on the boundary" if len(inner) else ""
    require(domain.comm, not message, message, "contact")
    message = "there is no facet: the problem is linear, see dolfinx.fem.petsc.LinearProblem"
    require(domain.comm, domain.comm.allreduce(len(facets)) > 0, message, "contact")
    return np.unique(facets).astype(np.int32)


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


def _named_facets(domain: mesh.Mesh, contact: Any) -> tuple[LocalIndices, str]:
    """The facets, and what is wrong with the facets on this rank."""
    nothing = np.empty(0, dtype=np.int32)
    pair = isinstance(contact, tuple) and len(contact) == 2
    tags, values = contact if pair else (contact, None)
    if isinstance(tags, mesh.MeshTags):
        dimension = domain.topology.dim - 1
        if tags.dim != dimension:
            return nothing, f"tags of dimension {tags.dim}, not of facets, which have {dimension}"
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
    message = indices(contact)
    if message:
        return nothing, f"{message}, or by MeshTags"
    return np.asarray(contact).astype(np.int64), ""
