"""Second derivatives of piecewise linear functions: the discrete W^{2,p} seminorm.

The gradient of a function of V_h jumps across the inner edges E, by J_E in the normal direction.
J_E / h plays the part of a second derivative in the cells beside E, whose area is like h^2:

    |v_h|_{2,p,h} = ( sum over E of |E|^2 (|J_E| / |E|)^p )^{1/p}.

On quasi-uniform meshes the seminorm of approximations of u stays bounded if u is in W^{2,p}, and
grows like h^{a - 2 + 2/p} if u is like r^a with a smaller a than that allows.
"""

import math

import ufl
from dolfinx import fem

from dolfinx_signorini.base import compiled


def second_seminorms(function: fem.Function, exponents: tuple[float, ...]) -> dict[str, float]:
    """Return the discrete W^{2,p} seminorms of a piecewise linear function.

    Args:
        function: The function.
        exponents: The exponents p, finite.

    Returns:
        The seminorms by the exponent as text.
    """
    domain = function.function_space.mesh
    n = ufl.FacetNormal(domain)
    jump = abs(ufl.jump(ufl.grad(function), n))
    edge = ufl.FacetArea(domain)("+")
    dS = ufl.dS(metadata={"quadrature_degree": 0})
    result = {}
    for p in exponents:
        power = fem.Constant(domain, float(p))  # type: ignore[arg-type]
        form = compiled.form(edge ** (1.0 - power) * ufl.max_value(jump, 1e-30) ** power * dS)
        total = domain.comm.allreduce(float(fem.assemble_scalar(form)))
        result[f"{p:g}"] = math.pow(total, 1.0 / p)
    return result
