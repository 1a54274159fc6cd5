"""Steps per second of 64 Push-T environments, compared with gym-pusht, and a scripted baseline."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from benchmarks.figures import Figure, Size, at_least
from benchmarks.report import console
from fixel.environments.push_t import SUCCESS, PushTVectorEnv, WorldName
from fixel.environments.push_t_planner import PushTPlanner
from fixel.typing import FloatArray

CHILD = Path(__file__).with_name("push_t_process.py")
ENVIRONMENTS = 64
ACTIONS = ("random", "pushes")
OURS = ("fixel/PushT-v0", "vector_entry_point")
PEERS = {
    "gym-pusht, sync": ("gym_pusht/PushT-v0", "sync"),
    "gym-pusht, async": ("gym_pusht/PushT-v0", "async"),
}
AHEAD = 20.0  # what the ratio to the faster peer must reach
FIRST_SEED = 100_000  # of the planner's episodes
PEER_PYTHON = "FIXEL_PEER_PYTHON"  # set by --peer-python


def run(size: Size) -> list[Figure]:
    """Time both in turn, each in a process of its own, so that a slower machine slows both."""
    peer_python = os.environ.get(PEER_PYTHON)
    if peer_python is None:
        console().print("      gym-pusht: skipped (--peer-python PATH of one that has it)")
    figures = []
    for actions in ACTIONS:
        ours: list[float] = []
        theirs: dict[str, list[float]] = {name: [] for name in PEERS if peer_python}
        for _ in range(size.repeats):
            ours.append(_measure(sys.executable, *OURS, actions, 20 * size.calls))
            for name, values in theirs.items():
                values.append(_measure(str(peer_python), *PEERS[name], actions, size.calls))
        figures.append(Figure(f"Push-T, {actions}: fixel", "steps/s", tuple(ours)))
        figures += [
            Figure(f"Push-T, {actions}: {name}", "steps/s", tuple(values))
            for name, values in theirs.items()
        ]
        if theirs:
            best = map(max, *theirs.values())
            ratios = tuple(a / b for a, b in zip(ours, best, strict=True))
            label = f"Push-T, {actions}: fixel over the faster gym-pusht"
            figures.append(Figure(label, "x", ratios, at_least(AHEAD)))
    return figures


def _measure(python: str, name: str, mode: str, actions: str, steps: int) -> float:
    """Return the steps per second that a process of its own measures."""
    command = [python, str(CHILD), name, mode, actions, str(ENVIRONMENTS), str(steps)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{python} with {name} failed: {done.stderr.strip()[-300:]}")
    return float(json.loads(done.stdout.splitlines()[-1]))


def run_planner(size: Size) -> list[Figure]:
    """Success of the scripted planner in episodes of 300 steps, by world: Wilson intervals."""
    figures = []
    n = max(2, size.rollouts // 20)
    worlds: tuple[WorldName, ...] = ("nominal", "posterior")
    with ProcessPoolExecutor() as pool:
        coverages = list(pool.map(_best_coverages, worlds, [n] * len(worlds)))
    for world, coverage in zip(worlds, coverages, strict=True):
        solved = int((coverage > SUCCESS).sum())
        interval = binomtest(solved, n).proportion_ci(0.95, method="wilson")
        label = f"Push-T planner, {world}, {n} episodes"
        figures += [
            Figure(f"{label}: success", "%", (100.0 * solved / n,)),
            Figure(f"{label}: 95 % interval, low", "%", (100.0 * interval.low,)),
            Figure(f"{label}: 95 % interval, high", "%", (100.0 * interval.high,)),
            Figure(f"{label}: largest coverage, mean", "%", (100.0 * float(coverage.mean()),)),
        ]
    return figures


def _best_coverages(world: WorldName, n: int) -> FloatArray:
    """Return the largest coverages (n,) of episodes with the seeds from `FIRST_SEED`."""
    env, planner = PushTVectorEnv(n, world=world), PushTPlanner(n, world="nominal")
    seen, info = env.reset(seed=FIRST_SEED)
    best: FloatArray = info["coverage"].copy()
    running = np.ones(n, bool)
    while running.any():
        action = seen[:, :2].copy()  # of episodes that are over
        action[running] = planner.actions(seen, np.flatnonzero(running))
        seen, _, terminated, truncated, info = env.step(action)
        best = np.where(running, np.maximum(best, info["coverage"]), best)
        running &= ~(terminated | truncated)
        planner.restart(np.flatnonzero(terminated | truncated))
    return best
