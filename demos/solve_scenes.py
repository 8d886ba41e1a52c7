"""Solve the scene files of this folder: on any number of processes, for example mpirun -n 2.

Run: python3 demos/solve_scenes.py
"""

from pathlib import Path

from dolfinx_signorini.scenes import load_scene, solve_scene
from dolfinx_signorini.scenes.output.pictures import scene_boundaries
from dolfinx_signorini.scenes.output.summary import lines, listing, summarise

from mpi4py import MPI

comm = MPI.COMM_WORLD
for path in sorted((Path(__file__).parent / "scenes").glob("*.toml")):
    result = solve_scene(load_scene(path, comm), comm)
    summary = summarise(result, scene_boundaries(result))
    result.destroy()
    if comm.rank == 0:
        print(f"{path.name}: {result.posed.scene.title}")
        print(listing(lines(summary)), end="")
