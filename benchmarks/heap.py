"""Many bodies: a square heap on the plane, swept together by a bar."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from benchmarks.figures import Bar, Figure, Size, at_least, at_most, seconds
from fixel.model import Body, Disk, LineDrive, PairFriction, Pusher, Scene, Tripod
from fixel.simulation import Simulation, StewartTrinkle, simulate
from fixel.simulation.stepping import AbstractStepper
from fixel.testing.scenes import box

PITCH = 0.05  # [m]
SPEED = 0.03  # [m/s]
STEP = 0.02  # [s]
RESIDUAL = 1e-9  # scaled, what every step must reach
BARS = {100: at_most(6.0), 300: at_most(40.0)}  # [s]
EXPONENT = 1.6


def swept_heap(n: int, duration: float) -> Scene:
    """``n`` blocks and disks in a rectangle as square as possible, and a bar as wide as it."""
    rows = next(k for k in range(math.isqrt(n), 0, -1) if n % k == 0)
    columns = n // rows
    bodies = tuple(_body(row, column, columns) for row in range(rows) for column in range(columns))
    bar = Pusher(
        name="bar",
        shape=box(0.01, columns * PITCH),
        pose=np.array([-0.03, 0.0, 0.0]),
        drive=LineDrive(direction=np.array([1.0, 0.0]), speed=SPEED),
        friction=0.3,
    )
    return Scene(
        bodies=bodies,
        pushers=(bar,),
        contact_friction=(PairFriction(pair=("body-*", "body-*"), friction=0.3),),
        duration=duration,
    )


def _body(row: int, column: int, columns: int) -> Body:
    k = row * columns + column
    y = PITCH * (column - 0.5 * (columns - 1))
    return Body(
        name=f"body-{k + 1}",
        shape=Disk(0.018) if k % 3 == 2 else box(0.036, 0.026),
        mass=0.05,
        pose=np.array([PITCH * row, y + 0.003 * (row % 2), 0.07 * k]),
        support=Tripod(radius=0.01, friction=0.3, angle=0.4 * k),
    )


def run(size: Size) -> list[Figure]:
    """Wall time of ten simulated seconds at a fixed step and as they come, how it grows with the
    number of bodies, and the worst step."""
    n = size.heaps[len(size.heaps) // 2]
    fixed = _swept(n, size, "20 ms steps", StewartTrinkle(step=STEP), at_most(size.heap_seconds))
    free = [_swept(n, size, "default stepper", None, BARS.get(n)) for n in size.heaps]
    growth = math.log(free[-1][0].median / free[0][0].median)
    exponent = growth / math.log(size.heaps[-1] / size.heaps[0])
    name = f"heaps of {size.heaps[0]} to {size.heaps[-1]}, exponent of time"
    figures = [*fixed, *(figure for each in free for figure in each)]
    return [*figures, Figure(name, "-", (exponent,), at_most(EXPONENT))]


def _swept(
    n: int, size: Size, how: str, stepper: AbstractStepper | None, bar: Bar | None
) -> list[Figure]:
    name = f"heap of {n}, {size.heap_seconds:g} s, {how}"
    scene = swept_heap(n, size.heap_seconds)
    simulate(replace(scene, duration=1e-3), stepper=stepper, output_interval=1e-3)
    last: list[Simulation] = []

    def call() -> None:
        last.append(simulate(scene, stepper=stepper, output_interval=scene.duration))

    taken = seconds(call, 1, warm_up=False)
    if taken[0] <= size.heap_seconds:
        taken += seconds(call, min(size.repeats, 3) - 1, warm_up=False)
    worst = max(one.max_residual for one in last)
    reached = last[-1].duration
    return [
        Figure(name, "s", taken, bar),
        Figure(f"{name}, simulated time reached", "s", (reached,), at_least(size.heap_seconds)),
        Figure(f"{name}, worst residual", "-", (worst,), at_most(RESIDUAL)),
        Figure(f"{name}, steps", "-", (float(last[-1].steps),)),
        Figure(f"{name}, fallbacks", "-", (float(last[-1].fallbacks),)),
    ]
