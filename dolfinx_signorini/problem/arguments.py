"""Checks of the arguments of a problem: each refusal names the argument, before any long work."""

from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np
import ufl
from dolfinx import fem, mesh
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.errors import InputError, require
from dolfinx_signorini.base.kinds import (
    MESH,
    check,
    data,
    indices,
    instance,
    integer,
    on_mesh,
    sequence,
)
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, facet_count
from dolfinx_signorini.solvers.pressure import ContactState

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
    if not same_space(arguments[1].ufl_function_space(), space):
        raise InputError("trial and test function belong to different spaces", "form a")
    if len(L.arguments()) != 1:
        raise InputError(f"the form L needs one test function, has {len(L.arguments())}", "load")
    if not same_space(L.arguments()[0].ufl_function_space(), space):
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


def check_conditions(space: fem.FunctionSpace, bcs: Iterable[Any]) -> None:
    """Refuse what is no Dirichlet condition of a space.

    Args:
        space: The space.
        bcs: What should be Dirichlet conditions of this very space.

    Raises:
        InputError: The subject is "bcs".
    """
    kind = instance(fem.DirichletBC, "a Dirichlet condition")
    check(bcs=(bcs, sequence(kind, "a list of Dirichlet conditions")))
    for bc in bcs:
        if not space._cpp_object.contains(bc.function_space):
            raise InputError(
                "a Dirichlet condition belongs to another function space than the form a", "bcs"
            )


def check_data(value: Any, space: fem.FunctionSpace, subject: str) -> None:
    """Refuse what is no number, UFL expression, function or callable on the mesh of a space.

    Args:
        value: The data.
        space: The space.
        subject: The name of the argument.

    Raises:
        InputError: The data cannot be evaluated on the mesh.
    """
    check(**{subject: (value, data)})
    if isinstance(value, Expr):
        check(**{subject: (value, on_mesh(space.mesh))})


def check_function(value: Any, space: fem.FunctionSpace, subject: str) -> None:
    """Refuse what is no function of a space.

    Args:
        value: What should be a function.
        space: The space.
        subject: The name of the argument.

    Raises:
        InputError: The value is no function of this very space.
    """
    if not isinstance(value, fem.Function):
        raise InputError(f"must be a function, not {type(value).__name__}", subject)
    if not same_space(value.function_space, space):
        raise InputError("belongs to another function space than the form a", subject)


def check_start(start: fem.Function, subject: str) -> None:
    """Refuse a start with values that are not finite; the call is collective.

    Args:
        start: A function of the space of the problem.
        subject: The name of the function.

    Raises:
        InputError: Some value is not finite, on any rank.
    """
    finite = bool(np.isfinite(start.x.array).all())
    require(start.function_space.mesh.comm, finite, "has a value that is not finite", subject)


def check_limits(method: str, limits: Mapping[str, Any]) -> None:
    """Refuse limits of TAO that are no positive integers, or that are given to the cascade.

    Args:
        method: The name of the solver.
        limits: The limits by name.

    Raises:
        InputError: The subject is the name of the limit.
    """
    if method == "cascade" and limits:
        raise InputError("only for the methods of TAO", ", ".join(limits))
    check(**{name: (limit, integer(1)) for name, limit in limits.items()})


def check_coarse(method: str, coarse: Any) -> None:
    """Refuse what is no contact state, or a contact state for a solver that does not take one.

    Args:
        method: The name of the solver.
        coarse: What should be a contact state.

    Raises:
        InputError: The subject is "coarse".
    """
    if method != "cascade":
        raise InputError("only for the cascade", "coarse")
    if not isinstance(coarse, ContactState):
        raise InputError(f"must be a contact state, not {type(coarse).__name__}", "coarse")


def same_space(one: Any, other: Any) -> bool:
    """Return whether two Python objects stand for the same function space, dof for dof.

    Args:
        one, other: The two objects, of any kind.
    """
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
