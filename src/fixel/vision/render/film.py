"""Rendering of films, also under a microscope: exposure, light, hands, noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import ceil
from typing import Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model import Body, Disk, Pusher, Scene, Trajectory
from fixel.model.fields import frozen
from fixel.model.probability import stream
from fixel.model.shape import placed
from fixel.simulation import Simulation
from fixel.typing import FloatArray
from fixel.vision.frame import Frame, opencv
from fixel.vision.marks import Rig
from fixel.vision.render.bench import HAND, Poses, RenderedBench
from fixel.vision.render.bodies import OBJECT_HEIGHT, direction_of, falloff, hand_solid, pixel_of
from fixel.vision.render.canvas import FloatPicture, PictureWindow, cover, painter
from fixel.vision.render.looks import CameraEffects, light
from fixel.vision.render.solids import outline_of, polygon
from fixel.vision.render.virtual_camera import Projection, Sensor

AWAY: Final = 0.45  # [m] from its resting place to one outside the picture
MOVING: Final = 0.45  # [s] to arrive, and to leave
STEPS: Final = 12  # bisections to find the resting place
STRIDE: Final = 0.4  # [px] of motion between the times rendered in one exposure
MAX_INSTANTS: Final = 6
Motion = Simulation | Mapping[str, Trajectory]


class Occlusion:
    """Motion of a hand over the first body of a scene, in a film with frames at times (n,) [s]."""

    def __init__(
        self, scene: Scene, rig: Rig, looks: CameraEffects, times: FloatArray, seed: int
    ) -> None:
        self._looks, self._rig, self._body = looks, rig, scene.bodies[0]
        self._eye = Projection(rig.camera)
        random = stream(seed, "film", "hand")
        first, last = float(times[0]), float(times[-1])
        spare = max(last - first - looks.occlusion, 0.0)
        self._begins = first + spare * random.uniform(0.35, 0.6)
        self._ends = min(self._begins + looks.occlusion, last)
        self._heading = 0.5 * np.pi + random.uniform(-0.35, 0.35)
        pixel = pixel_of(rig)
        self._hand = hand_solid(4.0 * pixel)
        self._outline = outline_of(self._body.shape, 2.0 * pixel).points
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
        part = self._rig.parts.get(self._body.name)
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


def view_of(
    scene: Scene,
    rig: Rig,
    looks: CameraEffects,
    seed: int,
    like: RenderedBench | BrightField | None = None,
) -> RenderedBench | BrightField:
    """Create the renderer for the lighting: testbed under a lamp, or bright field.

    It uses the plate of the renderer `like` again, which has the same rig, looks and seed.
    """
    if looks.lighting == "through":
        return BrightField(scene, rig, looks, seed)
    shared = like if isinstance(like, RenderedBench) else None
    return RenderedBench(scene, rig, looks, seed, shared)


def film_scene(
    scene: Scene, motion: Motion, rig: Rig, looks: CameraEffects, times: FloatArray, seed: int = 1
) -> Iterator[Frame]:
    """Render the frames of a film, one by one.

    Raise `InvalidInput` if a body or pusher has no trajectory.

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
    """
    tracks = tracks_of(scene, motion)
    view = view_of(scene, rig, looks, seed)
    sensor = Sensor(looks, view.size, seed)
    factors = light(looks, times, seed)
    occlusion = Occlusion(scene, rig, looks, times, seed)
    pixel = rig.camera.metres_per_pixel()
    for number, time in enumerate(times.tolist()):
        instants = [
            poses_at(tracks, instant, occlusion, scene)
            for instant in exposure_times(tracks, time, looks.exposure, pixel)
        ]
        yield Frame(time, sensor.exposed(view.light(instants), factors[number], number))


def tracks_of(scene: Scene, motion: Motion) -> dict[str, Trajectory]:
    """Trajectories of all bodies and pushers of a scene, by name."""
    names = [*(body.name for body in scene.bodies), *(pusher.name for pusher in scene.pushers)]
    for name in names:
        if not isinstance(motion, Simulation) and name not in motion:
            found, expected = f"no trajectory of {name!r}", "trajectories of all moving bodies"
            raise InvalidInput("motion", found=found, expected=expected)
    return {name: motion[name] for name in names}


def poses_at(
    tracks: Mapping[str, Trajectory], time: float, occlusion: Occlusion, scene: Scene
) -> dict[str, FloatArray]:
    """Poses (3,) of bodies and pushers at a time [s], and of the hand while it is present."""
    poses = {name: track.at(time) for name, track in tracks.items()}
    hand = occlusion.pose(time, poses[scene.bodies[0].name])
    return poses if hand is None else {**poses, HAND: hand}


def exposure_times(
    tracks: Mapping[str, Trajectory], time: float, exposure: float, pixel: float
) -> list[float]:
    """Times [s] to render for one exposure: more for faster motion."""
    if exposure == 0.0:
        return [time]
    ends = np.array([time - 0.5 * exposure, time + 0.5 * exposure])
    way = max(float(np.hypot(*np.diff(track.at(ends), axis=0)[0, :2])) for track in tracks.values())
    count = min(max(1, ceil(way / pixel / STRIDE)), MAX_INSTANTS)
    return [time + exposure * ((k + 0.5) / count - 0.5) for k in range(count)]


GROUND: Final = 214.0  # [grey levels]
BLACK: Final = 22.0
SHEET: Final = 38.1e-6  # [m] height of a part that the rig lacks

# Half width of the needle behind its tip: first straight, then a cone, then the shank.
NEEDLE: Final = ((0.0, 0.5), (25e-6, 0.5), (1.6e-3, 5.2), (1.2e-2, 7.0))  # [m], [tip sides]


class BrightField:
    """Renderer of a scene with the true shapes under the microscope, lit from below."""

    def __init__(self, scene: Scene, rig: Rig, looks: CameraEffects, seed: int) -> None:
        self._eye, self._looks = Projection(rig.camera), looks
        self.size = self._eye.size  # width and height [px]
        pixel = rig.camera.metres_per_pixel()
        self._outlines: list[tuple[str, FloatArray, float]] = []
        for body in scene.bodies:
            self._add(rig, body.name, part_outline(body, looks.tab, pixel))
        for pusher in scene.pushers:
            self._add(rig, pusher.name, needle_outline(pusher, pixel))
            self._add(rig, pusher.name, outline_of(pusher.shape, pixel).points)
        for fixel in scene.fixels:
            self._add(rig, fixel.name, placed(outline_of(fixel.shape, pixel).points, fixel.pose))
        self._ground = _ground(self.size, seed, clean=looks.read_noise == 0.0)
        self._falloff = falloff(self._eye, looks.vignetting)[..., None]

    def light(self, instants: Sequence[Poses]) -> FloatPicture:
        """Render the light on the sensor (h, w, 3) float32 over an exposure [grey levels]."""
        total = self._sharp(instants[0])
        for poses in instants[1:]:
            total += self._sharp(poses)
        if len(instants) > 1:
            total /= np.float32(len(instants))
        if self._looks.blur > 0.0:
            total = opencv().GaussianBlur(total, (0, 0), self._looks.blur)
        return np.asarray(total * self._falloff)

    def _add(self, rig: Rig, name: str, outline: FloatArray) -> None:
        part = rig.parts.get(name)
        self._outlines.append((name, outline, part.height if part else SHEET))

    def _sharp(self, poses: Poses) -> FloatPicture:
        picture = self._ground.copy()
        paint = painter(PictureWindow(0, 0, *self.size), picture)
        still = np.zeros(3)
        for name, outline, height in self._outlines:
            points = placed(outline, poses.get(name, still))
            paint(self._eye.polygons(points, height, np.full(3, BLACK)))
        return picture


def part_outline(body: Body, tab: tuple[float, float], pixel: float) -> FloatArray:
    """Outline (n, 2) of a part with its tab in the middle of its first shortest side [m].

    A tab has a width and a length [m]; a disk has no tab.
    """
    width, length = tab
    if isinstance(body.shape, Disk) or width * length == 0.0:
        return outline_of(body.shape, pixel).points
    corners = body.shape.outline
    along = np.roll(corners, -1, axis=0) - corners
    size = np.hypot(*along.T)
    k = int(np.argmin(np.round(size / size.max(), 6)))
    unit = along[k] / size[k]
    out = np.array([unit[1], -unit[0]])
    middle, half = corners[k] + 0.5 * along[k], 0.5 * min(width, 0.98 * float(size[k])) * unit
    stub = [
        middle - half,
        middle - half + length * out,
        middle + half + length * out,
        middle + half,
    ]
    return polygon(np.concatenate((corners[: k + 1], stub, corners[k + 1 :])), pixel).points


def needle_outline(pusher: Pusher, pixel: float) -> FloatArray:
    """Outline (n, 2) of the needle whose end is the pusher, in the pusher's frame [m]."""
    x = direction_of(pusher)
    y = np.array([-x[1], x[0]])
    side = float(np.ptp(pusher.shape.outline @ y))
    back = np.array([far for far, _ in NEEDLE])[:, None] * -x
    wide = np.array([half for _, half in NEEDLE])[:, None] * side * y
    return polygon(np.concatenate((back - wide, (back + wide)[::-1])), pixel).points


def _ground(size: tuple[int, int], seed: int, *, clean: bool) -> FloatPicture:
    """Render the bright ground (h, w, 3), with some dust out of focus."""
    w, h = size
    ground = np.full((h, w, 3), GROUND, np.float32)
    if clean:
        return ground
    random = stream(seed, "film", "dust")
    u, v = np.meshgrid(np.arange(w), np.arange(h))
    for _ in range(7):
        far = np.hypot(u - random.uniform(0, w), v - random.uniform(0, h))
        size_px, deep = random.uniform(2.0, 6.0), random.uniform(3.0, 11.0)
        spot = np.exp(-0.5 * (far / size_px) ** 2) - 0.4 * np.exp(-0.5 * (far / size_px - 2.0) ** 2)
        ground -= np.asarray(deep * spot, np.float32)[..., None]
    return ground
