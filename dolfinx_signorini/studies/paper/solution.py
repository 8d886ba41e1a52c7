"""The solution of Christof and Haubner's experiment, and its problem."""

from dataclasses import replace

import ufl
from dolfinx import mesh

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
    detachment point: with C + iS = (x + iy)^{1/2}, r^{3/2} sin(3/2 theta) = S (3 C^2 - S^2).

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
    x0, x1 = x[0] - detachment[0], x[1] - detachment[1]
    # Scaled like hypot, so that the squares of tiny distances do not underflow.
    largest = ufl.max_value(abs(x0), abs(x1))
    scale = ufl.conditional(ufl.gt(largest, 0.0), largest, 1.0)
    r = scale * ufl.sqrt((x0 / scale) * (x0 / scale) + (x1 / scale) * (x1 / scale))
    # The larger of sqrt(r) cos(theta/2) and sqrt(r) sin(theta/2), then the other one by division.
    large = ufl.sqrt(0.5 * (r + abs(x0)))
    small = 0.5 * x1 / ufl.conditional(ufl.gt(large, 0.0), large, 1.0)
    left = ufl.lt(x0, 0.0)
    c = ufl.conditional(left, small, large)
    s = ufl.conditional(left, large, small)
    w = s * (3.0 * c * c - s * s)

    t = ufl.min_value(r / radius, 1.0)
    t3 = t * t * t
    q = 1.0 - t
    q3 = q * q * q
    psi = q3 * q * q * (1.0 + t * (5.0 + t * (15.0 + t * (35.0 + t * 70.0))))
    dpsi_over_r = -630.0 * t3 * q3 * q / radius**2
    laplacian = -2520.0 * t3 * q3 * (2.0 - 3.0 * t) / radius**2  # psi'' + 4 psi' / r

    centre = float(detachment[0]), float(detachment[1])
    return ManufacturedSolution(
        mesh=domain,
        u=-AMPLITUDE * psi * w,
        grad=(
            -AMPLITUDE * (1.5 * psi * s + w * dpsi_over_r * x0),
            -AMPLITUDE * (1.5 * psi * c + w * dpsi_over_r * x1),
        ),
        load=AMPLITUDE * w * (laplacian - psi),
        support=(centre, float(radius)),
        singular=(centre,),
    )


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
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    dx = ufl.Measure(
        "dx", domain, subdomain_data=[(1, exact.support_cells())], metadata=rule.metadata
    )
    return SignoriniProblem(a, exact.load * v * dx(1), contact=boundary_facets(domain))


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
