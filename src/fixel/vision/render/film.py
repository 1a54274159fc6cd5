"""Rendering of films of a scene in motion, with exposure, light, hands and noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import ceil
from typing import Final, Protocol

import numpy as np

from fixel.errors import InvalidInput
from fixel.model import Scene, Trajectory
from fixel.simulation import Simulation
from fixel.typing import FloatArray
from fixel.vision.frame import Frame
from fixel.vision.marks import Rig
from fixel.vision.render.bench import HAND, Poses, RenderedBench
from fixel.vision.render.bright_field import BrightField
from fixel.vision.render.canvas import FloatPicture
from fixel.vision.render.hand import Occlusion
from fixel.vision.render.looks import Looks, light
from fixel.vision.render.sensor import Sensor

STRIDE: Final = 0.4  # [px] of motion between the times rendered in one exposure
MAX_INSTANTS: Final = 6

Motion = Simulation | Mapping[str, Trajectory]


class FilmView(Protocol):
    """Renderer of single pictures: `RenderedBench` or `BrightField`."""

    @property
    def size(self) -> tuple[int, int]: ...

    def light(self, instants: Sequence[Poses]) -> FloatPicture: ...


def view_of(scene: Scene, rig: Rig, looks: Looks, seed: int) -> FilmView:
    """Create the renderer for the lighting: testbed under a lamp, or bright field."""
    if looks.lighting == "through":
        return BrightField(scene, rig, looks, seed)
    return RenderedBench(scene, rig, looks, seed)


def film_scene(
    scene: Scene, motion: Motion, rig: Rig, looks: Looks, times: FloatArray, seed: int = 1
) -> Iterator[Frame]:
    """Render the frames of a film, one by one.

    Parameters
    ----------
    scene : Scene
        Scene with the true shapes.
    motion : Simulation or mapping of str to Trajectory
        Motion of every body and pusher in film time; they rest before its begin and after its end.
    rig : Rig
    looks : Looks
    times : (n,) float64
        Increasing times of the frames, in the middle of their exposures [s]. See `frame_times`.
    seed : int
        Seed of the random numbers; results for one seed are bit for bit equal.

    Yields
    ------
    Frame

    Raises
    ------
    InvalidInput
        A body or pusher has no trajectory.
    """
    tracks = tracks_of(scene, motion)
    view = view_of(scene, rig, looks, seed)
    sensor = Sensor(looks, view.size, seed)
    factors = light(looks, times, seed)
    occlusion = occlusion_of(scene, rig, looks, times, seed)
    pixel = rig.camera.metres_per_pixel()
    for number, time in enumerate(times.tolist()):
        instants = [
            poses_at(tracks, instant, occlusion, scene)
            for instant in _instants(tracks, time, looks.exposure, pixel)
        ]
        yield Frame(time, sensor.exposed(view.light(instants), factors[number], number))


def tracks_of(scene: Scene, motion: Motion) -> dict[str, Trajectory]:
    """Trajectories of all bodies and pushers of a scene, by name."""
    names = [*(body.name for body in scene.bodies), *(pusher.name for pusher in scene.pushers)]
    if isinstance(motion, Simulation):
        return {name: motion.trajectory(name) for name in names}
    missing = [name for name in names if name not in motion]
    if missing:
        raise InvalidInput(
            "motion", found=f"no trajectory of {missing[0]!r}", expected="one of all that moves"
        )
    return {name: motion[name] for name in names}


def occlusion_of(scene: Scene, rig: Rig, looks: Looks, times: FloatArray, seed: int) -> Occlusion:
    """Create the hand of a film, over the scene's first body."""
    body = scene.bodies[0]
    return Occlusion(looks, body.name, body.shape, rig, times, seed)


def poses_at(
    tracks: Mapping[str, Trajectory], time: float, occlusion: Occlusion, scene: Scene
) -> dict[str, FloatArray]:
    """Poses (3,) of bodies and pushers at a time [s], and of the hand while it is present."""
    poses = {name: track.at(time) for name, track in tracks.items()}
    hand = occlusion.pose(time, poses[scene.bodies[0].name])
    return poses if hand is None else {**poses, HAND: hand}


def _instants(
    tracks: Mapping[str, Trajectory], time: float, exposure: float, pixel: float
) -> list[float]:
    """Times [s] to render for one exposure: more for faster motion."""
    if exposure == 0.0:
        return [time]
    ends = np.array([time - 0.5 * exposure, time + 0.5 * exposure])
    way = max(float(np.hypot(*np.diff(track.at(ends), axis=0)[0, :2])) for track in tracks.values())
    count = min(max(1, ceil(way / pixel / STRIDE)), MAX_INSTANTS)
    return [time + exposure * ((k + 0.5) / count - 0.5) for k in range(count)]
