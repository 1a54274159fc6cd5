"""The same grasp by other engines, each at the largest step that is accurate enough for it."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from rich.console import Console

from benchmarks.accuracy import ANGLE_BAR, FINE, POSITION_BAR, apart, characteristic_length
from benchmarks.figures import Figure, Size, at_least, at_most, seconds
from benchmarks.report import console
from fixel.errors import MissingExtra
from fixel.model import Scene
from fixel.simulation import Adaptive, Simulation, simulate
from fixel.simulation.engines import AbstractPhysicsEngine, PlainTask, engine_of
from fixel.simulation.engines.task import task_of
from fixel.simulation.stepping import AbstractStepper
from fixel.testing.scenes import grasp
from fixel.typing import FloatArray


class Peer(NamedTuple):
    """An engine, and choices worth trying; the fastest accurate one counts."""

    title: str
    engine: str
    variants: dict[str, str]


PEERS = (
    Peer("pymunk", "pymunk", {"10 iterations": "", "100 iterations": "iterations=100"}),
    Peer(
        "Box2D",
        "box2d",
        {"10 iterations": "", "50 iterations, finer unit": "iterations=50,unit=1000"},
    ),
    Peer("MuJoCo", "mujoco", {"as shipped": "", "stiffer": "timeconst=0.004,impratio=10"}),
    Peer(
        "Drake", "drake", {name: f"approximation={name}" for name in ("lagged", "similar", "sap")}
    ),
    # Its former solver, which releases announce to remove.
    Peer("Drake TAMSI", "drake", {"as shipped": "approximation=tamsi"}),
)
LADDER = (2e-2, 1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4)  # [s]
AHEAD = 100.0  # what the ratio to every peer must reach
SHORT = 1e-4  # [s] of a task that is hardly more than the building of its world


class Found(NamedTuple):
    """A setting of a peer at its largest accurate step."""

    variant: str
    step: float  # [s]
    limit: FloatArray  # (3,) its own finest answer
    run: tuple[float, ...]  # [s] a rollout
    whole: tuple[float, ...]  # [s] the same with building


def slip_grasp() -> Scene:
    """Return the grasp that a rigid drive can finish: the square slides past the pegs and turns."""
    return grasp("slip", force_limit=None)


def run(size: Size) -> list[Figure]:
    """Time of each engine and its ratio to ours; building the world is not in it for either."""
    screen = console()
    scene = slip_grasp()
    ours = _fixel(scene, size)
    task, _ = task_of(scene, np.array([scene.duration]), {}, {})
    figures = [ours.time, ours.call, *ours.errors]
    for peer in PEERS:
        try:
            figures += _compared(peer, task, ours, size, screen)
        except MissingExtra:
            screen.print(f"      {peer.title}: not installed, skipped (make bench installs it)")
    return figures


class Ours(NamedTuple):
    time: Figure  # inside the loop, as for the peers
    call: Figure  # with packing and unpacking
    errors: list[Figure]
    limit: FloatArray


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
        fine,
    )


def _compared(peer: Peer, task: PlainTask, ours: Ours, size: Size, screen: Console) -> list[Figure]:
    """The fastest accurate setting of one peer."""
    tried = [_largest_step(peer, variant, task, size, screen) for variant in peer.variants]
    found = [one for one in tried if one is not None]
    title = f"{peer.title} {engine_of(peer.engine).version}"
    if not found:
        screen.print(f"      {title}: no step is within 0.1 mm and 0.1 deg of its finest answer")
        return []
    best = min(found, key=lambda one: min(one.run))
    distance, angle = apart(best.limit, ours.limit)
    label = f"{title}, {best.variant}, {1e3 * best.step:g} ms"
    ratios = tuple(1e3 * s / ours.time.median for s in best.run)
    whole = tuple(1e3 * s / ours.call.median for s in best.whole)
    return [
        Figure(label, "ms", tuple(1e3 * s for s in best.run)),
        Figure(f"{peer.title}, its limit off ours", "mm", (float(distance),)),
        Figure(f"{peer.title}, its limit off ours", "deg", (float(angle),)),
        Figure(f"{peer.title} over fixel", "x", ratios, at_least(AHEAD)),
        Figure(f"{peer.title} over fixel, with building", "x", whole, at_least(AHEAD)),
    ]


def _largest_step(
    peer: Peer, variant: str, task: PlainTask, size: Size, screen: Console
) -> Found | None:
    """The largest step from which all finer ones stay near the finest answer, and its time."""
    steps = [step for step in LADDER if step >= size.finest_peer_step * (1.0 - 1e-9)]
    choices = peer.variants[variant]
    made = [engine_of(f"{peer.engine}:{choices},step={step!r}") for step in steps]
    ends = [own.answer(task)[-1] for own in made]
    chosen = None
    for k in reversed(range(len(steps) - 1)):
        distance, angle = apart(ends[k], ends[-1])
        if not (distance <= POSITION_BAR and angle <= ANGLE_BAR):
            break
        chosen = k
    said = "never settles" if chosen is None else f"accurate from {1e3 * steps[chosen]:g} ms"
    screen.print(f"      {peer.title}, {variant}: {said}", highlight=False)
    if chosen is None:
        return None
    times = [_timed(made[chosen], task) for _ in range(size.repeats)]
    inside, whole = zip(*times, strict=True)
    return Found(variant, steps[chosen], ends[-1], inside, whole)


def _timed(engine: AbstractPhysicsEngine, task: PlainTask) -> tuple[float, float]:
    """Seconds inside the loop and in all; the former by the difference to a very short task."""
    spent = []
    for own in (task._replace(times=np.array([SHORT])), task):
        start = time.perf_counter()
        engine.simulate(own)
        spent.append(time.perf_counter() - start)
    return spent[1] - spent[0], spent[1]
