"""Cost of the steps of a grasp, by phase, and what corners and support points add to it."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from benchmarks.accuracy import random_sets
from benchmarks.figures import Figure, Size, at_most, seconds
from fixel.model import Body, Polygon, Scene, UniformPressure
from fixel.simulation import StewartTrinkle, simulate, simulate_batch
from fixel.simulation.stepping import AbstractStepper
from fixel.testing.scenes import grasp, pushed_square

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
    """Checking, packing and unpacking: what a call costs in addition to its steps."""
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


def run_corners(size: Size) -> list[Figure]:
    """Time per step of a disc of 64 corners, and of a push of a traced outline, over a square's."""
    return [
        _over("step of 64 corners over 4, grasp", size, 3.0, [_grasped(n) for n in (4, 64)]),
        _over("step of 64 corners over 4, finger alike", size, 3.0, [_pushed(n) for n in (4, 64)]),
        _over("push of a traced outline over a square's", size, 5.0, _traced(), per_step=False),
    ]


def run_points(size: Size) -> list[Figure]:
    """Time of a grasp on 64 points of even pressure over that on a tripod."""
    square = grasp("seated")
    even = _with_part(square, support=UniformPressure(friction=0.25, n_points=64))
    fixed = StewartTrinkle(step=STEP)
    return [
        _over("grasp on 64 points over 3", size, 1.7, [square, even], per_step=False),
        _over("fixed step on 64 points over 3", size, 1.7, [square, even], fixed),
    ]


def _grasped(corners: int) -> Scene:
    return _with_part(grasp("seated"), shape=Polygon.regular(corners, 0.0607))


def _pushed(corners: int) -> Scene:
    scene = pushed_square()
    finger = replace(scene.pushers[0], shape=Polygon.regular(corners, 0.005))
    away = scene.bodies[0].pose + np.array([0.012, 0.0, 0.0])
    part = _with_part(scene, shape=Polygon.regular(corners, 0.0607), pose=away)
    return replace(part, pushers=(finger,))


def _traced() -> list[Scene]:
    """A square, and a smooth outline of 508 corners with two hollows, both on even pressure."""
    angle = np.arange(508) * (2.0 * np.pi / 508)
    radius = 0.05 * (1.0 + 0.3 * np.cos(2.0 * angle) + 0.1 * np.cos(4.0 * angle))
    corners = radius[:, None] * np.column_stack((np.cos(angle), np.sin(angle)))
    even = UniformPressure(friction=0.25)
    scene = _with_part(pushed_square(), support=even)
    away = np.array([0.02, 0.0, 0.0])
    return [scene, _with_part(scene, shape=Polygon(corners), pose=away)]


def _with_part(scene: Scene, **changes: object) -> Scene:
    part: Body = replace(scene.bodies[0], **changes)  # type: ignore[arg-type]
    return replace(scene, bodies=(part,))


def _over(
    name: str,
    size: Size,
    bar: float,
    scenes: list[Scene],
    stepper: AbstractStepper | None = None,
    per_step: bool = True,
) -> Figure:
    """Processor time of the second scene, in all or per step, over that of the first, called in
    turn."""
    ratios = []
    for _ in range(size.calls + 1):
        cost = []
        for scene in scenes:
            values = random_sets(8)
            own = {"mu_pusher": values["mu_pusher"]}
            before = time.process_time()
            result = simulate_batch(scene, own, stepper=stepper, threads=1)
            taken = time.process_time() - before
            cost.append(taken / float(np.sum(result.steps)) if per_step else taken)
        ratios.append(cost[1] / cost[0])
    return Figure(name, "x", tuple(ratios[1:]), at_most(bar))
