"""Recorded pushes of known truth for the filter's tests."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import numpy as np

from fixel.model import Experiment, PlannedExperiment, Tripod
from fixel.testbed.simulated import SimulatedTestbed
from fixel.testing.scenes import grasp

MU_PUSHER, MU_FIXEL, TRIPOD_RADIUS = 0.35, 0.3, 0.04


def push(
    seed: int = 1,
    aside: float = 0.004,
    duration: float = 7.0,
    noise: tuple[float, float] = (5e-5, 0.002),
    ahead: float = -0.012,
) -> Experiment:
    """A square pushed against three fixels, seen and felt as in the laboratory; nothing else.

    The model is right, and its parameters are those above: only the sensors err, the camera by
    `noise` [m, rad].
    """
    scene = grasp("seated")
    body = replace(
        scene.bodies[0],
        pose=scene.bodies[0].pose + np.array([ahead, aside, 0.0]),
        support=Tripod(radius=TRIPOD_RADIUS, friction=0.25, angle=pi / 2),
    )
    scene = replace(
        scene,
        bodies=(body,),
        pushers=(replace(scene.pushers[0], friction=MU_PUSHER),),
        fixels=tuple(replace(f, friction=MU_FIXEL) for f in scene.fixels),
        duration=duration,
    )
    bench = replace(
        SimulatedTestbed.ideal(seed=seed),
        position_noise=noise[0],
        angle_noise=noise[1],
        dropped_frames=0.01,
        false_contact=0.0425,
        missed_contact=0.0125,
    )
    (experiment,) = bench.run([PlannedExperiment(name="push", scene=scene)])
    return experiment


def carried_along(experiment: Experiment, interval: tuple[float, float]) -> float:
    """RMS error [m] of a blind guess: the object goes on as it moved just before."""
    track, (start, end) = experiment.trajectory, interval
    last = int(np.flatnonzero(track.time < start)[-1])
    before = last - 6
    rate = (track.pose[last] - track.pose[before]) / (track.time[last] - track.time[before])
    hidden = (track.time >= start) & (track.time <= end)
    guess = track.pose[last] + rate * (track.time[hidden] - track.time[last])[:, None]
    return float(np.sqrt(np.mean(np.sum((guess - track.pose[hidden])[:, :2] ** 2, axis=1))))
