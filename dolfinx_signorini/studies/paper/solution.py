"""The solution of Christof and Haubner's experiment, and its problem."""

from collections.abc import Sequence
from dataclasses import replace

import ufl
from dolfinx import fem, mesh
from ufl.core.expr import Expr

from dolfinx_signorini.base.kinds import check, coordinates, positive, simplices
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.elements import bernstein_space
from dolfinx_signorini.meshes.quadrature import QuadratureRule
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, boundary_facets
from dolfinx_signorini.norms.manufactured import ManufacturedSolution
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.studies.tradeoff.family import Family, Posed

DETACHMENT = (0.5, 0.0)
SUPPORT_RADIUS = 0.45
AMPLITUDE = 10.0

# "A 16-point Gauss-Legendre-type quadrature rule for triangles" (Christof and Haubner, Section 7):
# the collapsed 4 x 4 rule, for the load and for every norm on the domain.
PAPER_RULE = QuadratureRule("Gauss-Jacobi", 7)


def christof_haubner(
    domain: mesh.Mesh, detachment: tuple[float, float] = DETACHMENT, radius: float = SUPPORT_RADIUS
) -> ManufacturedSolution:
    r"""Return the paper's solution (28) on the unit square, with its gradient and load.

    With polar coordinates (r, theta) about the detachment point,

        u = -10 psi(r) r^{3/2} sin(3/2 theta),

    where psi is the polynomial of degree 9 with psi(0) = 1, psi(radius) = 0 and four vanishing
    derivatives at both ends, continued by 0. The function u solves -div(grad u) + u = f with
    u >= 0, du/dn >= 0 and u du/dn = 0 on the whole boundary, is positive on the bottom edge to the
    left of the detachment point and touches the obstacle 0 to the right of that point.

    All expressions are free of trigonometric functions and of cancellation, and are finite at the
    detachment point: with C + iS = (x + iy)^{1/2}, r^{3/2} sin(3/2 theta) = Im (C + iS)^3.

    Args:
        domain: A mesh of the unit square.
        detachment: The detachment point on the bottom edge, at least `radius` from its ends.
        radius: Where psi ends.

    Raises:
        InputError: An argument is of another kind, or the domain is not in the plane.

    Source: Christof and Haubner, Section 7, equation (28).
    """
    check(
        domain=(domain, simplices(2)),
        detachment=(detachment, coordinates(2)),
        radius=(radius, positive),
    )
    x = ufl.SpatialCoordinate(domain)
    value, slope, laplacian = local_piece(x[0] - detachment[0], x[1] - detachment[1], radius)
    centre = float(detachment[0]), float(detachment[1])
    return ManufacturedSolution(
        mesh=domain,
        u=AMPLITUDE * value,
        grad=(AMPLITUDE * slope[0], AMPLITUDE * slope[1]),
        load=AMPLITUDE * (value - laplacian),
        support=(centre, float(radius)),
        singular=(centre,),
    )


def local_piece(
    X: Expr, Y: Expr, radius: float, exponent: float = 1.5
) -> tuple[Expr, tuple[Expr, Expr], Expr]:
    """Return -psi Im (X + iY)^k, its gradient in X and Y, and its Laplacian.

    Args:
        X, Y: Coordinates along the boundary into the contact set, and into the domain.
        radius: Where psi ends.
        exponent: k, a multiple of 1/2, at least 3/2.
    """
    r, *root = half_angle(X, Y)
    w = _power(root, round(2.0 * exponent))[1]
    slope = _power(root, round(2.0 * exponent) - 2)
    t = ufl.min_value(r / radius, 1.0)
    q, t3 = 1.0 - t, t * t * t
    q3 = q * q * q
    psi = q3 * q * q * (1.0 + t * (5.0 + t * (15.0 + t * (35.0 + t * 70.0))))
    decay = -630.0 * t3 * q3 * q / radius**2  # psi' / r
    bend = -2520.0 * t3 * q3 * (1.0 - 2.0 * t) / radius**2  # psi''
    along, inward = (
        -(exponent * psi * part + w * decay * x) for part, x in ((slope[1], X), (slope[0], Y))
    )
    return -psi * w, (along, inward), -w * (bend + (1.0 + 2.0 * exponent) * decay)


def half_angle(X: Expr, Y: Expr) -> tuple[Expr, Expr, Expr]:
    """Return r, the distance from the origin, and C and S with C + iS the root of X + iY, Y >= 0.

    Args:
        X, Y: The coordinates, which may be tiny.
    """
    # Scaled like hypot, so that the squares of tiny distances do not underflow.
    largest = ufl.max_value(abs(X), abs(Y))
    scale = ufl.conditional(ufl.gt(largest, 0.0), largest, 1.0)
    r = scale * ufl.sqrt((X / scale) * (X / scale) + (Y / scale) * (Y / scale))
    # The larger of sqrt(r) cos(theta/2) and sqrt(r) sin(theta/2), then the other one by division.
    large = ufl.sqrt(0.5 * (r + abs(X)))
    small = 0.5 * Y / ufl.conditional(ufl.gt(large, 0.0), large, 1.0)
    left = ufl.lt(X, 0.0)
    return r, ufl.conditional(left, small, large), ufl.conditional(left, large, small)


def _power(root: Sequence[Expr], n: int) -> Sequence[Expr]:
    """The n-th power of a complex number."""
    c, s = root
    for _ in range(n - 1):
        c, s = c * root[0] - s * root[1], c * root[1] + s * root[0]
    return c, s


def paper_problem(
    exact: ManufacturedSolution, degree: int = 1, rule: QuadratureRule | None = None
) -> SignoriniProblem:
    """Return the paper's problem (S_h): (u, v)_H1, load f, contact everywhere, obstacle 0.

    Args:
        exact: Solution and load; the load is integrated on the cells of the support only.
        degree: Polynomial degree of the Lagrange elements.
        rule: Quadrature rule of the load; by default the paper's for degree 1, and two degrees more
            for each further degree, so that the rule does not limit the order.

    Source: Christof and Haubner, Section 2.3.
    """
    rule = rule or replace(PAPER_RULE, degree=PAPER_RULE.degree + 2 * (degree - 1))
    domain = exact.mesh
    space = bernstein_space(domain, degree)
    cells = [(1, exact.support_cells())]
    dx = ufl.Measure("dx", domain, subdomain_data=cells, metadata=rule.metadata)
    load = exact.load * ufl.TestFunction(space) * dx(1)
    return SignoriniProblem(h1_product(space), load, contact=boundary_facets(domain))


def h1_product(space: fem.FunctionSpace) -> ufl.Form:
    """Return the bilinear form (u, v)_H1."""
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    return (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx


def paper_family(
    detachment: tuple[float, float] = DETACHMENT, rule: QuadratureRule = PAPER_RULE
) -> Family:
    """Return the paper's problem on Friedrichs-Keller triangulations.

    Args:
        detachment: The detachment point, see `christof_haubner`.
        rule: Quadrature rule of the load.
    """

    def on(sided: SidedMesh, degree: int) -> Posed:
        exact = christof_haubner(sided.mesh, detachment)
        return Posed(paper_problem(exact, degree, rule), exact)

    return Family(
        dimension=2,
        width=1.0,
        make=lambda comm, n: SidedMesh(friedrichs_keller(comm, n), {}),
        pose=on,
    )
