"""A particle filter of 500 particles over a grasp with three fixels, frame by frame on one core."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.figures import Figure, Size, at_least, at_most
from fixel.filtering.particle_filter import ParticleFilter
from fixel.filtering.running import FilterFrame, RunningFilter, start_filter
from fixel.model import Experiment, PlannedExperiment
from fixel.testbed.simulated import SimulatedTestbed
from fixel.testing.scenes import Layout, grasp

FRAME_MS = 1e3 / 30.0  # at the camera's 30 frames a second


def run(size: Size) -> list[Figure]:
    """Both layouts; the camera, the fixels, and a second and a half in which only the fixels."""
    particles = 500 if size.rollouts >= 500 else 20
    return [*_figures("seated", particles, size), *_figures("slip", particles, size)]


def _figures(layout: Layout, particles: int, size: Size) -> list[Figure]:
    experiment = _recorded(layout, 11.0 if size.rollouts >= 500 else 0.3)
    options = ParticleFilter(n_particles=particles, threads=1)
    wall, busy = _frames(experiment, options, time.perf_counter), []
    for _ in range(min(size.repeats, 2)):
        busy += _frames(experiment, options, time.thread_time)
    name = f"filter, {layout}, a frame"
    in_time = 100.0 * float(np.mean(np.array(busy) <= FRAME_MS))
    return [
        Figure(f"{name}, wall", "ms", tuple(wall), at_most(FRAME_MS)),
        Figure(f"{name}, processor", "ms", tuple(busy), at_most(FRAME_MS)),
        Figure(f"filter, {layout}, frames in time", "%", (in_time,), at_least(95.0)),
    ]


def _recorded(layout: Layout, duration: float) -> Experiment:
    planned = PlannedExperiment(name=layout, scene=replace(grasp(layout), duration=duration))
    (experiment,) = SimulatedTestbed().run([planned])
    return experiment


def _frames(
    experiment: Experiment, options: ParticleFilter, clock: Callable[[], float]
) -> list[float]:
    """Milliseconds of every frame by a clock."""
    track, pusher, tactile = experiment.trajectory, experiment.pusher, experiment.channel("tactile")
    assert pusher is not None
    assert tactile is not None
    running: RunningFilter = start_filter(options, experiment)
    taken = []
    for k in range(1, len(track.time)):
        hidden = 5.0 < track.time[k] < 6.5
        reading = tactile.values[np.searchsorted(tactile.time, track.time[k] - 1e-6)]
        seen = None if hidden else track.pose[k]
        begun = clock()
        running.step(FilterFrame(float(track.time[k]), pusher.pose[k], seen, reading))
        taken.append(1e3 * (clock() - begun))
    return taken
