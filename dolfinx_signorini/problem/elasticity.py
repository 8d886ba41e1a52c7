"""Linear elasticity: the stress of a displacement, von Mises stress, and the bilinear form."""

from typing import Any

import ufl
from ufl.core.expr import Expr

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.kinds import check, choice, instance

DISPLACEMENT = instance(Expr, "a displacement")
MATERIAL = instance((int, float, Expr), "a number or a UFL expression")


def stress(u: Expr, young: Any, poisson: Any, plane: str = "strain") -> Expr:
    """Return the stress of a displacement in an isotropic body.

    Args:
        u: The displacement, a vector with a component for each coordinate.
        young: Young's modulus E: a number, or a UFL expression.
        poisson: Poisson's ratio, below 1/2, likewise.
        plane: In the plane "strain" for thick bodies, or "stress" for thin plates.

    Raises:
        InputError: An argument makes no sense.

    Source: 2 mu eps + lambda tr(eps) I with mu = E / (2 (1 + nu)) and lambda = E nu / ((1 + nu)
    (1 - 2 nu)), and with E nu / (1 - nu^2) in place of lambda for plane stress.
    """
    shear, volume, strain = _material(u, young, poisson, plane)
    return 2.0 * shear * strain + volume * ufl.tr(strain) * ufl.Identity(len(u))


def weighted_strain(u: Expr, young: Any, poisson: Any, plane: str = "strain") -> Expr:
    """Return the strain with the weights of the energy: its L2 norm is the energy norm.

    The square of the length of this matrix is the product of stress and strain:

        error_norms(u_h, exact, ["L2"], of=lambda u: weighted_strain(u, young=200.0, poisson=0.3))

    Args:
        u, young, poisson, plane: See `stress`.

    Raises:
        InputError: An argument makes no sense.
    """
    shear, volume, strain = _material(u, young, poisson, plane)
    size, trace = len(u), ufl.tr(strain)
    mean = trace / size * ufl.Identity(size)  # orthogonal to the rest of the strain
    return ufl.sqrt(2.0 * shear) * (strain - mean) + ufl.sqrt(2.0 * shear + size * volume) * mean


def _material(u: Expr, young: Any, poisson: Any, plane: str) -> tuple[Any, Any, Expr]:
    """The constants mu and lambda, and the strain."""
    check(
        u=(u, DISPLACEMENT),
        young=(young, MATERIAL),
        poisson=(poisson, MATERIAL),
        plane=(plane, choice("strain", "stress")),
    )
    size = ufl.grad(u).ufl_shape
    if len(size) != 2 or size[0] != size[1]:
        raise InputError("must be a vector with a component for each coordinate", "u")
    if isinstance(poisson, int | float) and not -1.0 < poisson < 0.5:
        raise InputError(f"must lie between -1 and 1/2, not {poisson}", "poisson")
    if isinstance(young, int | float) and not young > 0.0:
        raise InputError(f"must be positive, not {young}", "young")
    shear = young / (2.0 * (1.0 + poisson))
    volume = young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    if size[0] == 2 and plane == "stress":
        volume = young * poisson / (1.0 - poisson**2)
    return shear, volume, ufl.sym(ufl.grad(u))


def von_mises(u: Expr, young: Any, poisson: Any, plane: str = "strain") -> Expr:
    """Return the von Mises stress of a displacement, a scalar that is never negative.

    In plane strain the stress at right angles to the plane counts, too.

    Args:
        u, young, poisson, plane: See `stress`.

    Raises:
        InputError: An argument makes no sense.

    Source: sqrt(3/2) times the size of the deviator of the stress, von Mises (1913).
    """
    found = stress(u, young, poisson, plane)
    size, trace = found.ufl_shape[0], ufl.tr(found)
    beside = poisson * trace if size == 2 and plane == "strain" else 0.0
    mean = (trace + beside) / 3.0
    deviator = found - mean * ufl.Identity(size)
    squares = ufl.inner(deviator, deviator)
    if size == 2:
        squares += (beside - mean) ** 2
    return ufl.sqrt(1.5 * squares)


def elasticity(u: Expr, v: Expr, young: Any, poisson: Any, plane: str = "strain") -> ufl.Form:
    """Return the bilinear form of linear elasticity, the work of the stress of u on v.

    For example, with the trial and the test function of a space of vectors:

        a = elasticity(u, v, young=200.0, poisson=0.3)

    Args:
        u, v: The displacements.
        young, poisson, plane: The material, see `stress`.

    Raises:
        InputError: An argument makes no sense.
    """
    check(v=(v, DISPLACEMENT))
    tension = stress(u, young, poisson, plane)
    if ufl.grad(v).ufl_shape != tension.ufl_shape:
        raise InputError("must be a vector with as many components as u", "v")
    return ufl.inner(tension, ufl.sym(ufl.grad(v))) * ufl.dx
