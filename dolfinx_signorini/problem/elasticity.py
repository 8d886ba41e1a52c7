"""Linear elasticity: the stress of a displacement, and the bilinear form."""

from typing import Any

import ufl
from ufl.core.expr import Expr

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.kinds import check, choice, instance


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
    check(u=(u, instance(Expr, "a displacement")), plane=(plane, choice("strain", "stress")))
    size = ufl.grad(u).ufl_shape
    if len(size) != 2 or size[0] != size[1]:
        raise InputError("must be a vector with a component for each coordinate", "u")
    if isinstance(poisson, int | float) and not -1.0 < poisson < 0.5:
        raise InputError(f"must lie between -1 and 1/2, not {poisson}", "poisson")
    if isinstance(young, int | float) and not young > 0.0:
        raise InputError(f"must be positive, not {young}", "young")
    strain = ufl.sym(ufl.grad(u))
    shear = young / (2.0 * (1.0 + poisson))
    volume = young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    if size[0] == 2 and plane == "stress":
        volume = young * poisson / (1.0 - poisson**2)
    return 2.0 * shear * strain + volume * ufl.tr(strain) * ufl.Identity(size[0])


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
    check(v=(v, instance(Expr, "a displacement")))
    tension = stress(u, young, poisson, plane)
    if ufl.grad(v).ufl_shape != tension.ufl_shape:
        raise InputError("must be a vector with as many components as u", "v")
    return ufl.inner(tension, ufl.sym(ufl.grad(v))) * ufl.dx
