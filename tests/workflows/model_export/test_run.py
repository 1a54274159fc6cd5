"""Tests of models for other engines: files, their program, their card, and refusals."""

from __future__ import annotations

import csv
import io
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from tests.fixtures import refused

import fixel
from fixel.errors import InvalidInput
from fixel.model import (
    Body,
    Disk,
    Ellipsoid,
    Fixel,
    PathDrive,
    Polygon,
    Pusher,
    Scene,
    SupportPoints,
)
from fixel.testing.pushes import example_pushes
from fixel.testing.scenes import grasp, pushed_square

ENGINES = ("pymunk", "box2d", "mujoco", "drake")
PACKAGES = {"box2d": "Box2D", "drake": "pydrake"}
EXAMPLES = Path(__file__).parents[3] / "examples" / "scenes"
SPACE = {"mu_pusher": (0.0, 1.0), "tripod_radius": 0.038}
# What a program of an export sees: no fixel.
ALONE = "import runpy, sys; sys.modules['fixel'] = None; sys.path.insert(0, sys.argv[1]); "
ALONE += "runpy.run_path(sys.argv[1] + '/run.py', run_name='__main__')"
L_SHAPE = Polygon([(0, 0), (0.08, 0), (0.08, 0.03), (0.03, 0.03), (0.03, 0.06), (0, 0.06)])


def rich_scene() -> Scene:
    """L-shaped body, its centre of mass off the centroid, between a turning pusher and fixels."""
    body = Body(
        "part",
        L_SHAPE,
        mass=0.2,
        pose=(0.01, -0.02, 0.3),
        centre_of_mass=(0.03, 0.02),
        support=SupportPoints(points=[(0.01, 0.01), (0.07, 0.01), (0.01, 0.05)], friction=0.3),
    )
    path = [(0.0, -0.02, 0.0, 0.1), (1.0, 0.005, 0.002, 0.0), (1.7, 0.02, -0.003, -0.1)]
    head = Pusher(
        "head",
        Polygon.rectangle(0.02, 0.03),
        pose=path[0][1:],
        friction=0.2,
        drive=PathDrive(path),
    )
    hexagon = [0.008 * np.array((np.cos(a), np.sin(a))) for a in np.arange(6) * np.pi / 3]
    fixels = (
        Fixel("peg", Disk(0.005), pose=(0.097, -0.01, 0.0), friction=0.4),
        Fixel("nut", Polygon(hexagon), pose=(0.042, 0.06, 0.2), friction=0.1),
    )
    return Scene((body,), (head,), fixels, duration=2.0)


def poses_of(folder: Path) -> np.ndarray:
    """Run the program of an export without fixel; return times and poses (n, 4)."""
    done = subprocess.run(
        [sys.executable, "-c", ALONE, str(folder)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    table = list(csv.reader(io.StringIO(done.stdout)))
    assert table[0] == ["time_s", "x_m", "y_m", "theta_rad"]
    return np.array(table[1:], float)


def difference(folder: Path, scene: Scene, engine: str) -> float:
    """Return the largest difference between a program and fixel's own adapter of its engine."""
    fixel.export_model(scene, folder, to=engine, scenes=0)
    found = poses_of(folder)
    direct = fixel.simulate(scene, motion=engine, output_interval=scene.duration / 100)
    assert direct.converged
    assert np.ptp(direct.pose["part"][:, 0]) > 5e-3  # it is pushed
    np.testing.assert_allclose(found[:, 0], direct.time[1:], atol=1e-12)
    return float(np.abs(found[:, 1:] - direct.pose["part"][1:]).max())


@pytest.mark.parametrize("engine", ENGINES)
def test_the_program_moves_the_body_as_the_adapter_does(engine: str, tmp_path: Path) -> None:
    pytest.importorskip(PACKAGES.get(engine, engine))
    assert difference(tmp_path / "model", rich_scene(), engine) == 0.0


@pytest.mark.parametrize("engine", ENGINES)
def test_the_program_of_a_small_part_answers_in_metres_and_seconds(
    engine: str, tmp_path: Path
) -> None:
    """A model of a small part has the size of a bench, in units that it states."""
    pytest.importorskip(PACKAGES.get(engine, engine))
    scene = fixel.load_scene(str(EXAMPLES / "micro_push.yaml")).scene
    fixel.export_model(scene, tmp_path / "model", to=engine, scenes=0)
    found = poses_of(tmp_path / "model")
    direct = fixel.simulate(scene, motion=engine, output_interval=scene.duration / 100)
    np.testing.assert_allclose(found[:, 0], direct.time[1:], rtol=1e-12)
    np.testing.assert_allclose(found[:, 1:], direct.pose["part"][1:], rtol=0, atol=1e-15)
    model = json.loads((tmp_path / "model" / "model.json").read_text())
    length = model["units"]["length_m"]
    sides = np.ptp(np.array(model["body"]["outline"]["pieces"][0]), axis=0)
    assert length * sides == pytest.approx([1621e-6, 842e-6])


def test_mass_and_inertia_of_models_are_those_of_the_body(tmp_path: Path) -> None:
    """Other readers of the files find the exact values; feet on the rim had 23 % more inertia."""
    mujoco, dynamics = pytest.importorskip("mujoco"), pytest.importorskip("pydrake.all")
    on_rim = SupportPoints(
        points=[(0.0, 0.0), (0.08, 0.0), (0.0, 0.06), (0.03, 0.06)], friction=0.3,
        loads=[0.5, 0.6, 0.4, 0.3],
    )  # fmt: skip
    scene = rich_scene()
    for k, support in enumerate((scene.bodies[0].support, on_rim)):
        body = fixel.Body(
            "part", L_SHAPE, mass=0.2, centre_of_mass=(0.03, 0.02), support=support,
            pose=scene.bodies[0].pose,
        )  # fmt: skip
        exported = Scene((body,), scene.pushers, scene.fixels, duration=2.0)
        expected = pytest.approx([0.2, 0.2, body.moment_of_inertia], rel=1e-12)
        for name in ("mujoco", "drake", "urdf"):
            fixel.export_model(exported, tmp_path / f"{name}{k}", to=name, scenes=0)
        model = mujoco.MjModel.from_xml_path(str(tmp_path / f"mujoco{k}" / "model.xml"))
        data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
        mujoco.mj_forward(model, data)
        for row, unit in zip(full, np.eye(model.nv), strict=True):
            mujoco.mj_mulM(model, data, row, unit)
        assert np.diag(full)[:3] == expected
        assert full[2, :2] == pytest.approx([0.0, 0.0], abs=1e-12)  # about the centre of mass
        plant = dynamics.MultibodyPlant(0.01)
        dynamics.Parser(plant).AddModels(str(tmp_path / f"drake{k}" / "model.sdf"))
        plant.Finalize()
        first = plant.GetJointByName("object_plane").velocity_start()
        own = slice(first, first + 3)
        full = plant.CalcMassMatrix(plant.CreateDefaultContext())[own, own]
        assert np.diag(full) == expected
        assert full[2, :2] == pytest.approx([0.0, 0.0], abs=1e-12)
        robot = ElementTree.parse(tmp_path / f"urdf{k}" / "object.urdf").getroot()
        masses = [float(own.get("value") or "nan") for own in robot.iter("mass")]
        inertia = sum(float(own.get("izz") or "nan") for own in robot.iter("inertia"))
        assert [sum(masses), sum(masses), inertia] == expected


def test_an_ellipsoid_becomes_one_foot_with_torsion_in_mujoco(tmp_path: Path) -> None:
    scene = pushed_square()
    body = Body("part", scene.bodies[0].shape, mass=0.15, support=Ellipsoid(force=0.4, torque=0.01))
    scene = Scene((body,), scene.pushers, duration=2.0)
    assert difference(tmp_path / "model", scene, "mujoco") < 1e-9
    pairs = ElementTree.parse(tmp_path / "model" / "model.xml").findall("contact/pair")
    (foot,) = [pair for pair in pairs if pair.get("geom1") == "floor"]
    slide, _, torsion, *_ = map(float, str(foot.get("friction")).split())
    assert slide == 1.0
    assert torsion == pytest.approx(0.01 / 0.4)
    with pytest.raises(InvalidInput, match="ellipsoidal limit surface"):
        fixel.export_model(scene, tmp_path / "other", to="box2d", scenes=0)


def test_urdf_has_loads_on_its_feet_and_lists_what_it_lacks(tmp_path: Path) -> None:
    import mujoco

    scene = rich_scene()
    done = fixel.export_model(scene, tmp_path / "model", to="urdf")
    path = tmp_path / "model" / "object.urdf"
    robot = ElementTree.parse(path).getroot()
    feet = robot.findall("gazebo")
    rough = [float(foot.findtext("mu1") or "nan") for foot in feet]
    assert rough == pytest.approx([0.3] * 3, rel=2e-3)
    assert "2 fixels" in done.card["not_in_the_model"]
    assert any("0.1, 0.2, 0.4" in text for text in done.card["not_in_the_model"])
    assert not any("inertia" in text for text in done.card["not_in_the_model"])
    model = mujoco.MjModel.from_xml_path(str(path))  # another reader of URDF
    assert model.nq == 3
    links = robot.findall("link")
    masses = np.array([float(own.find("inertial/mass").get("value")) for own in links])
    places = np.array(
        [
            [float(x) for x in str(own.get("xyz")).split()][:2]
            for own in robot.findall("joint/origin")
        ]
    )
    centres = np.array(
        [
            [float(x) for x in str(own.find("inertial/origin").get("xyz")).split()][:2]
            for own in links
        ]
    )
    # The centre of mass of every link is that of the body, and the loads are in balance about it.
    np.testing.assert_allclose(places + centres[1:], 0.0, atol=1e-15)
    np.testing.assert_allclose(masses[1:] @ places, 0.0, atol=1e-12)
    assert masses[1:].sum() * rough[0] == pytest.approx(0.2 * 0.3)  # the friction force is exact


@pytest.mark.parametrize(("friction", "lacks"), [(2.5, "for Drake"), (0.0, "no feet"), (1.9, "")])
def test_urdf_of_a_rough_or_frictionless_support_states_what_it_lacks(
    friction: float, lacks: str, tmp_path: Path
) -> None:
    """The partner of a coefficient above 2 was negative, and frictionless feet vanished."""
    scene = rich_scene()
    (body,) = scene.bodies
    own = replace(body, support=replace(body.support, friction=friction))
    done = fixel.export_model(replace(scene, bodies=(own,)), tmp_path / "model", to="urdf")
    robot = ElementTree.parse(tmp_path / "model" / "object.urdf").getroot()
    partners = [float(one.get("value") or "nan") for one in robot.iter("{drake.mit.edu}mu_dynamic")]
    found = [2.0 * one / (one + 1.0) for one in partners]  # as Drake combines it with a floor of 1
    assert found == pytest.approx([friction] * (3 if friction == 1.9 else 0), rel=2e-3)
    assert len(robot.findall("gazebo")) == (3 if friction else 0)
    stated = [t for t in done.card["not_in_the_model"] if "for Drake" in t or "no feet" in t]
    assert [lacks in text for text in stated] == [True] * bool(lacks)


@pytest.mark.system
def test_the_card_of_a_calibration_has_intervals_and_errors(tmp_path: Path) -> None:
    pushes = example_pushes(4)
    fit = fixel.calibrate(pushes[:2], SPACE, progress=False)
    done = fixel.export_model(
        fit, tmp_path / "own", to="pymunk:inertia_factor=10", scenes=4, progress=False
    )
    card = json.loads((tmp_path / "own" / "card.json").read_text())
    assert card == done.card
    known = {own["name"]: own for own in card["parameters"]}
    estimate = fit.estimates["mu_pusher"]
    assert (known["mu_pusher"]["low"], known["mu_pusher"]["high"]) == (estimate.low, estimate.high)
    assert card["exported_values"]["mu_pusher"] == fit["mu_pusher"]
    assert card["choices"]["inertia_factor"] == 10.0
    model = json.loads((tmp_path / "own" / "model.json").read_text())
    assert model["pusher"]["friction"] == fit["mu_pusher"]
    errors = card["errors_on_experiments"]
    assert not errors["held_out"]
    # Independent of the card's own way: the last residual of each experiment.
    ends = [1e3 * np.hypot(*fit.residuals(push)[-1, :2]) for push in pushes[:2]]
    assert errors["fixel"]["position_mm"]["median"] == pytest.approx(np.median(ends))
    assert card["distance_from_fixel"]["simulations"] == 4
    held = fixel.export_model(
        fit, tmp_path / "held", to="pymunk", scenes=0, held_out=pushes[2:], progress=False
    )
    errors = held.card["errors_on_experiments"]
    assert errors["held_out"]
    assert errors["fixel"]["simulations"] == 2
    assert held.card["distance_from_fixel"] is None
    with pytest.raises(InvalidInput, match="which the calibration has used"):
        fixel.export_model(fit, tmp_path / "used", to="pymunk", held_out=pushes[1:3])


@pytest.mark.system
def test_a_stored_calibration_is_exported_as_its_value(tmp_path: Path) -> None:
    project = fixel.Project.create(tmp_path / "lab")
    project.add(example_pushes(2), progress=False)
    fit = project.calibrate("", SPACE, verdicts=False, progress=False)
    fixel.export_model(fit, tmp_path / "value", to="box2d", scenes=0, progress=False)
    done = fixel.export_model(project, tmp_path / "stored", to="box2d", scenes=0, progress=False)
    texts = [(tmp_path / name / "model.json").read_text() for name in ("value", "stored")]
    assert texts[0] == texts[1]
    assert done.card["source"]["calibration"] == fit.run.ids[0]


@pytest.mark.system
def test_fresh_scenes_are_as_far_from_fixel_as_the_card_states(tmp_path: Path) -> None:
    """The program of the export is run on starts of another seed; 16 scenes instead of 100."""
    from benchmarks.model_export import measured

    stated, found = measured(pushed_square(), "pymunk", tmp_path / "model", 16)
    low, high = stated["median_low"], stated["median_high"]
    assert np.quantile(found, 0.2) < high
    assert np.quantile(found, 0.8) > low
    assert np.median(found) == pytest.approx(stated["median"], rel=0.1)


def test_bad_input_leaves_nothing(tmp_path: Path) -> None:
    scene, target = pushed_square(), tmp_path / "model"
    refused(fixel.export_model, scene, target, to="gazebo", match="one of mujoco, drake")
    refused(fixel.export_model, scene, target, to="pymunk:stepp=1", match="choices of pymunk")
    refused(fixel.export_model, scene, target, to="pymunk==1.0", match="version")
    refused(fixel.export_model, grasp(), target, to="mujoco", match="force limit")
    refused(fixel.export_model, scene, target, to="pymunk", scenes=-1, match="0 to 100000")
    with pytest.raises(InvalidInput, match="needs the project that has it"):
        fixel.export_model(scene, target, to="pymunk", calibration=1)
    assert not list(tmp_path.iterdir())
    target.mkdir()
    (target / "notes.txt").write_text("mine")
    refused(fixel.export_model, scene, target, to="pymunk", match="new or empty folder")
    assert [path.name for path in tmp_path.rglob("*")] == ["model", "notes.txt"]


def test_a_direction_of_the_plane_is_refused_by_other_engines() -> None:
    with pytest.raises(InvalidInput, match="depends on direction"):
        fixel.simulate(pushed_square(), {"anisotropy_xy": 0.5}, motion="pymunk")
