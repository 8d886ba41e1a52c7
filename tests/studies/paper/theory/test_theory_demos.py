"""The demos of the theory run and leave their pictures."""

import runpy
import sys
from pathlib import Path

import pytest
from mpi4py import MPI

DEMOS = sorted((Path(__file__).parents[4] / "demos").glob("theory_*.py"))


def test_there_are_demos():
    assert len(DEMOS) >= 2


@pytest.mark.slow
@pytest.mark.parametrize("demo", DEMOS, ids=lambda demo: demo.stem)
def test_demo(demo, folder, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [str(demo), str(folder)])
    runpy.run_path(str(demo), run_name="__main__")
    MPI.COMM_WORLD.barrier()
    assert (folder / f"{demo.stem}.png").stat().st_size > 10_000
    printed = capsys.readouterr().out
    assert ("| N" in printed or "| p" in printed or "| norm" in printed) == (
        MPI.COMM_WORLD.rank == 0
    )
