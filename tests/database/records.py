"""Experiments that the tests of stores and bundles share."""

import math

import numpy as np

from fixel.model import Channel, Experiment, Parameters, Provenance, Trajectory
from fixel.model.records import SimulationRecord
from fixel.testing.scenes import grasp

HERE = Provenance(version="0.1", command="test", source="a.csv", sha256="00", seed=7)


def path(n=5, shift=0.0):
    time = np.linspace(0.0, 1.0, n)
    return Trajectory(time=time, pose=np.column_stack((time + shift, -0.0 * time, 7.0 * time)))


def simulation(number, error, parameters=None):
    """A stored simulation of an experiment with this error [mm^2], of a part that rests."""
    return SimulationRecord(
        experiment_id=number, parameters=Parameters(parameters), provenance=Provenance(version="0"),
        trajectory=Trajectory(time=[0.0, 1.0], pose=np.zeros((2, 3))), error_mm2=error,
    )  # fmt: skip


def experiment(name="1", **more):
    scene = grasp("seated")
    given = {
        "dataset": "lab",
        "name": name,
        "real": True,
        "provenance": HERE,
        "trajectory": path(),
        "pusher": path(9),
        "scene": scene,
        "object_name": scene.bodies[0].name,
        "height": 0.045,
        "channels": (
            Channel(name="tactile", time=[0.0, 0.5], columns=("a_bool",), values=[[0], [math.nan]]),
        ),
        "contact_mode": "010",
        "effective": (0.1, 0.9),
        "conditions": {"surface": "plywood", "speed_m_s": 0.02, "layout": 5, "times": 5.0},
    }
    return Experiment(**(given | more))
