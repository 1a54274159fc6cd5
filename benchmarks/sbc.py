"""Simulation-based calibration of posteriors: two pushes of a box, three unknowns."""

from __future__ import annotations

import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from typing import Final

import numpy as np

from benchmarks.figures import Figure, Size, at_least, at_most
from benchmarks.simulation_based_calibration import Ranks, calibrate_by_simulation
from fixel.calibration.noise import Noise
from fixel.calibration.objective import Comparer
from fixel.calibration.target import Target
from fixel.model import Tripod
from fixel.model.space import ParameterSpace, Unknown
from fixel.simulation import QuasiStatic, StewartTrinkle
from fixel.simulation.rollouts import RolloutCase
from fixel.testing.scenes import free_push, row
from fixel.typing import FloatArray
from fixel.uncertainty.error_terms import ModelError
from fixel.uncertainty.posterior import NestedSampling

DATA_SETS: Final = 300
NOISE: Final = Noise(position_m=3e-4, angle_rad=5e-3)
MODEL_ERROR: Final = ModelError(low=1e-4, high=5e-3)
LIVE: Final = 150
SAMPLES: Final = 400
PROCESSES: Final = 2
FRAMES: Final[FloatArray] = 0.5 * np.arange(1.0, 11.0)  # [s]
# y and angle of the box where the finger meets it: left and right of its middle.
STARTS: Final = ((0.015, 0.1), (-0.02, -0.05))


def run(size: Size) -> list[Figure]:
    """Ranks of 300 truths: how even they are, and how many lie in the 95 % intervals."""
    n = DATA_SETS if size.rollouts >= 500 else 20  # the fewest for a test of evenness
    begun = time.perf_counter()
    found = ranks(n)
    figures = [Figure(f"posterior, SBC, {n} data sets", "s", (time.perf_counter() - begun,))]
    for label, p, held in zip(found.labels, found.uniformity, found.coverage, strict=True):
        figures += [
            Figure(f"posterior, SBC, uniformity of {label}", "-", (float(p),), at_least(0.01)),
            Figure(f"posterior, SBC, 95 % held, {label}", "-", (float(held),), at_least(0.92)),
            Figure(f"posterior, SBC, 95 % held, {label}", "-", (float(held),), at_most(0.98)),
        ]
    return figures


def ranks(data_sets: int, processes: int = PROCESSES) -> Ranks:
    """Of truths drawn from the prior."""
    each = -(-data_sets // processes)
    parts = [(k, min(each, data_sets - k)) for k in range(0, data_sets, each)]
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        found = list(pool.map(some_ranks, parts))
    return Ranks(
        found[0].labels,
        np.concatenate([part.truths for part in found]),
        np.concatenate([part.ranks for part in found]),
    )


def some_ranks(part: tuple[int, int]) -> Ranks:
    """Of some data sets: number of the first, and how many."""
    first, count = part
    return calibrate_by_simulation(
        pushes(),
        NOISE,
        MODEL_ERROR,
        count,
        first=first,
        sampling=NestedSampling(samples=SAMPLES, live=LIVE),
        threads=1,
    )


def pushes() -> Comparer:
    """Two pushes of a box on three points by a round finger, seen ten times each."""
    targets = [_push(k, y, angle) for k, (y, angle) in enumerate(STARTS)]
    space = ParameterSpace(
        unknowns=(
            Unknown(name="mu_pusher", low=0.0, high=1.0, nominal=0.3),
            Unknown(name="tripod_radius", low=0.01, high=0.06, nominal=0.04),
        )
    )
    return Comparer(
        targets, space, motion=QuasiStatic(), stepper=StewartTrinkle(step=0.25), threads=1
    )


def _push(number: int, y: float, angle: float) -> Target:
    scene = free_push(Tripod(radius=0.04, friction=0.3), friction=0.3)
    body = replace(scene.bodies[0], pose=row(0.062, y, angle))
    scene = replace(scene, bodies=(body,), duration=float(FRAMES[-1]))
    return Target(f"sbc/{number}", {}, RolloutCase(scene, FRAMES), np.zeros((len(FRAMES), 3)))
