"""Rendering of films of a scene in motion, with exposure, light, hands and noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import ceil
from typing import Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model import Scene, Shape, Trajectory
from fixel.model.fields import frozen
from fixel.model.probability import stream
from fixel.model.shape import placed
from fixel.simulation import Simulation
from fixel.typing import FloatArray
from fixel.vision.frame import Frame
from fixel.vision.marks import Rig
from fixel.vision.render.bench import HAND, RenderedBench
from fixel.vision.render.bodies import OBJECT_HEIGHT, hand_solid, pixel_of
from fixel.vision.render.bright_field import BrightField
from fixel.vision.render.canvas import cover
from fixel.vision.render.looks import CameraEffects, light
from fixel.vision.render.solids import outline_of
from fixel.vision.render.virtual_camera import Projection, Sensor

AWAY: Final = 0.45  # [m] from its resting place to one outside the picture
MOVING: Final = 0.45  # [s] to arrive, and to leave
STEPS: Final = 12  # bisections to find the resting place
STRIDE: Final = 0.4  # [px] of motion between the times rendered in one exposure
MAX_INSTANTS: Final = 6
Motion = Simulation | Mapping[str, Trajectory]


class Occlusion:
    """Motion of a hand in one film.

    Parameters
    ----------
    looks : CameraEffects
        Duration of the occlusion, and covered share of the object.
    name : str
        Name of the object.
    shape : Shape
        Shape of the object.
    rig : Rig
    times : (n,) float64
        Times of the film's frames [s].
    seed : int
    """

    def __init__(
        self, looks: CameraEffects, name: str, shape: Shape, rig: Rig, times: FloatArray, seed: int
    ) -> None:
        self._looks, self._name, self._rig = looks, name, rig
        self._eye = Projection(rig.camera)
        random = stream(seed, "film", "hand")
        first, last = float(times[0]), float(times[-1])
        spare = max(last - first - looks.occlusion, 0.0)
        self._begins = first + spare * random.uniform(0.35, 0.6)
        self._ends = min(self._begins + looks.occlusion, last)
        self._heading = 0.5 * np.pi + random.uniform(-0.35, 0.35)
        pixel = pixel_of(rig)
        self._hand = hand_solid(4.0 * pixel)
        self._outline = outline_of(shape, 2.0 * pixel).points
        self._ahead: float | None = None

    @property
    def interval(self) -> tuple[float, float]:
        """First and last time at which the hand lies over the object [s]; (0, 0) without a hand."""
        return (self._begins, self._ends) if self._looks.occlusion > 0.0 else (0.0, 0.0)

    def pose(self, time: float, object_pose: FloatArray) -> FloatArray | None:
        """Pose (3,) of the hand [m, m, rad]; None while it is outside the picture."""
        if self._looks.occlusion == 0.0:
            return None
        late = max(self._begins - time, time - self._ends, 0.0) / MOVING
        if late >= 1.0:
            return None
        if self._ahead is None:
            self._ahead = self._ahead_for(object_pose)
        away = late * late * (3.0 - 2.0 * late) * AWAY
        return self._at(object_pose, self._ahead - away)

    def share(self, hand: FloatArray | None, object_pose: FloatArray) -> float:
        """Share of the object's upper face that a hand at this pose covers [-]."""
        if hand is None:
            return 0.0
        part = self._rig.parts.get(self._name)
        height = part.height if part else OBJECT_HEIGHT
        face = self._eye.project_at(placed(self._outline, object_pose), height)
        low = np.floor(face.min(axis=0))
        w, h = (int(n) for n in np.ceil(face.max(axis=0)) - low + 1)
        room = np.zeros((h, w + 2))
        wanted, covered = np.zeros((h, w), np.float32), np.zeros((h, w), np.float32)
        cover(wanted, room, face - low)
        for slab in self._hand.slabs:
            pixels = self._eye.project_at(placed(slab.outline.points, hand), slab.high)
            cover(covered, room, pixels - low)
        return float(np.minimum(wanted, covered).sum() / wanted.sum())

    def _at(self, object_pose: FloatArray, ahead: float) -> FloatArray:
        along = np.array([np.cos(self._heading), np.sin(self._heading)])
        return frozen([*(object_pose[:2] + ahead * along), self._heading])

    def _ahead_for(self, object_pose: FloatArray) -> float:
        """Find the reach of the fingertips beyond the object that covers the given share [m]."""
        low, high = -0.15, 0.2
        for _ in range(STEPS):
            middle = 0.5 * (low + high)
            found = self.share(self._at(object_pose, middle), object_pose)
            low, high = (middle, high) if found < self._looks.occluded else (low, middle)
        return 0.5 * (low + high)


def view_of(scene: Scene, rig: Rig, looks: CameraEffects, seed: int) -> RenderedBench | BrightField:
    """Create the renderer for the lighting: testbed under a lamp, or bright field."""
    if looks.lighting == "through":
        return BrightField(scene, rig, looks, seed)
    return RenderedBench(scene, rig, looks, seed)


def film_scene(
    scene: Scene, motion: Motion, rig: Rig, looks: CameraEffects, times: FloatArray, seed: int = 1
) -> Iterator[Frame]:
    """Render the frames of a film, one by one.

    Parameters
    ----------
    scene : Scene
        Scene with the true shapes.
    motion : Simulation or mapping of str to Trajectory
        Motion of every body and pusher in film time; they rest before its begin and after its end.
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
        return {name: motion[name] for name in names}
    missing = [name for name in names if name not in motion]
    if missing:
        raise InvalidInput(
            "motion",
            found=f"no trajectory of {missing[0]!r}",
            expected="trajectories of all moving bodies",
        )
    return {name: motion[name] for name in names}


def occlusion_of(
    scene: Scene, rig: Rig, looks: CameraEffects, times: FloatArray, seed: int
) -> Occlusion:
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
