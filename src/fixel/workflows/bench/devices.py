"""Devices of a bench: camera, tactile board, drive, and how the drive lies in the world."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import shapely

from fixel.errors import DeviceFailed, InvalidInput, check_name
from fixel.formats.rig_file import rig_of
from fixel.model import LineDrive, PlannedExperiment, Scene, placed
from fixel.model.fields import pose_of
from fixel.testbed.frame_source import SharedCamera
from fixel.testbed.motion import AbstractActuator
from fixel.testbed.open_source import check_size, source_of
from fixel.testbed.recorder import TouchReader
from fixel.testbed.tactile import TactileReader
from fixel.typing import FloatArray
from fixel.vision.marks import Rig
from fixel.workflows.acquisition.devices import chosen_actuator
from fixel.workflows.acquisition.record import connected_tactile

if TYPE_CHECKING:
    from fixel.testbed.emulators.laboratory import EmulatedLaboratory

FAST: Final = 0.05  # [m/s] of the head on its way to a start, if its drive can do that
CLEAR: Final = 0.05  # of the radius of the part: between it and the head on its ways
AROUND: Final = 12  # places about the part through which a way may lead
BEHIND: Final = 0.5  # of the radius of the part: from the start of a push to the head after it
SMALLER: Final = 0.75  # pictures of the emulated laboratory: fixels are still found in them
# Rows of the emulated laboratory in which a hand hides a marker, and in which the head jams.
HIDDEN, OVERLOAD = slice(3, None, 10), slice(6, None, 10)
USUAL_SIZE: Final = 0.1  # [m] of parts of the usual laboratory
NO_ZERO: Final = (
    "The position of the drive is unknown: its controller does not home, and counts from the place"
    " where it was switched on. Move the drive by hand to its position 0, which is the withdrawn"
    " end, or with several axes the place from which drive_pose is measured. Then try again (key a)"
)
SETTINGS: Final[Mapping[str, Any]] = {
    "camera": "0", "rig": "", "tactile": "", "driver": "grbl", "port": "", "axes": "X",
    "drive_pose": "", "rate": 30.0,
}  # fmt: skip
"""Settings of a bench with their defaults, as the section `bench` of `fixel.yaml` states them."""


@dataclass(eq=False)
class BenchDevices:
    """Open devices of a bench."""

    camera: SharedCamera
    rig: Rig
    tactile: TouchReader | None
    drive: AbstractActuator
    # Pose (3,) of the coordinates of the drive in the world [m, m, rad]; None for a drive with one
    # axis, which begins every push withdrawn.
    frame: FloatArray | None = None
    clock: Callable[[], float] = time.monotonic  # of the bench [s], which an emulated accelerates
    laboratory: EmulatedLaboratory | None = None  # to which emulated devices belong
    _fast: float = 0.0

    def sleep(self, seconds: float) -> None:
        """Wait for a time on the clock of the bench."""
        until = self.clock() + seconds
        while self.clock() < until and not self.camera.reason:
            time.sleep(0.002)

    # --- moves ----------------------------------------------------------------------------------

    def stroke(self, scene: Scene) -> Stroke:
        """Return the straight push of a scene in coordinates of the drive; raise for another."""
        head = scene.pushers[0]
        way = head.drive
        if len(scene.pushers) != 1 or not isinstance(way, LineDrive):
            raise InvalidInput("scene", found="another path", expected="one straight push")
        n = self.drive.n_axes
        start, direction = np.zeros(n), np.eye(n)[0]
        if self.frame is not None:
            turn = math.atan2(way.direction[1], way.direction[0]) - self.frame[2]
            start[:2] = inside(self.frame, head.pose[:2])
            direction[:2] = math.cos(turn), math.sin(turn)
        travel = way.distance(scene.duration)
        return Stroke(start, direction, travel, way.speed, travel * way.direction)

    def check(self, row: PlannedExperiment) -> None:
        """Raise `InvalidInput` if the drive cannot perform a row; nothing moves."""
        try:
            push = self.stroke(row.scene)
            self.drive.aim(push.start, push.direction)
            self.drive.check(to=0.0, speed=push.speed)
            self.drive.check(to=push.travel, speed=push.speed)
            self._fast = self._fast or self._way_speed(push)
            things = row.scene.bodies[0], row.scene.pushers[0]
            part, head = (placed(own.shape.outline, own.pose) for own in things)
            swept = shapely.MultiPoint(np.concatenate((head, head + push.way))).convex_hull
            if gap := swept.distance(shapely.Polygon(part)):
                found = f"a part {1e3 * gap:.1f} mm away from the way of the head"
                raise InvalidInput("scene", found=found, expected="a part that the push touches")
        except InvalidInput as problem:
            hint = "change the row, or where and how fast the drive can move"
            raise problem.at(f"row {row.name}: {problem.where}", hint) from None

    def _way_speed(self, push: Stroke) -> float:
        """Return the speed [m/s] at which the head moves to a start."""
        try:
            for axis in np.eye(self.drive.n_axes):
                self.drive.aim(push.start, axis)
                self.drive.check(to=0.0, speed=FAST)
        except InvalidInput:
            return push.speed
        return FAST

    def way_to(self, scene: Scene, part: FloatArray | None) -> list[FloatArray] | None:
        """Return places (n_axes,) of the drive on the way to the start of a push, past the part.

        `part` is its present pose (3,) [m, m, rad], if it is seen. None is returned where no way is
        clear.
        """
        end, here = self.stroke(scene).start, self.drive.place()
        if self.frame is None or part is None:
            return [end]
        head, body = scene.pushers[0], scene.bodies[0]
        room = float(np.hypot(*head.shape.outline.T).max()) + CLEAR * _radius(scene)
        first, last = (placed(place[:2], self.frame) for place in (here, end))
        way = clear_way(placed(body.shape.outline, part), first, last, room)
        if way is None:
            return None
        return [np.array([*inside(self.frame, place), *here[2:]]) for place in way[:-1]] + [end]

    def withdrawn(self, scene: Scene) -> FloatArray:
        """Return the place of the drive after a push: behind its start, if the drive gets there."""
        push = self.stroke(scene)
        self.drive.aim(push.start, push.direction)
        behind = max(-BEHIND * _radius(scene), min(self.drive.reach[0], 0.0))
        return push.start + behind * push.direction

    def go(self, places: list[FloatArray], before: Callable[[], None]) -> None:
        """Move the head through places of the drive; `before` is called before each move."""
        for place in places:
            before()
            self.drive.go(place, speed=self._fast)

    def recover_drive(self, at_zero: bool, before: Callable[[], None]) -> bool:
        """Connect a drive whose connection is lost; home it if it is locked. Return whether it was.

        One that does not home must be `at_zero`, as `NO_ZERO` requests of a person; `before` is
        called before homing. `DeviceFailed` is raised where the drive does not answer, or its
        position remains unknown.
        """
        if not self.drive.connected:
            self.drive.connect()
        if not (self.drive.zero_known or at_zero):
            raise DeviceFailed(NO_ZERO)
        self.drive.set_zero()
        state = self.drive_state
        if state == "Alarm":
            before()
            self.drive.home()
        elif state != "Idle":
            self.drive.stop()
        return state == "Alarm"

    @property
    def board_trouble(self) -> str:
        """Why the tactile board is lost; empty while it answers, and without one."""
        why = "" if self.tactile is None else self.tactile.trouble
        return why and f"the tactile board no longer answers: {why}. Then try again (key a)"

    def recover_board(self) -> None:
        """Connect a tactile board that is lost; raise `InvalidInput` if it is not at its port."""
        if isinstance(self.tactile, TactileReader) and not self.tactile.connected:
            connected_tactile(self.tactile)

    @property
    def drive_state(self) -> str:
        """State of the drive as its controller names it; `Idle` for one that names none."""
        if not self.drive.connected:
            raise DeviceFailed("it is not connected", hint="check its cable and power")
        return str(getattr(self.drive, "state", "Idle"))


def _radius(scene: Scene) -> float:
    """Return the radius of the part of a scene about its centroid [m]."""
    body = scene.bodies[0]
    return float(np.hypot(*(body.shape.outline - body.shape.centroid).T).max())


class Stroke(NamedTuple):
    """Straight push in coordinates of the drive."""

    start: FloatArray  # (n_axes,) [m]
    direction: FloatArray  # (n_axes,) unit vector
    travel: float  # [m]
    speed: float  # [m/s]
    way: FloatArray  # (2,) motion of the head in the world [m]


def inside(frame: FloatArray, place: FloatArray) -> FloatArray:
    """Return a place of the world in a frame."""
    c, s = math.cos(frame[2]), math.sin(frame[2])
    return np.asarray(np.array([[c, s], [-s, c]]) @ (place - frame[:2]))


def clear_way(
    outline: FloatArray, here: FloatArray, there: FloatArray, room: float
) -> list[FloatArray] | None:
    """Return places on a way that stays clear of a part.

    The way leads from `here` to `there` (2,) [m], at a distance `room` [m] from the outline (n, 2)
    of the part where it lies. Either end may be nearer; the way does not come nearer than they are.
    The last of the places is `there`; None is returned if no way was found.
    """
    part = shapely.Polygon(outline)
    middle = outline.mean(axis=0)
    # Chords of the ring keep their distance too.
    radius = (float(np.hypot(*(outline - middle).T).max()) + room) / math.cos(math.pi / AROUND)
    turns = np.linspace(0.0, 2.0 * math.pi, AROUND, endpoint=False)
    ring = middle + 1.01 * radius * np.column_stack((np.cos(turns), np.sin(turns)))
    first = int(np.argmin(np.hypot(*(ring - here).T)))
    ways = [[there]]
    for n in range(1, AROUND // 2 + 2):
        for step in (1, -1):
            ways.append([*(ring[(first + step * k) % AROUND] for k in range(n)), there])
    return next((way for way in ways if _is_clear(part, [here, *way], room)), None)


def _is_clear(part: shapely.Polygon, places: list[FloatArray], room: float) -> bool:
    near = [float(part.distance(shapely.Point(place))) for place in places]
    legs = [shapely.LineString(pair) for pair in pairwise(places)]
    return all(
        part.distance(leg) >= min(room, near[k], near[k + 1]) - 1e-9 for k, leg in enumerate(legs)
    )


def settings_of(stored: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a bench: those given, else those of the project, else the defaults.

    Raise `InvalidInput` if the project's settings have another key, or a value of another kind.
    """
    for name, value in stored.items():
        check_name("fixel.yaml: bench", name, SETTINGS)
        kind = type(SETTINGS[name])
        if isinstance(value, bool) or not isinstance(value, (kind, int)):
            raise InvalidInput(
                f"fixel.yaml: bench.{name}", found=repr(value), expected=f"{SETTINGS[name]!r}, say"
            )
    chosen = {name: value for name, value in given.items() if value is not None}
    return {**SETTINGS, **{k: type(SETTINGS[k])(v) for k, v in stored.items()}, **chosen}


@contextmanager
def open_devices(settings: Mapping[str, Any]) -> Iterator[BenchDevices]:
    """Open the devices of a bench by its settings, each of which is named if it is missing.

    Raise `InvalidInput` without a rig, or for a device that is missing or another one, and
    `DeviceFailed` if one does not answer as it should.
    """
    if not settings["rig"]:
        hint = "set rig=FILE, or write it once into fixel.yaml: bench: {rig: FILE}"
        raise InvalidInput("rig", found="none", expected="a rig with camera and markers", hint=hint)
    rig = rig_of(settings["rig"])
    size = rig.camera.lens.image_size
    with ExitStack() as stack:
        camera_opener = partial(source_of, settings["camera"], size=size, rate=settings["rate"])
        camera = SharedCamera(camera_opener)
        stack.callback(camera.close)
        check_size(camera.stream, size, camera.source.name)
        board = settings["tactile"]
        tactile = stack.enter_context(connected_tactile(TactileReader(board))) if board else None
        own = settings["driver"], settings["port"] or None
        drive = stack.enter_context(
            chosen_actuator(*own, axes=settings["axes"], notify=print, keys=False)
        )
        yield BenchDevices(camera, rig, tactile, drive, _frame(settings["drive_pose"], drive))


def _frame(text: str, drive: AbstractActuator) -> FloatArray | None:
    """Return the pose of the drive in the world from text such as `0,-50,90` [mm, mm, deg]."""
    if drive.n_axes == 1:
        return None
    if not text:
        expected = "the pose of the drive's coordinates in the world, for several axes"
        hint = "set drive_pose=X,Y,ANGLE in mm and degrees"
        raise InvalidInput("drive_pose", found="none", expected=expected, hint=hint)
    return pose_of(text, "drive_pose")


@contextmanager
def emulated_devices(
    rows: Sequence[PlannedExperiment], seed: int, rig: str
) -> Iterator[BenchDevices]:
    """Return the devices of an emulated laboratory, whose true scenes are hidden."""
    from fixel.testbed.emulators.laboratory import EmulatedLaboratory, Faults, smaller
    from fixel.testbed.simulated import SimulatedTestbed

    names = [row.name for row in rows]
    usual, faults = SimulatedTestbed(seed=seed), Faults()
    # Lengths of the usual laboratory, at the size of the part.
    extent = float(np.ptp(rows[0].scene.bodies[0].shape.outline, axis=0).max())
    scale = min(1.0, extent / USUAL_SIZE)
    x, y = usual.centre_of_pressure
    lengths = ("centre_of_pressure_spread", "plate_grain", "position_noise")
    scaled: Any = {name: scale * getattr(usual, name) for name in lengths}
    truth = replace(usual, centre_of_pressure=(scale * x, scale * y), **scaled)
    faults = Faults(
        placement=(scale * faults.placement[0], faults.placement[1]),
        corrected=(scale * faults.corrected[0], faults.corrected[1]),
        hidden=names[HIDDEN],
        overload=names[OVERLOAD],
    )
    laboratory = EmulatedLaboratory(
        smaller(rig_of(rig or "thesis-tags"), SMALLER), truth=truth, seed=seed, faults=faults
    )
    laboratory.prepare(rows[0])
    camera = SharedCamera(lambda: laboratory.source)
    with closing(camera), laboratory.drive as drive:
        yield BenchDevices(
            camera, laboratory.rig, laboratory.tactile, drive, np.zeros(3), laboratory.clock,
            laboratory,
        )  # fmt: skip
