"""Groups of repeated pushes: CMU's two-finger pushes, and RPI's trials with nearly equal starts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import shapely

from fixel.datasets.cmu import FINGER_RADIUS, FINGER_SPACING, CmuTwoPoint
from fixel.datasets.rpi_2dgad import Rpi2dgad
from fixel.model import (
    Body,
    Experiment,
    LineDrive,
    PathDrive,
    Polygon,
    Pusher,
    Scene,
    Tripod,
    UniformPressure,
)
from fixel.model.trajectory import wrapped
from fixel.typing import BoolArray, FloatArray
from fixel.uncertainty.error_terms import StartError, even_points
from fixel.uncertainty.start_ensemble import Neighbour, remove_overlap, simulate_starts

MIN_ROWS: Final = 30  # minimum number of rows of a push
JUMP: Final = 4e-3  # [m], minimum distance of two rows that belong to different pushes
WAYPOINTS: Final = 40
READINGS: Final = 3  # number of readings of the tracker that are averaged to a pose
# Maximum time between a reading and the time of interest [s]: blocks may move meanwhile.
OLD: Final = 0.15
MAX_APART: Final = 6e-3  # [m], largest error of the fingers' frame

MASS: Final = 0.1  # [kg]; irrelevant without inertia
CORNERS: Final = 4  # number of straight segments per quarter circle of a finger


class RepeatGroup(NamedTuple):
    """Repeated runs of one push."""

    name: str
    start_pose: str
    object: str
    by_hand: bool  # whether a person placed the object, rather than the previous push
    start: FloatArray  # (runs, 3) measured poses [m, m, rad]
    end: FloatArray  # (runs, 3)
    path: FloatArray  # (n, 4) of the point midway between the fingers: time [s], pose

    @property
    def runs(self) -> int:
        """Number of runs."""
        return len(self.start)

    @property
    def duration(self) -> float:
        """Duration of the push [s]."""
        return float(self.path[-1, 0])


class _RepeatedPush(NamedTuple):
    start: FloatArray | None  # None if it was not tracked
    end: FloatArray | None
    path: FloatArray


def read_groups(folder: Path) -> list[RepeatGroup]:
    """Load groups of at least three runs whose start and end were tracked."""
    runs: dict[str, list[list[_RepeatedPush]]] = {}
    objects: dict[str, str] = {}
    for experiment in CmuTwoPoint().read(folder).experiments():
        start_pose = str(experiment.conditions["start_pose"])
        runs.setdefault(start_pose, []).append(_at_rest(list(_pushes(experiment))))
        objects[start_pose] = str(experiment.conditions["object"])
    groups = []
    for start_pose, own in runs.items():
        for k in range(min(map(len, own))):
            ways = [
                (push.start, push.end, push.path)
                for push in (pushes[k] for pushes in own)
                if push.start is not None and push.end is not None
            ]
            if len(ways) >= 3:
                groups.append(_group(start_pose, objects[start_pose], k, ways))
    return groups


def _at_rest(pushes: list[_RepeatedPush]) -> list[_RepeatedPush]:
    """Replace untracked ends by the next start, and vice versa: blocks rest between pushes."""
    full = list(pushes)
    for k in range(len(full) - 1):
        before, after = full[k], full[k + 1]
        if before.end is None:
            full[k] = before._replace(end=after.start)
        elif after.start is None:
            full[k + 1] = after._replace(start=before.end)
    return full


def _group(
    start_pose: str, kind: str, k: int, ways: list[tuple[FloatArray, FloatArray, FloatArray]]
) -> RepeatGroup:
    first, last, path = ways[0]
    start = np.array([first + _off(way[0], first) for way in ways])
    end = np.array([last + _off(way[1], last) for way in ways])
    return RepeatGroup(f"{start_pose} #{k + 1}", start_pose, kind, k == 0, start, end, path)


def _off(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.append(a[:2] - b[:2], wrapped(a[2] - b[2]))


def rig_noise(groups: Sequence[RepeatGroup]) -> FloatArray:
    """Standard deviations (2,) of measured ends that are due to noise alone [m], [rad].

    Two fingers against an edge fix a block's angle and its distance from them. What varies there
    from run to run is the error of the tracker, and of the camera's place above the robot.
    """
    square, freedom = np.zeros(2), 0
    for group in groups:
        off = group.end - group.end.mean(axis=0)
        heading = group.path[-1, 3]
        across = off[:, 0] * np.cos(heading) + off[:, 1] * np.sin(heading)
        square += ((across**2).sum(), (off[:, 2] ** 2).sum())
        freedom += len(off) - 1
    return np.asarray(np.sqrt(square / freedom))


def _pushes(experiment: Experiment) -> Iterator[_RepeatedPush]:
    """Yield the pushes of a run."""
    channel, pusher = experiment.channel("action"), experiment.pusher
    assert channel is not None
    assert pusher is not None
    action = channel.values[:, 0]
    edges = np.flatnonzero(np.diff(action)) + 1
    for rows in np.split(np.arange(len(action)), edges):
        pose, time = pusher.pose[rows], pusher.time[rows]
        # The first row of a push often still has the fingers at the end of the previous push.
        skip = 0
        while skip < 3 and np.hypot(*(pose[skip + 1] - pose[skip])[:2]) > JUMP:
            skip += 1
        if len(rows) - skip < MIN_ROWS:
            continue
        time, pose = time[skip:], pose[skip:]
        start, end = _seen(experiment, time[0], 1.0), _seen(experiment, time[-1], -1.0)
        thin = np.unique(np.linspace(0, len(time) - 1, WAYPOINTS).round().astype(int))
        path = np.column_stack((time[thin] - time[0], pose[thin]))
        yield _RepeatedPush(start, end, path)


def _seen(experiment: Experiment, instant: float, way: float) -> FloatArray | None:
    """Pose at an instant: mean of the next readings after (way 1) or before it (way -1)."""
    time, pose = experiment.trajectory.time, experiment.trajectory.pose
    late = way * (time - instant)
    near = np.flatnonzero((late >= -1e-9) & (late <= OLD))
    near = near[np.argsort(late[near], kind="stable")][:READINGS]
    return None if len(near) == 0 else np.asarray(pose[near].mean(axis=0))


# --- scenes -------------------------------------------------------------------------------------


def group_scene(group: RepeatGroup) -> Scene:
    """Scene of a group, with the object at the mean of the measured starts.

    The fingers are joined to one shape; the area between them never matters for convex blocks.
    """
    fingers = Polygon(_fingers())
    outline = outline_of(group.object)
    start, reasons = remove_overlap(
        outline,
        group.start.mean(axis=0)[None],
        [Neighbour("fingers", fingers, group.path[0, 1:])],
        MAX_APART,
    )
    assert not reasons[0], f"{group.name}: {reasons[0]}"
    body = Body(
        name="block",
        shape=outline,
        mass=MASS,
        pose=start[0],
        support=UniformPressure(friction=0.3, n_points=16),
    )
    pusher = Pusher(
        name="fingers",
        shape=fingers,
        pose=group.path[0, 1:],
        drive=PathDrive(waypoints=group.path),
        friction=0.3,
    )
    return Scene(bodies=(body,), pushers=(pusher,), duration=group.duration)


def outline_of(kind: str) -> Polygon:
    """Outline of a block about its centroid [m]."""
    if kind == "tri":
        a, b = 58e-3 / 3.0, 27.5e-3 / 3.0
        return Polygon(np.array([[a, -b], [a, 2.0 * b], [-2.0 * a, -b]]))
    return Polygon(
        np.array([[-25e-3, -17.5e-3], [25e-3, -17.5e-3], [25e-3, 17.5e-3], [-25e-3, 17.5e-3]])
    )


def _fingers() -> FloatArray:
    """Outline of two round fingers side by side along y, joined, pushing along x."""
    half = 0.5 * FINGER_SPACING
    line = shapely.LineString([(0.0, -half), (0.0, half)])
    return np.array(line.buffer(FINGER_RADIUS, quad_segs=CORNERS).exterior.coords[:-1])


# --- trials that start alike -------------------------------------------------------------------

NAMES: Final = ("126", "127", "129", "130", "132", "134", "136")

# Square and head of trial 141 on the same rig, and the head's speed there [m/s].
SQUARE: Final = np.array([[-53.8, 53.4], [-53.8, -53.4], [53.4, -53.4], [53.4, 53.4]]) * 1e-3
HEAD: Final = np.array([[-14.3, -14.3], [14.3, -14.3], [14.3, 14.3], [-14.3, 14.3]]) * 1e-3
SPEED: Final = 9.24e-3
SQUARE_MASS: Final = 0.2564

# Range of the head's centre along the side of the square, with at least 1 mm of contact [m].
HEAD_PLACE: Final = (-66e-3, 66e-3)
FRICTION: Final = {
    "mu_pusher": (0.15, 0.6),
    "tripod_radius": (25e-3, 50e-3),
    "friction_centre_x": (-5e-3, 5e-3),
    "friction_centre_y": (-5e-3, 5e-3),
}

MOVED: Final = 0.5e-3  # [m], displacement from which the object counts as moving
AFTER: Final = 1.0  # [s] of motion, before any trial has met a fixel
START_FRAMES: Final = 30  # number of frames before the motion, whose mean is the start


class AlikeGroup(NamedTuple):
    """Trials with nearly the same start pose of the object."""

    name: str
    start: FloatArray  # (n, 3) measured [m, m, rad]
    end: FloatArray  # (n, 3) measured after a second of motion
    error: StartError

    def predicted(self, n: int) -> tuple[FloatArray, BoolArray]:
        """Predict poses (n, 3) after a second of motion, for any place of the head, and a mask."""
        names = ("registration_x", *FRICTION)
        ranges = np.array([HEAD_PLACE, *FRICTION.values()])
        shares = even_points(n, len(names) + 3, seed=6)
        # Shuffle, since neighbours in a Sobol sequence are not independent trials.
        shares = np.random.default_rng(9).permutation(shares)
        values = {
            name: low + (high - low) * shares[:, k]
            for k, (name, (low, high)) in enumerate(zip(names, ranges, strict=True))
        }
        drawn = np.random.default_rng(10).standard_normal((n, 3)) * self.error.size
        scene = _alike_scene(self.start.mean(axis=0))
        fan = simulate_starts(scene, self.error, drawn=drawn, values=values, times=[scene.duration])
        return fan.pose[:, -1], fan.ended


def alike_group(folder: Path) -> AlikeGroup:
    """Load trials 126 to 136 of the square, whose starts are within a millimetre."""
    found = {e.name: e for e in Rpi2dgad().read(folder).experiments() if e.name in NAMES}
    pairs = [_start_and_end(found[name]) for name in NAMES if name in found]
    start, end = (np.array(poses) for poses in zip(*pairs, strict=True))
    spread = start.std(axis=0, ddof=1)
    error = StartError(
        x=float(spread[0]), y=float(spread[1]), theta=float(spread[2]), kind="normal"
    )
    return AlikeGroup("2dgad 126-136, first second of motion", start, end, error)


def _start_and_end(experiment: Experiment) -> tuple[FloatArray, FloatArray]:
    time, pose = experiment.trajectory.time, experiment.trajectory.pose
    still = pose[:START_FRAMES].mean(axis=0)
    first = int(np.argmax(np.hypot(*(pose - still)[:, :2].T) > MOVED))
    last = int(np.searchsorted(time, time[first] + AFTER))
    return still, pose[last - 1 : last + 2].mean(axis=0)


def _alike_scene(start: FloatArray) -> Scene:
    """Scene in which the head moves along -y, as in trial 141, from just above the square."""
    square, head = Polygon(SQUARE), Polygon(HEAD)
    top = 53.6e-3 + 14.3e-3 + 0.6e-3
    body = Body(
        name="square",
        shape=square,
        mass=SQUARE_MASS,
        pose=start,
        support=Tripod(radius=37e-3, friction=0.46),
    )
    pusher = Pusher(
        name="head",
        shape=head,
        pose=np.array([start[0], start[1] + top, 0.0]),
        drive=LineDrive(direction=np.array([0.0, -1.0]), speed=SPEED),
        friction=0.36,
    )
    return Scene(bodies=(body,), pushers=(pusher,), duration=AFTER + 0.06)
