"""Run `model.sdf` in Drake: `python run.py > poses.csv`. Needs the package drake 1.51.

The pusher weighs so much that nothing slows it down; its velocity is set where it changes.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from fixel.workflows.model_export.scripts.drive import Poses, pusher_path, run

SAME = 1e-9  # [m/s], [rad/s]


def simulate(model: dict[str, Any]) -> Poses:
    """Return the poses of the body at the times of the model."""
    own, choices, times = model["body"], model["choices"], model["times"]
    n = math.ceil(times[-1] / choices["step"] * (1.0 - 1e-9))
    step = times[-1] / n
    plant, diagram = built(model, step)
    simulator = Simulator(diagram)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    body, drive = (plant.GetJointByName(name) for name in ("object_plane", "pusher_plane"))
    grid = np.linspace(0.0, times[-1], n + 1)
    path = np.array(pusher_path(model))
    head = np.column_stack([np.interp(grid, path[:, 0], path[:, k]) for k in (1, 2, 3)])
    for joint, pose in ((body, own["start"]), (drive, head[0])):
        joint.set_translation(context, pose[:2])
        joint.set_rotation(context, pose[2])
    body.set_translational_velocity(context, own["velocity"][:2])
    body.set_angular_velocity(context, own["velocity"][2])
    simulator.Initialize()
    velocity = np.diff(head, axis=0) / step
    track = [own["start"]]
    for k in range(n):
        if k == 0 or np.abs(velocity[k] - velocity[k - 1]).max() > SAME:
            drive.set_translational_velocity(context, velocity[k, :2])
            drive.set_angular_velocity(context, velocity[k, 2])
        simulator.AdvanceTo(grid[k + 1])
        track.append([*body.get_translation(context), body.get_rotation(context)])
    columns = [np.interp(times, grid, column) for column in np.array(track).T]
    return list(np.column_stack(columns).tolist())


def built(model: dict[str, Any], step: float) -> tuple[Any, Any]:
    """Return the plant of `model.sdf`, and the diagram that contains it."""
    builder = DiagramBuilder()
    config = MultibodyPlantConfig(
        time_step=step,
        discrete_contact_approximation=model["choices"]["approximation"],
        contact_model="point",
        stiction_tolerance=model["choices"]["stiction"],
    )
    plant, _ = AddMultibodyPlant(config, builder)
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -model["gravity"]])
    Parser(plant).AddModels(str(Path(__file__).with_name("model.sdf")))
    plant.Finalize()
    return plant, builder.Build()


if __name__ == "__main__":
    run(simulate)
