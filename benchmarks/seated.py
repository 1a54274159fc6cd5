"""Random grasps and pushes, with tools and supports of every kind: how many are wrong, or flagged.

``python -m benchmarks seated``. New scenes, both motion models. Every default answer is compared
with fixed steps of a millisecond. Those that differ are suspects and are simulated again with both
fixed-step steppers at a tenth of a millisecond, which share no decision with the adaptive one.
A wrong answer is silent if its `accuracy` is not uncertain.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from benchmarks.accuracy import apart
from benchmarks.figures import Figure, Size, at_most
from benchmarks.varied import MOTIONS, final
from fixel.model import (
    Body,
    Disk,
    Ellipsoid,
    Fixel,
    LineDrive,
    Polygon,
    Pusher,
    Scene,
    SupportPoints,
    Tripod,
    UniformPressure,
)
from fixel.simulation import Midpoint, Simulation, StewartTrinkle, simulate
from fixel.simulation.motion import AbstractMotionModel
from fixel.testing.scenes import FIXEL_RADIUS, STALL_FORCE, box, row
from fixel.typing import FloatArray

SEED = 20_261_124
HEAD = 0.029  # [m]
GRAVITY = 9.81  # [m/s^2]
STEP = 1e-3  # [s] of the fixed steps that find suspects
SMALL_STEP = 1e-4  # [s] of those that judge them
SUSPECT = 0.25  # [mm] or [deg]: a default answer this far from the first is a suspect
OFF = 0.5  # [mm] or [deg]: a suspect this far from both others is wrong
REPORTED = 500  # grasps between two lines of progress


def _drive(travel: float) -> LineDrive:
    return LineDrive(direction=row(1.0, 0.0), speed=0.0135, travel=travel, force_limit=STALL_FORCE)


def seated_grasp(seed: int) -> Scene:
    """Return a random part of three to six sides that a flat head pushes between three pegs."""
    rng = np.random.default_rng([SEED, seed])
    n = int(rng.integers(3, 7))
    size = float(rng.uniform(0.045, 0.08))
    angles = 2.0 * math.pi * np.arange(n) / n
    start = 0.5 * HEAD + size + rng.uniform(0.002, 0.02)
    part = Body(
        name="object",
        shape=Polygon(size * np.stack([np.cos(angles), np.sin(angles)], axis=1)),
        mass=float(rng.uniform(0.05, 0.3)),
        pose=row(start, rng.uniform(-0.03, 0.03), rng.uniform(0.0, 2.0 * math.pi / n)),
        support=Tripod(radius=float(rng.uniform(0.2, 0.8)) * size, friction=rng.uniform(0.1, 0.6)),
    )
    # One peg ahead, one on either side of it, nearer to the part.
    depth = rng.uniform(0.0, 0.07, 2)
    ahead = start + size + FIXEL_RADIUS + 0.005 + max(depth) + rng.uniform(0.0, 0.03)
    places = (
        (ahead, rng.uniform(-0.015, 0.015)),
        (ahead - depth[0], rng.uniform(0.03, 0.08)),
        (ahead - depth[1], -rng.uniform(0.03, 0.08)),
    )
    friction = float(rng.uniform(0.0, 0.6))
    pegs = [
        Fixel(
            name=f"fixel-{k + 1}", shape=Disk(FIXEL_RADIUS), pose=row(x, y, 0.0), friction=friction
        )
        for k, (x, y) in enumerate(places)
    ]
    pusher = Pusher(
        name="actuator",
        shape=box(HEAD, HEAD),
        pose=row(0.0, 0.0, 0.0),
        drive=_drive(0.15),
        friction=float(rng.uniform(0.0, 0.6)),
    )
    return Scene(bodies=(part,), pushers=(pusher,), fixels=tuple(pegs), duration=11.5)


def free_push(seed: int) -> Scene:
    """Return a push of such a part without pegs, by a flat head, a disk or a corner, on three
    points, four points, even pressure or an ellipsoid."""
    rng = np.random.default_rng([SEED, 1, seed])
    grasp = seated_grasp(seed)
    part, pusher = grasp.bodies[0], grasp.pushers[0]
    corner = Polygon(HEAD * np.array([[-0.5, -0.3], [0.5, 0.0], [-0.5, 0.3]]))
    tools = (pusher.shape, Disk(float(rng.uniform(0.002, 0.01))), corner)
    friction = float(rng.uniform(0.1, 0.6))
    limit = friction * part.mass * GRAVITY
    wide = float(rng.uniform(0.01, 0.04))
    corners = wide * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    supports = (
        part.support,
        SupportPoints(points=corners * rng.uniform(0.5, 1.0, (4, 1)), friction=friction),
        UniformPressure(friction=friction, n_points=16),
        Ellipsoid(force=limit, torque=limit * wide),
    )
    return replace(
        grasp,
        bodies=(replace(part, support=supports[seed % 4]),),
        pushers=(
            replace(
                pusher,
                shape=tools[seed // 4 % 3],
                pose=row(0.0, rng.uniform(-0.03, 0.03), 0.0),
                drive=_drive(0.06),
            ),
        ),
        fixels=(),
        duration=5.0,
    )


SCENES = {"seated grasps": seated_grasp, "free pushes": free_push}


def _apart(one: FloatArray, other: FloatArray) -> float:
    """Distance of two poses [mm or deg]; infinite where there is none."""
    worst = float(max(apart(one, other)))
    return worst if math.isfinite(worst) else math.inf


def _suspects(
    kind: str, n: int, motion: AbstractMotionModel, verdicts: Counter[str]
) -> Iterator[tuple[int, FloatArray, Simulation]]:
    """Yield seed, last pose and default answer of the scenes to be judged; counts verdicts of
    all."""
    for seed in range(n):
        scene = SCENES[kind](seed)
        push = simulate(scene, motion=motion, accuracy=True)
        assert push.accuracy is not None
        verdicts[push.accuracy.verdict] += 1
        pose = np.array(push.final["object"])
        coarse, _ = final(scene, motion, StewartTrinkle(step=STEP))
        if not push.converged or _apart(pose, coarse) > SUSPECT:
            yield seed, pose, push
        if (seed + 1) % REPORTED == 0:
            print(f"      {motion.name}: {seed + 1} of {n} {kind}", flush=True)


def run(size: Size) -> list[Figure]:
    """Numbers of scenes that are wrong, undecided or stopped early, and the worst, of each motion
    model."""
    figures = []
    n = max(4, size.rollouts // 2)
    for motion, kind in product(MOTIONS, SCENES):
        name = f"{n} {kind}, {motion.name}"
        wrong: list[float] = []
        undecided = stopped = suspects = silent = 0
        verdicts: Counter[str] = Counter()
        for seed, pose, push in _suspects(kind, n, motion, verdicts):
            suspects += 1
            if not push.converged:
                stopped += 1
                print(f"      {name}, seed {seed}: {push.status}", flush=True)
                continue
            scene = SCENES[kind](seed)
            judges = [
                final(scene, motion, stepper(step=SMALL_STEP))
                for stepper in (StewartTrinkle, Midpoint)
            ]
            error = min(_apart(pose, judge) for judge, _ in judges)
            if error <= OFF:
                continue
            ended = " and ".join(judge for _, judge in judges)
            between = _apart(judges[0][0], judges[1][0])
            print(
                f"      {name}, seed {seed}: off by {error:.3g} mm or deg; the fixed steps "
                f"({ended}) are {between:.3g} apart; {push.accuracy}",
                flush=True,
            )
            flagged = push.accuracy is not None and push.accuracy.verdict == "uncertain"
            silent += not flagged
            if between <= SUSPECT:
                wrong.append(error)
            else:
                undecided += 1
        figures += [
            Figure(
                f"{name}, off by more than 0.5 mm or deg", "-", (float(len(wrong)),), at_most(0.0)
            ),
            Figure(f"{name}, off and not flagged", "-", (float(silent),), at_most(0.0)),
            Figure(
                f"{name}, flagged",
                "%",
                (100.0 * verdicts["uncertain"] / n,),
                at_most(2.0),
            ),
            *[
                Figure(f"{name}, {verdict}", "%", (100.0 * verdicts[verdict] / n,))
                for verdict in ("certified", "agreed")
            ],
            Figure(f"{name}, worst of those", "mm or deg", (max(wrong, default=0.0),)),
            Figure(f"{name}, stopped early", "-", (float(stopped),), at_most(0.0)),
            Figure(f"{name}, off, but fixed steps differ", "-", (float(undecided),)),
            Figure(f"{name}, suspects judged", "-", (float(suspects),)),
        ]
    return figures
