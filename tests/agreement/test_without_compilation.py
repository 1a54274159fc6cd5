"""The kernels run as plain Python make the numbers that they make compiled."""

import json
import os
import subprocess
import sys

import numpy as np

from fixel.simulation import StewartTrinkle, simulate
from fixel.testing.scenes import grasp

_SCRIPT = """
import json
from fixel.simulation import StewartTrinkle, simulate
from fixel.testing.scenes import grasp
run = simulate(grasp("slip"), stepper=StewartTrinkle(step=0.05), duration=3.0)
print(json.dumps([run.status, run.pose["object"].tolist()]))
"""


def test_a_short_grasp_without_compilation():
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        [sys.executable, "-c", _SCRIPT],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    status, poses = json.loads(done.stdout)
    run = simulate(grasp("slip"), stepper=StewartTrinkle(step=0.05), duration=3.0)
    assert status == run.status
    # To the bit where it was measured (x86-64, 2026-11); elsewhere compiled code may fuse a
    # multiplication and an addition into one rounding.
    assert np.abs(np.array(poses) - run.pose["object"]).max() < 1e-12
