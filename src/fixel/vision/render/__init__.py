"""Rendering of a scene in motion to films, as a camera would record them.

    looks = looks_named("thesis")
    times = frame_times(duration, 30.0, looks, seed)
    for frame in film_scene(scene, simulation, rig, looks, times, seed):
        ...  # frame.time [s], frame.picture (h, w, 3) uint8, blue, green, red

Motion is a `Simulation` or a trajectory for each body and pusher, on the film's clock.
"""

from fixel.vision.render.film import film_scene
from fixel.vision.render.looks import (
    LIGHTINGS,
    MICROSCOPE,
    PRESETS,
    CameraEffects,
    changed,
    frame_times,
    looks_named,
)

__all__ = [
    "LIGHTINGS",
    "MICROSCOPE",
    "PRESETS",
    "CameraEffects",
    "changed",
    "film_scene",
    "frame_times",
    "looks_named",
]
