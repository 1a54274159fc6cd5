"""Ten thousand rollouts at once: grasps and free pushes with random parameters."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.accuracy import PUSH_RANGES, apart, converged_batch, random_sets, share_within
from benchmarks.figures import Bar, Figure, Size, at_least, at_most, seconds
from fixel.model import Scene
from fixel.simulation import BatchResult, QuasiStatic, StewartTrinkle, simulate_batch
from fixel.simulation.ensemble import Ensemble
from fixel.simulation.motion import AbstractMotionModel, Dynamic
from fixel.simulation.rollouts import RolloutCase, Rollouts, ensemble_of
from fixel.testing.scenes import Layout, grasp, micro_push
from fixel.typing import FloatArray

SECOND_STEP = 1e-4  # [s] of the stepper that the converged answer is checked with
MAGNIFIED = 100.0  # the part of the free push is a hundredth of the testbed's square


def run_grasps(size: Size) -> list[Figure]:
    """Both layouts, force-limited drive, default stepper."""
    return [*_grasps("seated", size), *_grasps("slip", size)]


def run_pushes(size: Size) -> list[Figure]:
    """The free push of the ASME 2006 paper, 700 um, quasi-static."""
    sets = random_sets(size.rollouts, PUSH_RANGES)
    scene = micro_push(test=2)
    motion = QuasiStatic()
    reference = converged_batch(scene, sets, motion, fineness=1e-6)
    return [
        *_throughput("free push", scene, sets, motion, size, at_least(5000.0)),
        _share("free push", scene, sets, motion, reference, MAGNIFIED),
    ]


def run_contract(size: Size) -> list[Figure]:
    """Grasps by `ensemble_of`, which chooses the engine, over the same by `Ensemble`, in turn."""
    scene = grasp("slip")
    cases = [RolloutCase(scene, np.array([scene.duration]))]
    sets = random_sets(64)
    ratios = []
    for repeat in range(10 * size.repeats):
        chosen, own = (
            seconds(partial(_simulated, made, cases, sets), 1, repeat == 0)[0]
            for made in (ensemble_of, Ensemble)
        )
        ratios.append(chosen / own)
    ratio = float(np.median(ratios))
    return [Figure("64 slip grasps through the contract of engines", "x", (ratio,), at_most(1.05))]


def _simulated(
    made: Callable[..., Rollouts], cases: list[RolloutCase], sets: dict[str, FloatArray]
) -> None:
    made(cases, Dynamic()).simulate(np.zeros(64, np.int64), sets)


def _grasps(layout: Layout, size: Size) -> list[Figure]:
    sets = random_sets(size.rollouts)
    scene = grasp(layout)
    reference = converged_batch(scene, sets)
    name = f"{layout} grasps"
    return [
        *_throughput(name, scene, sets, None, size, at_least(12000.0)),
        _share(name, scene, sets, None, reference),
        *_check(name, scene, sets, reference, size),
    ]


def _throughput(
    name: str,
    scene: Scene,
    sets: dict[str, FloatArray],
    motion: AbstractMotionModel | None,
    size: Size,
    bar: Bar,
) -> list[Figure]:
    """Rollouts a second on two threads, and how many times those of one thread that is.

    The two are timed in turn, so that a machine that slows down slows both.
    """
    call = partial(simulate_batch, scene, sets, motion=motion)
    one: list[float] = []
    two: list[float] = []
    for repeat in range(size.repeats):
        one += seconds(lambda: call(threads=1), 1, warm_up=repeat == 0)
        two += seconds(lambda: call(threads=2), 1, warm_up=repeat == 0)
    rates = tuple(size.rollouts / s for s in two)
    gains = tuple(a / b for a, b in zip(one, two, strict=True))
    return [
        Figure(f"{name}, two cores", "rollouts/s", rates, bar),
        Figure(f"{name}, two threads over one", "x", gains, at_least(1.9)),
    ]


def _share(
    name: str,
    scene: Scene,
    sets: dict[str, FloatArray],
    motion: AbstractMotionModel | None,
    reference: BatchResult,
    magnified: float = 1.0,
) -> Figure:
    result = simulate_batch(scene, sets, motion=motion)
    share = 100.0 * share_within(result, reference, magnified)
    return Figure(f"{name}, within 0.1 mm and 0.1 deg", "%", (share,), at_least(95.0))


def _check(
    name: str, scene: Scene, sets: dict[str, FloatArray], reference: BatchResult, size: Size
) -> list[Figure]:
    """Whether the converged answer is one: a stepper of another kind, at a tiny step, agrees."""
    few = {key: column[: size.subset] for key, column in sets.items()}
    other = simulate_batch(scene, few, stepper=StewartTrinkle(step=SECOND_STEP))
    distance, angle = apart(other.final[:, 0], reference.final[: size.subset, 0])
    off = np.maximum(distance, angle)
    off[~(other.converged & reference.converged[: size.subset])] = np.inf
    return [
        Figure(f"{name}, two references apart, median", "mm or deg", (float(np.median(off)),)),
        Figure(
            f"{name}, two references within 0.1",
            "%",
            (100.0 * float(np.mean(off <= 0.1)),),
            at_least(95.0),
        ),
    ]
