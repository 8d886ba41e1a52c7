"""The error u_h - u and its derivatives at any points of cells and facets."""

import basix
import numpy as np
import ufl
from dolfinx import fem, mesh

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.meshes.points import FormulaAtPoints, Points, basix_element
from dolfinx_signorini.norms.references import Reference, components

CELLS = ("triangle", "tetrahedron", "quadrilateral", "hexahedron")


class ErrorAtPoints:
    """The error of a discrete solution as a function of points:

        error = ErrorAtPoints(u_h, exact, derivatives=True)
        e, dx, dy = error(Points(domain, cells, lattice))

    The construction compiles the exact solution, unless that is a discrete function; collective.

    Args:
        u_h: The discrete solution, a scalar function in a Lagrange space.
        exact: The known solution, on the mesh of u_h; None for u_h itself.
        derivatives: Whether the error is followed by its derivatives in each direction of space;
            at points of facets these are those of the tangential gradient.

    Attributes:
        domain: The mesh.
        degree: The polynomial degree of u_h, or of a discrete u if that is larger.

    Raises:
        InputError: u_h is no scalar Lagrange function, its cells are of another kind than `CELLS`,
            or the exact solution belongs to another mesh or is no function of coordinates and of
            discrete functions.
    """

    def __init__(self, u_h: fem.Function, exact: Reference | None, derivatives: bool):
        self.domain, self.degree = u_h.function_space.mesh, _degree(u_h)
        self._u_h, self._derivatives = u_h, derivatives
        self._discrete: fem.Function | None = None
        self._formula: FormulaAtPoints | None = None
        if exact is None:
            return
        if exact.mesh._cpp_object is not self.domain._cpp_object:
            raise InputError("belongs to another mesh than the discrete solution", "exact")
        if isinstance(exact.u, fem.Function) and tuple(exact.grad) == components(ufl.grad(exact.u)):
            self._discrete = exact.u
            self.degree = max(self.degree, _degree(exact.u))
        else:
            expressions = [exact.u, *(exact.grad if derivatives else ())]
            self._formula = FormulaAtPoints(self.domain, expressions)
        cells = self.domain.topology.index_map(self.domain.topology.dim)
        self._support = np.zeros(cells.size_local + cells.num_ghosts, dtype=bool)
        self._support[exact.support_cells()] = True

    @np.errstate(divide="ignore", invalid="ignore", over="ignore")
    def __call__(self, points: Points) -> list[Array]:
        """Return the error, then its derivatives if there are any, each of shape (n, m)."""
        found = self._of(self._u_h, points)
        if self._discrete is not None:
            exact = self._of(self._discrete, points)
            found = [u_h - u for u_h, u in zip(found, exact, strict=True)]
        elif self._formula is not None:
            rows = np.flatnonzero(self._support[points.cells])
            part = points if len(rows) == len(points.cells) else points.of(rows)
            for component, u in zip(found, self._formula(part), strict=True):
                component[rows] -= u
        return [found[0], *points.tangential(found[1:])]

    @property
    def of_u_h(self) -> "ErrorAtPoints":
        """The discrete solution itself in place of the error."""
        return ErrorAtPoints(self._u_h, None, self._derivatives)

    @property
    def kinds(self) -> int:
        """2 for an error with derivatives, else 1."""
        return 1 + int(self._derivatives)

    def _of(self, function: fem.Function, points: Points) -> list[Array]:
        gradient = points.gradients(function)[0] if self._derivatives else []
        return [*points.values(function), *gradient]


def kind_of(domain: mesh.Mesh, places: LocalIndices) -> basix.CellType:
    """Return the kind of cells, or of boundary facets as pairs (cell, local facet)."""
    cell = basix.CellType[domain.topology.cell_name()]
    return basix.cell.subentity_types(cell)[domain.topology.dim + 1 - places.ndim][0]


def _degree(function: fem.Function) -> int:
    cell = function.function_space.mesh.topology.cell_name()
    if cell not in CELLS:
        raise InputError(f"known for meshes of {', '.join(CELLS)}, not of {cell} cells", "norms")
    if function.ufl_shape != ():
        raise InputError(f"must be scalar, has the shape {function.ufl_shape}", "u_h")
    return int(basix_element(function, "u_h").embedded_superdegree)
