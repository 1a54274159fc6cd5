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

from fixel.simulation.engines.scripts.drive import EngineFailed, Poses, pusher_path, run

SAME = 1e-9  # [m/s], [rad/s]


def simulate(model: dict[str, Any], folder: Path = Path(__file__).parent) -> Poses:
    """Return the poses of the body at the times of the model, whose SDF is in a folder."""
    own, times = model["body"], model["times"]
    n = math.ceil(times[-1] / model["choices"]["step"] * (1.0 - 1e-9))
    step = times[-1] / n
    plant, diagram = built(model, step, folder)
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
    track, before = [own["start"]], 0
    # A call of Drake takes longer than a step: one until the velocity changes, or a sample.
    jumps = np.abs(np.diff(velocity, axis=0)).max(axis=1) > SAME
    changes = {0, *(1 + np.flatnonzero(jumps)).tolist()}
    after = np.searchsorted(grid, times)
    stops = sorted({*changes, *(after - 1).tolist(), *after.tolist()} - {0, -1})
    for k in stops:
        if before in changes:
            drive.set_translational_velocity(context, velocity[before, :2])
            drive.set_angular_velocity(context, velocity[before, 2])
        try:
            simulator.AdvanceTo(grid[k])
        except RuntimeError as problem:
            raise EngineFailed(str(problem).strip().partition("\n")[0]) from None
        track.append([*body.get_translation(context), body.get_rotation(context)])
        before = k
    known = grid[[0, *stops]]
    columns = [np.interp(times, known, column) for column in np.array(track).T]
    return list(np.column_stack(columns).tolist())


def built(model: dict[str, Any], step: float, folder: Path) -> tuple[Any, Any]:
    """Return the plant of the SDF in a folder, and the diagram that contains it."""
    builder = DiagramBuilder()
    config = MultibodyPlantConfig(
        time_step=step,
        discrete_contact_approximation=model["choices"]["approximation"],
        contact_model="point",
        stiction_tolerance=model["choices"]["stiction"],
    )
    plant, _ = AddMultibodyPlant(config, builder)
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -model["gravity"]])
    # A model that is a file is parsed ten times as slowly as a text, but meshes have to be files.
    text = (folder / "model.sdf").read_text("utf-8")
    text = text.replace("<uri>", f"<uri>file://{folder.absolute()}/")
    Parser(plant).AddModelsFromString(text, "sdf")
    plant.Finalize()
    return plant, builder.Build()


if __name__ == "__main__":
    run(simulate)
