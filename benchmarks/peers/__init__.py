"""The same grasp by other engines, each at the largest step that is accurate enough for it."""

from __future__ import annotations

import time
from importlib import import_module
from typing import Any, NamedTuple, cast

from rich.console import Console

from benchmarks.accuracy import ANGLE_BAR, FINE, POSITION_BAR, apart, characteristic_length
from benchmarks.figures import Figure, Size, at_least, at_most, seconds
from benchmarks.peers.task import Peer, Task, slip_grasp
from benchmarks.report import console
from fixel.model import Scene
from fixel.simulation import Adaptive, Simulation, simulate
from fixel.simulation.stepper import AbstractStepper

PEERS = {
    "pymunk": "chipmunk",
    "Box2D": "box2d",
    "MuJoCo": "mujoco",
    "Drake": "drake",
    "Drake TAMSI": "drake_tamsi",
}
LADDER = (2e-2, 1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4)  # [s]
AHEAD = 100.0  # what the ratio to every peer must reach

Pose = tuple[float, float, float]


class Found(NamedTuple):
    """A setting of a peer at its largest accurate step."""

    variant: str
    step: float  # [s]
    limit: Pose  # its own finest answer
    run: tuple[float, ...]  # [s] a rollout
    build: tuple[float, ...]  # [s]


def run(size: Size) -> list[Figure]:
    """Time of each engine and its ratio to ours; building the world is not in it for either."""
    screen = console()
    scene, task = slip_grasp()
    ours = _fixel(scene, size)
    figures = [ours.time, ours.call, *ours.errors]
    for name, module in PEERS.items():
        try:
            peer = cast(Peer, import_module(f"benchmarks.peers.{module}"))
        except ImportError:
            screen.print(f"      {name}: not installed, skipped (make bench installs it)")
            continue
        figures += _beside(peer, task, ours, size, screen)
    return figures


class Ours(NamedTuple):
    time: Figure  # inside the loop, as for the peers
    call: Figure  # with packing and unpacking
    errors: list[Figure]
    limit: Pose


def _fixel(scene: Scene, size: Size) -> Ours:
    """The default stepper against its own converged answer."""
    inside: list[float] = []

    def once(stepper: AbstractStepper | None = None) -> Simulation:
        simulation = simulate(scene, stepper=stepper, output_interval=scene.duration)
        inside.append(1e3 * simulation.wall_time_s)
        return simulation

    pose = once().pose["object"][-1]
    fine = once(Adaptive(tolerance=FINE * characteristic_length(scene))).pose["object"][-1]
    inside.clear()
    whole = seconds(once, size.calls)
    distance, angle = apart(pose, fine)
    return Ours(
        Figure("fixel, slip grasp", "ms", tuple(inside[1:])),
        Figure("fixel, slip grasp, whole call", "ms", tuple(1e3 * s for s in whole)),
        [
            Figure("fixel, off its own limit", "mm", (float(distance),), at_most(POSITION_BAR)),
            Figure("fixel, off its own limit", "deg", (float(angle),), at_most(ANGLE_BAR)),
        ],
        (float(fine[0]), float(fine[1]), float(fine[2])),
    )


def _beside(peer: Peer, task: Task, ours: Ours, size: Size, screen: Console) -> list[Figure]:
    """The fastest accurate setting of one peer."""
    found = [
        one
        for variant, settings in peer.variants.items()
        if (one := _largest_step(peer, task, variant, settings, size, screen))
    ]
    title = f"{peer.name} {peer.version}"
    if not found:
        screen.print(f"      {title}: no step is within 0.1 mm and 0.1 deg of its finest answer")
        return []
    best = min(found, key=lambda one: min(one.run))
    distance, angle = apart(best.limit, ours.limit)
    label = f"{title}, {best.variant}, {1e3 * best.step:g} ms"
    ratios = tuple(1e3 * s / ours.time.median for s in best.run)
    whole = tuple(
        1e3 * (a + b) / ours.call.median for a, b in zip(best.run, best.build, strict=True)
    )
    return [
        Figure(label, "ms", tuple(1e3 * s for s in best.run)),
        Figure(f"{peer.name}, its limit off ours", "mm", (float(distance),)),
        Figure(f"{peer.name}, its limit off ours", "deg", (float(angle),)),
        Figure(f"{peer.name} over fixel", "x", ratios, at_least(AHEAD)),
        Figure(f"{peer.name} over fixel, with building", "x", whole, at_least(AHEAD)),
    ]


def _largest_step(
    peer: Peer, task: Task, variant: str, settings: dict[str, Any], size: Size, screen: Console
) -> Found | None:
    """The largest step from which all finer ones stay near the finest answer, and its time."""
    steps = [step for step in LADDER if step >= size.finest_peer_step * (1.0 - 1e-9)]
    ends = [peer.run(peer.build(task, step, **settings)) for step in steps]
    accurate = 0.0
    for step, end in zip(reversed(steps[:-1]), reversed(ends[:-1]), strict=True):
        distance, angle = apart(end, ends[-1])
        if not (distance <= POSITION_BAR and angle <= ANGLE_BAR):
            break
        accurate = step
    said = f"accurate from {1e3 * accurate:g} ms" if accurate else "never settles"
    screen.print(f"      {peer.name}, {variant}: {said}", highlight=False)
    if not accurate:
        return None
    times = [_timed(peer, task, accurate, settings) for _ in range(size.repeats)]
    build, run = zip(*times, strict=True)
    return Found(variant, accurate, ends[-1], run, build)


def _timed(peer: Peer, task: Task, step: float, settings: dict[str, Any]) -> tuple[float, float]:
    """Seconds to build a world, and to run it to the end."""
    start = time.perf_counter()
    world = peer.build(task, step, **settings)
    ready = time.perf_counter()
    peer.run(world)
    return ready - start, time.perf_counter() - ready
