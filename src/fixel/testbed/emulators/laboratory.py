"""Emulated laboratory: a rendered camera, fixels and a drive at a simulated bench.

    laboratory = EmulatedLaboratory(smaller(rig, 0.5), truth=SimulatedTestbed(seed=3), seed=3)
    laboratory.prepare(planned)  # a person places fixels and part, about where they belong
    with laboratory.source as source, laboratory.drive as drive:
        source.open()
        for picture in source.frames():  # each picture advances the laboratory by one frame
            ...

In accelerated time the laboratory advances while its pictures are read, and at no other time:
`drive.move` returns only if another thread reads them. Coordinates of the drive are those of the
middle of the head in the world.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model import LineDrive, PathDrive, PlannedExperiment, Scene, Trajectory, placed
from fixel.model.fields import fraction, non_negative, positive
from fixel.model.probability import stream
from fixel.simulation import simulate
from fixel.testbed.frame_source import CameraPicture, FrameSource, Stream
from fixel.testbed.imperfections import nominal_friction, touching
from fixel.testbed.motion import SimulatedActuator
from fixel.testbed.simulated import SimulatedTestbed
from fixel.testbed.tactile import TactileReading
from fixel.typing import BoolArray, FloatArray
from fixel.uncertainty.start_ensemble import Neighbour, remove_overlap
from fixel.vision.marks import Rig
from fixel.vision.render import CameraEffects, looks_named
from fixel.vision.render.bench import HAND, RenderedBench
from fixel.vision.render.bodies import direction_of
from fixel.vision.render.canvas import FloatPicture
from fixel.vision.render.film import exposure_times, occlusion_of, poses_at
from fixel.vision.render.looks import light
from fixel.vision.render.virtual_camera import Sensor

RATE: Final = 30.0  # [frames/s]
REACH: Final = (-0.3, 0.3)  # [m] of both axes of the drive
CATCH_UP: Final = 0.05  # [m/s] at which a head that was held up follows its drive
SAMPLES: Final = 4  # of the true motion in each frame
REST: Final = 1e-6  # [m/s, rad/s; m, rad] below which a part is at rest
NEAR: Final = 5e-4  # [m] from the planned line, within which a move of the head is the push
ASIDE: Final = 5e-3  # [m] by which a person places a part beside what is in its place
TICK: Final = 2.0**-20  # [s]
MOMENTS: Final = 20_000  # that are stored, eleven minutes
JAM: Final = 0.4  # of the travel, at which the head jams in a row with an overload


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Faults:
    """Faults of a laboratory.

    Faults of single rows occur at the first push of that row only, so that its repetition succeeds.
    """

    # Largest errors of a part that is placed roughly, and once the person has corrected it
    # [m, rad].
    placement: tuple[float, float] = (3e-3, math.radians(3.0))
    corrected: tuple[float, float] = (2e-4, math.radians(0.3))
    jitter: float = 5e-4  # standard deviation of the error of a time stamp [s]
    dropped: float = 0.003  # probability that a frame is lost [-]
    hidden: Collection[str] = ()  # names of rows in which a hand hides the part for a while
    hand: float = 1.0  # duration for which it does [s]
    overload: Collection[str] = ()  # names of rows in which the head jams on its way


class Moment(NamedTuple):
    """Hidden truth at one frame."""

    time: float  # middle of the exposure, on the clock of the laboratory [s]
    stamp: float  # time that the camera reports [s]
    part: FloatArray  # pose of the part in the middle of the exposure (3,) [m, m, rad]
    head: FloatArray  # pose of the head (3,) [m, m, rad]
    touches: BoolArray  # whether the part touches each fixel of the scene (n_fixel,)
    bits: int  # tactile byte as reported; -1 without fixels
    hidden: bool  # whether a hand is in the picture
    lost: bool  # whether the frame was lost


class _Push(NamedTuple):
    """Planned motion of the head in the world."""

    start: FloatArray  # (2,) [m]
    direction: FloatArray  # (2,) unit vector
    travel: float  # [m]


@final
class EmulatedLaboratory:
    """Laboratory whose true scene is simulated while its drive moves the head.

    Parameters
    ----------
    rig : Rig
        Camera, whose lens determines the size of the pictures, and markers; see `smaller`.
    truth : SimulatedTestbed
        Testbed whose true scenes the laboratory has.
    seed : int
        Seed of placements, noise and faults.
    faults : Faults, optional
        Faults; the usual ones of a bench by default.
    pace : float
        0 for accelerated time, in which the camera waits for its reader; 1 for real time.
    looks : CameraEffects, optional
        Light, lens and sensor; those of the thesis by default. Its faults are not used.
    rate : float
        Frame rate [Hz].

    Attributes
    ----------
    drive : SimulatedActuator
        Drive with two axes, parallel to those of the world.
    tactile : LaboratoryFixels
    moments : deque of Moment
        Hidden truth at the last frames, which only tests may read.

    Raises
    ------
    InvalidInput
        A fault or the pace is out of range.

    Examples
    --------
    >>> from fixel.formats.rig_file import rig_of
    >>> from fixel.sampling import thesis_plan
    >>> laboratory = EmulatedLaboratory(
    ...     smaller(rig_of("thesis-tags"), 0.25), truth=SimulatedTestbed(seed=3), seed=3
    ... )
    >>> laboratory.prepare(thesis_plan().experiments[0])
    >>> with laboratory.source as source, laboratory.drive as drive:
    ...     source.open().size
    ...     picture = next(source.frames())
    (320, 180)
    >>> picture.pixels.shape
    (180, 320, 3)
    """

    def __init__(
        self,
        rig: Rig,
        *,
        truth: SimulatedTestbed,
        seed: int = 1,
        faults: Faults | None = None,
        pace: float = 0.0,
        looks: CameraEffects | None = None,
        rate: float = RATE,
    ) -> None:
        if pace not in (0.0, 1.0):
            raise InvalidInput("pace", found=pace, expected="0 (accelerated) or 1 (real time)")
        self.rig, self.live, self.rate = rig, pace == 1.0, positive(rate, "rate", "Hz")
        self._truth, self._seed = truth, seed
        self._faults = _checked(faults or Faults())
        chosen = looks or looks_named("thesis")
        self._looks = replace(chosen, light_change=0.0, colour_change=0.0, occlusion=0.0)
        # Times since zero are whole ticks: exact, so that the same seed gives the same pictures.
        self._zero, self._now = float(math.floor(time.monotonic())), 0.0
        self.drive = SimulatedActuator(
            n_axes=2,
            reach=REACH,
            ripple=truth.ripple,
            frequency=truth.ripple_frequency,
            clock=self.clock,
        )
        self.tactile = LaboratoryFixels(self)
        self.made_by = f"fixel emulated laboratory, seed {seed}"
        self.moments: deque[Moment] = deque(maxlen=MOMENTS)
        self._lock = threading.RLock()
        self._sensor = Sensor(self._looks, rig.camera.lens.image_size, seed)
        self._pixel = rig.camera.metres_per_pixel()
        self._frame = 0  # number of the last frame
        self._placings = 0
        self._pushes: dict[str, int] = {}  # number of pushes by row
        self._view: RenderedBench | None = None

    def clock(self) -> float:
        """Return the time of the laboratory [s], which is `time.monotonic` in real time."""
        return time.monotonic() if self.live else self._zero + self._now

    @property
    def source(self) -> LaboratoryCamera:
        """New source of the pictures from now on."""
        return LaboratoryCamera(self)

    @property
    def true_parameters(self) -> dict[str, float]:
        """Hidden true values in the present row, which only tests may read [SI units]."""
        scene = self._scene
        return {
            "mu_pusher": scene.pushers[0].friction,
            "mu_fixel": max((fixel.friction for fixel in scene.fixels), default=0.0),
            "mu_support": nominal_friction(scene.bodies[0], scene.gravity) or 0.0,
        }

    # --- the person at the bench ------------------------------------------------------------------

    def prepare(self, planned: PlannedExperiment) -> None:
        """Place the fixels and the part of a row, the part only roughly.

        The head stays where its drive is; a part is placed beside it.

        Raises
        ------
        InvalidInput
            The row is no push of one part, or has no true scene.
        """
        done = self._pushes.get(planned.name, 0)
        # Every repetition has its own scatter.
        run = replace(planned, name=f"{planned.name} {done + 1}") if done else planned
        scene = self._truth.true_scene(run)
        simulate(scene, duration=1e-6)  # compiles here and not while the pictures run
        with self._lock:
            self._planned, self._scene, self._push = planned, scene, _push(planned.scene)
            self._pushing, self._jam = False, math.inf
            self._commanded = self.drive.place()
            self._head = np.append(self.drive.place(), planned.scene.pushers[0].pose[2])
            self._hand = occlusion_of(scene, self.rig, self._looks, np.zeros(1), self._seed)
            view = RenderedBench(scene, self.rig, self._looks, self._seed, like=self._view)
            self._view = view
            self._place(self._faults.placement)

    def nudge(self) -> None:
        """Correct the place of the part, as a person does who watches the picture."""
        with self._lock:
            self._place(self._faults.corrected)

    def _place(self, error: tuple[float, float]) -> None:
        """Place the part with a random error [m, rad], beside what is there."""
        self._placings += 1
        random = stream(self._seed, "placed", self._planned.name, str(self._placings))
        way, far = random.uniform(0.0, 2.0 * math.pi), error[0] * math.sqrt(random.uniform())
        off = (far * math.cos(way), far * math.sin(way), random.uniform(-error[1], error[1]))
        self._part = self._beside(self._planned.scene.bodies[0].pose + np.array(off), ASIDE)
        self._twist = np.zeros(3)
        self._touches = np.zeros(len(self._scene.fixels), np.bool_)
        self._still: FloatPicture | None = None

    def _beside(self, pose: FloatArray, most: float) -> FloatArray:
        """Return a pose of the part moved out of head and fixels, if there is space nearby."""
        scene = self._scene
        there = [Neighbour(own.name, own.shape, own.pose) for own in scene.fixels]
        there.append(Neighbour("head", scene.pushers[0].shape, self._head))
        moved, reasons = remove_overlap(scene.bodies[0].shape, pose[None], there, most)
        return pose if reasons[0] else np.asarray(moved[0])

    # --- motion -----------------------------------------------------------------------------------

    def advance(self) -> CameraPicture | None:
        """Advance to the next frame; return its picture, or None if it is lost.

        Raises
        ------
        InvalidInput
            No row was prepared.
        """
        with self._lock:
            if self._view is None:
                raise InvalidInput("laboratory", found="no row", expected="a prepared row")
            self._frame += 1
            before = self._now
            now = self.clock() - self._zero if self.live else before + 1.0 / self.rate
            self._now = round(now / TICK) * TICK
            tracks = self._moved(before, self._now)
            return self._taken(self._view, tracks, self._now - 0.5 * self._looks.exposure)

    def _moved(self, before: float, now: float) -> dict[str, Trajectory]:
        """Move the head after its drive from one time to another, and the part with it [s]."""
        body, pusher = self._scene.bodies[0], self._scene.pushers[0]
        instants, start = np.array([before, now]), self._head
        way = self._way(now - before)
        if not way.any() and not self._twist.any():
            poses = {body.name: self._part, pusher.name: start}
            return {
                name: Trajectory(time=instants, pose=[pose, pose]) for name, pose in poses.items()
            }
        steps = [[0.0, *start], [now - before, *(start + way)]]
        drive = PathDrive(np.array(steps), force_limit=pusher.drive.force_limit)
        moving = replace(pusher, pose=start, drive=drive)
        part = replace(body, pose=self._beside(self._part, 1e-4), velocity=self._twist)
        try:
            scene = replace(self._scene, bodies=(part,), pushers=(moving,), duration=now - before)
        except InvalidInput:  # the head stood where the part was placed, and leaves
            self._head = start + way
            return {
                body.name: Trajectory(time=instants, pose=[self._part, self._part]),
                pusher.name: Trajectory(time=instants, pose=[start, self._head]),
            }
        run = simulate(scene, output_interval=(now - before) / SAMPLES)
        self._part, self._head = run.pose[body.name][-1], run.pose[pusher.name][-1]
        self._twist, self._touches = run.twist[body.name][-1], touching(run)[-1]
        if np.abs(self._twist).max() < REST:
            self._twist = np.zeros(3)
        return {
            name: Trajectory(time=before + run.time, pose=run.pose[name])
            for name in (body.name, pusher.name)
        }

    def _way(self, step: float) -> FloatArray:
        """Return the motion (3,) of the head in a time step, were there no force on it [m]."""
        place = self.drive.place()
        driven = float(np.hypot(*(place - self._commanded)))
        most, self._commanded = driven + CATCH_UP * step, place
        way = place - self._head[:2]
        far = float(np.hypot(*way))
        if far < 1e-9:
            return np.zeros(3)
        way *= min(1.0, most / far)
        push = self._push
        after = self._head[:2] + way - push.start
        along = float(after @ push.direction)
        if along > self._jam and way @ push.direction > 0.0:
            return np.zeros(3)
        beside = float(np.hypot(*(after - along * push.direction)))
        if not self._pushing and along > NEAR and beside < NEAR:
            self._begin_push(self._push.travel * step / max(driven, 1e-9))
        return np.append(way, 0.0)

    def _begin_push(self, seconds: float) -> None:
        """Begin the faults of a row, which only its first push has, of a given duration [s]."""
        name, faults = self._planned.name, self._faults
        self._pushing, done = True, self._pushes.get(self._planned.name, 0)
        self._pushes[name] = done + 1
        if done:
            return
        if name in faults.overload:
            self._jam = JAM * self._push.travel
        if name in faults.hidden:
            looks = replace(self._looks, occlusion=faults.hand)
            times = self._now + np.array([0.0, seconds])
            self._hand = occlusion_of(self._scene, self.rig, looks, times, self._seed)

    # --- picture ----------------------------------------------------------------------------------

    def _taken(
        self, view: RenderedBench, tracks: dict[str, Trajectory], middle: float
    ) -> CameraPicture | None:
        """Take the picture of an exposure about `middle` [s]; None if it is lost."""
        random = stream(self._seed, "stamp", str(self._frame))
        # Limited, so that the order of frames is preserved.
        late = min(abs(error := self._faults.jitter * random.standard_normal()), 0.3 / self.rate)
        stamp = self._zero + middle + math.copysign(late, error)
        lost = bool(random.random() < self._faults.dropped)
        instants = exposure_times(tracks, middle, self._looks.exposure, self._pixel)
        poses = [poses_at(tracks, instant, self._hand, self._scene) for instant in instants]
        body, pusher = self._scene.bodies[0].name, self._scene.pushers[0].name
        self.moments.append(
            Moment(
                time=self._zero + middle,
                stamp=stamp,
                part=tracks[body].at(middle),
                head=tracks[pusher].at(middle),
                touches=self._touches,
                bits=self._felt(random),
                hidden=HAND in poses[0],
                lost=lost,
            )
        )
        if lost:
            return None
        if HAND in poses[0] or any(
            np.ptp(own.pose, axis=0).max() > REST for own in tracks.values()
        ):
            self._still, shown = None, view.light(poses)
        else:
            self._still = shown = view.light(poses) if self._still is None else self._still
        factor = light(self._looks, np.array([middle]), self._seed)[0]
        pixels = self._sensor.exposed(shown, factor, self._frame)
        arrival = time.monotonic() if self.live else stamp
        return CameraPicture(arrival, pixels=pixels, captured=stamp)

    def _felt(self, random: np.random.Generator) -> int:
        """Return the tactile byte as reported, with false and missed contacts."""
        touches, truth = self._touches, self._truth
        if not len(touches):
            return -1
        wrong = random.random(len(touches)) < np.where(
            touches, truth.missed_contact, truth.false_contact
        )
        names = [fixel.name for fixel in self._scene.fixels]
        felt = dict(zip(names, touches ^ wrong, strict=True))
        return sum(bool(felt.get(name)) << bit for bit, name in enumerate(self.rig.tactile))


@final
class LaboratoryCamera(FrameSource):
    """Camera of an emulated laboratory."""

    name = "emulated laboratory"

    def __init__(self, laboratory: EmulatedLaboratory) -> None:
        self._laboratory = laboratory
        self._stop = threading.Event()

    def open(self) -> Stream:
        """Return the properties of the camera."""
        own = self._laboratory
        return Stream(own.rig.camera.lens.image_size, own.rate, False, own.live, own.made_by)

    def frames(self) -> Iterator[CameraPicture]:
        """Yield pictures until the source is closed; each advances the laboratory by one frame."""
        own = self._laboratory
        due = own.clock()
        while not self._stop.is_set():
            if own.live:
                # Frames that are due while one is rendered are lost, as those of a slow camera.
                due = max(due + 1.0 / own.rate, own.clock())
                self._stop.wait(due - own.clock())
            picture = own.advance()
            if picture is not None:
                yield picture
        self.ended = "stopped"

    def close(self) -> None:
        """End `frames`."""
        self._stop.set()


@final
class LaboratoryFixels:
    """Reader of the fixels of an emulated laboratory."""

    trouble = ""

    def __init__(self, laboratory: EmulatedLaboratory) -> None:
        self._laboratory = laboratory

    def read(self) -> TactileReading:
        """Return the reading of the newest frame."""
        return self.at(math.inf)

    def at(self, time: float) -> TactileReading:
        """Return the reading of the frame whose stamp is nearest to a time [s]."""
        moments = self._laboratory.moments.copy()
        if not moments:
            return TactileReading(None, self._laboratory.clock(), problem="no frame yet")
        near = moments[-1] if time == math.inf else min(moments, key=lambda m: abs(m.stamp - time))
        if near.bits < 0:
            return TactileReading(None, near.time, problem="no fixels")
        return TactileReading(near.bits, near.time)


def smaller(rig: Rig, factor: float) -> Rig:
    """Return a rig whose camera takes smaller pictures of the same view.

    Parameters
    ----------
    rig : Rig
    factor : float
        New width over old width of the pictures [-].

    Raises
    ------
    InvalidInput
        The size of the pictures would not be a whole number of pixels.
    """
    lens = rig.camera.lens
    width, height = (round(positive(factor, "factor") * side) for side in lens.image_size)
    if rig.measured is not None:
        measured = rig.measured.for_pictures_of((width, height), rescale=True)
        return replace(rig, camera=measured.placed(), measured=measured)
    shrunk = lens.for_pictures_of((width, height), rescale=True)
    return replace(rig, camera=replace(rig.camera, lens=shrunk))


def _checked(faults: Faults) -> Faults:
    fraction(faults.dropped, "faults.dropped")
    non_negative(faults.jitter, "faults.jitter", "s")
    positive(faults.hand, "faults.hand", "s")
    for error in (*faults.placement, *faults.corrected):
        non_negative(error, "faults.placement")
    return faults


def _push(scene: Scene) -> _Push:
    pusher = scene.pushers[0]
    way = placed(direction_of(pusher), (0.0, 0.0, pusher.pose[2]))
    drive = pusher.drive
    if isinstance(drive, LineDrive):
        return _Push(pusher.pose[:2], way, min(drive.travel, drive.speed * scene.duration))
    return _Push(pusher.pose[:2], way, float(np.ptp(drive.waypoints[:, 1:3] @ way)))
