"""Random grasps that end seated, stalled or beside their pegs: how many are wrong, or flagged.

``python -m benchmarks seated``. New grasps, both motion models. Every default answer is compared
with fixed steps of a millisecond. Those that differ are suspects and are simulated again with both
fixed-step steppers at a tenth of a millisecond, which share no decision with the adaptive one.
A wrong answer is silent if its `accuracy` is not uncertain.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator

import numpy as np

from benchmarks.accuracy import apart
from benchmarks.figures import Figure, Size, at_most
from benchmarks.varied import MOTIONS, final
from fixel.model import Body, Disk, Fixel, LineDrive, Polygon, Pusher, Scene, Tripod
from fixel.simulation import Midpoint, Simulation, StewartTrinkle, simulate
from fixel.simulation.motion import AbstractMotionModel
from fixel.testing.scenes import FIXEL_RADIUS, STALL_FORCE, box, row
from fixel.typing import FloatArray

SEED = 20_261_124
HEAD = 0.029  # [m]
STEP = 1e-3  # [s] of the fixed steps that find suspects
SMALL_STEP = 1e-4  # [s] of those that judge them
SUSPECT = 0.25  # [mm] or [deg]: a default answer this far from the first is a suspect
OFF = 0.5  # [mm] or [deg]: a suspect this far from both others is wrong
REPORTED = 500  # grasps between two lines of progress


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
    speed, travel = 0.0135, 0.15
    drive = LineDrive(direction=row(1.0, 0.0), speed=speed, travel=travel, force_limit=STALL_FORCE)
    pusher = Pusher(
        name="actuator",
        shape=box(HEAD, HEAD),
        pose=row(0.0, 0.0, 0.0),
        drive=drive,
        friction=float(rng.uniform(0.0, 0.6)),
    )
    return Scene(bodies=(part,), pushers=(pusher,), fixels=tuple(pegs), duration=11.5)


def _apart(one: FloatArray, other: FloatArray) -> float:
    """Distance of two poses [mm or deg]; infinite where there is none."""
    worst = float(max(apart(one, other)))
    return worst if math.isfinite(worst) else math.inf


def _suspects(
    n: int, motion: AbstractMotionModel, verdicts: Counter[str]
) -> Iterator[tuple[int, FloatArray, Simulation]]:
    """Yield seed, last pose and default answer of the grasps to be judged; counts verdicts of
    all."""
    for seed in range(n):
        scene = seated_grasp(seed)
        push = simulate(scene, motion=motion, accuracy=True)
        assert push.accuracy is not None
        verdicts[push.accuracy.verdict] += 1
        pose = np.array(push.final["object"])
        coarse, _ = final(scene, motion, StewartTrinkle(step=STEP))
        if not push.converged or _apart(pose, coarse) > SUSPECT:
            yield seed, pose, push
        if (seed + 1) % REPORTED == 0:
            print(f"      {motion.name}: {seed + 1} of {n} grasps", flush=True)


def run(size: Size) -> list[Figure]:
    """Numbers of grasps that are wrong, undecided or stopped early, and the worst, of each motion
    model."""
    figures = []
    n = max(4, size.rollouts // 2)
    for motion in MOTIONS:
        name = f"{n} seated grasps, {motion.name}"
        wrong: list[float] = []
        undecided = stopped = suspects = silent = 0
        verdicts: Counter[str] = Counter()
        for seed, pose, push in _suspects(n, motion, verdicts):
            suspects += 1
            if not push.converged:
                stopped += 1
                print(f"      {name}, grasp {seed}: {push.status}", flush=True)
                continue
            scene = seated_grasp(seed)
            judges = [
                final(scene, motion, kind(step=SMALL_STEP)) for kind in (StewartTrinkle, Midpoint)
            ]
            error = min(_apart(pose, judge) for judge, _ in judges)
            if error <= OFF:
                continue
            ended = " and ".join(judge for _, judge in judges)
            between = _apart(judges[0][0], judges[1][0])
            print(
                f"      {name}, grasp {seed}: off by {error:.3g} mm or deg; the fixed steps "
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
