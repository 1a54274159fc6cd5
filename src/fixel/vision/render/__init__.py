"""Rendering of a scene in motion to films, as a camera would record them.

    looks = looks_named("thesis")
    times = frame_times(duration, 30.0, looks, seed)
    for frame in film_scene(scene, simulation, rig, looks, times, seed):
        ...  # frame.time [s], frame.picture (h, w, 3) uint8, blue, green, red

Motion is a `Simulation` or a trajectory for each body and pusher, on the film's clock.
"""

from fixel.vision.render.film import film_scene as film_scene
from fixel.vision.render.looks import (
    LIGHTINGS as LIGHTINGS,
    MICROSCOPE as MICROSCOPE,
    PRESETS as PRESETS,
    CameraEffects as CameraEffects,
    changed as changed,
    frame_times as frame_times,
    looks_named as looks_named,
)
