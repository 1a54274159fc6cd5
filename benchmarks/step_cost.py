"""Where the time of a grasp goes: per step in each phase, for rescues, and around the steps."""

from __future__ import annotations

import numpy as np

from benchmarks.accuracy import random_sets
from benchmarks.figures import Figure, Size, seconds
from fixel.simulation import StewartTrinkle, simulate, simulate_batch
from fixel.testing.scenes import grasp

STEP = 0.01  # [s]
# When the phases of the seated grasp with nominal parameters end [s].
PHASES = {"approach": 0.35, "align and push": 5.8, "stalled": 11.0}


def run(size: Size) -> list[Figure]:
    """Figures without bars."""
    return [*_phases(size), _around(size), *_rescues(size)]


def _phases(size: Size) -> list[Figure]:
    """Microseconds a fixed step, from the times of runs that end with each phase."""
    scene = grasp("seated")
    figures, earlier, earlier_end = [], 0.0, 0.0
    for phase, end in PHASES.items():
        walls = [_wall(end) for _ in range(size.calls)]
        cost = 1e6 * (min(walls) - earlier) / ((end - earlier_end) / STEP)
        figures.append(Figure(f"one step, {phase}", "us", (cost,)))
        earlier, earlier_end = min(walls), end
    assert scene.duration == earlier_end
    return figures


def _wall(duration: float) -> float:
    """Seconds inside the compiled loop."""
    return simulate(
        grasp("seated"),
        stepper=StewartTrinkle(step=STEP),
        duration=duration,
        output_interval=duration,
    ).wall_time_s


def _around(size: Size) -> Figure:
    """Checking, packing and unpacking: what a call costs beside its steps."""
    scene = grasp("seated")
    inside: list[float] = []

    def call() -> None:
        inside.append(simulate(scene, output_interval=scene.duration).wall_time_s)

    whole = seconds(call, size.calls)
    around = tuple(1e3 * (a - b) for a, b in zip(whole, inside[1:], strict=True))
    return Figure("around the steps of one call", "ms", around)


def _rescues(size: Size) -> list[Figure]:
    """How many steps of a rollout Newton does not solve at once, default stepper."""
    result = simulate_batch(
        grasp("seated"), random_sets(min(size.rollouts, 1000))
    )  # one scene was asked about
    return [
        Figure("steps of a seated grasp", "-", (float(np.mean(result.steps)),)),
        Figure("of which need a fallback", "-", (float(np.mean(result.fallbacks)),)),
    ]
