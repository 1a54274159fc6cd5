"""Accuracy of the default stepper over grasps of varied layouts, shapes, offsets and poses.

``python -m benchmarks varied``. Every scene is simulated with two fixed-step steppers, at a step
far finer than anybody would use, and again with the start moved by a micrometre each way. Where
these five answers agree, the scene is insensitive, and the default stepper has no excuse. Every
other scene is printed. Adaptive steps at a tolerance of 1e-9 are judged too; they decide nothing.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from benchmarks.accuracy import ANGLE_BAR, POSITION_BAR, apart, characteristic_length
from benchmarks.figures import Figure, Size, at_least
from fixel.model import (
    Body,
    Disk,
    Fixel,
    LineDrive,
    Polygon,
    Pusher,
    Scene,
    Shape,
    Support,
    SupportPoints,
    Tripod,
    UniformPressure,
)
from fixel.simulation import Adaptive, Dynamic, Midpoint, QuasiStatic, StewartTrinkle, simulate
from fixel.simulation.motion import AbstractMotionModel
from fixel.simulation.stepping import AbstractStepper
from fixel.testing.scenes import FIXEL_RADIUS, STALL_FORCE, box, row
from fixel.typing import FloatArray

SEED = 20_261_122
STEPS = 20_000  # of the two references: 5 um of the pusher's way each
NUDGE = 1e-6  # [m] by which starts are moved
AGREED = 0.5  # of the bar: references further apart than this make a scene sensitive
FINEST = 1e-9  # tolerance of the other adaptive answer, in characteristic lengths
MOTIONS: tuple[AbstractMotionModel, ...] = (Dynamic(), QuasiStatic())


class Answer(NamedTuple):
    """Final poses of one scene by every method, (3,) each [m, m, rad]; NaN where it stopped."""

    references: FloatArray  # (2, 3)
    nudged: FloatArray  # (3, 3) starts moved along x, y and turned
    default: FloatArray
    finest: FloatArray  # at a tolerance of 1e-9

    @property
    def spread(self) -> float:
        """Largest distance of a reference from the first, as a multiple of the bar."""
        return max(_bars(pose, self.references[0]) for pose in (*self.references, *self.nudged))

    @property
    def is_insensitive(self) -> bool:
        """Whether references and moved starts agree."""
        return self.spread <= AGREED

    @property
    def errors(self) -> tuple[float, float]:
        """Distance of default and finest steps from the two references, as multiples of the bar."""
        middle = self.references.mean(axis=0)
        return _bars(self.default, middle), _bars(self.finest, middle)


def _bars(one: FloatArray, other: FloatArray) -> float:
    distance, angle = apart(one, other)
    worst = max(float(distance) / POSITION_BAR, float(angle) / ANGLE_BAR)
    return worst if np.isfinite(worst) else np.inf


def varied_grasp(seed: int) -> Scene:
    """Return a random grasp: a part, a head, two to four pegs, none of them overlapping."""
    rng = np.random.default_rng([SEED, seed])
    shape, size = _part(rng)
    head, reach = _head(rng)
    part = Body(
        name="object",
        shape=shape,
        mass=float(rng.uniform(0.05, 0.4)),
        pose=row(
            reach + size + rng.uniform(0.002, 0.02),
            rng.uniform(-0.3, 0.3) * size,
            rng.uniform(-np.pi, np.pi),
        ),
        support=_support(rng, size),
    )
    pegs: list[Fixel] = []
    friction = float(rng.uniform(0.1, 0.25))
    for _ in range(int(rng.integers(2, 5))):
        x = part.pose[0] + size + FIXEL_RADIUS + rng.uniform(0.005, 0.06)
        y = rng.uniform(-1.0, 1.0) * size
        if all(np.hypot(x - p.pose[0], y - p.pose[1]) > 0.015 for p in pegs):
            name = f"fixel-{len(pegs) + 1}"
            pegs.append(
                Fixel(name=name, shape=Disk(FIXEL_RADIUS), pose=row(x, y, 0.0), friction=friction)
            )
    speed = float(rng.uniform(0.005, 0.03))
    travel = float(rng.uniform(0.08, 0.15))
    drive = LineDrive(direction=row(1.0, 0.0), speed=speed, travel=travel, force_limit=STALL_FORCE)
    pusher = Pusher(
        name="actuator",
        shape=head,
        pose=row(0.0, 0.0, 0.0),
        drive=drive,
        friction=float(rng.uniform(0.1, 0.4)),
    )
    return Scene(
        bodies=(part,), pushers=(pusher,), fixels=tuple(pegs), duration=travel / speed + 0.5
    )


def _part(rng: np.random.Generator) -> tuple[Shape, float]:
    """Return a shape and the radius of the circle around it [m]."""
    kind = rng.choice(["square", "rectangle", "regular", "irregular", "corner"])
    size = float(rng.uniform(0.04, 0.08))
    if kind == "square":
        return box(np.sqrt(2.0) * size, np.sqrt(2.0) * size), size
    if kind == "rectangle":
        angle = rng.uniform(0.4, 0.75)
        return box(2.0 * size * np.cos(angle), 2.0 * size * np.sin(angle)), size
    if kind == "corner":
        a, b = 1.2 * size, 0.5 * size
        outline = np.array([[0, 0], [a, 0], [a, b], [b, b], [b, a], [0, a]]) - 0.42 * size
        return Polygon(outline), float(np.hypot(*outline.T).max())
    n = int(rng.integers(3, 8))
    angles = 2.0 * np.pi * np.arange(n) / n
    if kind == "irregular":
        angles = angles + rng.uniform(-0.25, 0.25, n)
    return Polygon(size * np.stack([np.cos(angles), np.sin(angles)], axis=1)), size


def _head(rng: np.random.Generator) -> tuple[Shape, float]:
    """Return a shape and how far it reaches ahead [m]."""
    if rng.random() < 0.3:
        radius = float(rng.uniform(0.005, 0.015))
        return Disk(radius), radius
    depth = 0.029
    return box(depth, float(rng.uniform(0.02, 0.06))), 0.5 * depth


def _support(rng: np.random.Generator, size: float) -> Support:
    friction = float(rng.uniform(0.15, 0.35))
    kind = rng.choice(["tripod", "tripod", "points", "uniform"])
    if kind == "tripod":
        radius = float(rng.uniform(0.3, 0.6)) * size
        return Tripod(radius=radius, friction=friction, angle=float(rng.uniform(-3.0, 3.0)))
    if kind == "points":
        angles = np.array([0.3, 2.4, 4.3]) + rng.uniform(-0.4, 0.4, 3)
        reach = 0.5 * size * rng.uniform(0.7, 1.0, 3)
        points = reach[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return SupportPoints(points=points, friction=friction)
    return UniformPressure(friction=friction, n_points=16)


def final(
    scene: Scene, motion: AbstractMotionModel, stepper: AbstractStepper | None = None
) -> tuple[FloatArray, str]:
    """Return the final pose of the object, NaN unless the simulation converged, and its status."""
    run = simulate(scene, motion=motion, stepper=stepper, output_interval=scene.duration)
    return (run.pose["object"][-1] if run.converged else np.full(3, np.nan)), run.status


def nudged(scene: Scene) -> Iterator[Scene]:
    """Yield the scene with its part moved by a micrometre along x, along y, and turned as far."""
    part = scene.bodies[0]
    arm = np.sqrt(part.moment_of_inertia / part.mass)
    for shift in np.diag([NUDGE, NUDGE, NUDGE / arm]):
        yield replace(scene, bodies=(replace(part, pose=part.pose + shift),))


def references(scene: Scene, motion: AbstractMotionModel) -> tuple[FloatArray, FloatArray]:
    """Final poses by two fixed-step steppers, and of the moved starts."""
    step = scene.duration / STEPS
    fixed = (Midpoint(step=step), StewartTrinkle(step=0.7 * step))
    own = np.stack([final(scene, motion, stepper)[0] for stepper in fixed])
    moved = np.stack([final(other, motion, fixed[0])[0] for other in nudged(scene)])
    return own, moved


def answer(scene: Scene, motion: AbstractMotionModel) -> Answer:
    """Return the final poses of a scene by every method."""
    finest = Adaptive(tolerance=FINEST * characteristic_length(scene))
    own = [final(scene, motion, stepper)[0] for stepper in (None, finest)]
    return Answer(*references(scene, motion), *own)


def run(size: Size) -> list[Figure]:
    """Share of insensitive scenes, and of them that the default stepper gets right; the worst."""
    figures = []
    n = min(400, max(4, size.rollouts // 25))
    scenes = [varied_grasp(seed) for seed in range(n)]
    for motion in MOTIONS:
        name = f"varied grasps, {motion.name}"
        found = [answer(scene, motion) for scene in scenes]
        calm = np.array([one.is_insensitive for one in found])
        errors = np.array([one.errors for one in found])
        for k in np.flatnonzero(~calm | (errors[:, 0] > 1.0)):
            print(
                f"      {name}, scene {k}: references {found[k].spread:.3g} bars apart, default "
                f"{errors[k, 0]:.3g} bars off, at 1e-9 {errors[k, 1]:.3g}",
                flush=True,
            )
        start = time.process_time()
        for scene in scenes:
            final(scene, motion)
        spent = 1e3 * (time.process_time() - start) / n
        right = f"{name}, within 0.1 mm and 0.1 deg"
        share = 100.0 * np.mean(errors <= 1.0, axis=0)
        of_calm = 100.0 * np.mean(errors[calm] <= 1.0, axis=0)
        worst = np.max(errors[calm], axis=0, initial=0.0) * POSITION_BAR
        figures += [
            Figure(f"{name}, insensitive", "%", (100.0 * float(calm.mean()),), at_least(85.0)),
            Figure(f"{right}, insensitive", "%", (float(of_calm[0]),), at_least(97.0)),
            Figure(f"{right}, insensitive, at 1e-9", "%", (float(of_calm[1]),)),
            Figure(f"{right}, all", "%", (float(share[0]),)),
            Figure(f"{name}, worst insensitive", "mm or deg", (float(worst[0]),)),
            Figure(f"{name}, worst insensitive, at 1e-9", "mm or deg", (float(worst[1]),)),
            Figure(f"{name}, CPU time of one", "ms", (spent,)),
        ]
    return figures
