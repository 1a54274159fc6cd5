"""Searches that are killed at any moment continue to the same plan."""

import subprocess
import sys
import time

import numpy as np
import pytest

import fixel

CALL = """
import sys, fixel
from fixel.testing.scenes import pushed_square
from fixel.units import deg, mm
goal = fixel.PoseRegion((0.03, 0.01, 0.1), position=3 * mm, angle=3 * deg)
belief = fixel.Belief(
    parameters={"mu_pusher": (0.2, 0.4)},
    start=fixel.StartError(x=mm, y=mm, theta=deg, kind="uniform"),
)
plan = fixel.plan(
    pushed_square(), goal, belief=belief, rollouts=8_000, store=sys.argv[1], progress=False
)
plan.save(sys.argv[2])
"""


def searching(store, file) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-c", CALL, str(store), str(file)])


@pytest.mark.slow
def test_a_hundred_kills_change_no_bit_of_a_plan(tmp_path):
    begun = time.monotonic()
    assert searching(tmp_path / "calm", tmp_path / "calm.fixel").wait() == 0
    longest = time.monotonic() - begun
    rng = np.random.default_rng(0)
    kills = rounds = 0
    while kills < 100:
        store, file = tmp_path / f"killed-{rounds}", tmp_path / f"killed-{rounds}.fixel"
        while not file.exists():
            process = searching(store, file)
            try:
                process.wait(rng.uniform(0.3, 1.2) * longest)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                kills += 1
        assert fixel.load(file) == fixel.load(tmp_path / "calm.fixel")
        rounds += 1
