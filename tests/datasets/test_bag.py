"""Poses from MCAP files, ROS 2 bags and AprilTag logs, which other libraries write."""

import json
import struct

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tests.fixtures import refused

import fixel
from fixel import InvalidInput, MissingExtra

mcap_writer = pytest.importorskip("mcap.writer")
rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

STORE = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
T = STORE.types
Array = NDArray[np.float64]
TIME = np.arange(0.0, 2.0, 0.05)
# On the table: x, y [m] and angle [rad] of part and tip, at any times.
START = 1_700_000_000.0


def part_at(t):
    return np.column_stack((0.1 + 0.02 * t, 0.05 - 0.01 * t**2, 3.0 + 0.3 * t))


def tip_at(t):
    return np.column_stack((0.04 + 0.02 * t, 0.05 + 0.0 * t))


def matrices(planar, height=0.02):
    """Homogeneous matrices (n, 4, 4) of planar poses (n, 3)."""
    found = np.tile(np.eye(4), (len(planar), 1, 1))
    found[:, :3, :3] = Rotation.from_euler("z", planar[:, 2:3]).as_matrix()
    found[:, :3, 3] = np.column_stack((planar[:, :2], np.full(len(planar), height)))
    return found


def stamp(t):
    return T["builtin_interfaces/msg/Time"](sec=int(t), nanosec=round(t % 1 * 1e9))


def header(t, frame):
    return T["std_msgs/msg/Header"](stamp=stamp(t), frame_id=frame)


def pose(m):
    q = Rotation.from_matrix(m[:3, :3]).as_quat()
    return T["geometry_msgs/msg/Pose"](
        position=T["geometry_msgs/msg/Point"](*m[:3, 3].tolist()),
        orientation=T["geometry_msgs/msg/Quaternion"](*q.tolist()),
    )


def posed(t, m, frame="table", kind="PoseStamped"):
    own = pose(m)
    cov = np.zeros(36)
    if kind != "PoseStamped":
        own = T["geometry_msgs/msg/PoseWithCovariance"](pose=own, covariance=cov)
    more = {}
    if kind == "Odometry":
        zero = T["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
        twist = T["geometry_msgs/msg/Twist"](linear=zero, angular=zero)
        twist = T["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=cov)
        more = {"child_frame_id": "part", "twist": twist}
    package = "nav_msgs" if kind == "Odometry" else "geometry_msgs"
    return T[f"{package}/msg/{kind}"](header=header(t, frame), pose=own, **more)


def transform(t, parent, child, m):
    q = Rotation.from_matrix(m[:3, :3]).as_quat()
    return T["geometry_msgs/msg/TransformStamped"](
        header=header(t, parent),
        child_frame_id=child,
        transform=T["geometry_msgs/msg/Transform"](
            translation=T["geometry_msgs/msg/Vector3"](*m[:3, 3].tolist()),
            rotation=T["geometry_msgs/msg/Quaternion"](*q.tolist()),
        ),
    )


def tf(*transforms):
    return T["tf2_msgs/msg/TFMessage"](transforms=list(transforms))


def write_bag(path, messages, storage="sqlite3"):
    """Write a ROS 2 bag with rosbags; messages are topic, log time and content."""
    plugin = rosbag2.StoragePlugin[storage.upper()]
    with rosbag2.Writer(path, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for topic, logged, content in messages:
            kind = content.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            data = STORE.serialize_cdr(content, kind)
            writer.write(connections[topic], round(logged * 1e9), data)
    return path


def two_topics(kind="PoseStamped", times=TIME):
    """Poses of the part, and of the tip at twice the rate and other times."""
    found = [
        ("/part", START + t, posed(START + t, m, kind=kind))
        for t, m in zip(times, matrices(part_at(times)), strict=True)
    ]
    dense = np.arange(times[0] - 0.01, times[-1] + 0.03, 0.025)
    tips = np.column_stack((tip_at(dense), 0.0 * dense))
    found += [
        ("/tip", START + t, posed(START + t, m))
        for t, m in zip(dense, matrices(tips, 0.1), strict=True)
    ]
    return sorted(found, key=lambda one: one[1])


def check(experiment, times=TIME, tip=True):
    wanted = part_at(times)
    assert experiment.trajectory.time == pytest.approx(times - times[0], abs=1e-6)
    assert experiment.trajectory.pose[:, :2] == pytest.approx(wanted[:, :2], abs=1e-7)
    turn = experiment.trajectory.pose[:, 2] - wanted[:, 2]
    assert np.ptp(turn) < 1e-6  # unwrapped over half a turn
    assert np.cos(turn) == pytest.approx(1.0)
    if tip:
        assert experiment.pusher.pose[:, :2] == pytest.approx(tip_at(times), abs=1e-6)


ROLES = {"part": "/part", "pusher": "/tip"}


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
@pytest.mark.parametrize("kind", ["PoseStamped", "PoseWithCovarianceStamped", "Odometry"])
def test_topics_of_a_bag(tmp_path, storage, kind):
    bag = write_bag(tmp_path / "bag", two_topics(kind), storage)
    found = fixel.read_experiments(bag, columns=ROLES)
    check(found[0])
    assert found.notes[0] == "/part (topic, 40 poses) is the part, in table."
    (file,) = [path for path in bag.iterdir() if path.suffix in (".db3", ".mcap")]
    check(fixel.read_experiments(file, columns=ROLES)[0])


def test_bag_with_scene_can_be_simulated(tmp_path):
    square = fixel.Body(
        "part",
        fixel.Polygon.rectangle(0.1, 0.1),
        mass=0.5,
        support=fixel.Tripod(radius=0.03, friction=0.25),
    )
    scene = fixel.Scene(square, fixel.Pusher("tip", fixel.Disk(0.005), friction=0.3))
    bag = write_bag(tmp_path / "bag", two_topics())
    (push,) = fixel.read_experiments(bag, columns=ROLES, scene=scene)
    assert push.scene.duration == pytest.approx(TIME[-1])
    assert push.scene.pushers[0].drive.waypoints[-1][1:3] == pytest.approx(tip_at(TIME[-1:])[0])


def frames(times, camera, tag_in_part):
    """Transforms of a camera that sees the table's tag and the part's tag."""
    seen = camera @ matrices(part_at(times)) @ tag_in_part
    found = [
        ("/tf_static", START - 9, tf(transform(0.0, "camera", "table", camera))),
        ("/tf_static", START - 8, tf(transform(0.0, "mark", "part", np.linalg.inv(tag_in_part)))),
    ]
    for k, t in enumerate(times):
        found.append(("/tf", START + t, tf(transform(START + t, "camera", "mark", seen[k]))))
    return found


def test_frames_through_a_camera(tmp_path):
    camera, mark = np.eye(4), np.eye(4)
    camera[:3, :3] = Rotation.from_euler("xyz", (160, 10, 40), degrees=True).as_matrix()
    camera[:3, 3] = 0.1, -0.2, 0.9
    mark[:3, :3] = Rotation.from_euler("z", 77, degrees=True).as_matrix()
    mark[:3, 3] = 0.01, -0.02, 0.005
    bag = write_bag(tmp_path / "bag", frames(TIME, camera, mark), "mcap")
    roles = {"part": "part", "reference": "table"}
    found = fixel.read_experiments(bag, columns=roles)
    check(found[0], tip=False)
    assert any("heights of 20.0 to 20.0 mm, a tilt of up to 0.0 deg" in n for n in found.notes)
    with pytest.raises(InvalidInput, match=r"a tilt of up to .* of part against camera"):
        fixel.read_experiments(bag, columns={"part": "part", "reference": "camera"})
    with pytest.raises(InvalidInput, match="'table'"):
        fixel.read_experiments(bag, columns={"part": "part", "reference": "tabel"})


def test_overhead_camera_sees_no_mirror_image(tmp_path):
    camera = np.diag((1.0, -1.0, -1.0, 1.0))  # x as on the table, z down
    camera[2, 3] = 0.5
    bag = write_bag(tmp_path / "bag", frames(TIME, camera, np.eye(4)))
    found = fixel.read_experiments(bag, columns={"part": "part", "reference": "camera"})
    check(found[0], tip=False)
    assert any("y is reversed" in note for note in found.notes)


def test_tag_log(tmp_path):
    """Tags as AprilTag 3 has them: z points into the tag, y down."""
    into = np.diag((1.0, -1.0, -1.0, 1.0))
    camera = np.eye(4)
    camera[:3, :3] = Rotation.from_euler("x", 150, degrees=True).as_matrix()
    camera[:3, 3] = 0.0, 0.1, 0.8
    lines = []
    for k, m in enumerate(camera @ matrices(part_at(TIME), 0.0) @ into):
        seen = [(4, camera @ into)] if k % 3 == 0 else []
        seen += [(7, m)] if k != 5 else []
        rows = [
            {"tag_id": i, "pose_t": n[:3, 3:].tolist(), "pose_R": n[:3, :3].tolist()}
            for i, n in seen
        ]
        lines.append(json.dumps({"time_s": TIME[k], "detections": rows}))
    path = tmp_path / "tags.jsonl"
    path.write_text("\n".join(lines) + "\n")
    found = fixel.read_experiments(path, columns={"part": "tag:7", "reference": "tag:4"})
    check(found[0], np.delete(TIME, 5), tip=False)
    assert "z pointed into the tag" in found.notes[0]


@pytest.mark.parametrize(
    "wrong", ["xx", '{"time_s": 0.2, "detections": [{"tag_id', '{"tag_id": 7}', "7"]
)
def test_a_wrong_line_of_a_log_of_tags_is_named(wrong, tmp_path):
    """The line counts from the first one of the file, empty lines included."""
    row = {"tag_id": 7, "pose_t": [0.1, 0.0, 0.8], "pose_R": np.eye(3).tolist()}
    good = json.dumps({"time_s": 0.1, "detections": [row]})
    path = tmp_path / "tags.jsonl"
    path.write_text(f"{good}\n\n{good}\n{wrong}\n")
    problem = refused(fixel.read_experiments, path, columns={"part": "tag:7"})
    assert problem.where == "tags.jsonl, line 4"
    assert repr(wrong[:60]) in str(problem)


def test_a_log_without_poses_and_one_frame_for_both_are_named(tmp_path):
    path = tmp_path / "tags.jsonl"
    path.write_text('{"time_s": 0.1, "detections": []}\n')
    columns = {"part": "part", "pusher": "tip"}
    refused(fixel.read_experiments, path, columns=columns, match="found no poses")
    row = {"tag_id": 7, "pose_t": [0.1, 0.0, 0.8], "pose_R": np.eye(3).tolist()}
    path.write_text(json.dumps({"time_s": 0.1, "detections": [row]}))
    same = {"part": "tag:7", "pusher": "tag:7"}
    refused(fixel.read_experiments, path, columns=same, match="'tag:7', as of the part")


DETECTIONS = {
    "apriltag_ros": "int32[] id\nfloat64[] size\ngeometry_msgs/PoseWithCovarianceStamped pose\n",
    "isaac_ros_apriltag_interfaces": (
        "string family\nint32 id\ngeometry_msgs/Point center\ngeometry_msgs/Point[4] corners\n"
        "geometry_msgs/PoseWithCovarianceStamped pose\n"
    ),
}


def detections_in(store, package, more=""):
    """Classes of one detection, with further fields, and of an array of them."""
    one = f"{package}/msg/AprilTagDetection"
    array = f"std_msgs/Header header\n{package}/AprilTagDetection[] detections\n"
    store.register(typesys.get_types_from_msg(DETECTIONS[package] + more, one))
    store.register(typesys.get_types_from_msg(array, f"{one}Array"))
    return store.types[one], store.types[f"{one}Array"]


@pytest.mark.parametrize("package", DETECTIONS)
def test_arrays_of_detections(package, tmp_path):
    """Two tags in each image, as the packages of ROS publish them; z points into the tag."""
    one, array = detections_in(STORE, package)
    family = "tag" if package == "apriltag_ros" else "tag36h11"
    into = np.diag((1.0, -1.0, -1.0, 1.0))
    camera = np.eye(4)
    camera[:3, :3] = Rotation.from_euler("xyz", (150, 10, 40), degrees=True).as_matrix()
    camera[:3, 3] = 0.0, 0.1, 0.8

    def seen(t, number, m):
        own = posed(t, m, "camera_optical", "PoseWithCovarianceStamped")
        if package == "apriltag_ros":
            return one(np.array([number], np.int32), np.array([0.04]), own)
        corner = T["geometry_msgs/msg/Point"](1.0, 2.0, 0.0)
        return one(family, number, corner, [corner] * 4, own)

    messages = []
    for t, m in zip(TIME, camera @ matrices(part_at(TIME), 0.0) @ into, strict=True):
        at = START + t
        both = [seen(at, 4, camera @ into), seen(at, 7, m)]
        messages.append(("/tag_detections", at, array(header(at, "camera_optical"), both)))
    bag = write_bag(tmp_path / "bag", messages)
    roles = {"part": f"{family}:7", "reference": f"{family}:4"}
    check(fixel.read_experiments(bag, columns=roles)[0], tip=False)


def test_detections_with_other_fields_are_skipped(tmp_path):
    """Another version of a package, whose messages cannot be decoded, hides no other poses."""
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    one, array = detections_in(store, "apriltag_ros", "int32[2] corner\n")
    own = posed(START, np.eye(4), "camera", "PoseWithCovarianceStamped")
    corner = np.array([3, 4], np.int32)
    seen = one(np.array([7], np.int32), np.array([0.04]), own, corner)
    path = tmp_path / "bag"
    with rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.SQLITE3) as writer:
        for topic, at, content in [
            ("/tags", START, array(header(START, "camera"), [seen] * 3)),
            *((topic, at, m) for topic, at, m in two_topics() if topic == "/part"),
        ]:
            kind = content.__msgtype__
            known = {own.topic: own for own in writer.connections}
            connection = known.get(topic) or writer.add_connection(topic, kind, typestore=store)
            writer.write(connection, round(at * 1e9), store.serialize_cdr(content, kind))
    check(fixel.read_experiments(path)[0], tip=False)


def test_tags_on_a_table_keep_their_axes(tmp_path):
    """A frame that is called a tag, but not seen by a camera."""
    seen = zip(TIME, matrices(part_at(TIME)), strict=True)
    messages = [("/tf", START + t, tf(transform(START + t, "map", "tag7", m))) for t, m in seen]
    found = fixel.read_experiments(write_bag(tmp_path / "bag", messages))
    check(found[0], tip=False)
    assert not any("turned" in note for note in found.notes)


def test_foxglove_messages_in_json(tmp_path):
    def times(t):
        return {"sec": int(START + t), "nsec": round((START + t) % 1 * 1e9)}

    def xyzw(m):
        q = Rotation.from_matrix(m[:3, :3]).as_quat().tolist()
        place = dict(zip("xyz", m[:3, 3].tolist(), strict=True))
        return place, dict(zip("xyzw", q, strict=True))

    path = tmp_path / "push.mcap"
    with path.open("wb") as stream:
        writer = mcap_writer.Writer(stream)
        writer.start()
        ids = {}
        for topic, schema in (("/part", "PoseInFrame"), ("/tf", "FrameTransform"), ("/x", "Log")):
            number = writer.register_schema(f"foxglove.{schema}", "jsonschema", b"{}")
            ids[topic] = writer.register_channel(topic, "json", number)
        tips = np.column_stack((tip_at(TIME), 0 * TIME))
        for t, m, tip in zip(TIME, matrices(part_at(TIME)), matrices(tips), strict=True):
            place, turn = xyzw(m)
            own = {"timestamp": times(t), "frame_id": "table"}
            own["pose"] = {"position": place, "orientation": turn}
            place, turn = xyzw(tip)
            moved = {"timestamp": times(t), "parent_frame_id": "table", "child_frame_id": "tip"}
            moved |= {"translation": place, "rotation": turn}
            for topic, content in (("/part", own), ("/tf", moved), ("/x", {"any": "thing"})):
                data = json.dumps(content).encode()
                at = round((START + t) * 1e9)
                writer.add_message(ids[topic], at, data, at)
        writer.finish()
    check(fixel.read_experiments(path, columns={"part": "/part", "pusher": "tip"})[0])


def test_joints_are_the_place_of_the_pusher(tmp_path):
    kind = T["sensor_msgs/msg/JointState"]
    messages = [one for one in two_topics() if one[0] == "/part"]
    none = np.zeros(0)
    for t, (x, y) in zip(TIME, tip_at(TIME), strict=True):
        state = kind(header(START + t, ""), ["a", "gx", "gy"], np.array([9.0, x, y]), none, none)
        messages.append(("/joints", START + t, state))
    bag = write_bag(tmp_path / "bag", messages)
    check(fixel.read_experiments(bag, columns={"part": "/part", "pusher": "gx,gy"})[0])


def test_pushes_are_separated_by_gaps_topics_and_files(tmp_path):
    second = TIME + 10.0
    gaps = write_bag(tmp_path / "gaps", [*two_topics(), *two_topics(times=second)])
    found = fixel.read_experiments(gaps, columns=ROLES)
    assert [one.key for one in found] == ["gaps/1", "gaps/2"]
    check(found[1], second)
    assert len(fixel.read_experiments(gaps, columns=ROLES, split_by="20")) == 1
    text = T["std_msgs/msg/String"]
    names = [("/push", START - 0.5 + t, text(name)) for t, name in ((0, "a"), (1, "b"), (2, ""))]
    topic = write_bag(tmp_path / "topic", [*two_topics(), *names, *two_topics(times=second)])
    found = fixel.read_experiments(topic, columns=ROLES, split_by="/push")
    assert [one.key for one in found] == ["topic/a", "topic/b"]
    assert [len(one.trajectory.time) for one in found] == [10, 20]
    late = write_mcap(
        tmp_path / "late.mcap", [*two_topics(times=second), *names[::-1], *two_topics()], b""
    )
    again = fixel.read_experiments(late, columns=ROLES, split_by="/push")
    assert [len(one.trajectory.time) for one in again] == [10, 20]
    both = [write_bag(tmp_path / name, two_topics()) for name in "ab"]
    assert len(fixel.read_experiments(both, columns=ROLES)) == 2
    refused(fixel.read_experiments, topic, columns=ROLES, split_by="/pushes", match="split_by")


def test_roles_are_needed_and_known(tmp_path):
    bag = write_bag(tmp_path / "bag", two_topics())
    raised = refused(fixel.read_experiments, bag, match="poses of /tip, /part")
    assert "--option part=NAME" in str(raised)
    refused(fixel.read_experiments, bag, columns={"part": "/prt"}, match="did you mean '/part'")
    refused(fixel.read_experiments, bag, columns={"x": "/part"}, match="the option x")
    refused(fixel.read_experiments, bag, columns=ROLES, units={"length": "mm"}, match="units")
    alone = write_bag(tmp_path / "one", [one for one in two_topics() if one[0] == "/part"])
    check(fixel.read_experiments(alone)[0], tip=False)


def test_a_bag_of_other_messages_names_what_to_record(tmp_path):
    kinds = typesys.get_types_from_msg(
        "std_msgs/Header header\nint32[] id", "apriltag_msgs/msg/AprilTagDetectionArray"
    )
    STORE.register(kinds)
    found = T["apriltag_msgs/msg/AprilTagDetectionArray"]
    seen = found(header(START, "camera"), np.array([7], np.int32))
    bag = write_bag(tmp_path / "bag", [("/tags", START, seen)])
    assert "record /tf" in str(refused(fixel.read_experiments, bag, match="found no poses"))


def test_messages_without_stamp_have_the_time_of_the_log(tmp_path):
    messages = [
        (topic, at, posed(0.0, matrices(part_at(np.array([at - START])))[0]))
        for topic, at, _ in two_topics()
        if topic == "/part"
    ]
    found = fixel.read_experiments(write_bag(tmp_path / "bag", messages))
    check(found[0], tip=False)
    assert "40 poses have no stamp; the time of the log is used." in found.notes


# --- hostile and damaged files


def mcap_of(tmp_path):
    bag = write_bag(tmp_path / "source", two_topics(), "mcap")
    (path,) = bag.glob("*.mcap")
    return path.read_bytes()


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_truncated_files(tmp_path, share):
    data = mcap_of(tmp_path)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(share * len(data))])
    refused(
        fixel.read_experiments,
        cut,
        columns=ROLES,
        match=r"found damaged, incomplete or foreign content, but .*mcap recover"
        if share
        else "found an empty file, but .*copy or download it again",
    )
    (path,) = write_bag(tmp_path / "bag", two_topics()).glob("*.db3")
    if share < 0.9:
        (tmp_path / "cut.db3").write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
        refused(fixel.read_experiments, tmp_path / "cut.db3", columns=ROLES)


@pytest.mark.parametrize("name", ["a.mcap", "a.db3", "a.jsonl"])
def test_foreign_files(tmp_path, name):
    for data in (b"", b"\x80\x04cposix\nsystem\n", b"SQLite format 3\x00" + bytes(5000), b"[1]\n"):
        (tmp_path / name).write_bytes(data)
        refused(fixel.read_experiments, tmp_path / name)


def write_mcap(path, messages, definition):
    """Write an MCAP file with the library of that format, which adds checksums."""
    with path.open("wb") as stream:
        writer = mcap_writer.Writer(stream)
        writer.start()
        channels = {}
        for topic, logged, content in messages:
            if topic not in channels:
                number = writer.register_schema(content.__msgtype__, "ros2msg", definition)
                channels[topic] = writer.register_channel(topic, "cdr", number)
            data = STORE.serialize_cdr(content, content.__msgtype__)
            writer.add_message(channels[topic], round(logged * 1e9), bytes(data), 0)
        writer.finish()
    return path


def test_any_flipped_bit_of_a_file_with_checksums_is_found_or_harmless(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", two_topics(), b"")
    data, random = path.read_bytes(), np.random.default_rng(0)
    (whole,) = fixel.read_experiments(path, columns=ROLES, progress=False)
    refused = 0
    for at in random.integers(len(data), size=60).tolist():
        own = bytearray(data)
        own[at] ^= 1 << int(random.integers(8))
        path.write_bytes(own)
        try:
            (found,) = fixel.read_experiments(path, columns=ROLES, progress=False)
        except InvalidInput:
            refused += 1
            continue
        assert found.trajectory == whole.trajectory
        assert found.pusher == whole.pusher
    assert 10 < refused < 50


@pytest.mark.parametrize("how", ["zstd", "lz4"])
def test_chunk_that_unpacks_to_gigabytes(tmp_path, how):
    """A chunk of zeros whose declared size is small."""
    if how == "zstd":
        zstandard = pytest.importorskip("zstandard")
        packer = zstandard.ZstdCompressor(level=1).compressobj()
        body = b"".join(packer.compress(bytes(1 << 24)) for _ in range(20)) + packer.flush()
    else:
        lz4 = pytest.importorskip("lz4.frame")
        body = lz4.compress(bytes(20 << 24), compression_level=0)
    assert len(body) < 2_000_000
    chunk = struct.pack("<QQQI", 0, 0, 100, 0) + struct.pack("<I", len(how)) + how.encode()
    chunk += struct.pack("<Q", len(body)) + body
    header = struct.pack("<I", 0) * 2
    path = tmp_path / "bomb.mcap"
    magic = b"\x89MCAP0\r\n"
    parts = ((1, header), (6, chunk), (2, bytes(20)))
    path.write_bytes(
        magic + b"".join(struct.pack("<BQ", op, len(own)) + own for op, own in parts) + magic
    )
    refused(fixel.read_experiments, path, match="at most 256 MB in a chunk")


def test_poses_are_counted_not_messages(tmp_path, monkeypatch):
    """One message may have any number of transforms."""
    own = [transform(START, "table", f"frame{k}", np.eye(4)) for k in range(20)]
    bag = write_bag(tmp_path / "bag", [("/tf", START, tf(*own))])
    monkeypatch.setattr("fixel.datasets.bag_file.MAX_POSES", 19)
    refused(fixel.read_experiments, bag, match="19 poses")


@pytest.mark.parametrize("length", [2**31, 2**40, 2**63])
def test_record_length_that_a_file_declares_is_not_believed(tmp_path, length):
    path = tmp_path / "a.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, length) + bytes(100))
    refused(fixel.read_experiments, path, match="a readable MCAP file")


def test_definitions_in_a_file_are_not_used(tmp_path):
    """A definition that would change the layout of a known type has no effect."""
    evil = b"string x \"__import__('os').mkdir('made')\"\nfloat64[1000000000] data\n"
    part = [one for one in two_topics() if one[0] == "/part"]
    path = write_mcap(tmp_path / "a.mcap", part, evil)
    check(fixel.read_experiments(path)[0], tip=False)


def test_poses_that_are_none(tmp_path):
    m = matrices(part_at(TIME))
    messages = [("/p", START + t, posed(START + t, m[k])) for k, t in enumerate(TIME)]
    messages[3][2].pose.orientation.w = messages[3][2].pose.orientation.z = 0.0
    refused(fixel.read_experiments, write_bag(tmp_path / "q", messages), match="unit rotations")
    circle = [
        ("/tf", START, tf(transform(START, "b", "a", m[0]), transform(START, "a", "b", m[0])))
    ]
    circle += [("/tf", START + 1, tf(transform(START + 1, "b", "a", m[1])))]
    with pytest.raises(InvalidInput):
        fixel.read_experiments(
            write_bag(tmp_path / "circle", circle), columns={"part": "a", "reference": "c"}
        )
    two = [("/tf", START, tf(transform(START, "b", "a", m[0]), transform(START, "c", "a", m[0])))]
    refused(fixel.read_experiments, write_bag(tmp_path / "two", two), match="one parent")
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "a.mcap").write_bytes(b"")
    refused(fixel.read_experiments, tmp_path / "empty")


def test_missing_package_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "mcap", None)
    (tmp_path / "a.mcap").write_bytes(b"")
    with pytest.raises(MissingExtra, match=r"needs the package mcap; run: pip install 'fixel"):
        fixel.read_experiments(tmp_path / "a.mcap")
