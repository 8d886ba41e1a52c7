"""Objects of PETSc."""

from typing import Any

from petsc4py import PETSc

# PETSc's sweeps over nodes of several dofs take a diagonal entry below 2e-14 for a zero, whatever
# the unit of the form is. The option of matrices that are made, and what one matrix is told:
NO_NODES = "mat_no_inode"


def without_nodes(matrix: PETSc.Mat) -> PETSc.Mat:
    """Return a matrix whose sweeps go from dof to dof, so that its entries may be tiny."""
    matrix.setOption(PETSc.Mat.Option.USE_INODES, False)
    return matrix


def destroy(*items: Any) -> None:
    """Free objects of PETSc, and others that have such; None stands for none."""
    for item in items:
        if item is not None:
            item.destroy()
