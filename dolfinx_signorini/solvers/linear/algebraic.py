"""Options of PETSc's algebraic multigrid: which of them a matrix gets."""

from typing import Any

import numpy as np
from petsc4py import PETSc

# One Gauss-Seidel sweep forward on the way down and one backward on the way up are symmetric
# together, and half the work of PETSc's default, which is symmetric each time. Sweeps leave out
# what couples ranks; where that is strong, as with large reactions, they are definite only if the
# diagonal is raised by it (Baker, Falgout, Kolev and Yang, SIAM J. Sci. Comput. 33 (2011) 2864).
# The last levels, a few dofs each, cost more than a direct solve. Coarsening and interpolation are
# those of `benchmarks/amg.py`: aggressive on the first level, in the plane and in space. Few dofs
# are coarsened in PETSc's way, which leaves hardly an iteration.
CLASSICAL: dict[str, Any] = {
    "pc_type": "hypre",
    "pc_hypre_type": "boomeramg",
    "pc_hypre_boomeramg_relax_type_down": "l1-Gauss-Seidel",
    "pc_hypre_boomeramg_relax_type_up": "backward-l1-Gauss-Seidel",
    "pc_hypre_boomeramg_max_coarse_size": 50,
}
HYPRE: dict[str, Any] = CLASSICAL | {
    "pc_hypre_boomeramg_coarsen_type": "HMIS",
    "pc_hypre_boomeramg_interp_type": "ext+i",
    "pc_hypre_boomeramg_P_max": 4,
    "pc_hypre_boomeramg_agg_nl": 1,
    "pc_hypre_boomeramg_agg_num_paths": 2,
}
LEAST_PIVOT = float(np.finfo(np.float64).tiny)  # the unit of the form is free; PETSc's is 2e-14
# PETSc's own algebraic multigrid, for a PETSc without hypre. The unit of the form is free: norms of
# size 1e200 have no squares, so that eigenvalues are estimated by CG, and pivots may be tiny. The
# interpolation is made anew for each set of held dofs.
GAMG: dict[str, Any] = {
    "pc_type": "gamg",
    "pc_gamg_esteig_ksp_type": "cg",
    "pc_gamg_reuse_interpolation": False,
    "mg_coarse_sub_pc_factor_zeropivot": LEAST_PIVOT,
}
# For bodies that bend, whose rigid motions GAMG keeps on all levels, with and without hypre. In
# `benchmarks/elastic_amg.py` (a plate with a hole and a cube of gmsh, half of the contact held) CG
# takes 12 to 17 iterations where BoomerAMG takes 26 to 51, and half the CPU time in the plane; in
# space the times are the same up to 100,000 unknowns, and BoomerAMG's iterations grow. The
# interpolation vectors of BoomerAMG (nodal coarsening 4, variant 2) left 26 to 43 iterations where
# hypre did not fail with them. Symmetric Gauss-Seidel sweeps in place of Chebyshev's save a tenth
# in space and a third in the plane; thresholds and more aggressive coarsening save nothing. On
# several ranks sweeps leave out what couples these, and a cycle may be indefinite (a cube of degree
# 2 on three ranks): Chebyshev's polynomials know the largest eigenvalue.
VECTORS: dict[str, Any] = GAMG | {
    "mg_levels_ksp_type": "richardson",
    "mg_levels_ksp_max_it": 1,
    "mg_levels_pc_type": "sor",
}
AMG = HYPRE if PETSc.Sys.hasExternalPackage("hypre") else GAMG
DEFAULT_OPTIONS: dict[str, Any] = {"ksp_type": "cg"} | AMG


def amg_options(
    block: int, few: bool = False, coarsest: bool = False, alone: bool = True
) -> dict[str, Any]:
    """Return the options of the algebraic multigrid for a matrix.

    Args:
        block: The number of dofs of a node, whose rigid motions the matrix knows.
        few: Whether a factorization would cost less.
        coarsest: Whether one cycle stands for the solve on the coarsest level of a geometric
            multigrid, and is to be accurate.
        alone: Whether one rank has the whole matrix.
    """
    if block > 1:
        return VECTORS if alone else GAMG
    if AMG is not HYPRE:
        return AMG
    if few:
        return CLASSICAL
    return HYPRE | ({"pc_hypre_boomeramg_agg_nl": 0} if coarsest else {})
