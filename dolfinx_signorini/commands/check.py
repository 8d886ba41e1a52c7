"""The job `check`: what a scene needs and costs, without a solve."""

import argparse

from mpi4py import MPI

from dolfinx_signorini.base.logs import Progress
from dolfinx_signorini.commands.options import add_scene
from dolfinx_signorini.scenes.expectations import (
    Expectation,
    check_errors,
    cost,
    expect,
    terms,
    unknowns,
)
from dolfinx_signorini.scenes.files.reading import load_scene, naming_the_file
from dolfinx_signorini.scenes.files.scene import Scene
from dolfinx_signorini.scenes.output.summary import listing
from dolfinx_signorini.scenes.posing import pose


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the job."""
    add_scene(parser)


def run(args: argparse.Namespace) -> int:
    """Assemble the scene on its coarsest mesh and print what it needs, on rank 0.

    Raises:
        InputError: The scene is refused.
    """
    comm = MPI.COMM_WORLD
    with Progress("reading the scene"):
        scene = load_scene(args.scene, comm, args.overrides)
    with naming_the_file(args.scene, scene):
        with Progress("coarsest mesh and its matrix"):
            posed = pose(scene.levels()[0], comm)
        try:
            with Progress("orders to expect"):
                expectation = expect(scene, posed.sided)
            with Progress("values of the solution"):
                norm = None if scene.accuracy is None else scene.norm
                check_errors(posed, expectation, norm)
        finally:
            posed.problem.destroy()
    if comm.rank == 0:
        print(scene.title)
        print(listing(_lines(scene, expectation)), end="")
        for note in expectation.notes:
            print(f"note: {note}")
    return 0


def _lines(scene: Scene, expectation: Expectation) -> list[tuple[str, str]]:
    rows = [("terms" if k == 0 else "", term) for k, term in enumerate(terms(scene))]
    rows.append(("expected orders", str(expectation)))
    if scene.accuracy is not None:
        wanted = f"an error of {scene.accuracy:g} in {scene.norm}"
        return [*rows, ("meshes", f"refined where the solution needs it, for {wanted}")]
    meshes = [f"{level.domain.vertices}" for level in scene.levels()]
    memory, seconds = cost(scene)
    rows.append(("meshes", f"{', '.join(meshes)} vertices"))
    rows.append(("unknowns", f"about {unknowns(scene)}"))
    rows.append(("memory", f"about {memory / 1e9:.2g} GB in all"))
    rows.append(("time", f"about {seconds + 1.0:.2g} s on one core, and more for the results"))
    return rows
