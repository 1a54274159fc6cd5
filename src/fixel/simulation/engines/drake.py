"""Drake: discrete contact by convex problems that are solved to high accuracy, three dimensions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version as version_of
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar, final

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from fixel.model.engine_parameters import DRAKE, ParameterInfo
from fixel.simulation.engines.contract import AbstractPhysicsEngine, EngineFailed
from fixel.simulation.engines.sdf import MAX_FRICTION, sdf
from fixel.simulation.engines.solids import footed
from fixel.simulation.engines.task import PlainTask, planar_refusal, pusher_poses
from fixel.typing import FloatArray

SAME = 1e-9  # [m/s], [rad/s]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Drake(AbstractPhysicsEngine):
    """Engine Drake, by default with the contacts that it is shipped with.

    Every support point is a ball on a floor, pressed down by its own weight.

    Parameters
    ----------
    step : float
        Time step [s].
    approximation : str
        Approximation of contact: "lagged", "similar", "sap" or "tamsi".
    stiffness : float
        Stiffness of a contact point [N/m].
    dissipation : float
        Dissipation of Hunt and Crossley [s/m].
    relaxation : float
        Relaxation time of contacts, of "sap" only [s].
    stiction : float
        Tolerance of stiction, of "tamsi" only [m/s].
    """

    name: ClassVar[str] = "drake"
    parameters: ClassVar[Mapping[str, ParameterInfo]] = DRAKE
    at_bench_size: ClassVar[bool] = True

    step: float = 5e-3
    approximation: str = "similar"
    stiffness: float = 1e6
    dissipation: float = 50.0
    relaxation: float = 0.1
    stiction: float = 1e-3

    @property
    def version(self) -> str:
        return version_of("drake")

    def refusal(self, task: PlainTask) -> str:
        pairs = [fixel.friction for fixel in task.fixels]
        pairs += [] if task.pusher is None else [task.pusher.friction]
        largest = max([*pairs, *footed(task.body, task.gravity).friction.tolist()], default=0.0)
        if largest >= MAX_FRICTION:
            return f"a friction coefficient of {largest:.3g}; it takes less than {MAX_FRICTION:g}"
        return planar_refusal(task)

    def simulate(self, task: PlainTask) -> FloatArray:
        end = float(task.times[-1])
        n = math.ceil(end / self.step * (1.0 - 1e-9))
        step = end / n
        diagram, plant = self._built(task, step)
        simulator = Simulator(diagram)
        context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        joint = plant.GetJointByName("object_plane")
        drive = plant.GetJointByName("pusher_plane")
        joint.set_translation(context, task.body.start[:2])
        joint.set_rotation(context, float(task.body.start[2]))
        joint.set_translational_velocity(context, task.body.velocity[:2])
        joint.set_angular_velocity(context, float(task.body.velocity[2]))
        grid = np.linspace(0.0, end, n + 1)
        head = np.zeros((n + 1, 3)) if task.pusher is None else pusher_poses(task.pusher, grid)
        drive.set_translation(context, head[0, :2])
        drive.set_rotation(context, float(head[0, 2]))
        simulator.Initialize()
        velocity = np.diff(head, axis=0) / step
        track, before = [task.body.start.tolist()], 0
        # A call of Drake takes longer than a step: one until the velocity changes, or a sample.
        jumps = np.abs(np.diff(velocity, axis=0)).max(axis=1) > SAME
        changes = {0, *(1 + np.flatnonzero(jumps)).tolist()}
        after = np.searchsorted(grid, task.times)
        stops = sorted({*changes, *(after - 1).tolist(), *after.tolist()} - {0, -1})
        for k in stops:
            if before in changes:
                drive.set_translational_velocity(context, velocity[before, :2])
                drive.set_angular_velocity(context, float(velocity[before, 2]))
            try:
                simulator.AdvanceTo(float(grid[k]))
            except RuntimeError as problem:
                reason = str(problem).strip().partition("\n")[0]
                raise EngineFailed(reason) from None
            track.append([*joint.get_translation(context), joint.get_rotation(context)])
            before = k
        known = grid[[0, *stops]]
        return np.column_stack([np.interp(task.times, known, own) for own in np.array(track).T])

    def _built(self, task: PlainTask, step: float) -> tuple[Any, Any]:
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(
            time_step=step,
            discrete_contact_approximation=self.approximation,
            contact_model="point",
            stiction_tolerance=self.stiction,
        )
        plant, _ = AddMultibodyPlant(config, builder)
        plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -task.gravity])
        meshes = dict(sdf(task, self))
        text = meshes.pop("model.sdf")
        # Meshes have to be files; a model that is one is parsed ten times as slowly as a text.
        with TemporaryDirectory() as folder:
            for name, mesh in meshes.items():
                Path(folder, name).write_text(mesh, "utf-8")
            text = text.replace("<uri>", f"<uri>file://{folder}/")
            Parser(plant).AddModelsFromString(text, "sdf")
        plant.Finalize()
        return builder.Build(), plant
