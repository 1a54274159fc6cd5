"""Recordings of motions, read back by the libraries of their formats and by geometry."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from scipy.spatial.transform import Rotation

import fixel
from fixel import InvalidInput, MissingExtra
from fixel.testing.pushes import example_pushes
from fixel.testing.scenes import pushed_square
from fixel.units import deg, mm

mcap_reader: Any = pytest.importorskip("mcap.reader")


def messages(path: Path, topic: str) -> list[tuple[str, float, Any]]:
    """Schema, log time and content of the messages of a topic."""
    with path.open("rb") as stream:
        reader = mcap_reader.make_reader(stream, validate_crcs=True)
        assert reader.get_summary() is not None  # a whole file, with an index
        return [
            (schema.name, 1e-9 * message.log_time, json.loads(message.data))
            for schema, _, message in reader.iter_messages(topics=[topic])
        ]


def poses(path: Path) -> dict[str, Any]:
    """Time, x, y and angle (n, 4) by frame."""
    found: dict[str, list[tuple[float, ...]]] = {}
    for schema, logged, content in messages(path, "/tf"):
        assert schema == "foxglove.FrameTransforms"
        for one in content["transforms"]:
            assert one["parent_frame_id"] == "world"
            time = one["timestamp"]["sec"] + 1e-9 * one["timestamp"]["nsec"]
            assert time == pytest.approx(logged, abs=1e-8)
            place, turn = one["translation"], [one["rotation"][name] for name in "xyzw"]
            angle = Rotation.from_quat(turn).as_euler("xyz")
            assert (place["z"], *angle[:2]) == pytest.approx((0, 0, 0))
            row = (time, place["x"], place["y"], angle[2])
            found.setdefault(one["child_frame_id"], []).append(row)
    return {name: np.array(rows) for name, rows in found.items()}


def check_motion(rows: Any, time: Any, pose: Any) -> None:
    assert rows[:, 0] == pytest.approx(time, abs=1e-8)
    assert rows[:, 1:3] == pytest.approx(pose[:, :2], abs=1e-12)
    turn = rows[:, 3] - pose[:, 2]
    assert np.cos(turn) == pytest.approx(1.0)


@pytest.fixture(scope="module")
def simulation() -> fixel.Simulation:
    return fixel.simulate(pushed_square())


def test_simulation_as_mcap(tmp_path: Path, simulation: fixel.Simulation) -> None:
    done = fixel.export_model(simulation, tmp_path / "made", to="mcap")
    assert (done.to, done.files) == ("mcap", ("card.json", "motion.mcap"))
    found = poses(done.folder / "motion.mcap")
    for name, pose in simulation.pose.items():
        check_motion(found[name], simulation.time, pose)
    ((schema, _, update),) = messages(done.folder / "motion.mcap", "/scene")
    assert schema == "foxglove.SceneUpdate"
    things = {one["id"]: one for one in update["entities"]}
    assert set(things) == set(found)
    for thing in (*simulation.scene.bodies, *simulation.scene.pushers):
        own = things[thing.name]
        assert (own["frame_id"], own["frame_locked"]) == (thing.name, True)
        (triangles,) = own["triangles"]
        corners = [[p["x"], p["y"]] for p in triangles["points"]]
        area = shapely.union_all(shapely.polygons(np.reshape(corners, (-1, 3, 2))))
        assert area.area == pytest.approx(shapely.Polygon(thing.shape.outline).area)


def test_mcap_of_a_motion_is_read_again(tmp_path: Path, simulation: fixel.Simulation) -> None:
    done = fixel.export_model(simulation, tmp_path / "made", to="mcap")
    path = done.folder / "motion.mcap"
    (push,) = fixel.read_experiments(path, columns={"part": "part", "pusher": "finger"})
    assert push.trajectory.pose[-1] == pytest.approx(simulation.final["part"], abs=1e-9)


def test_calibration_has_measured_and_simulated_motion(tmp_path: Path) -> None:
    pushes = example_pushes(2)
    fit = fixel.calibrate(pushes, ["mu_pusher"], verdicts=False, progress=False)
    done = fixel.export_model(fit, tmp_path / "made", to="mcap")
    found = poses(done.folder / "motion.mcap")
    name = pushes[0].scene.bodies[0].name
    measured = pushes[0].trajectory
    rows = found[f"{name} measured"]
    expected = [np.interp(rows[:, 0], measured.time, axis) for axis in measured.pose.T]
    assert rows[:, 1:] == pytest.approx(np.column_stack(expected), abs=1e-6)
    end = fixel.simulate(pushes[0].scene, fit).final[name]
    assert found[name][-1, 1:3] == pytest.approx(end[:2], abs=0.05 * mm)
    assert done.card["parameters"][0]["name"].startswith("mu_pusher")


def test_plan_as_mcap(tmp_path: Path) -> None:
    goal = fixel.PoseRegion((0.02, 0.0, 0.0), position=5 * mm, angle=5 * deg)
    plan = fixel.plan(pushed_square(), goal, rollouts=4_000, progress=False)
    done = fixel.export_model(plan, tmp_path / "made", to="mcap")
    found = poses(done.folder / "motion.mcap")
    assert found["part"][0, 1:3] == pytest.approx(plan.start[0, :2], abs=1e-9)
    assert found["part"][-1, 1:3] == pytest.approx(plan.end[:2], abs=0.2 * mm)
    assert found["finger"][-1, 1:3] == pytest.approx(plan.path[-1, -1, 1:3], abs=0.2 * mm)


def test_simulation_as_rerun(tmp_path: Path, simulation: fixel.Simulation) -> None:
    pytest.importorskip("rerun")
    chunks: Any = pytest.importorskip("rerun.chunk")
    done = fixel.export_model(simulation, tmp_path / "made", to="rerun")
    assert done.files == ("card.json", "motion.rrd")
    place, times, meshes = {}, {}, set()
    for chunk in chunks.RrdReader(done.folder / "motion.rrd").stream():
        table, name = chunk.to_record_batch(), str(chunk.entity_path).removeprefix("/world/")
        for column in table.schema.names:
            if column.endswith("Transform3D:translation"):
                place[name] = np.array(table[column].to_pylist())[:, 0]
                times[name] = np.array(table["time"].cast("int64").to_pylist()) * 1e-9
            elif column.endswith("Mesh3D:vertex_positions"):
                meshes.add(name)
    assert meshes == set(simulation.scene.names)
    for name, pose in simulation.pose.items():
        assert times[name] == pytest.approx(simulation.time, abs=1e-8)
        assert place[name][:, :2] == pytest.approx(pose[:, :2], abs=1e-6)  # float32


def test_names_with_slashes_are_no_paths_in_rerun(
    tmp_path: Path, simulation: fixel.Simulation
) -> None:
    # In rerun, world/part/2 would move with world/part.
    pytest.importorskip("rerun")
    chunks: Any = pytest.importorskip("rerun.chunk")
    pusher = replace(simulation.scene.pushers[0], name="part/2, red")
    run = fixel.simulate(replace(simulation.scene, pushers=(pusher,)))
    done = fixel.export_model(run, tmp_path / "made", to="rerun")
    stream = chunks.RrdReader(done.folder / "motion.rrd").stream()
    places = {str(chunk.entity_path) for chunk in stream}
    assert {"/world/part", r"/world/part\/2\,\ red"} <= places


def test_other_targets_reject_motions(tmp_path: Path, simulation: fixel.Simulation) -> None:
    with pytest.raises(InvalidInput, match="a simulation"):
        fixel.export_model(simulation, tmp_path / "made", to="urdf")
    with pytest.raises(InvalidInput, match="did you mean 'mcap'"):
        fixel.export_model(simulation, tmp_path / "made", to="mcp")
    assert not (tmp_path / "made").exists()


def test_missing_package_is_named(
    tmp_path: Path, simulation: fixel.Simulation, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "rerun", None)
    with pytest.raises(MissingExtra, match=r"pip install 'fixel\[rerun\]'"):
        fixel.export_model(simulation, tmp_path / "made", to="rerun")
    assert not (tmp_path / "made").exists()


def test_drawn_bodies_have_the_calibrated_outline_and_radius(tmp_path: Path) -> None:
    # Where a pusher touches the part, the drawn outlines touch as well.
    (push,) = example_pushes(1)
    start = {"outline_x": 5 * mm, "outline_theta": 2 * deg, "contact_offset": 1 * mm}
    fit = fixel.calibrate([push], {"mu_pusher": (0, 1), **start}, verdicts=False, progress=False)
    part, finger = push.scene.names[:2]
    for what in (fit, fixel.simulate(push.scene, fit)):
        done = fixel.export_model(what, tmp_path / type(what).__name__, to="mcap")
        path = done.folder / "motion.mcap"
        ((_, _, update),) = messages(path, "/scene")
        drawn = {}
        for thing in update["entities"]:
            (triangles,) = thing["triangles"]
            corners = np.array([[p["x"], p["y"]] for p in triangles["points"]])
            *place, angle = poses(path)[thing["id"]][-1, 1:]
            turn = np.array(((np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))))
            drawn[thing["id"]] = shapely.MultiPoint(corners @ turn + place).convex_hull
        assert drawn[part].distance(drawn[finger]) < 0.02 * mm
        assert drawn[part].intersection(drawn[finger]).area < 0.02 * mm * 10 * mm


@pytest.mark.parametrize("name", ["world", "part measured"])
def test_frames_have_names_of_their_own(tmp_path: Path, name: str) -> None:
    (push,) = example_pushes(1)
    assert push.scene.bodies[0].name == "part"
    pusher = replace(push.scene.pushers[0], name=name)
    push = replace(push, scene=replace(push.scene, pushers=(pusher,)))
    with pytest.raises(InvalidInput, match=name):
        fixel.export_model(push, tmp_path / "made", to="mcap")
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize("to", ["mcap:step=0.001", "rerun==1.0", "urdf:step=0.001"])
def test_only_engines_have_choices(tmp_path: Path, to: str) -> None:
    with pytest.raises(InvalidInput, match="but must be one of mujoco"):
        fixel.export_model(pushed_square(), tmp_path / "made", to=to)
