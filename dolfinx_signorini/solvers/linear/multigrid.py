"""Multigrid over degrees and meshes, as a preconditioner for matrices with held dofs.

Coarse matrices are Galerkin products. A held dof has no row in the matrix that the products are
made of: so the prolongations are truncated at the active set, without being changed. A cycle takes
one Gauss-Seidel sweep forward on the finest level on the way down, and one backward on the way up.
Coarser levels sweep there and back both times: they cost little, and coarse functions that reach
over the ends of the active set make them the slowest. So the cycle is symmetric. Sweeps leave out
what couples ranks, and for bodies have a larger diagonal where this coupling outweighs the
diagonal. A Cholesky factorization takes care of the coarsest level, or BoomerAMG where many nodes
are left.

Source: Kornhuber, Numer. Math. 69 (1994) 167-184, for the truncation.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.petsc import destroy, without_nodes
from dolfinx_signorini.base.tolerances import ROUNDING
from dolfinx_signorini.solvers.linear.algebraic import LEAST_PIVOT
from dolfinx_signorini.solvers.linear.hierarchy import SMALL, coarse_places, prolongations
from dolfinx_signorini.solvers.linear.options import options_set
from dolfinx_signorini.solvers.linear.rows import Rows
from dolfinx_signorini.solvers.motions import attach_motions, owned_places, rigid_motions
from dolfinx_signorini.solvers.system import System

DOWN, UP = "pc_sor_local_forward", "pc_sor_local_backward"
# On the coarsest level: one cycle of BoomerAMG may be far from a solution on flat cells. The matrix
# of some hundred nodes fits on every rank.
CHOLESKY = {"pc_type": "cholesky", "pc_factor_zeropivot": LEAST_PIVOT}
REDUNDANT_CHOLESKY = {"pc_type": "redundant"} | {f"redundant_{k}": v for k, v in CHOLESKY.items()}
CYCLES = 2  # on each coarser mesh, of a linear solve that begins there
# On coarser levels, and on the finest one for degrees above 2. With one sweep a linear solve takes
# 7 to 10 iterations in place of 5 to 8, and 3 to 14 % longer (benchmarks/obstacle.py).
BOTH = "pc_sor_local_symmetric"


class Multigrid:
    """A multigrid cycle for one matrix after another with the same pattern.

    For example:

        degrees, meshes = prolongations(space)
        options = amg_options(1, coarsest=True)
        multigrid = Multigrid([*degrees, *meshes], len(degrees), prefix, options)
        multigrid.set_up(A, held, 4.0, number=1)
        multigrid.pc.apply(r, y)

    Args:
        prolongations: The prolongations from lower degrees, then those from coarser meshes, the
            finest first. The object takes them over.
        degrees: How many of them are from lower degrees.
        prefix: The prefix of PETSc options; those of the smoothers begin with "mg_levels_", and
            those of the coarsest level with "mg_coarse_".
        coarsest: The options of a coarsest level of many nodes, without prefix.
        places: For bodies the nodes of this rank on the coarser levels, for their rigid motions.

    Attributes:
        prolongations, degrees: See above; coarser meshes may have been left out.
        pc: The cycle as a PETSc preconditioner.
        matrices: The Galerkin products of the last set-up, the finest first.
    """

    pc: PETSc.PC

    def __init__(
        self,
        prolongations: Sequence[PETSc.Mat],
        degrees: int,
        prefix: str,
        coarsest: Mapping[str, Any],
        places: Sequence[Array] = (),
    ):
        self.prolongations, self.degrees = list(prolongations), degrees
        self.prefix, self._places = prefix, places
        self.coarsest = coarsest
        self.matrices: list[PETSc.Mat] = []
        self._finest: PETSc.Mat | None = None  # the matrix of the last set-up
        self._levels: list[tuple[PETSc.KSP, ...]] = []
        self._whole: list[PETSc.Mat] = []  # the products without held dofs
        # How often the matrix of these, and that of the last set-up, had been assembled.
        self._number = self._truncated = 0
        self._off: Mask | None = None  # the held dofs of the last set-up
        self._filled: list[LocalIndices] = []  # rows of the matrices with a diagonal entry alone
        self._make()

    @property
    def name(self) -> str:
        """What the cycle goes through, in words: degrees and meshes."""
        meshes = len(self.prolongations) - self.degrees
        counts = (self.degrees, "lower degrees"), (meshes, "coarser meshes")
        return "multigrid over " + " and ".join(f"{n} {what}" for n, what in counts if n)

    def set_up(self, A: PETSc.Mat, held: LocalIndices, diagonal: float, number: int) -> None:
        """Set the cycle up for a matrix with those of a diagonal as rows and columns of held dofs.

        Args:
            A: The matrix with the rows and columns of the held dofs.
            held: The owned dofs that are held.
            diagonal: Their diagonal entries, the same ones as long as A is not assembled again.
            number: How often A has been assembled.
        """
        if not self._levels:
            self._make()
        self._truncate(A, held, diagonal, number)
        assert self._finest is not None and self._off is not None
        dead, self._filled = self._off, []
        for prolongation, coarse in zip(self.prolongations, self.matrices, strict=True):
            # A coarse function at held dofs alone is zero.
            dead = Rows(prolongation).largest(np.where(dead, 0.0, 1.0)) <= 0.0
            self._filled.append(np.flatnonzero(dead).astype(np.int32))
            Rows(coarse).fill(self._filled[-1], diagonal)
        # Coarse functions may differ at held dofs alone: the product is singular, which no factor
        # takes. The difference is 0 at all free dofs, so that its coefficient does not matter.
        _scale_diagonal(self.matrices[-1], 1.0 + ROUNDING)
        if self._places and not self._is_small:  # algebraic multigrid is told the rigid motions
            coarsest, places = self.matrices[-1], self._places[len(self.prolongations) - 1]
            size, comm = coarsest.getBlockSize(), coarsest.comm.tompi4py()
            attach_motions(coarsest, rigid_motions(comm, places, size), self._filled[-1])
        matrices = [self._finest, *self.matrices]
        for solvers, matrix in zip(self._levels, matrices, strict=True):
            for solver in solvers:
                solver.setOperators(matrix)
            _raise_diagonal(matrix, [solver.getPC() for solver in solvers])
        self.pc.setOperators(self._finest)
        with options_set(*self._coarse_options):  # GAMG reads those of its levels now
            self.pc.setUp()

    @property
    def is_set_up(self) -> bool:
        """Whether the cycle is that of the last set-up."""
        return self._off is not None

    def products(self, A: PETSc.Mat, number: int) -> list[PETSc.Mat]:
        """Return the Galerkin products of a matrix without held dofs, the finest first.

        The last set-up is lost where A has been assembled since the last call.

        Args:
            A: The matrix; the call is collective.
            number: How often A has been assembled.
        """
        if self._number != number:
            self._multiply(A)
            self._number, self._off = number, None
            if not self._whole:
                self._whole = [product.duplicate() for product in self.matrices]
            _copy(self.matrices, self._whole)
        return self._whole

    def _truncate(self, A: PETSc.Mat, held: LocalIndices, diagonal: float, number: int) -> None:
        """Make the matrix without the rows and columns of held dofs, and its Galerkin products.

        On one rank the entries that change are enough, where there are products of A for other held
        dofs, or for none: those from which fewer dofs have changed are renewed.

        Args:
            A: The matrix.
            held: The owned dofs that are held.
            diagonal: The diagonal entries of held dofs.
            number: How often A has been assembled.
        """
        alone, off = A.comm.size == 1, np.zeros(A.getLocalSize()[0], dtype=bool)
        off[held] = True
        last = self._off if alone and self._truncated == number else None
        changed = math.inf if last is None else (off != last).sum()
        self._off, self._truncated = off, number
        whole = alone and self._number == number and len(held) < changed
        if self._finest is None:
            self._finest = without_nodes(A.copy())
        elif whole or last is None:
            _copy([A], [self._finest])
        if not whole and last is None:
            self._finest.zeroRowsColumns(held + A.getOwnershipRange()[0], diag=0.0)
            self._multiply(self._finest)
            Rows(self._finest).fill(held, diagonal)
            return
        if whole:
            _copy(self._whole, self.matrices)
            last = np.zeros_like(off)
        else:
            for product, rows in zip(self.matrices, self._filled, strict=True):
                Rows(product).fill(rows, 0.0)
        assert last is not None
        fine = Rows(A)
        changes = fine.changes(last, off, diagonal, Rows(self._finest))
        for prolongation, product in zip(self.prolongations, self.matrices, strict=True):
            coarse = Rows(product)
            changes = fine.renew(changes, Rows(prolongation), coarse)
            fine = coarse

    def _multiply(self, fine: PETSc.Mat) -> None:
        """Make the Galerkin products of a matrix, in those of an earlier one if there are any."""
        made = list(self.matrices)  # PETSc multiplies into none but its own products
        for level, prolongation in enumerate(self.prolongations):
            fine = fine.ptap(prolongation, result=made[level] if made else None)
            if not made:
                self.matrices.append(fine)

    def extended(self, x: PETSc.Vec, known: Mask) -> None:
        """Extend the values of x at known dofs to all others, by the functions of coarser levels.

        On the coarsest level the others have the mean of the known values. So there is no jump
        beside known values that no coarser level sees.

        Args:
            x: The vector, whose other values are overwritten; the call is collective.
            known: Whether the value of each owned dof is known.
        """
        levels = [x.copy()]
        levels[0].array_w[~known] = np.nan
        for prolongation in self.prolongations:
            coarse = prolongation.createVecRight()
            coarse.array_w[:] = Rows(prolongation).injected(levels[-1].array_r, np.nan)
            levels.append(coarse)
        values = levels[-1].array_w
        own = values[np.isfinite(values)]
        total, count = x.comm.tompi4py().allreduce(np.array([own.sum(), len(own)]))
        values[~np.isfinite(values)] = total / max(count, 1.0)
        for prolongation in reversed(self.prolongations):
            coarse, fine = levels.pop(), levels[-1]
            given = fine.array_r.copy()
            prolongation.mult(coarse, fine)
            fine.array_w[:] = np.where(np.isfinite(given), given, fine.array_r)
            coarse.destroy()
        levels[0].copy(x)
        levels[0].destroy()

    def nested(self, rhs: PETSc.Vec, x: PETSc.Vec) -> float:
        """Solve on the coarser meshes, from the coarsest one on, and prolongate the solution.

        Args:
            rhs: The right-hand side on the finest mesh.
            x: Set to the prolongated solution of the next coarser mesh.

        Returns:
            The number of unknowns of the finest mesh over that of the next coarser one; 0, with
            nothing done, where the next coarser level is one of lower degree.
        """
        if self.degrees:
            return 0.0
        sides = [rhs]
        for prolongation in self.prolongations:
            sides.append(prolongation.createVecRight())
            prolongation.multTranspose(sides[-2], sides[-1])
        coarse = sides[-1].duplicate()
        self._levels[-1][0].solve(sides[-1], coarse)
        for level in range(len(sides) - 2, -1, -1):
            fine = sides[level].duplicate() if level else x
            self.prolongations[level].mult(coarse, fine)
            coarse.destroy()
            for _ in range(CYCLES if level else 0):
                self._cycle(level, sides[level], fine)
            coarse = fine
        destroy(*sides[1:])
        rows, columns = self.prolongations[0].getSize()
        return float(rows / columns)

    def _cycle(self, level: int, rhs: PETSc.Vec, x: PETSc.Vec) -> None:
        """Improve x on a level by one cycle."""
        if level == len(self.prolongations):
            self._levels[level][0].solve(rhs, x)
            return
        (down, up), prolongation = self._levels[level], self.prolongations[level]
        down.setInitialGuessNonzero(True)
        down.solve(rhs, x)
        down.setInitialGuessNonzero(False)
        rest, coarse_rest = prolongation.createVecs()[::-1]
        self.matrices[level - 1].mult(x, rest)
        rest.aypx(-1.0, rhs)
        prolongation.multTranspose(rest, coarse_rest)
        correction = coarse_rest.duplicate()
        correction.set(0.0)
        self._cycle(level + 1, coarse_rest, correction)
        prolongation.multAdd(correction, x, x)
        up.solve(rhs, x)
        destroy(rest, coarse_rest, correction)

    def drop_meshes(self) -> bool:
        """Leave coarser meshes out from now on; return whether lower degrees are left."""
        meshes = self.prolongations[self.degrees :]
        if not meshes or not self.degrees:
            return False
        self.free()
        destroy(*meshes)
        del self.prolongations[self.degrees :]
        return True

    def free(self) -> None:
        """Free what a set-up has made."""
        solvers = [solver for level in self._levels for solver in level]
        destroy(self.pc, *solvers, self._finest, *self.matrices, *self._whole)
        self._levels, self.matrices, self._whole = [], [], []
        self._finest = self._off = None
        self._number = self._truncated = 0

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.free()
        destroy(*self.prolongations)

    def _make(self) -> None:
        """Make the cycle, whose levels have no matrices yet; the finest level comes first."""
        count, comm = len(self.prolongations) + 1, self.prolongations[0].comm
        self.pc = PETSc.PC().create(comm)
        self.pc.setType(PETSc.PC.Type.MG)
        self.pc.setMGLevels(count)
        for level in range(count - 1, 0, -1):
            self.pc.setMGInterpolation(level, self.prolongations[count - 1 - level])
            down, up = self.pc.getMGSmootherDown(level), self.pc.getMGSmootherUp(level)
            one = self.degrees < 2 and level == count - 1
            for solver, sweep in ((down, DOWN), (up, UP)):
                self._smooth(solver, sweep if one else BOTH)
            up.setInitialGuessNonzero(True)
            self._levels.append((down, up))
        coarse = self.pc.getMGCoarseSolve()
        coarse.setType(PETSc.KSP.Type.PREONLY)
        coarse.setOptionsPrefix(self._coarse_options[0])
        with options_set(*self._coarse_options):
            coarse.setFromOptions()
        self._levels.append((coarse,))

    @property
    def _coarse_options(self) -> tuple[str, Mapping[str, Any], Mapping[str, Any]]:
        """The prefix of the coarsest level, no options of users, and the defaults."""
        options: Mapping[str, Any] = self.coarsest
        if self._is_small:
            one = self.prolongations[0].comm.size == 1
            options = CHOLESKY if one else REDUNDANT_CHOLESKY
        return f"{self.prefix}mg_coarse_", {}, options

    @property
    def _is_small(self) -> bool:
        """Whether the coarsest level is factored."""
        return bool(self.prolongations[-1].getSize()[1] <= SMALL)

    def _smooth(self, solver: PETSc.KSP, sweep: str) -> None:
        """Make a solver one Gauss-Seidel sweep; for a body on several ranks the sweep is a part.

        A part has a matrix of its own, see `_raise_diagonal`, and Richardson's method the residual.
        """
        pc, prefix, parts = solver.getPC(), f"{self.prefix}mg_levels_", list[Any]([solver])
        solver.setType(PETSc.KSP.Type.RICHARDSON)
        if pc.comm.size > 1 and self._places:
            pc.setType(PETSc.PC.Type.COMPOSITE)
            pc.addCompositePCType(PETSc.PC.Type.SOR)
            parts.append(pc.getCompositePC(0))
        else:
            pc.setType(PETSc.PC.Type.SOR)
        solver.setNormType(PETSc.KSP.NormType.NONE)
        solver.setTolerances(max_it=1)
        with options_set(prefix, {}, {sweep: None}):
            for part in parts:
                part.setOptionsPrefix(prefix)
                part.setFromOptions()


def multigrid_for(
    system: System, prefix: str, options: Mapping[str, Any], coarsest: Mapping[str, Any]
) -> Multigrid | None:
    """Return multigrid for a system, if lower degrees or coarser meshes are known.

    Somebody who chooses a preconditioner, by an option that begins with "pc_" in the options or in
    PETSc's database, gets this one: the result is None.

    Args:
        system: The system.
        prefix: The prefix of PETSc options.
        options: PETSc options without prefix.
        coarsest: The options of a coarsest level of many nodes, without prefix.
    """
    names = (*options, *PETSc.Options(prefix).getAll())
    if any(name.startswith("pc_") for name in names):
        return None
    layout = system.layout
    degrees, meshes = prolongations(layout.nodal)
    found, places = [*degrees, *meshes], []
    if layout.frame is not None:
        places = coarse_places(found, owned_places(layout.nodal))
        found = [layout.frame.prolongation(each, finest=k == 0) for k, each in enumerate(found)]
    return Multigrid(found, len(degrees), prefix, coarsest, places) if found else None


def _raise_diagonal(matrix: PETSc.Mat, smoothers: Sequence[PETSc.PC]) -> None:
    """Raise the diagonal of sweeps that are parts where the coupling outweighs it; collective.

    Gauss-Seidel sweeps leave the coupling to other ranks out: sweeps with a diagonal D reduce the
    energy of the error if 2 D - diag(A) is larger than this coupling (Baker, Falgout, Kolev and
    Yang, SIAM J. Sci. Comput. 33 (2011) 2864, section 6). Half of the coupling is added. For one
    unknown function the diagonal outweighs the coupling but for a little.
    """
    composite = [pc for pc in smoothers if pc.getType() == PETSc.PC.Type.COMPOSITE]
    if not composite:
        return
    coupling, diagonal, raised = Rows(matrix).coupling(), matrix.getDiagonal(), matrix.copy()
    weak = diagonal.array_r < coupling
    diagonal.array_w[weak] += 0.5 * coupling[weak]
    raised.setDiagonal(diagonal)
    for pc in composite:  # by itself a part keeps the matrix of its first set-up
        pc.getCompositePC(0).setOperators(matrix, raised)
    destroy(diagonal, raised)


def _scale_diagonal(matrix: PETSc.Mat, factor: float) -> None:
    diagonal = matrix.getDiagonal()
    diagonal.scale(factor)
    matrix.setDiagonal(diagonal)
    diagonal.destroy()


def _copy(matrices: Sequence[PETSc.Mat], others: Sequence[PETSc.Mat]) -> None:
    """Copy the entries of matrices into others of the same patterns."""
    for matrix, other in zip(matrices, others, strict=True):
        matrix.copy(other, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
