"""Run `model.xml` in MuJoCo: `python run.py > poses.csv`. Needs the package mujoco.

The pusher weighs so much that nothing slows it down; its velocity is set at each waypoint. Do not
replace it by a mocap body: friction of MuJoCo does not see the velocity of such a body.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco

from fixel.simulation.engines.scripts.drive import EngineFailed, Poses, pusher_path, run, segments

SETTLING = 0.2  # [s] before time zero in which feet sink to their rest


def simulate(model: dict[str, Any]) -> Poses:
    """Return the poses of the body at the times of the model."""
    file = Path(__file__).with_name("model.xml")
    return poses_of(model, mujoco.MjModel.from_xml_path(str(file)))


def poses_of(model: dict[str, Any], physics: mujoco.MjModel) -> Poses:
    """Return the poses of the body at the times of a model that MuJoCo has read."""
    own = model["body"]
    data = mujoco.MjData(physics)
    # Body and pusher are far from everything while the feet settle.
    data.qpos[:2], data.qpos[-3:-1] = 100.0, -100.0
    mujoco.mj_step(physics, data, round(SETTLING / model["choices"]["step"]))
    data.qvel[:] = 0.0
    data.time = 0.0
    data.qpos[:3], data.qvel[:3] = own["start"], own["velocity"]
    data.qpos[-3:] = pusher_path(model)[0][1:]
    found: Poses = []
    for n, step, velocity, wanted in segments(model):
        data.qvel[-3:] = velocity
        physics.opt.timestep = step
        mujoco.mj_step(physics, data, n)
        if any(warning.number for warning in data.warning):
            raise EngineFailed("MuJoCo became unstable")
        if wanted:
            found.append(data.qpos[:3].tolist())
    return found


if __name__ == "__main__":
    run(simulate)
