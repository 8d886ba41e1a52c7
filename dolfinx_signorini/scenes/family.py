"""A scene as a family: posed on any mesh of its domain, for a search for the right one."""

import math
from dataclasses import replace

from dolfinx_signorini.accuracy.family import Family
from dolfinx_signorini.errors import InputError
from dolfinx_signorini.meshes import SidedMesh
from dolfinx_signorini.scenes.domains import Cube, Domain, Polygon, Square
from dolfinx_signorini.scenes.posing import PosedScene, pose
from dolfinx_signorini.scenes.scene import Scene


def scene_family(scene: Scene) -> Family:
    """Return a scene on quasi-uniform meshes of its domain; its own mesh width does not matter.

    Raises:
        InputError: The scene's mesh is from a file, and there is no other.
    """
    domain = scene.domain
    if not isinstance(domain, Square | Cube | Polygon):
        raise InputError("domain: a mesh from a file is used as it is; there is nothing to choose")
    size = math.sqrt(domain.area) if isinstance(domain, Polygon) else 1.0

    def at(n: int) -> Domain:
        if isinstance(domain, Polygon):
            return replace(domain, width=size / n)
        return replace(domain, cells=n)

    def on(sided: SidedMesh, degree: int) -> PosedScene:
        return pose(replace(scene, degree=degree), sided.mesh.comm, sided)

    return Family(
        name=scene.title or "scene",
        dimension=domain.dimension,
        width=size,
        make=lambda comm, n: at(n).make(comm),
        pose=on,
    )
