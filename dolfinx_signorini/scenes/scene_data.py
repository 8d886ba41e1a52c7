"""The data of a scene: formulas with the cells or facets that they are on."""

from collections.abc import Iterator

import numpy as np

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.data.formulas import Formula, Node, number
from dolfinx_signorini.data.sampling import DEGREE, Datum
from dolfinx_signorini.meshes.sided_meshes import (
    SidedMesh,
    boundary_facets,
    facet_cells,
    facet_nodes,
    owned_cells,
)
from dolfinx_signorini.scenes.files.scene import Scene


def data_of(scene: Scene, sided: SidedMesh) -> Iterator[Datum]:
    """Yield the data of a scene that depend on the coordinates.

    Args:
        scene: The scene.
        sided: A mesh of the domain of the scene.
    """
    domain = sided.mesh
    dim, cells = domain.topology.dim, owned_cells(domain)
    x: Array = np.asarray(domain.geometry.x[:, :dim], dtype=np.float64)
    whole = x[domain.geometry.dofmap[cells]]
    for name, formula, measure in _on_cells(scene):
        if formula.constant is None:
            degree = max(DEGREE, scene.degree)
            yield Datum(name, formula, measure, degree, whole, cells)
    for condition in scene.conditions:
        if condition.value is None or condition.value.constant is not None:
            continue
        on = sided.facets(condition.sides)
        facets = np.intersect1d(on, boundary_facets(domain)).astype(np.int32)
        owners = facet_cells(domain, facets)[:, 0]
        corners = x[facet_nodes(domain, facets)]
        nodal = condition.acts_like != "Neumann"
        measure, degree = ("height", scene.degree) if nodal else ("mass", DEGREE)
        name = f"the {condition.value_key} of '{condition.key}'"
        yield Datum(name, condition.value, measure, degree, corners, owners)


def _on_cells(scene: Scene) -> Iterator[tuple[str, Formula, str]]:
    """The names, formulas and measures of the data on cells."""
    if scene.solution is not None and scene.manufactured:
        yield "the solution", scene.solution, "height"
    if scene.load is not None:
        yield "the load", scene.load, "mass"
    if scene.reaction is not None:
        yield "the reaction", scene.reaction, "mass"
    for i, row in enumerate(scene.diffusion):
        for entry in row[i:]:
            yield "the diffusion", entry, "mass"
        # A thin layer that lets nothing through is narrow in the reciprocal only.
        inverse = Node("/", (number(1.0).root, row[i].root))
        if row[i].constant is None:
            yield "the diffusion", Formula(f"1/({row[i].text})", inverse), "mass"
