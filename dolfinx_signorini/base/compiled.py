"""Forms whose compiled code is looked up once in a process.

DOLFINx looks up the code of each new form in a folder that holds all code compiled so far: the
folder is listed, and the code loaded, again each time. On a mesh of some thousand cells this takes
longer than everything else. Forms with the same signature have the same code, whatever their mesh.
The numbers in a form become components of a constant first, so that a sweep over a number compiles
one code. FFCx writes the code, and `libraries` has it compiled.
"""

import ctypes
import functools
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from types import SimpleNamespace
from typing import Any

import cffi
import ffcx.codegeneration.jit as ffcx_jit
import ffcx.naming
import numpy as np
import ufl
from dolfinx import default_scalar_type, fem, jit, la
from mpi4py import MPI
from ufl.algorithms.check_arities import ArityMismatch
from ufl.algorithms.compute_form_data import compute_form_data
from ufl.algorithms.map_integrands import map_integrand_dags
from ufl.classes import BesselFunction, Power, RealValue
from ufl.core.expr import Expr
from ufl.corealg.multifunction import MultiFunction
from ufl.corealg.traversal import unique_pre_traversal

from dolfinx_signorini.base import compat
from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.libraries import library

_codes: dict[tuple[str, str], Any] = {}  # by signature and options
# By the signature of a form: its numbers, and the signature with a constant in their place.
_numbered: dict[str, tuple[list[float], str]] = {}


def form(item: ufl.Form, subject: str = "", **options: Any) -> fem.Form:
    """Return a compiled form, as `dolfinx.fem.form` does; the call is collective.

    Args:
        item: The form.
        subject: What a form that users gave is called in messages.
        options: The keywords of `dolfinx.fem.form`.

    Raises:
        InputError: A form that users gave is not linear in each of its arguments, or its integrals
            of one type have different subdomain data.
    """
    if subject:
        _check_subdomains(item, subject)
    with remembered(subject, lambda _: _without_numbers(item)):
        return fem.form(_with_constant(item), **options)


def integral(item: ufl.Form, subject: str = "") -> float:
    """Return the value of a form without arguments, the sum of all ranks; collective.

    Args:
        item: The form; 0 is the value of one without integrals.
        subject: What a form that users gave is called in messages.
    """
    if item.empty():
        return 0.0
    made = form(item, subject)
    return float(made.mesh.comm.allreduce(fem.assemble_scalar(made)))


def assembled(made: fem.Form, space: fem.FunctionSpace) -> fem.Function:
    """Return the values of a linear form for all basis functions, as coefficients; collective.

    Args:
        made: The form, compiled.
        space: The space of its argument.
    """
    result = fem.Function(space)
    fem.assemble_vector(result.x.array, made)
    result.x.scatter_reverse(la.InsertMode.add)
    result.x.scatter_forward()
    return result


def form_on(
    item: ufl.Form,
    spaces: Sequence[fem.FunctionSpace],
    subdomains: dict[fem.IntegralType, list[tuple[int, LocalIndices]]],
) -> fem.Form:
    """Return a compiled form on the mesh of its spaces; the call is collective.

    The form is one of arguments on a `ufl.Mesh` without data: whoever keeps such a form for all
    meshes of a kind pays for its making and its signature once.

    Args:
        item: The form, without coefficients and constants.
        spaces: The spaces of its arguments.
        subdomains: Where to integrate, by type of integral: numbers of subdomains, each with cells
            or with (cell, local facet) pairs, flat.
    """
    domain = spaces[0].mesh
    key = item.signature(), "without a mesh"
    code = once(domain.comm, key, lambda: fem.compile_form(domain.comm, item))
    return fem.create_form(code, list(spaces), domain, subdomains, {}, {})


def check_linear(item: ufl.Form, subject: str) -> None:
    """Refuse a form that is not linear in each argument: DOLFINx lets other ranks wait for ever.

    Raises:
        InputError: With the subject that is given.
    """
    try:
        compute_form_data(item, complex_mode=False)
    except (ArityMismatch, ValueError):  # UFL trips over its own message where a term has none
        message = "each term must be linear in each trial and test function"
        raise InputError(message, subject) from None


def _check_subdomains(item: ufl.Form, subject: str) -> None:
    """Refuse integrals of one type with different subdomain data, which DOLFINx does not take."""
    for by_type in item.subdomain_data().values():
        for kind, data in by_type.items():
            if any(other is not data[0] for other in data):
                message = (
                    f"the subdomain_data of its {kind} integrals differ, or some have none; give "
                    "all of these integrals one measure, whose tags name every part"
                )
                raise InputError(message, subject)


class _Components(MultiFunction):
    """Replaces numbers by components of a constant; exponents and orders belong to the code."""

    def __init__(self, constant: Expr, places: dict[float, int]) -> None:
        super().__init__()
        self._constant, self._places = constant, places

    expr = MultiFunction.reuse_if_untouched

    def real_value(self, o: Expr) -> Expr:
        return self._constant[self._places[float(o)]] if float(o) in self._places else o

    def power(self, o: Expr, base: Expr, exponent: Expr) -> Expr:
        kept = o.ufl_operands[1]
        return self.expr(o, base, kept if isinstance(kept, RealValue) else exponent)

    def bessel_function(self, o: Expr, _: Expr, x: Expr) -> Expr:
        return self.expr(o, o.ufl_operands[0], x)


def _with_constant(item: ufl.Form) -> ufl.Form:
    """Return what is to DOLFINx the form `_without_numbers`: the form, with one constant more.

    DOLFINx takes from a form its signature, its constants and what they belong to. The form without
    numbers is made for its first signature, and again where its code is to be compiled.
    """
    key = item.signature()
    if key not in _numbered:
        _numbered[key] = _numbers(item), _without_numbers(item).signature()
    numbers, signature = _numbered[key]
    made = copy(item)
    if numbers:
        made._signature = signature
        made._constants = (*item.constants(), _constant(item, numbers))
    return made


def _constant(item: ufl.Form, numbers: Sequence[float]) -> fem.Constant:
    return fem.Constant(item.ufl_domain(), np.array(numbers, dtype=default_scalar_type))


def _numbers(item: ufl.Form) -> list[float]:
    """The numbers of a form that do not belong to its code."""
    integrands = [integral.integrand() for integral in item.integrals()]
    places: dict[float, int] = {}
    for node in (node for integrand in integrands for node in unique_pre_traversal(integrand)):
        code = {Power: 1}.get(type(node), 0 if isinstance(node, BesselFunction) else None)
        for k, operand in enumerate(node.ufl_operands):
            if k != code and isinstance(operand, RealValue):
                places.setdefault(float(operand), len(places))
    return list(places)


def _without_numbers(item: ufl.Form) -> ufl.Form:
    """Return a form whose numbers are components of one constant.

    One constant, because UFL sorts operands: components by their place, constants by a name that
    depends on what the process has made before.
    """
    numbers = _numbers(item)
    if not numbers:
        return item
    places = {value: k for k, value in enumerate(numbers)}
    return map_integrand_dags(_Components(_constant(item, numbers), places), item)


@contextmanager
def remembered(
    subject: str = "", coded: Callable[[Any], Any] = lambda item: item
) -> Iterator[None]:
    """Let DOLFINx find the codes that this module has seen.

    Args:
        subject: What forms of users are called in messages.
        coded: Returns what is compiled where the code of an item has not been seen.
    """

    def remember(comm: MPI.Comm, item: Any, *given: Any, **options: Any) -> Any:
        def found() -> Any:
            if subject:
                check_linear(item, subject)
            return _code(comm, coded(item), *given, **options)

        compute = ffcx.naming.compute_signature
        signature = item.signature() if isinstance(item, ufl.Form) else compute([item], "")
        return once(comm, (str(signature), repr((given, options))), found)

    before, jit.ffcx_jit = jit.ffcx_jit, remember
    try:
        yield
    finally:
        jit.ffcx_jit = before


def once(comm: MPI.Comm, key: tuple[str, str], look_up: Callable[[], Any]) -> Any:
    """Return what is known by a key, and look it up where a rank does not know it; collective."""
    known = key in _codes
    if comm.size > 1:  # to look a code up is collective
        known = comm.allreduce(known, op=MPI.LAND)
    if not known:
        _codes[key] = look_up()
    return _codes[key]


def _code(
    comm: MPI.Comm,
    item: Any,
    form_compiler_options: dict[str, Any] | None = None,
    jit_options: dict[str, Any] | None = None,
) -> tuple[Any, Any, tuple[None, None]]:
    """Return the code of a form, or of an expression and its points, as `jit.ffcx_jit` does."""
    options, settings = ffcx.get_options(form_compiler_options), jit.get_options(jit_options)
    kind = "form" if isinstance(item, ufl.Form) else "expression"
    signature = ffcx.naming.compute_signature([item], repr(sorted(options.items())))
    arguments = [*settings["cffi_extra_compile_args"]]
    arguments += [f"-l{each}" for each in settings["cffi_libraries"] or ()]
    folder, declared = settings["cache_dir"], _declared(np.dtype(options["scalar_type"]).name)
    write = functools.partial(compat.c_code, item, signature, options)
    file = library(comm, signature, write, arguments, folder)
    # FFCx gives the first object of a code this name.
    pointer = ctypes.c_void_p.in_dll(ctypes.CDLL(str(file)), f"{kind}_{signature}_0")
    made = declared.cast(f"ufcx_{kind} *", pointer.value)[0]
    return made, SimpleNamespace(ffi=declared), (None, None)


@functools.cache
def _declared(scalar: str) -> Any:
    """What FFCx declares for codes with a type of numbers.

    DOLFINx calls the kernels, and cffi knows complex numbers in code that it compiles itself alone:
    the types of complex arguments are left open.
    """
    declared = cffi.FFI()
    declared.cdef(
        ffcx_jit.UFC_HEADER_DECL.format(scalar)
        + re.sub("(float|double) _Complex", "void", ffcx_jit.UFC_INTEGRAL_DECL)
        + ffcx_jit.UFC_FORM_DECL
        + ffcx_jit.UFC_EXPRESSION_DECL
    )
    return declared
