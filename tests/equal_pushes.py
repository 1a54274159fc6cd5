"""Equal pushes at several places and orientations of a table, with known differences."""

from dataclasses import replace

import numpy as np

from fixel.model import Experiment, Trajectory
from fixel.testing.pushes import example_parts


def at(push: Experiment, name: str, pose, error=(0.0, 0.0, 0.0), tilt=(0.0, 0.0), **conditions):
    """Move a measured push so that its part starts at a pose; its end differs by an error in the
    frame of the part there, and by a tilt in the world."""
    scene = push.scene
    body, tip = scene.bodies[0], scene.pushers[0]
    turn = pose[2] - body.pose[2]
    rotation = complex(np.cos(turn), np.sin(turn))

    def moved(x, y):
        z = complex(*pose[:2]) + rotation * complex(x - body.pose[0], y - body.pose[1])
        return [z.real, z.imag]

    way = rotation * complex(*tip.drive.direction)
    end = push.trajectory.pose[-1].copy()
    inner = complex(np.cos(body.pose[2]), np.sin(body.pose[2])) * complex(*error[:2])
    end += [inner.real, inner.imag, error[2]]
    x, y = moved(*end[:2])
    last = [x + tilt[0], y + tilt[1], end[2] + turn]
    place = moved(*tip.pose[:2])
    return replace(
        push,
        name=name,
        scene=replace(
            scene,
            bodies=(replace(body, pose=np.array(pose)),),
            pushers=(
                replace(
                    tip,
                    pose=np.array([*place, tip.pose[2] + turn]),
                    drive=replace(tip.drive, direction=np.array([way.real, way.imag])),
                ),
            ),
        ),
        trajectory=Trajectory(time=push.trajectory.time[[0, -1]], pose=np.array([pose, last])),
        conditions={**push.conditions, **conditions},
    )


def over_a_table(
    seed=1, *, different=1, places=9, turns=(0.0, 2.1, 4.2), repeats=2, sessions=("",),
    noise=(0.0, 0.0), place=(0.0, 0.0), orientation=(0.0, 0.0), tilt=(0.0, 0.0), drift=0.0,
):  # fmt: skip
    """Return pushes with normal differences of given root mean squares [m, rad].

    Those of `orientation` are common to all places, those of `place` belong to a place and an
    orientation. In every later session, parts move farther by `drift` [m] in the direction of the
    push.
    """
    rng = np.random.default_rng(seed)

    def drawn(size):
        return rng.normal(size=3) * (size[0] / np.sqrt(2.0), size[0] / np.sqrt(2.0), size[1])

    found = []
    for number, push in enumerate(example_parts(1, different)):
        body, tip = push.scene.bodies[0], push.scene.pushers[0]
        c, s = np.cos(body.pose[2]), np.sin(body.pose[2])
        x, y = tip.drive.direction
        along = np.array([c * x + s * y, c * y - s * x, 0.0])  # in the frame of the part
        by_turn = [drawn(orientation) for _ in turns]
        for k in range(places):
            for turn, extra in zip(turns, by_turn, strict=True):
                here = extra + drawn(place)
                pose = (0.1 * (k % 3), 0.1 * (k // 3), turn)
                for j, session in enumerate(sessions):
                    for r in range(repeats):
                        error = here + drawn(noise) + j * drift * along
                        name = f"push-{number}-{k}-{turn:g}-{session}-{r}"
                        more = {"session": session} if session else {}
                        found.append(at(push, name, pose, error, tilt, **more))
    return found
