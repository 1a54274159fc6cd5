"""Emulated laboratory: a rendered camera, fixels and a drive at a simulated bench.

In accelerated time the laboratory advances while its pictures are read, and at no other time:
`drive.move` returns only if another thread reads them.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Annotated, Final, NamedTuple

import numpy as np

from fixel.errors import InvalidInput
from fixel.model import LineDrive, PathDrive, PlannedExperiment, Shape, Trajectory, placed
from fixel.model.fields import Value, check_fields, fraction, non_negative, positive
from fixel.model.probability import stream
from fixel.simulation import simulate
from fixel.testbed.frame_source import CameraPicture, FrameSource, Stream
from fixel.testbed.imperfections import felt, touching
from fixel.testbed.motion import SimulatedActuator
from fixel.testbed.simulated import SimulatedTestbed
from fixel.testbed.tactile import TactileReading
from fixel.typing import BoolArray, FloatArray
from fixel.uncertainty.start_ensemble import Neighbour, remove_overlap
from fixel.vision.frame import Frame
from fixel.vision.marks import Rig
from fixel.vision.render import MICROSCOPE, CameraEffects, film, looks_named
from fixel.vision.render.bench import HAND, RenderedBench
from fixel.vision.render.bodies import direction_of
from fixel.vision.render.canvas import FloatPicture
from fixel.vision.render.looks import light
from fixel.vision.render.virtual_camera import Sensor

REACH: Final = (-0.3, 0.3)  # [m] of both axes of the drive
CATCH_UP: Final = 0.05  # [m/s] at which a head that was held up follows its drive
SAMPLES: Final = 4  # of the true motion in each frame
TICK: Final = 2.0**-20  # [s]
REST: Final = 1e-6  # [m/s, rad/s; m, rad] below which a part is at rest
NEAR: Final = 0.02  # of the travel from the planned line, where a move of the head is the push
ASIDE: Final = 5e-3  # [m] by which a person places a part next to what is in its place
ROUNDING: Final = 1e-4  # [m] by which a part that seems to overlap others is moved
JAM: Final = 0.4  # of the travel, at which the head jams in a row with an overload
WAITING: Final = 200  # frames that may wait for their reader
MOMENTS: Final = 20_000  # frames whose truth is stored


@dataclass(frozen=True, slots=True, kw_only=True)
class Faults:
    """Faults of a laboratory; those of single rows occur at the first push of the row only."""

    # Largest errors of a part that is placed roughly, and that a person corrected [m, rad].
    placement: tuple[float, float] = (3e-3, math.radians(3.0))
    corrected: tuple[float, float] = (2e-4, math.radians(0.3))
    # Standard deviation of the error of a time stamp [s].
    jitter: Annotated[float, Value(non_negative, "s")] = 5e-4
    dropped: Annotated[float, Value(fraction)] = 0.003  # probability that a frame is lost [-]
    hidden: Collection[str] = ()  # names of rows in which a hand hides the part for a while
    hand: Annotated[float, Value(positive, "s")] = 1.0  # duration for which it does [s]
    overload: Collection[str] = ()  # names of rows in which the head jams on its way

    def __post_init__(self) -> None:
        check_fields(self, "faults")
        for name in ("placement", "corrected"):
            for value in getattr(self, name):
                non_negative(value, f"faults.{name}")


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


class EmulatedLaboratory:
    """Laboratory whose true scene is simulated while its drive moves the head.

    Its clock is `time.monotonic` in real time. The size of its pictures is that of the lens of the
    rig; see `smaller`. It reads the fixels itself, as `tactile`.

    Examples
    --------
    >>> from fixel.formats.rig_file import rig_of
    >>> from fixel.sampling import thesis_plan
    >>> rig = smaller(rig_of("thesis-tags"), 0.25)
    >>> laboratory = EmulatedLaboratory(rig, truth=SimulatedTestbed(seed=3), seed=3)
    >>> laboratory.prepare(thesis_plan().experiments[0])
    >>> with laboratory.source as source:
    ...     next(source.frames()).picture().shape
    (180, 320, 3)
    """

    trouble = ""  # why the fixels no longer work

    def __init__(
        self,
        rig: Rig,
        *,
        truth: SimulatedTestbed,  # testbed whose true scenes the laboratory has
        seed: int = 1,  # of placements, noise and faults
        faults: Faults | None = None,  # by default the usual ones of a bench
        pace: float = 0.0,  # 0: accelerated time, the camera waits for its reader; 1: real time
        looks: CameraEffects | None = None,  # without disturbances; by default as suits the rig
        rate: float = 30.0,  # of frames [Hz]
    ) -> None:
        if pace not in (0.0, 1.0):
            raise InvalidInput("pace", found=pace, expected="0 (accelerated) or 1 (real time)")
        self.rig, self.rate = rig, positive(rate, "rate", "Hz")
        self.stream = Stream(
            rig.camera.lens.image_size,
            rate,
            jpeg=False,
            live=pace == 1.0,
            simulated_by=f"fixel emulated laboratory, seed {seed}",
        )
        # Times since zero are whole ticks: exact, so that the same seed gives the same pictures.
        self._zero, self._now = float(math.floor(time.monotonic())), 0.0
        self._truth, self._seed, self._faults = truth, seed, faults or Faults()
        self._pixel = rig.camera.metres_per_pixel()
        looks = looks or looks_named("microscope" if self._pixel < MICROSCOPE else "thesis")
        self._looks = replace(looks, light_change=0.0, colour_change=0.0, occlusion=0.0)
        self.drive = SimulatedActuator(  # its coordinates are those of the head in the world
            n_axes=2,
            reach=REACH,
            ripple=truth.ripple,
            frequency=truth.ripple_frequency,
            clock=self.clock,
        )
        self.tactile = self
        self.moments: deque[Moment] = deque(maxlen=MOMENTS)  # of the last frames, for tests only
        self._lock = threading.RLock()
        self._sensor = Sensor(self._looks, self.stream.size, seed)
        self._frame = self._placings = 0
        self._view: RenderedBench | film.BrightField | None = None

    def clock(self) -> float:
        """Return the time of the laboratory [s]."""
        return time.monotonic() if self.stream.live else self._zero + self._now

    @property
    def source(self) -> LaboratoryCamera:
        """New source of the pictures from now on."""
        return LaboratoryCamera(self)

    # --- the person at the bench ------------------------------------------------------------------

    def prepare(self, planned: PlannedExperiment, done: int = 0) -> None:
        """Place fixels and part of a row, the part roughly; the head stays where it is.

        `done` is the number of pushes that the row has had: only the first has the faults of a row.
        """
        # Every repetition has its own scatter.
        run = replace(planned, name=f"{planned.name} {done + 1}") if done else planned
        scene, head = self._truth.true_scene(run), planned.scene.pushers[0]
        simulate(scene, duration=1e-6)  # compiles here and not while the pictures run
        drive, along = head.drive, placed(direction_of(head), (0.0, 0.0, head.pose[2]))
        with self._lock:
            self._planned, self._done, self._scene, self._along = planned, done, scene, along
            self._travel = (
                drive.distance(planned.scene.duration)
                if isinstance(drive, LineDrive)
                else float(np.ptp(drive.waypoints[:, 1:3] @ along))
            )
            self._pushing, self._jam = False, math.inf
            self._commanded = self.drive.place()
            self._head = np.append(self._commanded, head.pose[2])
            self._hand = film.Occlusion(scene, self.rig, self._looks, np.zeros(1), self._seed)
            self._view = film.view_of(scene, self.rig, self._looks, self._seed, self._view)
            self._place(self._faults.placement)

    def nudge(self) -> None:
        """Correct the place of the part, as a person does who watches the picture."""
        with self._lock:
            self._place(self._faults.corrected)

    def _place(self, error: tuple[float, float]) -> None:
        """Place the part with a random error [m, rad], next to what is there."""
        self._placings += 1
        random = stream(self._seed, "placed", self._planned.name, str(self._placings))
        way, far = random.uniform(0.0, 2.0 * math.pi), error[0] * math.sqrt(random.uniform())
        off = (far * math.cos(way), far * math.sin(way), random.uniform(-error[1], error[1]))
        self._part = self._shifted(self._planned.scene.bodies[0].pose + np.array(off), ASIDE)
        self._twist, self._touches = np.zeros(3), np.zeros(len(self._scene.fixels), np.bool_)
        self._still: Callable[[], FloatPicture] | None = None  # light of a scene at rest

    def _shifted(self, pose: FloatArray, most: float, *, head: bool = True) -> FloatArray:
        """Return a pose of the part moved out of fixels and head, if there is space nearby."""
        there = [Neighbour(own.name, own.shape, own.pose) for own in self._scene.fixels]
        if head:
            there.append(Neighbour("head", self._scene.pushers[0].shape, self._head))
        return _outside(self._scene.bodies[0].shape, pose, there, most)

    # --- motion -----------------------------------------------------------------------------------

    def advance(self) -> CameraPicture | None:
        """Advance to the next frame; return its picture, or None if it is lost."""
        with self._lock:
            if self._view is None:
                raise InvalidInput("laboratory", found="no row", expected="a prepared row")
            self._frame += 1
            before = self._now
            now = self.clock() - self._zero if self.stream.live else before + 1.0 / self.rate
            self._now = round(now / TICK) * TICK
            tracks = self._moved(before, self._now)
            return self._taken(self._view, tracks, self._now - 0.5 * self._looks.exposure)

    def _moved(self, before: float, now: float) -> dict[str, Trajectory]:
        """Move the head after its drive from one time to another, and the part with it [s]."""
        way, body, pusher = self._way(now - before), self._scene.bodies[0], self._scene.pushers[0]
        if way.any() or self._twist.any():
            with suppress(InvalidInput):
                return self._simulated(self._part, self._head, self._head + way, before, now)
            # A squeezed part may overlap by the tolerance of the simulation.
            part = self._shifted(self._part, ROUNDING, head=False)
            there = [Neighbour(body.name, body.shape, part)]
            head = _outside(pusher.shape, self._head, there, ROUNDING)
            with suppress(InvalidInput):
                return self._simulated(part, head, self._head + way, before, now)
        # Nothing moves, or the head stood where the part was placed, and leaves.
        poses = {body.name: [self._part, self._part], pusher.name: [self._head, self._head + way]}
        self._head, self._twist = self._head + way, np.zeros(3)
        return {name: Trajectory(time=[before, now], pose=pose) for name, pose in poses.items()}

    def _simulated(
        self, part: FloatArray, head: FloatArray, target: FloatArray, before: float, now: float
    ) -> dict[str, Trajectory]:
        """Simulate the motion of the head to a target, and that of the part."""
        body, pusher = self._scene.bodies[0], self._scene.pushers[0]
        path = np.array([[0.0, *head], [now - before, *target]])
        scene = replace(
            self._scene,
            bodies=(replace(body, pose=part, velocity=self._twist),),
            pushers=(replace(pusher, drive=PathDrive(path, force_limit=pusher.drive.force_limit)),),
            duration=now - before,
        )
        run = simulate(scene, output_interval=(now - before) / SAMPLES)
        self._part, self._head = run.pose[body.name][-1], run.pose[pusher.name][-1]
        twist = run.twist[body.name][-1]
        self._twist = twist if np.abs(twist).max() > REST else np.zeros(3)
        self._touches = touching(run)[-1]
        return {
            name: Trajectory(time=before + run.time, pose=pose) for name, pose in run.pose.items()
        }

    def _way(self, step: float) -> FloatArray:
        """Return the motion (3,) of the head in a time step, were there no force on it [m]."""
        place = self.drive.place()
        driven = float(np.hypot(*(place - self._commanded)))
        self._commanded, way = place, place - self._head[:2]
        far = float(np.hypot(*way))
        if far < 1e-9:
            return np.zeros(3)
        way *= min(1.0, (driven + CATCH_UP * step) / far)
        after = self._head[:2] + way - self._planned.scene.pushers[0].pose[:2]
        along = float(after @ self._along)
        if along > self._jam and way @ self._along > 0.0:
            return np.zeros(3)
        across = float(np.hypot(*(after - along * self._along)))
        near = NEAR * self._travel
        if not self._pushing and along > near and across < near:
            self._begin_push(self._travel * step / max(driven, 1e-9))
        return np.append(way, 0.0)

    def _begin_push(self, seconds: float) -> None:
        """Begin a push of a given duration [s], with the faults of its row if it is the first."""
        name, faults, self._pushing = self._planned.name, self._faults, True
        if name in faults.overload and not self._done:
            self._jam = JAM * self._travel
        if name in faults.hidden and not self._done:
            looks = replace(self._looks, occlusion=faults.hand)
            times = self._now + np.array([0.0, seconds])
            self._hand = film.Occlusion(self._scene, self.rig, looks, times, self._seed)

    # --- picture and fixels -----------------------------------------------------------------------

    def _taken(
        self, view: RenderedBench | film.BrightField, tracks: dict[str, Trajectory], middle: float
    ) -> CameraPicture | None:
        """Take the picture of an exposure about `middle` [s]; None if it is lost."""
        random = stream(self._seed, "stamp", str(self._frame))
        # Limited, so that the order of frames is preserved.
        most = 0.3 / self.rate
        error = float(np.clip(self._faults.jitter * random.standard_normal(), -most, most))
        stamp = self._zero + middle + error
        lost = bool(random.random() < self._faults.dropped)
        instants = film.exposure_times(tracks, middle, self._looks.exposure, self._pixel)
        poses = [film.poses_at(tracks, instant, self._hand, self._scene) for instant in instants]
        part, head = (track.at(middle) for track in tracks.values())
        hidden, bits = HAND in poses[0], self._felt(random)
        self.moments.append(
            Moment(self._zero + middle, stamp, part, head, self._touches, bits, hidden, lost)
        )
        if lost:
            return None
        moving = any(np.ptp(track.pose, axis=0).max() > REST for track in tracks.values())
        still = None if moving or hidden else self._still
        shown = still or cache(partial(view.light, poses))
        self._still = None if moving or hidden else shown
        tint, n = light(self._looks, np.array([middle]), self._seed)[0], self._frame
        frame = Frame(stamp, size=view.size, colours=lambda: self._sensor.exposed(shown(), tint, n))
        if self.stream.live:  # frames are lost meanwhile, as those of a slow camera
            return CameraPicture(pixels=frame.picture, time=time.monotonic(), captured=stamp)
        return CameraPicture(stamp, captured=stamp, rendered=frame)

    def _felt(self, random: np.random.Generator) -> int:
        """Return the tactile byte as reported, with false and missed contacts."""
        touches, truth = self._touches, self._truth
        reported = felt(touches, truth.false_contact, truth.missed_contact, random)
        on = {fixel.name for fixel, own in zip(self._scene.fixels, reported, strict=True) if own}
        bits = sum(1 << bit for bit, name in enumerate(self.rig.tactile) if name in on)
        return bits if len(touches) else -1

    def read(self) -> TactileReading:
        """Return the reading of the newest frame."""
        return self.at(math.inf)

    def at(self, time: float) -> TactileReading:
        """Return the reading of the frame whose stamp is nearest to a time [s]."""
        recent = list(self.moments)[-WAITING:]
        if not recent or recent[-1].bits < 0:
            return TactileReading(None, self.clock(), problem="no reading")
        time = min(time, recent[-1].stamp)
        near = min(recent, key=lambda moment: abs(moment.stamp - time))
        return TactileReading(near.bits, near.time)


class LaboratoryCamera(FrameSource):
    """Camera of an emulated laboratory."""

    name = "emulated laboratory"

    def __init__(self, laboratory: EmulatedLaboratory) -> None:
        self._laboratory = laboratory
        self._stop = threading.Event()

    def open(self) -> Stream:
        """Return the properties of the camera."""
        return self._laboratory.stream

    def frames(self) -> Iterator[CameraPicture]:
        """Yield pictures until the source is closed; each advances the laboratory by one frame."""
        own = self._laboratory
        due = own.clock()
        while not self._stop.is_set():
            if own.stream.live:
                # Frames that are due while one is rendered are lost, as those of a slow camera.
                due = max(due + 1.0 / own.rate, own.clock())
                self._stop.wait(due - own.clock())
            if (picture := own.advance()) is not None:
                yield picture
        self.ended = "stopped"

    def close(self) -> None:
        """End `frames`."""
        self._stop.set()


def _outside(shape: Shape, pose: FloatArray, there: list[Neighbour], most: float) -> FloatArray:
    """Return a pose moved out of neighbours by at most `most` [m], or the pose itself."""
    moved, reasons = remove_overlap(shape, pose[None], there, most)
    return pose if reasons[0] else np.asarray(moved[0])


def smaller(rig: Rig, factor: float) -> Rig:
    """Return a rig with the same view in fewer pixels, by the ratio of the widths [-]."""
    width, height = (round(positive(factor, "factor") * n) for n in rig.camera.lens.image_size)
    measured = rig.measured and rig.measured.for_pictures_of((width, height), rescale=True)
    if measured is not None:
        return replace(rig, camera=measured.placed(), measured=measured)
    lens = rig.camera.lens.for_pictures_of((width, height), rescale=True)
    return replace(rig, camera=replace(rig.camera, lens=lens))
