"""What dofs add that are in contact in one of two solutions alone."""

import numpy as np
import pytest
from dolfinx import fem, mesh

from dolfinx_signorini.accuracy.contact_changes import contact_changes
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, owned_cells


def waves(space, *numbers):
    """Functions of a space that depend on the places of the dofs, and not on the ranks."""
    functions = [fem.Function(space) for _ in numbers]
    for function, k in zip(functions, numbers, strict=True):
        function.interpolate(lambda x, k=k: np.sin(k * x[0]) + np.cos((k + 1.0) * x[1]))
    return functions


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("counted", [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
def test_cells_share_the_sizes_of_both_sums(counted, degree, comm):
    domain = mesh.create_unit_square(comm, 4, 4)
    division = refined(SidedMesh(domain, {}))
    pairs, sums = [], 0.0
    for part, weight in zip((domain, division.sided.mesh), counted, strict=True):
        space = fem.functionspace(part, ("Lagrange", degree))
        forces, moved = waves(space, 3.0, 7.0)
        forces.x.array[:] *= weight
        owned = space.dofmap.index_map.size_local
        sums += np.abs(forces.x.array * moved.x.array)[:owned].sum()
        pairs.append((forces, moved))
    found = contact_changes(*pairs, division.parents)
    assert len(found) == len(owned_cells(domain)) and (found > 0.0).all()
    assert comm.allreduce(found.sum()) == pytest.approx(comm.allreduce(sums), rel=1e-12)
