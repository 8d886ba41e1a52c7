"""The data of a scene: formulas with the cells or facets that they are on."""

from collections.abc import Iterator

from dolfinx_signorini.data.form_data import on_boundary, on_cells, with_reciprocal
from dolfinx_signorini.data.formulas import Formula
from dolfinx_signorini.data.sampling import DEGREE, Datum
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, owned_cells
from dolfinx_signorini.scenes.files.scene import Scene


def data_of(scene: Scene, sided: SidedMesh) -> list[Datum]:
    """Return the data of a scene on a mesh of its domain that depend on the coordinates."""
    whole, degree = on_cells(sided.mesh, owned_cells(sided.mesh)), max(DEGREE, scene.degree)
    found = [Datum(*datum, degree, *whole) for datum in _on_cells(scene)]
    for condition in scene.conditions:
        parts = on_boundary(sided.mesh, sided.facets(condition.sides))
        nodal = condition.acts_like != "Neumann"
        measure, degree = ("height", scene.degree) if nodal else ("mass", DEGREE)
        found += [
            Datum(f"the {key} of '{condition.key}'", formula, measure, degree, *parts)
            for key, formula in condition.data
        ]
    if scene.obstacle is not None:
        inside = on_cells(sided.mesh, sided.cells(scene.obstacle.cells))
        found += [
            Datum(f"the {name} obstacle", formula, "height", scene.degree, *inside)
            for name, formula in scene.obstacle.named
        ]
    return [datum for datum in found if datum.formula.constant is None]


def _on_cells(scene: Scene) -> Iterator[tuple[str, Formula, str]]:
    """The names, formulas and measures of the data on cells."""
    if scene.solution is not None and scene.manufactured:
        yield "the solution", scene.solution, "height"
    if scene.load is not None:
        yield "the load", scene.load, "mass"
    if scene.reaction is not None:
        yield "the reaction", scene.reaction, "mass"
    if scene.elasticity is not None:
        yield from scene.elasticity.data
    for i, row in enumerate(scene.diffusion):
        for entry in (*with_reciprocal(row[i]), *row[i + 1 :]):
            yield "the diffusion", entry, "mass"
