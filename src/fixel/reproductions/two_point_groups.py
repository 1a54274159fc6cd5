"""CMU's repeated two-finger pushes as groups: runs of one push from one planned start."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import shapely

from fixel.datasets.cmu_two_point import FINGER_RADIUS, FINGER_SPACING, CmuTwoPoint
from fixel.model import Body, Experiment, PathDrive, Polygon, Pusher, Scene, UniformPressure
from fixel.model.trajectory import wrapped
from fixel.typing import FloatArray
from fixel.uncertainty.apart import Neighbour, set_apart

MIN_ROWS: Final = 30  # of a push
JUMP: Final = 4e-3  # [m], from the last pose of the push before to the first of a push
WAYPOINTS: Final = 40
READINGS: Final = 3  # of the tracker that make one pose
# [s], a reading this far from when it is wanted is none: blocks move meanwhile.
OLD: Final = 0.15
MAX_APART: Final = 6e-3  # [m], how far the frame of the fingers may be off

MASS: Final = 0.1  # [kg]; without inertia it does not matter
CORNERS: Final = 4  # straight pieces a quarter of a finger is drawn with


class RepeatGroup(NamedTuple):
    """One push, several times."""

    name: str
    start_pose: str
    object: str
    by_hand: bool  # whether a person put the object there, or the push before
    start: FloatArray  # (runs, 3) measured [m, m, rad]
    end: FloatArray  # (runs, 3)
    path: FloatArray  # (n, 4) of the fingers' middle: time [s], pose

    @property
    def runs(self) -> int:
        """How many."""
        return len(self.start)

    @property
    def duration(self) -> float:
        """[s]."""
        return float(self.path[-1, 0])


class _RepeatedPush(NamedTuple):
    start: FloatArray | None  # None where nobody saw it
    end: FloatArray | None
    path: FloatArray


def read_groups(folder: Path) -> list[RepeatGroup]:
    """Groups of at least three runs whose start and end were seen."""
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
    """Nothing moves a block between pushes: where one end was not seen, the next start was."""
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
    """(2,) standard deviations of a measured end that no block can have [m], [rad].

    Two fingers against an edge leave a block no freedom to turn, or to be nearer or farther: what
    varies there from run to run is the tracker, and the camera's place over the robot.
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
    """The pushes of a run."""
    channel, pusher = experiment.channel("action"), experiment.pusher
    assert channel is not None
    assert pusher is not None
    action = channel.values[:, 0]
    edges = np.flatnonzero(np.diff(action)) + 1
    for rows in np.split(np.arange(len(action)), edges):
        pose, time = pusher.pose[rows], pusher.time[rows]
        # The first row of a push often still has the fingers where the push before left them.
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
    """The pose at an instant: the mean of the next readings after or before it."""
    time, pose = experiment.trajectory.time, experiment.trajectory.pose
    late = way * (time - instant)
    near = np.flatnonzero((late >= -1e-9) & (late <= OLD))
    near = near[np.argsort(late[near], kind="stable")][:READINGS]
    return None if len(near) == 0 else np.asarray(pose[near].mean(axis=0))


# --- scenes -------------------------------------------------------------------------------------


def group_scene(group: RepeatGroup) -> Scene:
    """What was on the table, the object at the mean of the measured starts.

    The fingers are drawn with what is between them: no block is hollow, so it never matters.
    """
    fingers = Polygon(_fingers())
    outline = outline_of(group.object)
    start, reasons = set_apart(
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
    """Of a block, about its centroid [m]."""
    if kind == "tri":
        a, b = 58e-3 / 3.0, 27.5e-3 / 3.0
        return Polygon(np.array([[a, -b], [a, 2.0 * b], [-2.0 * a, -b]]))
    return Polygon(
        np.array([[-25e-3, -17.5e-3], [25e-3, -17.5e-3], [25e-3, 17.5e-3], [-25e-3, 17.5e-3]])
    )


def _fingers() -> FloatArray:
    """Two round fingers side by side along y, pushing along x."""
    half = 0.5 * FINGER_SPACING
    line = shapely.LineString([(0.0, -half), (0.0, half)])
    return np.array(line.buffer(FINGER_RADIUS, quad_segs=CORNERS).exterior.coords[:-1])
