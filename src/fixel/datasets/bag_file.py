"""Poses in MCAP files, ROS 2 bags and logs of AprilTags.

ROS messages are decoded by the standard definitions of their types, never by those that a file has
with it: these become program code.
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final, NamedTuple

import numpy as np
import scipy  # which loads `scipy.spatial` when it is used

from fixel.datasets.files import bounded_lines
from fixel.errors import DatasetMissing, InvalidInput, require
from fixel.io.atomic import parsed
from fixel.typing import FloatArray

MAX_CHUNK = 256_000_000  # [bytes] of one record, unpacked
MAX_POSES = 2_000_000
ENDINGS: Final = (".mcap", ".db3")
TAGS: Final = ".jsonl"
# Short names of types with poses, and types whose value may name a push.
_POSES: Final = ("PoseStamped", "PoseWithCovarianceStamped", "Odometry", "foxglove.PoseInFrame")
_TRANSFORMS: Final = ("TFMessage", "foxglove.FrameTransforms")
_TRANSFORM: Final = ("TransformStamped", "foxglove.FrameTransform")
_NAMES: Final = re.compile(r"std_msgs/msg/(String|U?Int\d+)")
_USED: Final = {*_POSES, *_TRANSFORMS, *_TRANSFORM, "JointState"}
_TAG_ARRAY: Final = "AprilTagDetectionArray"
_TAGS: Final = {  # detections with poses, by the packages that define them
    "apriltag_ros": "int32[] id\nfloat64[] size\ngeometry_msgs/PoseWithCovarianceStamped pose",
    "isaac_ros_apriltag_interfaces": "string family\nint32 id\ngeometry_msgs/Point center\n"
    "geometry_msgs/Point[4] corners\ngeometry_msgs/PoseWithCovarianceStamped pose",
}
_FLIP: Final = (1.0, 0.0, 0.0, 0.0)  # half a turn about x, as a quaternion


class Message(NamedTuple):
    """Message with the short name of its type, and the time of the log [s]."""

    kind: str
    topic: str
    logged: float
    content: Any


@dataclass
class FrameTrack:
    """Poses of a frame, or of a topic, in its parent frame."""

    parent: str
    source: str
    static: bool
    turned: bool = False  # whether z pointed into the tag
    rows: list[tuple[float, ...]] = field(default_factory=list)  # time, log time, pose
    time: FloatArray = field(init=False)  # (n,) [s] increasing
    logged: FloatArray = field(init=False)  # (n,) [s]
    position: FloatArray = field(init=False)  # (n, 3) [m]
    rotation: Any = field(init=False)  # n rotations

    def finish(self, name: str) -> None:
        """Make the arrays, in the order of time."""
        table = np.array(self.rows, dtype=np.float64)
        table = table[np.unique(table[:, 0], return_index=True)[1]]
        length = np.linalg.norm(table[:, 5:], axis=1)
        if not np.isfinite(table).all() or (np.abs(length - 1.0) > 0.1).any():
            found, expected = "a pose without a place or rotation", "finite, unit rotations"
            raise InvalidInput(name, found=found, expected=expected)
        self.time, self.logged, self.position = table[:, 0], table[:, 1], table[:, 2:5]
        self.rotation = scipy.spatial.transform.Rotation.from_quat(table[:, 5:])
        # AprilTag 3 has z into the tag, as the camera looks; others have it out of the tag.
        seen = name.startswith("tag") and re.search("cam|optical", self.parent.lower())
        if seen and self.rotation.as_matrix()[:, 2, 2].mean() > 0.0:
            self.rotation, self.turned = self.rotation * self.rotation.from_quat(_FLIP), True


@dataclass
class Bag:
    """Tracks by the name of their frame or topic, and texts by topic with their log times."""

    tracks: dict[str, FrameTrack] = field(default_factory=dict)
    names: dict[str, list[tuple[float, str]]] = field(default_factory=lambda: defaultdict(list))
    unstamped: int = 0  # messages without a time of their own
    n: int = 0  # poses and texts

    def add(self, message: Message) -> None:
        """Add the poses of a message."""
        kind, topic, logged, m = message
        if kind in _POSES:
            header, pose = getattr(m, "header", m), m.pose
            pose = getattr(pose, "pose", pose)
            self._add(message, topic, header, (pose.position, pose.orientation))
        elif kind == "JointState":
            for name, value in zip(m.name, m.position, strict=False):
                place = SimpleNamespace(x=float(value), y=0.0, z=0.0)
                self._add(message, name, m.header, (place, SimpleNamespace(x=0, y=0, z=0, w=1)))
        elif kind in (*_TRANSFORM, *_TRANSFORMS):
            for one in getattr(m, "transforms", (m,)):
                moved = getattr(one, "transform", one)
                child = getattr(one, "child_frame_id", "")
                header = getattr(one, "header", one)
                self._add(message, child, header, (moved.translation, moved.rotation))
        elif kind == _TAG_ARRAY:
            for one in m.detections:
                header = one.pose.header if one.pose.header.frame_id else m.header
                ids = "+".join(map(str, np.atleast_1d(one.id)))  # several of a bundle
                pose = one.pose.pose.pose
                name = f"{getattr(one, 'family', 'tag')}:{ids}"
                self._add(message, name, header, (pose.position, pose.orientation))
        else:
            self._count(topic)
            self.names[topic].append((logged, str(m.data)[:100]))

    def _count(self, topic: str) -> None:
        self.n += 1
        if self.n > MAX_POSES:
            raise InvalidInput(topic, found="more", expected=f"{MAX_POSES} poses and texts in all")

    def _add(self, message: Message, name: str, header: Any, pose: tuple[Any, Any]) -> None:
        named = hasattr(header, "frame_id")
        parent = str(header.frame_id if named else getattr(header, "parent_frame_id", ""))
        stamp = getattr(header, "stamp", None) or header.timestamp
        time = stamp.sec + 1e-9 * getattr(stamp, "nanosec", getattr(stamp, "nsec", 0))
        self._count(message.topic)
        self.unstamped += not time and message.logged > 0.0
        static = message.topic.endswith("tf_static")
        own = self.tracks.setdefault(name, FrameTrack(parent, message.topic, static))
        if own.parent != parent:
            found = f"{name} in {own.parent!r} and in {parent!r}"
            raise InvalidInput(message.topic, found=found, expected="one parent of a frame")
        p, q = pose
        own.rows.append((time or message.logged, message.logged, p.x, p.y, p.z, q.x, q.y, q.z, q.w))


def bag_files(source: Path) -> list[Path]:
    """Return the files of a bag; empty for another source."""
    if source.is_dir():
        return sorted(path for path in source.iterdir() if path.suffix.lower() in ENDINGS)
    return [source] if source.suffix.lower() in (*ENDINGS, TAGS) else []


def read_bag(source: Path) -> Bag:
    """Read the poses of a bag; raise for damaged files, no poses, or a missing package."""
    readers = {".mcap": _from_mcap, ".db3": _from_sqlite, TAGS: _from_tags}
    bag = Bag()
    if not (files := bag_files(source)):
        raise DatasetMissing(source, f"a file that ends in {', '.join(readers)}")
    for path in files:
        hint = "mcap recover FILE saves what is left of a torn MCAP file"
        with parsed(path, hint if path.suffix == ".mcap" else ""):
            for message in readers[path.suffix.lower()](path):
                bag.add(message)
    for name, track in bag.tracks.items():
        track.finish(name)
    return bag


def _from_mcap(path: Path) -> Iterator[Message]:
    require("mcap", "an MCAP file", extra="files")
    from mcap import stream_reader as mcap

    schemas: dict[int, str] = {}
    channels: dict[int, Any] = {}
    with path.open("rb") as stream:
        reader = mcap.StreamReader(
            stream, emit_chunks=True, validate_crcs=True, record_size_limit=MAX_CHUNK
        )
        for record in _records(reader.records, mcap, path.name):
            if isinstance(record, mcap.Schema):
                schemas[record.id] = record.name
            elif isinstance(record, mcap.Channel):
                channels[record.id] = record
            elif isinstance(record, mcap.Message):
                channel = channels[record.channel_id]
                kind = schemas.get(channel.schema_id, "")
                logged = 1e-9 * record.log_time
                encoding = channel.message_encoding
                if message := _decoded(kind, channel.topic, logged, record.data, encoding):
                    yield message


def _records(found: Iterable[Any], mcap: Any, where: str) -> Iterator[Any]:
    """Yield records, also those in chunks, which unpack to a bounded size."""
    for record in found:
        if not isinstance(record, mcap.Chunk):
            yield record
            continue
        data = record.data
        if record.compression == "zstd":
            data = mcap.zstandard.ZstdDecompressor().stream_reader(data).read(MAX_CHUNK + 1)
        elif record.compression == "lz4":
            data = mcap.lz4.LZ4FrameDecompressor().decompress(data, max_length=MAX_CHUNK + 1)
        if len(data) > MAX_CHUNK:
            expected = f"at most {MAX_CHUNK // 10**6} MB in a chunk, unpacked"
            raise InvalidInput(where, found="more", expected=expected)
        yield from mcap.breakup_chunk(replace(record, compression="", data=data), True)


def _from_sqlite(path: Path) -> Iterator[Message]:
    require("rosbags", "a ROS 2 bag", extra="files")
    from rosbags import rosbag2

    with rosbag2.Reader(path) as bag:
        used = [own for own in bag.connections if _short(own.msgtype)]
        for own, logged, data in bag.messages(used) if used else ():
            if message := _decoded(own.msgtype, own.topic, 1e-9 * logged, data, "cdr"):
                yield message


def _short(kind: str) -> str:
    """Return the short name of a type that is used; empty for others."""
    if _NAMES.fullmatch(kind):
        return kind
    short = kind.rpartition("/")[2]
    detected = short == _TAG_ARRAY and kind.partition("/")[0] in _TAGS
    return short if short in _USED or detected else ""


@cache
def _definitions() -> Any:
    require("rosbags", "a ROS message", extra="files")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    found = get_typestore(Stores.ROS2_HUMBLE)
    for package, text in _TAGS.items():
        one = f"{package}/msg/AprilTagDetection"
        array = f"std_msgs/Header header\n{one}[] detections"
        found.register(get_types_from_msg(text, one) | get_types_from_msg(array, f"{one}Array"))
    return found


def _decoded(kind: str, topic: str, logged: float, data: bytes, encoding: str) -> Message | None:
    """Decode a message of a type that is used."""
    short = _short(kind)
    if not short or encoding not in ("cdr", "json"):
        return None
    if encoding == "json":
        content = json.loads(data, object_hook=lambda own: SimpleNamespace(**own))
    else:
        from rosbags.serde import SerdeError

        try:
            content = _definitions().deserialize_cdr(data, kind)
        except SerdeError:
            if short == _TAG_ARRAY:  # a version of it with other fields
                return None
            raise
    return Message(short, topic, logged, content)


def _from_tags(path: Path) -> Iterator[Message]:
    """Yield detections: a line of JSON each, with time_s, tag_id, pose_t [m] and pose_R."""
    with path.open(encoding="utf-8") as stream:
        for number, line in enumerate(bounded_lines(stream, path.name), 1):
            try:
                yield from _detections(json.loads(line), path.name) if line.strip() else ()
            except (ValueError, KeyError, TypeError, AttributeError):
                where, found = f"{path.name}, line {number}", repr(line.strip()[:60])
                expected = "a line of JSON with time_s, tag_id, pose_t and pose_R"
                raise InvalidInput(where, found=found, expected=expected) from None


def _detections(row: Any, topic: str) -> Iterator[Message]:
    for seen in row.get("detections", [row]):
        x, y, z = np.asarray(seen["pose_t"], dtype=np.float64).ravel().tolist()
        q = scipy.spatial.transform.Rotation.from_matrix(seen["pose_R"]).as_quat().tolist()
        pose = SimpleNamespace(
            translation=SimpleNamespace(x=x, y=y, z=z),
            rotation=SimpleNamespace(**dict(zip("xyzw", q, strict=True))),
            timestamp=SimpleNamespace(sec=row["time_s"]),
            frame_id="camera",
            child_frame_id=f"{seen.get('tag_family', 'tag')}:{seen['tag_id']}",
        )
        yield Message("foxglove.FrameTransform", topic, row["time_s"], pose)
