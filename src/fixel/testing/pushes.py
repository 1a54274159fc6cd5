"""Simulated pushes with known parameters, for examples and tests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version
from typing import Final

import numpy as np

from fixel import model
from fixel.parts.next_pushes import push_candidates
from fixel.simulation import simulate
from fixel.simulation.vary import composed
from fixel.testing.scenes import box, row
from fixel.typing import FloatArray

TRUTH: Final = {"mu_pusher": 0.25, "tripod_radius": 0.038}
POSITION_NOISE: Final = 1e-4  # [m]
ANGLE_NOISE: Final = 1e-3  # [rad]


def example_pushes(n: int = 8, *, seed: int = 1, duration: float = 1.0) -> list[model.Experiment]:
    """Return simulated pushes of a square part, measured with noise.

    They were made with `mu_pusher` 0.25 and `tripod_radius` 38 mm. Their scenes have other nominal
    values: 0.4 and 30 mm.

    Parameters
    ----------
    n : int
        Number of pushes, at even distances from the part's centre.
    seed : int
        Seed of the noise.
    duration : float
        Duration of each push [s]; 20 poses per second are measured.

    Examples
    --------
    >>> [push.key for push in example_pushes(2)]
    ['example/push-01', 'example/push-02']
    """
    rng = np.random.default_rng(seed)
    time = np.linspace(0.0, duration, max(2, round(20 * duration) + 1))
    found = []
    for k, offset in enumerate(np.linspace(-0.03, 0.03, n) if n > 1 else [0.02], 1):
        scene = _scene(float(offset), duration)
        exact = simulate(scene, model.Parameters(TRUTH), output_interval=float(time[1])).pose[
            "part"
        ]
        noise = rng.normal(size=(len(time), 3)) * (POSITION_NOISE, POSITION_NOISE, ANGLE_NOISE)
        noise[0] = 0.0
        pose = exact[: len(time)] + noise
        conditions = {"offset_m": float(offset), "side": "left" if offset > 0.0 else "right"}
        found.append(_experiment(f"push-{k:02d}", scene, time, pose, seed, conditions))
    return found


def _scene(offset: float, duration: float) -> model.Scene:
    part = model.Body(
        name="part",
        shape=box(0.1, 0.1),
        mass=0.15,
        pose=row(0.0, 0.0, 0.0),
        support=model.Tripod(radius=0.03, friction=0.25),
    )
    finger = model.Pusher(
        name="finger",
        shape=model.Disk(0.005),
        pose=row(-0.055, offset, 0.0),
        drive=model.LineDrive(direction=row(1.0, 0.0), speed=0.03),
        friction=0.4,
    )
    return model.Scene(bodies=(part,), pushers=(finger,), duration=duration)


def example_parts(
    n: int = 3, pushes: int = 12, *, seed: int = 1, uneven: float = 0.0
) -> list[model.Experiment]:
    """Return simulated pushes of several parts on a board, measured with noise.

    Every part is a rectangle of its own size that presses on its own points. The pushes start
    around its outline.

    Parameters
    ----------
    n : int
        Number of parts.
    pushes : int
        Number of pushes of each.
    seed : int
        Seed of the sizes, of the loads under the parts and of the noise.
    uneven : float
        Standard deviation of the logarithm of the loads on an uneven board, which the scenes of the
        experiments do not have. The parts then start at many places and angles of it.

    Examples
    --------
    >>> sorted({push.conditions["part"] for push in example_parts(2, 3)})
    ['part-1', 'part-2']
    """
    rng = np.random.default_rng(seed)
    board = model.Plane() if uneven == 0.0 else model.Plane(load_map=uneven_board(uneven))
    found = []
    for k in range(n):
        width, height = rng.uniform(0.08, 0.11, 2)
        body = model.Body(
            name="part",
            shape=box(float(width), float(height)),
            mass=0.8,
            support=model.UniformPressure(friction=0.25),
        )
        truth = {
            "mu_pusher": float(rng.uniform(0.2, 0.3)),
            "pressure_rim": float(rng.normal(0.0, 1.0)),
            "pressure_xy": float(rng.normal(0.5, 0.5)),
        }
        scenes = push_candidates(body, travel=0.04, contacts=max(pushes, 4))
        for j, which in enumerate(rng.permutation(len(scenes))[:pushes].tolist()):
            scene = scenes[which]
            if uneven:
                scene = _moved(scene, rng)
            run = simulate(
                replace(scene, plane=board),
                truth,
                motion="quasistatic",
                output_interval=scene.duration,
            )
            noise = rng.normal(size=3) * (POSITION_NOISE, POSITION_NOISE, ANGLE_NOISE)
            pose = run.pose["part"][[0, -1]] + [np.zeros(3), noise]
            name, time = f"part-{k + 1}", np.array([0.0, scene.duration])
            conditions = {"part": name, "surface": "board"}
            found.append(_experiment(f"{name}-{j + 1:02d}", scene, time, pose, seed, conditions))
    return found


def uneven_board(deviation: float, seed: int = 5, *, cell: float = 0.05) -> model.LoadMap:
    """Return a board whose nodes have random logarithms of load factors."""
    nodes = np.random.default_rng(seed).normal(0.0, deviation, (9, 9))
    return model.LoadMap(origin=np.full(2, -4.0 * cell), cell=np.full(2, cell), log_load=nodes)


def _moved(scene: model.Scene, rng: np.random.Generator) -> model.Scene:
    """Return a scene turned as a whole, and moved to a random place."""
    place = np.array([*rng.uniform(-0.08, 0.08, 2), rng.uniform(-np.pi, np.pi)])
    body, (pusher,) = scene.bodies[0], scene.pushers
    drive = pusher.drive
    turn = np.array([[np.cos(place[2]), -np.sin(place[2])], [np.sin(place[2]), np.cos(place[2])]])
    assert isinstance(drive, model.LineDrive)
    return replace(
        scene,
        bodies=(replace(body, pose=composed(place, body.pose)),),
        pushers=(
            replace(
                pusher,
                pose=composed(place, pusher.pose),
                drive=replace(drive, direction=turn @ drive.direction),
            ),
        ),
    )


def _experiment(
    name: str,
    scene: model.Scene,
    time: FloatArray,
    pose: FloatArray,
    seed: int,
    conditions: Mapping[str, str | float],
) -> model.Experiment:
    """Return the experiment of a simulated push, measured as poses (n, 3) at times (n,)."""
    return model.Experiment(
        dataset="example",
        name=name,
        real=False,
        simulated_by="fixel",
        provenance=model.Provenance(version=version("fixel"), seed=seed),
        trajectory=model.Trajectory(time=time, pose=pose),
        object_name="part",
        scene=scene,
        conditions=conditions,
    )
