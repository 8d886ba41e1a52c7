"""The names of norms: L4, W1_inf, H1_2_boundary and the like."""

import math
import re
from collections.abc import Collection
from dataclasses import dataclass

from dolfinx_signorini.base.errors import InputError


@dataclass(frozen=True)
class Norm:
    """A norm, whose name is its text:

        assert str(Norm(1.0, 4.0)) == "W1_4"

    Attributes:
        derivatives: Order of differentiability: 0 (L^p), 1 (W^{1,p}) or 0.5 (H^{1/2}).
        p: Exponent, from 1 to infinity; 2 for H^{1/2}.
        boundary: Whether the norm is taken on the boundary of the domain.
        spectral: For H^{1/2}: the true fractional norm in place of the interpolation estimate.
    """

    derivatives: float
    p: float
    boundary: bool = False
    spectral: bool = False

    def __str__(self) -> str:
        where = "_boundary" if self.boundary else ""
        if self.derivatives == 0.5:
            return f"H1_2{where}" + ("_spectral" if self.spectral else "")
        exponent = "inf" if math.isinf(self.p) else f"{self.p:.12g}"
        return f"L{exponent}{where}" if self.derivatives == 0 else f"W1_{exponent}{where}"


def parse_norm(name: str, subject: str = "norm") -> Norm:
    """Return the norm of a name such as L4, Linf, W1_4, W1_inf, L2_boundary or H1_2_boundary.

    H1 stands for W1_2, H1_2_boundary for the interpolation estimate of the H^{1/2} norm and
    H1_2_boundary_spectral for the norm itself.

    Args:
        name: The name.
        subject: The subject of an error.

    Raises:
        InputError: The name is unknown or p is smaller than 1.
    """
    if name in ("H1_2_boundary", "H1_2_boundary_spectral"):
        return Norm(0.5, 2.0, boundary=True, spectral=name.endswith("spectral"))
    match = re.fullmatch(r"(?:(L|W1_)(inf|[0-9.]+(?:e[+-]?[0-9]+)?)|(H1))(_boundary)?", name)
    try:
        if match is None:
            raise ValueError
        p = 2.0 if match[3] else float(match[2])
    except ValueError:
        message = (
            f"unknown norm {name!r}; known are Lp and W1_p with 1 <= p <= inf (L4, Linf, W1_16, "
            "W1_inf), H1, each with or without _boundary, H1_2_boundary, H1_2_boundary_spectral"
        )
        raise InputError(message, subject) from None
    if not p >= 1.0:
        raise InputError(f"{name!r}: p must be at least 1", subject)
    return Norm(0.0 if match[1] == "L" else 1.0, p, boundary=match[4] is not None)


def listed_norms(text: str, others: Collection[str] = ()) -> tuple[str, ...]:
    """Return the names in a list such as "L4,Linf", as the option --norms takes it.

    Args:
        text: The list.
        others: Names that may be listed, too, and are none of `parse_norm`.

    Raises:
        InputError: One of them is not the name of a norm.
    """
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in [name for name in names if name not in others]:
        parse_norm(name, "--norms")
    return names
