"""TAO accepts what the active set method has accepted, at any tolerance and on any ranks."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from dolfinx import fem
from large import Large, posed
from large_meshes import unit_square
from one_stop import PROBLEMS, TOLERANCES, steps_of_tao

HELD = "0 steps of TAO on what the active set method has accepted"


def test_tao_takes_no_step_on_what_is_accepted(record):
    count, steps = steps_of_tao(16, TOLERANCES)
    assert steps == []
    assert count >= 0.9 * len(PROBLEMS) * len(TOLERANCES)
    case = f"rtol 1e-3 ... 1e-13, {len(PROBLEMS)} problems, N = 16"
    record(
        "stop", case, HELD, f"{count} solves of {len(PROBLEMS) * len(TOLERANCES)}, all from nothing"
    )


@pytest.mark.parametrize(
    "ranks,every",
    [
        (2, 10),
        pytest.param(2, 2, marks=pytest.mark.slow),
        pytest.param(3, 2, marks=pytest.mark.slow),
    ],
)
def test_tao_takes_no_step_on_several_ranks(ranks, every, serial, record):
    script = Path(__file__).with_name("one_stop.py")
    command = ["mpirun", "-n", ranks, "--oversubscribe", sys.executable, script, every]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr[-2000:]
    report = json.loads(done.stdout.strip().splitlines()[-1])
    asked = len(PROBLEMS) * len(TOLERANCES[1::every])
    assert report["steps"] == []
    assert report["count"] >= 0.9 * asked
    if every == 2:
        text = f"{report['count']} solves of {asked}, all from nothing"
        record("stop", f"the same on {ranks} ranks, N = 40", HELD, text)


@pytest.mark.parametrize("share", [0.5, 0.6, 0.85])
def test_a_negative_multiplier_within_the_tolerance_is_accepted(share):
    """TAO's measure of such a dof is twice the natural residual."""
    rtol = 1e-5
    problem = Large(unit_square(8), obstacle=lambda x: 0.0 * x[0]).problem()

    def force(x):
        """One, but for the dof in the middle of the lower side."""
        middle = (np.abs(x[0] - 0.5) < 1e-9) & (x[1] < 1e-9)
        return np.where(middle, -share * rtol * pressing, 1.0)

    pressing = np.sqrt(31.0)  # the norm of the load, which has the forces alone
    start = fem.Function(problem.space)
    posed(problem, lambda x: 0.0 * x[0], force)
    problem.solve(start=start, rtol=rtol)
    assert problem.result.natural_residual == pytest.approx(share * rtol, rel=1e-3)
    assert problem.result.iterations == 0
    problem.destroy()
