"""Random problems whose data change from step to step, for `random_loops.py`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini import SignoriniProblem, bernstein_space

Array = npt.NDArray[np.float64]
Dofs = npt.NDArray[np.int32]
Shape = Callable[[Array], Array]
Law = Callable[[np.random.Generator, int], Array]

STEPS = 10
COMM = MPI.COMM_WORLD
# Cell types, and the highest degree.
CELLS = {
    "triangles": (mesh.CellType.triangle, 4),
    "quadrilaterals": (mesh.CellType.quadrilateral, 4),
    "tetrahedra": (mesh.CellType.tetrahedron, 3),
}
# Cells along an axis, by dimension, for degree 1: a few, and more than are solved directly.
SMALL, LARGE = {2: (3, 40), 3: (2, 7)}, {2: (56, 80), 3: (10, 12)}
CHANGES = ("obstacle", "load", "Dirichlet", "matrix")
OBSTACLES = ("Constant", "Function", "UFL", "callable")
RTOLS = {"default": 1e-7, "1e-6": 1e-6, "1e-10": 1e-10}


def _steady(rng: np.random.Generator, steps: int) -> Array:
    return rng.uniform(-0.5, 0.5) * np.arange(steps)


def _slow(rng: np.random.Generator, steps: int) -> Array:
    return rng.uniform(-1.0, 1.0) + 10.0 ** rng.uniform(-9.0, -2.0) * np.arange(steps)


def _reversed(rng: np.random.Generator, steps: int) -> Array:
    turn = int(rng.integers(2, steps - 2))
    return rng.uniform(-0.4, 0.4) * (turn - np.abs(turn - np.arange(steps)))


def _waving(rng: np.random.Generator, steps: int) -> Array:
    return rng.uniform(0.2, 1.5) * np.sin(rng.uniform(0.3, 3.0) * np.arange(steps))


def _jump(rng: np.random.Generator, steps: int) -> Array:
    at, size = rng.integers(1, steps), rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-1.0, 2.0)
    return np.where(np.arange(steps) < at, 0.0, size) + 0.01 * np.arange(steps)


def _random(rng: np.random.Generator, steps: int) -> Array:
    return rng.uniform(-2.0, 2.0, steps)


LAWS: dict[str, Law] = {
    "steady": _steady,
    "slow": _slow,
    "reversed": _reversed,
    "waving": _waving,
    "jump": _jump,
    "random": _random,
}


@dataclass
class Loop:
    """A problem with its forms and numbers, as the check and the changes see them.

    Attributes:
        names: What the loop is, by kind.
        problem: The problem.
        a, L: The forms.
        balance: The integral of reaction and load: the equation with the function 1.
        facets: The contact facets.
        dofs: The owned dofs on the contact boundary without Dirichlet data.
        fixed: The owned dofs with Dirichlet data.
        shared: The dofs on both parts of the boundary.
        sign: 1 for a lower obstacle, -1 for an upper one.
        size: The size of the load.
        numbers: What the changes set.
        obstacle: The interpolant of the obstacle, made without the package.
        held: The Dirichlet data.
        factors: What is added to the first value in each step, by the name of the change.
        shape: The obstacle as a function of the coordinates.
    """

    names: Mapping[str, str]
    problem: SignoriniProblem
    a: ufl.Form
    L: ufl.Form
    balance: ufl.Form
    facets: Dofs
    dofs: Dofs
    fixed: Dofs
    shared: Dofs
    sign: float
    size: float
    numbers: Mapping[str, fem.Constant]
    obstacle: fem.Function
    held: fem.Function
    factors: Mapping[str, Array]
    shape: Shape = field(repr=False)

    def move(self, step: int) -> None:
        """Change the numbers of a step; Dirichlet data stay above the obstacle where both meet."""
        numbers = self.numbers
        for name, factors in self.factors.items():
            if name in ("obstacle", "load"):
                numbers[name].value = 1.0 + factors[step]
            elif name == "matrix":
                numbers["diffusion"].value = np.exp(np.clip(factors[step], -5.0, 5.0))
                numbers["reaction"].value = np.exp(-np.clip(factors[step], -5.0, 5.0))
        if self.names["singular"] == "yes":  # only a load that presses has a solution
            numbers["load"].value = max(abs(float(numbers["load"].value)), 0.05)
        numbers["level"].value = numbers["obstacle"].value * numbers["height"].value
        interpolated(self.obstacle, self.shape)
        wanted = self.size * (1.0 + self.factors.get("Dirichlet", np.zeros(STEPS))[step])
        highest = float(np.max(self.sign * self.obstacle.x.array[self.shared], initial=-np.inf))
        self.held.x.array[:] = self.sign * max(wanted, COMM.allreduce(highest, op=MPI.MAX))


def interpolated(u: fem.Function, shape: Callable[[Array], Array]) -> None:
    """Give a function the values of a callable at the nodes; those of Bernstein are equispaced."""
    element = u.function_space.element.basix_element
    if element.lagrange_variant == basix.LagrangeVariant.bernstein:
        kind, variant = element.cell_type.name, basix.LagrangeVariant.equispaced
        equal = basix.ufl.element("Lagrange", kind, element.degree, lagrange_variant=variant)
        nodal = fem.Function(fem.functionspace(u.function_space.mesh, equal))
        nodal.interpolate(shape)
        u.interpolate(nodal)
    else:
        u.interpolate(shape)
    u.x.scatter_forward()


def random_mesh(rng: np.random.Generator, cells: str, degree: int) -> mesh.Mesh:
    """A rectangle or box, small or (one of eight) too large for direct solves."""
    kind, _ = CELLS[cells]
    dimension = 3 if cells == "tetrahedra" else 2
    low, high = (LARGE if rng.random() < 0.125 else SMALL)[dimension]
    n = max(2, int(np.ceil(rng.integers(low, high) / degree)))
    ends = [np.zeros(dimension), rng.choice([1.0, 2.0, 0.3], dimension)]
    if dimension == 3:
        return mesh.create_box(COMM, ends, [n, n, n], kind)
    diagonal = mesh.DiagonalType.right if rng.random() < 0.7 else mesh.DiagonalType.crossed
    return mesh.create_rectangle(COMM, ends, [n, n], kind, diagonal=diagonal)


def parts(domain: mesh.Mesh, contact: str, dirichlet: str) -> tuple[Any, Any]:
    """The contact facets and those with Dirichlet data."""
    facet, last = domain.topology.dim - 1, domain.geometry.dim - 1
    domain.topology.create_connectivity(facet, facet + 1)
    top = COMM.allreduce(float(domain.geometry.x[:, last].max(initial=0.0)), op=MPI.MAX)
    marks: dict[str, Callable[[Array], Any]] = {
        "top": lambda x: np.isclose(x[last], top),
        "bottom": lambda x: np.isclose(x[last], 0.0),
        "two sides": lambda x: np.isclose(x[last], 0.0) | np.isclose(x[0], 0.0),
        "everywhere": lambda x: np.full(x.shape[1], True),
        "none": lambda x: np.full(x.shape[1], False),
    }
    found = [mesh.locate_entities_boundary(domain, facet, marks[m]) for m in (contact, dirichlet)]
    return np.setdiff1d(*found).astype(np.int32), found[1]


def random_names(rng: np.random.Generator) -> dict[str, str]:
    """What a loop is made of, in words."""
    cells = str(rng.choice(list(CELLS), p=[0.5, 0.25, 0.25]))
    few = rng.random() < 0.6
    dirichlet = "top" if rng.random() < 0.45 else "none"
    possible = [name for name in CHANGES if name != "Dirichlet" or dirichlet == "top"]
    changed = rng.choice(possible, 1 if few else int(rng.integers(2, len(possible) + 1)), False)
    return {
        "cells": cells,
        "basis": "nodal" if cells == "quadrilaterals" or rng.random() < 0.5 else "Bernstein",
        "degree": str(rng.integers(1, CELLS[cells][1] + 1)),
        "change": str(changed[0]) if few else "several",
        "changed": " ".join(map(str, changed)),
        "law": str(rng.choice(list(LAWS))),
        "obstacle": str(rng.choice(OBSTACLES)),
        "bound": str(rng.choice(["lower", "upper"])),
        "rtol": str(rng.choice(list(RTOLS))),
        "contact": str(rng.choice(["bottom", "two sides", "everywhere"])),
        "Dirichlet": dirichlet,
        "singular": "yes" if dirichlet == "none" and rng.random() < 0.2 else "no",
    }


def random_numbers(rng: np.random.Generator, names: Mapping[str, str]) -> dict[str, float]:
    """The numbers of a problem; "level" is the obstacle that is one number."""
    sign, size = (1.0 if names["bound"] == "lower" else -1.0), 10.0 ** rng.uniform(-3.0, 3.0)
    singular = names["singular"] == "yes"
    sloped = not singular and rng.random() < 0.5
    return {
        "size": size,
        "obstacle": 1.0,
        "load": 1.0,
        "diffusion": 1.0,
        "reaction": 1.0,
        "slope": sign * size * (20.0 if sloped else -1.0),
        "constant": sign * size * (-8.0 if sloped else -1.0),
        "level": 0.0,
        "height": 0.3 * sign * size * rng.uniform(-1.0, 1.0),
        "wave": 0.1 * size * rng.uniform(-1.0, 1.0) * (names["obstacle"] != "Constant"),
        "heat": 0.0 if singular else 10.0 ** rng.uniform(-2.0, 2.0),
        "phase": rng.uniform(0.0, 6.0),
    }


def random_loop(rng: np.random.Generator) -> Loop:
    """Pose a random problem; numbers are Constants, so that loops share compiled forms."""
    names = random_names(rng)
    degree, singular = int(names["degree"]), names["singular"] == "yes"
    domain = random_mesh(rng, names["cells"], degree)
    bernstein = names["basis"] == "Bernstein"
    element = ("Lagrange", degree)
    V = bernstein_space(domain, degree) if bernstein else fem.functionspace(domain, element)
    values = random_numbers(rng, names)
    numbers = c = {name: fem.Constant(domain, float(value)) for name, value in values.items()}
    u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(domain)
    spread = fem.Function(fem.functionspace(domain, ("DG", 0)))
    spread.interpolate(lambda y: 1.5 + np.sin(7.0 * y[0] + 5.0 * y[1] + values["phase"]))
    a = c["diffusion"] * spread * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    reaction, source = c["reaction"] * c["heat"], c["load"] * (c["slope"] * x[0] + c["constant"])
    if not singular:
        a += reaction * u * v * ufl.dx

    def shape(y: Array) -> Array:
        factor, height, wave = (float(c[name].value) for name in ("obstacle", "height", "wave"))
        return factor * (height + wave * np.sin(9.0 * y[0] + 4.0 * y[1]))

    obstacle, held, solution = fem.Function(V), fem.Function(V), fem.Function(V)
    formula = c["obstacle"] * (c["height"] + c["wave"] * ufl.sin(9.0 * x[0] + 4.0 * x[1]))
    given = dict(zip(OBSTACLES, (c["level"], obstacle, formula, shape), strict=True))
    facets, top = parts(domain, names["contact"], names["Dirichlet"])
    fixed, dofs = (
        fem.locate_dofs_topological(V, domain.topology.dim - 1, part) for part in (top, facets)
    )
    law, owned = LAWS[names["law"]], V.dofmap.index_map.size_local
    loop = Loop(
        names=names,
        problem=None,  # type: ignore[arg-type]
        a=a,
        L=source * v * ufl.dx,
        balance=(reaction * solution - source) * ufl.dx if not singular else -source * ufl.dx,
        facets=facets,
        dofs=np.setdiff1d(dofs[dofs < owned], fixed),
        fixed=fixed[fixed < owned],
        shared=np.intersect1d(dofs, fixed),
        sign=1.0 if names["bound"] == "lower" else -1.0,
        size=values["size"],
        numbers=numbers,
        obstacle=obstacle,
        held=held,
        factors={name: law(rng, STEPS) for name in names["changed"].split()},
        shape=shape,
    )
    loop.move(0)
    loop.problem = SignoriniProblem(
        a,
        loop.L,
        contact=facets,
        obstacle=given[names["obstacle"]],
        bound=names["bound"],
        bcs=[fem.dirichletbc(held, fixed)] if names["Dirichlet"] == "top" else [],
        u=solution,
        petsc_options={"ksp_type": "cg"} if rng.random() < 0.25 else {},
    )
    return loop
