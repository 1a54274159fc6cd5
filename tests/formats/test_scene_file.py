"""Scene files: the contract, round trips, overrides, and everything a file can get wrong."""

import copy
import json
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import pytest
from tests.fixtures import refused

from fixel import (
    Body,
    Disk,
    Ellipsoid,
    Fixel,
    LineDrive,
    NoSupport,
    PairFriction,
    PathDrive,
    Plane,
    Polygon,
    Pusher,
    Scene,
    SupportPoints,
    Tripod,
    UniformPressure,
    load_scene,
)
from fixel.formats import SceneFile, save_scene, scene_dict, scene_file_from_dict, scene_json_schema
from fixel.model import FrictionMap, Spring

EXAMPLES = sorted((Path(__file__).parents[2] / "examples" / "scenes").glob("*.yaml"))
SQUARE = [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]]
NAMES = ["1e-3", "no", "~", "a: b", "-", "#"]  # each reads as something else if left unquoted
CONTRACT = """\
fixel: 1                       # format version
gravity: 9.81
duration: 11.0
motion: dynamic
step: 0.01
output_interval: 0.0333

bodies:
  - name: object
    shape: {polygon: [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]]}
    mass: 0.15
    inertia: 2.9e-4
    centre_of_mass: [0, 0]
    pose: [0.09, 0, 0.3]
    velocity: [0, 0, 0]
    support:
      tripod: {radius: 0.03, friction: 0.25}

pushers:
  - name: actuator
    shape: {polygon: [[-0.01, -0.01], [0.01, -0.01], [0.01, 0.01], [-0.01, 0.01]]}
    pose: [0, 0, 0]
    drive: {direction: [1, 0], speed: 0.0135, travel: 0.15, force_limit: 34.3}
    friction: 0.25

fixels:
  - {name: fixel-1, shape: {disk: 0.0047625}, pose: [0.2, 0, 0], friction: 0.2}

contact_friction:
  - {pair: [object, actuator], friction: 0.3}
"""


def contract():
    return scene_dict(loaded(CONTRACT))


def loaded(text, suffix=".yaml", overrides=()):
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"scene{suffix}"
        path.write_text(text, encoding="utf-8")
        return load_scene(path, overrides)


def everything():
    """A scene with every kind of thing in it."""
    square = Polygon(SQUARE)
    ell = Polygon([[0, 0], [0.02, 0], [0.02, 0.01], [0.01, 0.01], [0.01, 0.02], [0, 0.02]])
    supports = [
        Tripod(radius=0.03, friction=0.25, angle=0.1),
        SupportPoints(points=[[-0.04, -0.04], [0.04, -0.04], [0, 0.04]], friction=[0.1, 0.2, 0.3]),
        SupportPoints(points=SQUARE, friction=0.2, loads=[1, 2, 3, 4]),
        UniformPressure(friction=0.3, n_points=100),
        Ellipsoid(force=1.0, torque=0.03, centre=(0.001, 0)),
        NoSupport(),
    ]
    bodies = [
        Body(
            name=name, shape=square, mass=0.1 + k / 7, pose=(0.2 * k, 0, 0.01), support=support,
            velocity=(0, 1 / 3, 0),
        )
        for k, (name, support) in enumerate(zip(NAMES, supports, strict=True))
    ]  # fmt: skip
    odd = Body(
        name="odd", shape=ell, mass=1e-7, pose=(0, 1, 0), inertia=1 / 3,
        centre_of_mass=(0.005, 0.005), force=(0.1, 0, 0.2),
        spring=Spring(stiffness=5.0, anchor=(0, 1.1)),
    )  # fmt: skip
    line = LineDrive(direction=(1, 2), speed=0.1)
    path = PathDrive(waypoints=[[0, 0, 2, 0], [1.5, 0.1, 2, 0.1]], force_limit=20)
    return SceneFile(
        scene=Scene(
            bodies=[*bodies, odd],
            pushers=[
                Pusher(name="line", shape=square, pose=(0, -1, 0), drive=line, friction=0.2),
                Pusher(name="path", shape=Disk(0.01), pose=None, drive=path, friction=0.2),
            ],
            fixels=[
                Fixel(name="f", shape=Disk(0.1), pose=(0, 3, 0), friction=0.1, restitution=0.5)
            ],
            contact_friction=[
                PairFriction(pair=("*", "*"), friction=0.2, restitution=0.1),
                PairFriction(pair=("odd", "f"), friction=0.0),
            ],
            plane=Plane(
                anisotropy=(1, 2),
                axis=0.3,
                friction_map=FrictionMap(origin=(0, 0), cell=(1, 1), factor=[[1, 2], [3, 4]]),
            ),
            gravity=1.62,
            duration=1 / 3,
            support_directions=8,
        ),
        motion="first-order",
        step=0.001,
        output_interval=None,
    )


def test_the_contract_is_read():
    made = loaded(CONTRACT)
    assert (made.motion, made.step, made.output_interval) == ("dynamic", 0.01, 0.0333)
    scene = made.scene
    assert scene.names == ("object", "actuator", "fixel-1")
    assert scene.bodies[0].support == Tripod(radius=0.03, friction=0.25)
    assert scene.bodies[0].inertia == 2.9e-4
    assert scene.pushers[0].drive.force_limit == 34.3
    assert scene.friction("object", "actuator") == 0.3
    assert scene.friction("object", "fixel-1") == 0.2


def test_what_is_left_out_has_its_usual_value():
    made = scene_file_from_dict({
        "duration": 1,
        "bodies": [{"name": "a", "shape": {"disk": 1}, "mass": 1, "pose": [0, 0, 0]}],
    })  # fmt: skip
    assert made == SceneFile(
        scene=Scene(
            bodies=[Body(name="a", shape=Disk(1.0), mass=1.0, pose=(0, 0, 0))], duration=1.0
        )
    )
    assert made.scene.gravity == 9.81


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
def test_a_scene_that_was_saved_is_read_back_equal(tmp_path, suffix):
    path = tmp_path / f"scene{suffix}"
    save_scene(everything(), path)
    assert load_scene(path) == everything()
    assert load_scene(str(path)) == everything()


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_examples_are_scenes(path, tmp_path):
    made = load_scene(path)
    save_scene(made, tmp_path / "copy.yaml")
    assert load_scene(tmp_path / "copy.yaml") == made


def test_there_are_examples():
    assert [path.stem for path in EXAMPLES] == ["grasp", "micro_push", "peg_slip"]


def test_numbers_and_text_are_those_of_yaml_1_2():
    text = CONTRACT.replace("mass: 0.15", "mass: 15e-2").replace("speed: 0.0135", "speed: 1e-2")
    made = loaded(text.replace("name: fixel-1", "name: on"))
    assert made.scene.bodies[0].mass == 0.15
    assert made.scene.pushers[0].drive.speed == 0.01
    assert made.scene.fixels[0].name == "on"


# --- wrong keys and values ----------------------------------------------------------------------


@pytest.mark.parametrize(("change", "where", "words"), [
    ({"bodies.0.mass": -1}, "bodies[0].mass", "is -1, but must be a number greater than 0"),
    ({"bodies.0.mass": "heavy"}, "bodies[0].mass", "is 'heavy', but must be a number"),
    ({"bodies.0.mass": None}, "bodies[0].mass", "is missing"),
    ({"bodies.0.pose": [0, 0]}, "bodies[0].pose", "at least 3 entries"),
    ({"bodies.0.pose": [0, 0, "x"]}, "bodies[0].pose[2]", "is 'x', but must be a number"),
    ({"bodies.0.pose": [0, 0, float("nan")]}, "bodies[0].pose[2]", "finite number"),
    ({"bodies.0.name": 3}, "bodies[0].name", "must be text"),
    ({"bodies.0.shape": "square"}, "bodies[0].shape", "the keys polygon, disk"),
    ({"bodies.0.shape": {}}, "bodies[0].shape", "is missing: give exactly one of polygon"),
    ({"bodies.0.shape": {"polygon": SQUARE, "disk": 1.0}}, "bodies[0].shape",
     "found polygon and disk, but fixel needs exactly one"),
    ({"bodies.0.shape": {"polygon": [[0, 0], [1, 1], [1, 0], [0, 1]]}},
     "bodies[0].shape.polygon", "crosses or touches itself"),
    ({"bodies.0.shape": {"polygon": [[0, 0], [1, 0], [inf, 1]]}},
     "bodies[0].shape.polygon[2][0]", "finite"),
    ({"bodies.0.shape": {"disk": 0}}, "bodies[0].shape.disk",
     "greater than 0 (radius of the disk [m])"),
    ({"bodies.0.support": {"points": {"at": [[1, 0], [2, 0], [1, 1]], "friction": 0.1}}},
     "bodies[0].support.points.at", "outside the support triangle"),
    ({"bodies.0.support": {"points": {"at": SQUARE, "friction": "rough"}}},
     "bodies[0].support.points.friction", "must be a number"),
    ({"bodies.0.support": {"tripod": {"radius": 1, "friction": 0}, "none": {}}},
     "bodies[0].support", "found tripod and none"),
    ({"bodies": []}, "bodies", "no free body"),
    ({"bodies": {"name": "a"}}, "bodies", "a list"),
    ({"fixel": 2}, "fixel", "must be 1"),
    ({"motion": "static"}, "motion", "'dynamic', 'quasistatic' or 'first-order'"),
    ({"support_directions": 3}, "support_directions", "at least 4"),
    ({"pushers.0.drive": {"speed": 1}}, "pushers[0].drive", "exactly one of direction, waypoints"),
    ({"pushers.0.drive": {"direction": [1, 0]}}, "pushers[0].drive.speed", "a speed"),
    ({"pushers.0.drive.direction": [0, 0]}, "pushers[0].drive.direction", "a direction"),
    ({"pushers.0.pose": None}, "pushers[0].pose", "is missing"),
    ({"pushers.0.drive": {"waypoints": [[0, 0, 0, 0]], "speed": 1}}, "pushers[0].drive.speed",
     "in addition to waypoints"),
    ({"pushers.0.drive": {"waypoints": [[0, 0, 0, 0], [2, 0, 0, 0], [1, 0, 0, 0]]}},
     "pushers[0].drive.waypoints[2]", "has decreasing times"),
    ({"fixels.0.pose": [0.09, 0.0, 0]}, "'object' and 'fixel-1'", "mm at the start"),
    ({"fixels.0.name": "object"}, "scene", "the name 'object' twice"),
    ({"contact_friction.0.pair": ["object"]}, "contact_friction[0].pair", "at least 2 entries"),
    ({"contact_friction.0.pair": ["object", "fixel"]}, "contact_friction[0].pair", "did you mean"),
    ({"plane": {"anisotropy": [1, 0]}}, "plane.anisotropy[1]", "greater than 0"),
    ({"plane": {"friction_map": {"origin": [0, 0], "cell": [1, 1], "factor": [[1, 2], [1]]}}},
     "plane.friction_map.factor", "2 numbers"),
])  # fmt: skip
def test_a_wrong_value_is_refused_with_the_path_of_its_key(change, where, words):
    raw = contract()
    for path, value in change.items():
        *parents, last = (int(key) if key.isdecimal() else key for key in path.split("."))
        container = raw
        for key in parents:
            container = container[key]
        container[last] = value
    refusal = refused(scene_file_from_dict, raw)
    assert refusal.where == where
    assert words in str(refusal)


@pytest.mark.parametrize(("old", "new", "where", "words"), [
    ("mass:", "mas:", "bodies[0].mass", "is missing"),
    ("gravity:", "gravitiy:", "gravitiy", "an unknown key"),
    ("travel:", "travell:", "pushers[0].drive.travell", "did you mean 'travel'?"),
    ("radius:", "radios:", "bodies[0].support.tripod.radius", "required"),
    ("inertia:", "inertai:", "bodies[0].inertai", "did you mean 'inertia'?"),
])  # fmt: skip
def test_unknown_and_missing_keys_are_refused(old, new, where, words):
    refusal = refused(loaded, CONTRACT.replace(old, new, 1))
    file, _, key = refusal.where.partition(": ")
    assert (Path(file).name, key) == ("scene.yaml", where)
    assert words in str(refusal)


@pytest.mark.parametrize("raw", [None, [], "scene", 3, [{}], {}])
def test_something_else_than_a_scene_is_refused(raw):
    refused(scene_file_from_dict, raw)


# --- hostile and careless files -----------------------------------------------------------------


def refusal_of(text, suffix=".yaml"):
    start = process_time()
    refusal = refused(loaded, text, suffix)
    assert process_time() - start < 5.0
    return str(refusal)


def test_a_file_of_a_hundred_megabytes_is_refused_unread(tmp_path):
    path = tmp_path / "large.yaml"
    with path.open("wb") as stream:
        stream.truncate(100_000_000)
    start = process_time()
    refused(load_scene, path, match="more than 10 MB")
    assert process_time() - start < 0.5


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
@pytest.mark.parametrize("depth", [41, 100_000])
def test_deep_nesting_is_refused(suffix, depth):
    assert "more than 40 levels" in refusal_of("[" * depth + "]" * depth, suffix)


def test_an_alias_bomb_is_refused():
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 12)]
    assert "line 2: found the alias *a0, but fixel needs no aliases" in refusal_of("\n".join(lines))


@pytest.mark.parametrize(("text", "suffix", "words"), [
    ("duration: 1\nduration: 2\n", ".yaml", "line 2: found the key 'duration' twice"),
    ('{"duration": 1, "duration": 2}', ".json", "the key 'duration' twice"),
    ("a: !!python/object/apply:os.system [ls]", ".yaml", "found the tag"),
    ("a: !!binary aGVsbG8=", ".yaml", "found the tag"),
    ("[a, b]: 1", ".yaml", "as a key"),
    ("a: [1, 2", ".yaml", "well-formed YAML"),
    ("a: 1\n---\nb: 2\n", ".yaml", "a second document"),
    ("\tduration: 1", ".yaml", "well-formed YAML"),
    ("a: \x00", ".yaml", "well-formed YAML"),
    ("", ".yaml", "the keys fixel, gravity"),
    ("", ".json", "well-formed JSON"),
    ("{", ".json", "line 1"),
    ('{"duration": NaN}', ".json", "duration is nan"),
    ('{"duration": ' + "9" * 5000 + "}", ".json", "numbers that can be read"),
    ("duration: " + "9" * 5000, ".yaml", "duration is inf"),
    ("duration: 1:30", ".yaml", "is '1:30'"),
    ("duration: 1_000", ".yaml", "is '1_000'"),
    ("duration: .nan", ".yaml", "is nan"),
    ("duration: yes", ".yaml", "is 'yes'"),
    ("duration: true", ".yaml", "is True"),
    ("bodies: &a [*a]", ".yaml", "no aliases"),
    ("{a: " * 41 + "1" + "}" * 41, ".yaml", "more than 40 levels"),
    ('{"a": ' * 41 + "1" + "}" * 41, ".json", "more than 40 levels"),
])  # fmt: skip
def test_a_careless_file_is_refused(text, suffix, words):
    assert words in refusal_of(text, suffix)


def test_a_file_that_is_no_text_is_refused(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_bytes(b"duration: \xff\xfe")
    refused(load_scene, path, match="UTF-8")


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    refused(load_scene, tmp_path / "nothing.yaml", match="no such file")
    refused(load_scene, tmp_path, match="a folder")
    refused(load_scene, "\0")


def test_a_byte_order_mark_is_fine():
    assert loaded("\ufeff" + CONTRACT).scene.names[0] == "object"


# --- overrides ----------------------------------------------------------------------------------


def test_overrides_change_values_by_number_and_by_name():
    made = loaded(
        CONTRACT,
        overrides=[
            "duration=5", "bodies.0.mass=2e-1", "bodies.object.support.tripod.friction=0.3",
            "bodies[0].pose.2=0.1", "fixels.fixel-1.pose=[0.25, 0.01, 0]", "motion=quasistatic",
        ],
    )  # fmt: skip
    assert made.scene.duration == 5
    assert made.motion == "quasistatic"
    assert made.scene.bodies[0].mass == 0.2
    assert made.scene.bodies[0].support.friction == 0.3
    assert made.scene.bodies[0].pose == pytest.approx([0.09, 0, 0.1])
    assert made.scene.fixels[0].pose == pytest.approx([0.25, 0.01, 0])


def test_a_pusher_without_a_drive_is_not_written_as_no_file_with_it_can_be_read(tmp_path):
    tip = Pusher("tip", Disk(0.01), friction=0.2, pose=(-0.2, 0.0, 0.0))
    template = Scene(Body("part", Disk(0.05), mass=0.1), tip, duration=1.0)
    file, path = SceneFile(scene=template), tmp_path / "scene.yaml"
    refused(save_scene, file, path, match="a template: no drive of pusher 'tip'")
    assert not [*tmp_path.iterdir()]


def test_an_override_may_add_a_key_the_file_left_out():
    made = loaded(CONTRACT, overrides=["plane.axis=0.5", "bodies.0.support.tripod.angle=0.1"])
    assert made.scene.plane.axis == 0.5
    assert made.scene.bodies[0].support.angle == 0.1


def test_an_override_leaves_the_dict_it_was_given_alone():
    raw = contract()
    before = copy.deepcopy(raw)
    scene_file_from_dict(raw, ["bodies.0.mass=9"])
    assert raw == before


@pytest.mark.parametrize(("override", "words"), [
    ("bodies.1.mass=1",
     "bodies.1: found no such index, but fixel needs a number below 1, or one of object"),
    ("bodies.objekt.mass=1", "one of object"),
    ("bodies.0.mas=1", "bodies[0].mas: found an unknown key"),
    ("bodies.0.mass.kg=1", "fixel needs a list or a mapping"),
    ("durations=1", "did you mean 'duration'?"),
    ("duration", "fixel needs path.to.key=value"),
    ("=1", "fixel needs path.to.key=value"),
    ("duration=[", "well-formed YAML"),
    ("duration=-1", "duration is -1"),
    ("duration=", "duration is missing"),
    ("bodies.0.pose.3=1", "a number below 3"),
    ("plane.friction_map.cells=1", "did you mean 'cell'?"),
    ("bodies.0.support.uniform.friction=0.1", "found tripod and uniform"),
    ("bodies.0.spring.stiffness=1", "bodies[0].spring.anchor is missing"),
])  # fmt: skip
def test_an_override_that_leads_nowhere_is_refused(override, words):
    assert words in str(refused(loaded, CONTRACT, overrides=[override]))


def test_an_override_cannot_add_to_a_list_the_file_left_out():
    raw = {
        "duration": 1,
        "bodies": [{"name": "a", "shape": {"disk": 1}, "mass": 1, "pose": [0] * 3}],
    }
    refused(scene_file_from_dict, raw, ["fixels.0.friction=1"], match="no such index")


# --- schema -------------------------------------------------------------------------------------


def test_the_schema_names_every_key_of_the_contract():
    schema = scene_json_schema()
    assert json.loads(json.dumps(schema)) == schema
    assert set(scene_dict(everything())) <= set(schema["properties"])
    assert schema["required"] == ["duration", "bodies"]
    assert schema["additionalProperties"] is False
