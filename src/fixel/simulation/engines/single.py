"""Simulation of one scene by another engine."""

from __future__ import annotations

import time as clock
from typing import Any

import numpy as np

from fixel.kernels import codes
from fixel.model import Parameters, Scene
from fixel.simulation.engines import EngineName, shared_program
from fixel.simulation.engines.ensemble import EngineEnsemble
from fixel.simulation.engines.task import pusher_poses, task_of
from fixel.simulation.motion import OtherEngine
from fixel.simulation.result import CONTACT_FIELDS
from fixel.simulation.rollouts import RolloutCase
from fixel.typing import FloatArray

SAMPLES = 100  # where no output interval is given: an engine's own steps are not known


def fields_of_engine(
    scene: Scene,
    engine: OtherEngine,
    parameters: Parameters | None,
    duration: float,
    times: FloatArray | None,
) -> dict[str, Any]:
    """Return the fields of a `Simulation` by another engine; forces and contacts are not known."""
    times = np.linspace(0.0, duration, SAMPLES + 1) if times is None else times
    case = RolloutCase(scene, times[1:])
    values = {name: np.array([value]) for name, value in (parameters or {}).items()}
    ensemble = EngineEnsemble([case], engine, programs=[shared_program(engine.name)])
    stated = EngineName.of(engine.name)._replace(version=ensemble.info.version)
    seconds = clock.perf_counter()
    outcome = ensemble.simulate(np.zeros(1, np.int64), values)
    seconds = clock.perf_counter() - seconds
    shared = {name: value for name, value in (parameters or {}).items() if "." not in name}
    task, frames = task_of(scene, times, shared, {})
    start = frames.scene_poses(task.body.start)[None]
    converged = bool(outcome.converged[0])
    if not converged:
        times = times[:1]
    track = np.concatenate((start, outcome.pose[0]))[: len(times)]
    pose = {scene.bodies[0].name: track}
    for pusher in scene.pushers:
        assert task.pusher is not None
        pose[pusher.name] = pusher_poses(task.pusher, times)
    return {
        "status": codes.STATUS_NAMES[codes.CONVERGED if converged else codes.ENGINE_FAILED],
        "stopped_at": None if converged else 0.0,
        "duration": duration if converged else 0.0,
        "time": times,
        "pose": pose,
        "twist": {
            name: np.gradient(own, times, axis=0) if len(times) > 1 else np.zeros_like(own)
            for name, own in pose.items()
        },
        "contacts": np.zeros(0, CONTACT_FIELDS),
        "pushers": {},
        "steps": 0,
        "fallbacks": 0,
        "max_residual": 0.0,
        "wall_time_s": seconds,
        "method": {
            "motion": str(stated),
            "engine": f"{stated.name} {stated.version}".strip(),
            "stepper": "its own",
            "solver": "its own",
            **({} if converged else {"reason": outcome.reasons[0]}),
        },
    }
