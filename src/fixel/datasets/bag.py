"""Importer of poses in MCAP files, ROS 2 bags and logs of AprilTags."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np
import scipy  # which loads `scipy.spatial` when it is used

from fixel.datasets.bag_file import Bag, FrameTrack, bag_files, read_bag
from fixel.datasets.base import Importer, ImportPlan, origin_of
from fixel.datasets.files import table_rows
from fixel.datasets.table import plan_table
from fixel.errors import InvalidInput, check_name, unknown_name
from fixel.typing import BoolArray, FloatArray

DATASET: Final = "bag"
GAP: Final = 1.0  # [s] between pushes; longer ones are never interpolated
MAX_TILT: Final = 15.0  # [deg]

_OPTIONS: Final = {
    "part": "topic or frame of the part",
    "pusher": "topic or frame of the pusher, or its joints: X,Y",
    "reference": "frame whose x and y axes span the plane; by default the parent of the part",
    "split_by": "topic whose values name the pushes, or seconds without poses; by default 1",
    "name": "name of the experiment; by default that of the file",
    "object_name": "name of the object",
    "simulated_by": "simulator that wrote the bag, if it was not measured",
    "scene": "scene file with object, pusher and fixels",
}


class BagImporter(Importer):
    """Importer of poses in MCAP files and bags; one experiment for each push."""

    name = DATASET
    title = "MCAP file, ROS 2 bag (.db3), or AprilTag log (.jsonl), with poses of part and pusher"
    licence = "yours"
    citation = ""
    options: ClassVar[Mapping[str, str]] = _OPTIONS

    def recognised(self, source: Path) -> bool:
        """Whether the name of a file ends like that of a bag, or a folder has such files."""
        return bool(bag_files(source))

    def _plan(self, source: Path, options: Mapping[str, object]) -> ImportPlan:
        own: dict[str, Any] = dict(options)
        bag, scene = read_bag(source), own.pop("scene", None)
        roles = {role: own.pop(role, None) for role in ("part", "pusher", "reference")}
        split_by = own.pop("split_by", None)
        columns, notes = _Roles.of(bag, source.name, **roles).columns(bag, split_by)
        split = "push" if len({*columns["push"]}) > 1 else None
        if split is None:
            del columns["push"]
        rows = table_rows(columns, source.name)
        origins = [origin_of(path) for path in bag_files(source)]
        origin = replace(origins[0], source=source.name)
        if len(origins) > 1:
            origin = replace(origin, sha256=" ".join(str(one.sha256) for one in origins))
        choice = Path(scene) if isinstance(scene, str) else scene
        settled = {"angle_unit": "rad", **own}
        plan = plan_table(rows, source, origin, settled, choice, split, dataset=DATASET)
        return replace(plan, understood=(*notes, *plan.understood))


class _Roles(NamedTuple):
    """Frames or topics of part, pusher and reference."""

    where: str
    part: str
    pusher: str | None
    reference: str

    @classmethod
    def of(
        cls, bag: Bag, where: str, part: str | None, pusher: str | None, reference: str | None
    ) -> _Roles:
        """Choose what is not named, if there is one candidate only."""
        moving = [name for name, own in bag.tracks.items() if not own.static and own.parent]
        if part is None or not bag.tracks:
            if len(moving) != 1:
                found = f"poses of {', '.join(moving[:20])}" if moving else "no poses"
                hint = "add --option part=NAME, in Python columns={'part': NAME}; and the pusher"
                if not moving:
                    hint = "record /tf; AprilTagDetectionArray of apriltag_msgs has no poses"
                expected = "the topic or frame of the part"
                raise InvalidInput(where, found=found, expected=expected, hint=hint)
            part = moving[0]
        joints = pusher.split(",") if pusher is not None and pusher not in bag.tracks else []
        for role, name in (("part", part), *(("pusher", joint) for joint in joints)):
            check_name(role, name, bag.tracks)
        if pusher == part:
            raise InvalidInput("pusher", found=f"{part!r}, as of the part", expected="another name")
        return cls(where, part, pusher, reference or bag.tracks[part].parent)

    def columns(self, bag: Bag, split_by: str | None) -> tuple[dict[str, Any], list[str]]:
        """Return the columns of the table, and sentences on how the bag was understood."""
        tracks = bag.tracks
        moving = (own for own in _path(tracks, self.part) if not own.static and len(own.time) > 1)
        driver = next(moving, None)
        if driver is None:
            raise InvalidInput(self.where, found=f"one pose of {self.part}", expected="a motion")
        time, notes = driver.time, [self._sentence("part", self.part, tracks)]
        poses = _pose_in(tracks, self.part, self.reference, time)
        flip = np.array((1.0, -1.0, -1.0)) if np.nanmedian(poses.up) < 0.0 else np.ones(3)
        notes += self._on_plane(poses, flip[2] < 0.0)
        x, y, theta = poses.planar(flip)
        columns: dict[str, Any] = {"time_s": time - time[0], "x_m": x, "y_m": y, "theta_rad": theta}
        if self.pusher is not None:
            if self.pusher in tracks:
                tip = _pose_in(tracks, self.pusher, self.reference, time).planar(flip)
                notes.append(self._sentence("pusher", self.pusher, tracks))
            else:
                joints = [_at(tracks[joint], time) for joint in self.pusher.split(",")]
                tip = [np.where(own.there, own.position[:, 0], np.nan) for own in joints]
                notes.append(f"The joints {self.pusher} are the place of the pusher [m].")
            titles = ("pusher_x_m", "pusher_y_m", "pusher_theta_rad")
            columns |= dict(zip(titles, tip, strict=False))
        if bag.unstamped:
            notes.append(f"{bag.unstamped} poses have no stamp; the time of the log is used.")
        push, how = _pushes(bag, driver, split_by)
        rows = np.flatnonzero(push != "")
        columns["push"] = push
        return {title: column[rows] for title, column in columns.items()}, [*notes, how]

    def _sentence(self, role: str, name: str, tracks: Mapping[str, FrameTrack]) -> str:
        own, at = tracks[name], ", at the times of the part" if role == "pusher" else ""
        kind = "topic" if name == own.source else f"frame, in {own.source}"
        up = "; z pointed into the tag, which is turned about x" if own.turned else ""
        return f"{name} ({kind}, {len(own.time)} poses) is the {role}, in {self.reference}{at}{up}."

    def _on_plane(self, poses: _Poses, flipped: bool) -> Iterator[str]:
        tilt = float(np.degrees(np.arccos(np.clip(np.nanmin(np.abs(poses.up)), 0.0, 1.0))))
        if tilt > MAX_TILT:
            found = f"a tilt of up to {tilt:.0f} deg of {self.part} against {self.reference}"
            expected = f"at most {MAX_TILT:g} deg"
            hint = "the reference should be a frame, or a tag, that lies on the plane"
            raise InvalidInput(self.where, found=found, expected=expected, hint=hint)
        height = 1e3 * poses.position[poses.there, 2]
        yield (
            f"Poses are projected on the plane of {self.reference}: heights of {height.min():.1f}"
            f" to {height.max():.1f} mm, a tilt of up to {tilt:.1f} deg."
        )
        if flipped:
            yield f"z of {self.reference} points down; it is turned about x, so y is reversed."


class _Poses(NamedTuple):
    """Poses in space; those that are not `there` are not known."""

    position: FloatArray  # (n, 3) [m]
    rotation: Any  # n rotations
    there: BoolArray  # (n,)

    @property
    def up(self) -> FloatArray:
        """Cosine of the tilt of the z axis, (n,)."""
        return np.where(self.there, self.rotation.as_matrix()[:, 2, 2], np.nan)

    def planar(self, flip: FloatArray) -> list[FloatArray]:
        """Return x, y [m] and the angle [rad]; NaN where they are not known."""
        x, y, _ = (self.position * flip).T
        axis = self.rotation.as_matrix()[:, :, 0] * flip
        known = (x, y, np.arctan2(axis[:, 1], axis[:, 0]))
        return [np.where(self.there, value, np.nan) for value in known]


def _path(tracks: Mapping[str, FrameTrack], name: str) -> Iterator[FrameTrack]:
    """Yield the tracks from a frame to the root of its tree."""
    seen = set()
    while name in tracks and name not in seen:
        seen.add(name)
        yield tracks[name]
        name = tracks[name].parent


def _pose_in(
    tracks: Mapping[str, FrameTrack], name: str, reference: str, time: FloatArray
) -> _Poses:
    """Return the poses of a frame in another, at some times."""
    own, other = [*_path(tracks, name)], [*_path(tracks, reference)]
    above = [reference, *(track.parent for track in other)]
    shared = [k for k, frame in enumerate([name, *(t.parent for t in own)]) if frame in above]
    if not shared:
        root = own[-1].parent if own else name
        raise unknown_name("reference", reference, [root, *(t for t in tracks)])
    meet = [name, *(track.parent for track in own)][shared[0]]
    low = _composed(own[: shared[0]], time)
    base = _composed(other[: above.index(meet)], time)
    back = base.rotation.inv()
    return _Poses(
        back.apply(low.position - base.position), back * low.rotation, low.there & base.there
    )


def _composed(tracks: list[FrameTrack], time: FloatArray) -> _Poses:
    """Return the poses of the first frame in the parent of the last."""
    n = len(time)
    found = _Poses(np.zeros((n, 3)), scipy.spatial.transform.Rotation.identity(n), np.ones(n, bool))
    for track in tracks:
        one = _at(track, time)
        position = one.position + one.rotation.apply(found.position)
        found = _Poses(position, one.rotation * found.rotation, one.there & found.there)
    return found


def _at(track: FrameTrack, time: FloatArray) -> _Poses:
    """Interpolate the poses of a track, but not over gaps."""
    n = len(track.time)
    if n == 1 or track.static:
        first = np.zeros(len(time), dtype=int)
        return _Poses(track.position[first], track.rotation[first], np.ones(len(time), dtype=bool))
    inside = np.clip(time, track.time[0], track.time[-1])
    after = np.clip(np.searchsorted(track.time, inside), 1, n - 1)
    there = (inside == time) & (
        (track.time[after] - track.time[after - 1] <= GAP) | np.isin(time, track.time)
    )
    position = [np.interp(inside, track.time, axis) for axis in track.position.T]
    rotation = scipy.spatial.transform.Slerp(track.time, track.rotation)(inside)
    return _Poses(np.column_stack(position), rotation, np.asarray(there))


def _pushes(bag: Bag, driver: FrameTrack, split_by: str | None) -> tuple[Any, str]:
    """Return the name of the push of each pose, empty for none, and a sentence."""
    if split_by is not None and split_by in bag.names:
        at, names = zip(*sorted(bag.names[split_by]), strict=True)  # a file may be out of order
        which = np.searchsorted(np.array(at), driver.logged, side="right")
        return np.array(["", *names])[which], f"{split_by} names the push of each pose."
    try:
        gap = GAP if split_by is None else float(split_by)
    except ValueError:
        raise unknown_name("split_by", str(split_by), bag.names) from None
    number = np.concatenate(([1], 1 + np.cumsum(np.diff(driver.time) > gap)))
    return number.astype(str), f"Pushes: {number[-1]}, separated by gaps of more than {gap:g} s."
