"""Measure a bench, and compare it with what a plan needs."""

from __future__ import annotations

import json
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from itertools import islice
from typing import Final, NamedTuple

import numpy as np
import shapely

from fixel.errors import DeviceFailed, InvalidInput
from fixel.formats.scene_file import SceneFile, scene_dict
from fixel.model import Experiment, PlannedExperiment, Scene, placed
from fixel.simulation.geometry import gap
from fixel.table import Table
from fixel.typing import FloatArray
from fixel.vision.frame import Frame
from fixel.workflows.acquisition.overlay import Overlay, frames_of
from fixel.workflows.bench.devices import BenchDevices, inside

PICTURES: Final = 60  # of resting markers
MOVES: Final = 10  # to the same place
SETTLED: Final = 5  # pictures after each move
WAITING: Final = 5  # pictures that may show what was before
ROOM: Final = 0.02  # [m] of these moves at most
LEAST: Final = 0.002  # [m] of these moves at least
READINGS: Final = 50  # of the tactile board
LASTING: Final = 4  # readings in a row with contact; single ones may be false
NEAR: Final = 0.005  # [m] between part and fixel, over which its approach is a straight line
CLEAR: Final = 0.0003  # [m] between them that the camera's noise does not close
SHARE: Final = 0.2  # of the tolerance: an error of this size adds 2 % to one of the tolerance's
UNITS: Final = {"mm": 1e3, "deg": 180.0 / np.pi, "ms": 1e3}

Move = Callable[[list[FloatArray], Callable[[Frame], None], Callable[[], None]], None]
"""Moves the head through places; called with each picture, and before each move."""


class BenchFigure(NamedTuple):
    """Measured property of a bench."""

    name: str
    value: float | None  # [m, rad or s]; None where it was not measured
    needed: float  # largest value with which the plan can be performed [m, rad or s]
    unit: str  # in which it is shown
    source: str  # how it was measured, or why not

    @property
    def verdict(self) -> str:
        """One of `good`, `too large` and `not measured`."""
        if self.value is None:
            return "not measured"
        return "good" if abs(self.value) <= self.needed else "too large"


class BenchRun(NamedTuple):
    """Accepted attempt: its row, the scene as it was shown, and its experiment."""

    row: PlannedExperiment
    scene: Scene
    experiment: Experiment


def figure_table(figures: Sequence[BenchFigure]) -> Table:
    """Return what was measured as a table."""
    rows = []
    for own in figures:
        unit = UNITS[own.unit]
        value = "-" if own.value is None else f"{unit * own.value:.3f} {own.unit}"
        needed = f"{unit * own.needed:.3f} {own.unit}"
        rows.append((own.name, value, needed, own.verdict, own.source))
    head = ("measured", "value", "at most", "verdict", "from")
    return Table(head, rows, left=5, title="Check of the bench")


def measure_bench(
    devices: BenchDevices, overlay: Overlay, performed: Sequence[BenchRun], move: Move
) -> tuple[BenchFigure, ...]:
    """Measure camera, drive, tactile board, and the experiments so far.

    The head moves to the start of the push, and ten times over at most half of its way to the part.
    Raise `InvalidInput` if the part is not seen, or is in the way of the head, and `DeviceFailed`
    if the camera was lost or a stop was requested.
    """
    part = _tracked(overlay, _frames(devices, PICTURES), overlay.scene.bodies[0].name)[:, 1:]
    if len(part) < PICTURES // 2:
        raise InvalidInput("part", found="no part", expected="the part of the first row")
    way = devices.way_to(overlay.scene, np.median(part, axis=0))
    if way is None:
        raise InvalidInput("part", found="it in the way of the head", expected="a free way")
    move(way, lambda frame: None, lambda: None)
    return (
        *_noise(part, overlay),
        *_drive(devices, overlay, np.median(part, axis=0), move),
        *_experiments(performed, overlay),
        *_board(devices, performed),
    )


def _tracked(overlay: Overlay, frames: Sequence[Frame], name: str) -> FloatArray:
    """Return times and poses (n, 4) of a part where it is seen, with continuous angles."""
    looks = [(own.time, part) for own in frames for part in overlay.look(own).parts]
    rows = [(t, *own.measured) for t, own in looks if own.name == name and own.measured is not None]
    time, x, y, angle = np.reshape(rows, (-1, 4)).T
    return np.column_stack((time, x, y, np.unwrap(angle)))  # stickers show half a turn each way


def _frames(devices: BenchDevices, n: int) -> list[Frame]:
    """Return the next pictures; those that waited for their reader are left out."""
    camera = devices.camera
    with closing(frames_of(camera.view(), camera.stream.live)) as frames:  # type: ignore[type-var]
        found = list(islice(frames, WAITING + n))[WAITING:]
    if len(found) < n:
        raise DeviceFailed(f"the camera stopped: {camera.reason}")
    return found


def _noise(part: FloatArray, overlay: Overlay) -> Iterator[BenchFigure]:
    spread, tolerance = part.std(axis=0, ddof=1), overlay.tolerance
    source = f"{len(part)} pictures of the resting part; standard deviation"
    place = float(np.sqrt(np.mean(spread[:2] ** 2)))
    yield BenchFigure("camera noise", place, SHARE * tolerance.distance, "mm", source)
    angle, needed = float(spread[2]), SHARE * tolerance.angle
    yield BenchFigure("camera noise, angle", angle, needed, "deg", source)


def _drive(
    devices: BenchDevices, overlay: Overlay, part: FloatArray, move: Move
) -> Iterator[BenchFigure]:
    """Yield repeatability and latency, from moves towards the part that end before it."""
    scene, push = overlay.scene, devices.stroke(overlay.scene)
    head, body = scene.pushers[0], scene.bodies[0]
    outlines = placed(head.shape.outline, head.pose), placed(body.shape.outline, part)
    free = shapely.Polygon(outlines[0]).distance(shapely.Polygon(outlines[1]))
    room = min(ROOM, 0.5 * free, push.travel)
    along = np.array(head.drive.direction)  # type: ignore[union-attr]
    places, delays = [], []
    for _ in range(MOVES if room >= LEAST else 0):
        seen: list[Frame] = []
        begun: list[float] = []
        move(
            [push.start + room * push.direction],
            seen.append,
            lambda begun=begun: begun.append(devices.clock()),  # type: ignore[misc]
        )
        move([push.start], lambda frame: None, lambda: None)
        rest = _tracked(overlay, _frames(devices, SETTLED), head.name)
        if not len(rest):
            continue
        places.append(rest[:, 1:3].mean(axis=0))
        track = _tracked(overlay, seen, head.name)
        far = (track[:, 1:3] - places[-1]) @ along
        under_way = (far > 0.2 * room) & (far < 0.8 * room)
        if under_way.sum() > 2:  # a line through the motion, back to where it began
            line = np.polyfit(far[under_way], track[under_way, 0], 1)
            delays.append(float(line[1]) - begun[0])
    why = f"{1e3 * free:.1f} mm between head and part" if room < LEAST else "the head is not seen"
    scatter = float(np.sqrt(np.var(places, axis=0, ddof=1).sum())) if len(places) > 1 else None
    source = f"{len(places)} moves to one place, seen by the camera" if places else why
    needed = SHARE * overlay.tolerance.distance
    yield BenchFigure("repeatability of the drive", scatter, needed, "mm", source)
    delay = min(delays, default=None)  # a busy computer begins a move late, never early
    source = f"{len(delays)} moves: shortest onset in the pictures after the begin of the move"
    interval = 1.0 / (devices.camera.stream.rate or 30.0)
    yield BenchFigure("latency of the camera", delay, interval, "ms", source if delays else why)


def _experiments(performed: Sequence[BenchRun], overlay: Overlay) -> Iterator[BenchFigure]:
    """Yield the error of placement, and the scatter of the ends of equal pushes."""
    starts, ends = [], defaultdict(list)
    for row, scene, experiment in performed:
        planned, pose = scene.bodies[0].pose, experiment.trajectory.pose
        starts.append(float(np.hypot(*(pose[0] - planned)[:2])))
        same = json.dumps(scene_dict(SceneFile(scene=row.scene)))
        ends[same].append(inside(planned, pose[-1, :2]))
    needed, n = overlay.tolerance.distance, len(starts)
    error = float(np.sqrt(np.mean(np.square(starts)))) if starts else None
    source = f"starts of {n} experiments; root mean square" if n else "no experiments yet"
    yield BenchFigure("error of placement", error, needed, "mm", source)
    off = [own - np.mean(own, axis=0) for own in map(np.array, ends.values()) if len(own) > 1]
    scatter, source = None, "no equal pushes yet"
    if off:
        total = sum(map(len, off))
        scatter = float(np.sqrt(np.square(np.concatenate(off)).sum() / (total - len(off))))
        source = f"ends of {total} pushes in {len(off)} groups of equal ones"
    yield BenchFigure("scatter between runs", scatter, needed, "mm", source)


def _board(devices: BenchDevices, performed: Sequence[BenchRun]) -> Iterator[BenchFigure]:
    """Yield the round trip of the tactile board and its delay, if there is one."""
    if devices.tactile is None:
        return
    trips = []
    for _ in range(READINGS):
        begun = time.perf_counter()
        if devices.tactile.read().bits is not None:
            trips.append(time.perf_counter() - begun)
    value = float(np.median(trips)) if trips else None
    source = f"{len(trips)} of {READINGS} readings" if trips else "no reading"
    interval = 1.0 / (devices.camera.stream.rate or 30.0)
    yield BenchFigure("round trip of the tactile board", value, 0.5 * interval, "ms", source)
    delays = [delay for run in performed for delay in contact_delays(run)]
    value = float(np.median(delays)) if delays else None
    source = f"{len(delays)} contacts with fixels, after the outlines meet in the pictures"
    source = source if delays else "no contact with a fixel yet"
    yield BenchFigure("delay of the tactile board", value, interval, "ms", source)


def contact_delays(run: BenchRun) -> Iterator[float]:
    """Yield how long after the outlines meet in the pictures each fixel reports contact [s].

    A straight line through the distances of the last `NEAR` metres gives the instant in which part
    and fixel meet. The report comes between two readings of the board; their middle counts.
    """
    scene, trajectory = run.scene, run.experiment.trajectory
    channel = run.experiment.channel("tactile")
    if channel is None:
        return
    body = scene.bodies[0]
    for fixel, reported in zip(scene.fixels, channel.values.T, strict=True):
        kept = np.convolve(reported, np.ones(LASTING), "valid") == LASTING
        first = int(np.argmax(kept))
        if first == 0 or reported[first - 1] != 0.0:  # none, or not seen to begin
            continue
        onset = 0.5 * float(channel.time[first - 1] + channel.time[first])
        before = abs(trajectory.time - onset) < 1.0
        times, poses = trajectory.time[before], trajectory.pose[before]
        apart = np.array([gap(body.shape, p, fixel.shape, fixel.pose).distance for p in poses])
        use = (apart > CLEAR) & (apart < NEAR)
        if use.sum() > 2 and np.ptp(apart[use]) > 0.2 * NEAR:
            yield onset - float(np.polyval(np.polyfit(apart[use], times[use], 1), 0.0))
