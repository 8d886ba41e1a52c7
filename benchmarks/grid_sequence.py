"""Peers that go from coarse to fine on squares of 8, 16, 32 ... cells, with the parts of PETSc.

Each level starts from the interpolated solution of the level before. Matrices, loads and bounds of
the levels are assembled by DOLFINx, once in a process: no time of a peer has them, unlike that of
the cascade, which makes its coarse levels from their meshes on.
"""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from common import paper
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini import SignoriniProblem
from dolfinx_signorini.solvers.linear.algebraic import DEFAULT_OPTIONS
from dolfinx_signorini.solvers.residual import NaturalResidual

COARSEST = 8
PREFIX = "peer_"  # of the options of PETSc
MARGIN = 0.5  # of the residual of the cascade: what the peers are asked for
LINEAR = 0.1  # of what is asked for: left to linear solves
MAX_STEPS = 50
BOOMERAMG = {"ksp_type": "cg", **DEFAULT_OPTIONS}
VI = {"snes_vi_zero_tolerance": 1e-13}  # of gaps that count as none; larger ones leave a residual
PCMG = {
    "ksp_type": "cg",
    "pc_type": "mg",
    "pc_mg_galerkin": "pmat",
    "mg_levels_ksp_type": "richardson",
    "mg_levels_ksp_max_it": 1,
    "mg_levels_pc_type": "sor",
}


@dataclass(frozen=True)
class Level:
    """A level in the order of a lattice: matrix, load, bounds, diagonal, the size of the data."""

    A: PETSc.Mat
    b: PETSc.Vec
    lower: PETSc.Vec
    upper: PETSc.Vec
    diagonal: Any
    scale: float


@functools.cache
def level(n: int) -> Level:
    """Assemble the paper's problem with n cells per side."""
    problem = paper(MPI.COMM_SELF, n)
    order = lattice_order(problem)
    index_set = PETSc.IS().createGeneral(order, comm=PETSc.COMM_SELF)
    A = problem.A.permute(index_set, index_set)
    lower = np.full(len(order), PETSc.NINFINITY)
    lower[problem.contact_dofs] = problem.obstacle
    values = problem.b.array_r, lower, np.full(len(order), PETSc.INFINITY)
    vectors = [PETSc.Vec().createWithArray(v[order], comm=PETSc.COMM_SELF) for v in values]
    scale = NaturalResidual(problem.system).scale
    problem.destroy()
    return Level(A, *vectors, A.getDiagonal().array_r.copy(), scale)


def lattice_order(problem: SignoriniProblem) -> Any:
    """Return the dofs row by row."""
    n = round(np.sqrt(problem.unknowns)) - 1
    x = np.rint(problem.space.tabulate_dof_coordinates() * n)
    return np.lexsort((x[:, 0], x[:, 1])).astype(np.int32)


def can_be_halved(n: int) -> bool:
    """Return whether n cells per side lead down to the coarsest square."""
    quotient, rest = divmod(n, COARSEST)
    return not rest and quotient.bit_count() == 1


def from_coarse_to_fine(
    solve: Callable[[PETSc.DM, Level, PETSc.Vec, float], None],
) -> Callable[[SignoriniProblem, float], Any]:
    """Return a peer that solves on one level after the other, each from the one before.

    Args:
        solve: Improves a vector on a level, until the residual has a norm.
    """

    def peer(problem: SignoriniProblem, rtol: float) -> Any:
        n = round(np.sqrt(problem.unknowns)) - 1
        if not can_be_halved(n):
            raise SystemExit(f"{n} cells per side cannot be halved down to {COARSEST}")
        cells = COARSEST
        dm = PETSc.DMDA().create(
            (cells + 1, cells + 1),
            stencil_type=PETSc.DMDA.StencilType.BOX,
            stencil_width=1,
            comm=PETSc.COMM_SELF,
            setup=True,
        )
        x = level(cells).b.duplicate()
        x.set(0.0)
        while True:
            data = level(cells)
            x.pointwiseMax(x, data.lower)
            solve(dm, data, x, MARGIN * rtol * data.scale)
            if cells == n:
                break
            fine = dm.refine()
            interpolation, _ = dm.createInterpolation(fine)
            dm, cells, coarse, x = fine, 2 * cells, x, level(2 * cells).b.duplicate()
            interpolation.mult(coarse, x)
        values = np.empty(len(x.array_r))
        values[lattice_order(problem)] = x.array_r
        return values

    return peer


def options_of(solver: Any, options: Mapping[str, Any]) -> None:
    """Let a PETSc object read options."""
    database = PETSc.Options(PREFIX)
    for key, value in options.items():
        database[key] = value
    solver.setOptionsPrefix(PREFIX)
    solver.setFromOptions()


def newton(options: Mapping[str, Any]) -> Callable[[SignoriniProblem, float], Any]:
    """SNES vinewtonrsls with CG and some preconditioner: what -snes_grid_sequence does.

    The loop is in Python because the bounds of a level cannot be set otherwise in petsc4py.
    """

    def solve(dm: PETSc.DM, data: Level, x: PETSc.Vec, atol: float) -> None:
        def residual(snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
            data.A.mult(x, f)
            f.axpy(-1.0, data.b)

        snes = PETSc.SNES().create(PETSc.COMM_SELF)
        snes.setType("vinewtonrsls")
        snes.setDM(dm)
        snes.setFunction(residual, data.b.duplicate())
        snes.setJacobian(lambda snes, x, J, P: None, data.A)
        snes.setVariableBounds(data.lower, data.upper)
        snes.setTolerances(rtol=0.0, stol=0.0, atol=atol, max_it=MAX_STEPS)
        snes.getKSP().setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        snes.getKSP().setTolerances(rtol=1e-12, atol=LINEAR * atol)
        options_of(snes, {**VI, **options})
        snes.solve(None, x)
        snes.destroy()

    return from_coarse_to_fine(solve)


def active_sets(dm: PETSc.DM, data: Level, x: PETSc.Vec, atol: float) -> None:
    """The plain primal-dual active set method with CG and tuned BoomerAMG, set up for each set.

    Linear solves that end earlier while the set is a guess take longer in all.
    """
    force, rhs, correction = (x.duplicate() for _ in range(3))
    held, lower = None, data.lower.array_r
    contact = lower > PETSC_INFINITE
    ksp = PETSc.KSP().create(PETSc.COMM_SELF)
    ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    options_of(ksp, BOOMERAMG)
    for _ in range(MAX_STEPS):
        data.A.mult(x, force)
        force.axpy(-1.0, data.b)
        gap = np.where(contact, data.diagonal * (x.array_r - lower), np.inf)
        residual = float(np.linalg.norm(np.minimum(gap, force.array_r)))
        if residual <= atol:
            break
        update = np.flatnonzero(force.array_r > gap).astype(np.int32)
        if held is None or not np.array_equal(update, held):
            held, matrix = update, data.A.copy()
            matrix.zeroRowsColumns(held, diag=float(data.diagonal.mean()))
            ksp.setOperators(matrix)
        x.array_w[held] = lower[held]
        data.A.mult(x, rhs)
        rhs.aypx(-1.0, data.b)
        rhs.array_w[held] = 0.0
        ksp.setTolerances(rtol=0.0, atol=LINEAR * atol)
        ksp.solve(rhs, correction)
        x.axpy(1.0, correction)
    x.pointwiseMax(x, data.lower)
    for item in (ksp, force, rhs, correction):
        item.destroy()


PETSC_INFINITE = 0.5 * PETSc.NINFINITY
GRID_SEQUENCES = {
    "SNES vinewtonrsls, grid sequence, PCMG": newton(PCMG),
    "SNES vinewtonrsls, grid sequence, BoomerAMG": newton(BOOMERAMG),
    "active sets, grid sequence, BoomerAMG": from_coarse_to_fine(active_sets),
}
