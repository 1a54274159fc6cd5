"""What each importer makes of a tiny recording."""

import json
import math
import sys

import numpy as np
import pytest
from tests.datasets import push_files, recordings
from tests.fixtures import refused

from fixel.datasets import IMPORTERS, importer_for
from fixel.errors import DatasetMissing, MissingExtra
from fixel.model import Disk, SupportPoints, UniformPressure


def imported(source, name=None, **options):
    plan = importer_for(source, name).read(source, **options)
    experiments = list(plan.experiments())
    assert len(experiments) == plan.n_experiments
    assert all(sentence.endswith(".") for sentence in plan.understood)
    return experiments


def flags(experiment):
    return [flag.name for flag in experiment.flags]


# --- which importer


def test_the_names_are_those_promised():
    assert list(IMPORTERS) == [
        "rpi-2dgad", "mit-push", "mit-pusher-slider", "cmu-tripod", "cmu-two-point", "bag",
        "csv",
    ]  # fmt: skip
    assert all(x.title and x.licence for x in IMPORTERS.values())


def test_every_recording_is_recognised(tmp_path):
    makers = {
        "rpi-2dgad": recordings.rpi_2dgad,
        "mit-push": recordings.mit_records,
        "mit-pusher-slider": recordings.mit_pusher_slider,
        "cmu-tripod": recordings.cmu_tripod,
        "cmu-two-point": recordings.cmu_two_point,
    }
    for name, make in makers.items():
        assert importer_for(make(tmp_path / name)).name == name
    pushes = push_files.mit_push(tmp_path / "table", push_files.push(0))
    assert importer_for(pushes).name == "mit-push"
    own = recordings.table_file(tmp_path / "own.csv", "t,x,y\n0,0,0\n")
    assert importer_for(own).name == "csv"


def test_unknown_names_are_refused_with_the_known_ones(tmp_path):
    with pytest.raises(DatasetMissing, match="rpi-2dgad, mit-push, mit-pusher-slider"):
        importer_for(tmp_path)
    with pytest.raises(DatasetMissing, match="no such file"):
        importer_for(tmp_path / "nowhere")
    refused(importer_for, tmp_path, "mit", match="'mit', but must be one of rpi-2dgad")


def test_folders_inside_are_named(tmp_path):
    recordings.rpi_2dgad(tmp_path / "trials")
    with pytest.raises(DatasetMissing, match="data found in: trials"):
        importer_for(tmp_path)


def test_a_named_importer_says_what_it_misses(tmp_path):
    for name in list(IMPORTERS)[:-1]:
        with pytest.raises(DatasetMissing):
            IMPORTERS[name].read(tmp_path)
    refused(IMPORTERS["csv"].read, tmp_path, match="one table")


def test_unknown_options_are_refused(tmp_path):
    folder = recordings.rpi_2dgad(tmp_path)
    said = "the option speed, but fixel needs one of its options: none"
    refused(IMPORTERS["rpi-2dgad"].read, folder, speed=3, match=said)


def test_a_caller_keeps_its_own_floating_point_settings(tmp_path):
    plan = IMPORTERS["cmu-two-point"].read(recordings.cmu_two_point(tmp_path))
    before = np.geterr()
    for _ in plan.experiments():
        assert np.geterr() == before


# --- rpi-2dgad


def test_a_complete_trial(tmp_path):
    trial = imported(recordings.rpi_2dgad(tmp_path))[0]

    assert trial.key == "rpi-2dgad/7"
    assert trial.real
    assert trial.contact_mode == "010"
    assert flags(trial) == ["actuator-filter-runs-on"]
    assert trial.trajectory.time[[0, 30]] == pytest.approx([0.0, 1.0])
    assert trial.effective == pytest.approx((1 / 30, 29 / 30))
    assert trial.provenance.source == "exp7_frames.csv"
    assert len(trial.provenance.sha256) == 64
    assert trial.scene.pushers[0].drive.force_limit == 34.3
    assert len(trial.scene.fixels) == 3
    assert trial.scene.bodies[0].pose.tolist() == trial.trajectory.pose[0].tolist()
    tactile = trial.channel("tactile")
    assert tactile.columns == ("fixel_1_bool", "fixel_2_bool", "fixel_3_bool")
    assert tactile.values[-1].tolist() == [0.0, 1.0, 0.0]
    assert trial.channel("actuator-filtered") is not None


def test_trials_without_actuator(tmp_path):
    _, invalid, valid = imported(recordings.rpi_2dgad(tmp_path))

    assert invalid.contact_mode == ""
    assert flags(invalid) == ["contact-mode-invalid", "no-actuator", "no-fixels", "no-shape"]
    assert valid.contact_mode == "100"
    assert flags(valid) == ["no-actuator", "no-fixels"]
    assert valid.scene is valid.pusher is None
    assert valid.height == pytest.approx(0.045)
    assert valid.trajectory.pose[0] == pytest.approx([0.01, 0.2, math.pi - 0.02])
    # Angles go on past half a turn, and heights do not get among them.
    assert np.diff(valid.trajectory.pose[:, 2]) == pytest.approx(0.01)


# --- mit-push


def test_a_push_of_the_end_point_set(tmp_path):
    folder = push_files.mit_push(tmp_path, push_files.push(0), push_files.push(1, gap1_mm=4.0))
    push, slid = imported(folder)

    assert push.key == "mit-push/felt_block_0"
    assert push.trajectory.time.tolist() == [0.0, 5.0]
    assert push.pusher.time.tolist() == [0.0, 5.0]
    assert push.scene.duration == 5.0
    assert push.scene.pushers[0].shape == Disk(push_files.TIP)
    assert push.scene.pushers[0].friction == 0.25
    assert isinstance(push.scene.bodies[0].support, UniformPressure)
    assert push.conditions["speed_m_s"] == 0.01
    assert slid.conditions["gap1_m"] == pytest.approx(4e-3)
    assert "misregistered" not in flags(slid)


def test_a_tip_inside_the_object_is_moved_to_contact_in_the_scene_only(tmp_path):
    start = 0.2 - 0.03 - push_files.TIP + 0.001
    (push,) = imported(push_files.mit_push(tmp_path, push_files.push(0, tip_x0=start)))
    assert flags(push) == ["pusher-moved-to-contact"]
    assert "1 mm" in push.flags[0].detail
    assert push.pusher.pose[0, 0] == start
    assert push.scene.pushers[0].pose[0] == pytest.approx(start - 0.001)
    assert push.scene.pushers[0].drive.waypoints[-1, 1] == push.pusher.pose[-1, 0]


def test_a_tip_deep_inside_has_no_scene(tmp_path):
    folder = push_files.mit_push(tmp_path, push_files.push(0, tip_x0=0.17, gap0_mm=-4.75))
    (push,) = imported(folder)
    assert push.scene is None
    assert flags(push) == ["misregistered", "no-scene"]


@pytest.mark.parametrize(("changes", "flag"), [
    ({"gap0_mm": 3.5}, "misregistered"),
    ({"gap1_mm": -3.5}, "misregistered"),
    ({"surface": "plywood", "shape": "hex"}, "systematic-offset"),
    ({"surface": "abs", "shape": "rect1", "speed_mm_s": 20}, "unexplained-error"),
])  # fmt: skip
def test_known_faults_are_flagged(changes, flag, tmp_path):
    folder = push_files.mit_push(tmp_path, push_files.push(0, **changes))
    shapes = json.loads((folder / "shapes.json").read_text())
    shapes["hex"] = shapes["rect1"] = shapes["block"]
    (folder / "shapes.json").write_text(json.dumps(shapes))
    assert flags(imported(folder)[0]) == [flag]


def test_repeated_names_are_refused(tmp_path):
    folder = push_files.mit_push(tmp_path, push_files.push(0), push_files.push(0))
    refused(imported, folder, match="row 2, column push_id: found 'felt_block_0' again")


def test_a_single_push(tmp_path):
    (push,) = imported(recordings.mit_records(tmp_path))

    assert push.name == recordings.RECORD
    assert push.trajectory.time[0] == 0.0
    assert push.trajectory.time[-1] == pytest.approx(0.196, abs=1e-6)
    assert push.conditions["surface"] == "felt"
    assert push.conditions["speed_m_s"] == pytest.approx(0.1)
    assert push.conditions["push_angle_rad"] == -0.349
    assert push.scene is not None
    assert push.channel("force").columns == ("fx_n", "fy_n", "torque_nm")


def test_a_single_push_of_an_unknown_shape_has_no_scene(tmp_path):
    file = tmp_path / f"{recordings.RECORD}.json"
    file.write_text(json.dumps(recordings.record(shape="star")))
    outlines = tmp_path / "outlines.json"
    outlines.write_text("{}")
    (push,) = imported(file, shapes=str(outlines))
    assert push.scene is None
    assert "no-shape" in flags(push)


def test_times_that_repeat_are_dropped_and_flagged(tmp_path):
    folder = recordings.mit_records(tmp_path)
    record = recordings.record()
    record["tip_pose"].insert(3, record["tip_pose"][2])
    (folder / "felt" / f"{recordings.RECORD}.json").write_text(json.dumps(record))
    (push,) = imported(folder)
    assert "repeated-times" in flags(push)
    assert len(push.pusher.time) == 50


def test_hdf5_without_its_library_says_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    file = tmp_path / f"{recordings.RECORD}.h5"
    file.write_bytes(b"\x89HDF\r\n")
    with pytest.raises(MissingExtra, match="hdf5"):
        imported(file)


def test_hdf5_as_published(tmp_path):
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    file = tmp_path / f"{recordings.RECORD}.h5"
    with h5py.File(file, "w") as stream:
        for key, rows in recordings.record().items():
            stream[key] = np.array(rows)
    (push,) = imported(file)
    assert len(push.trajectory.time) == 50


# --- mit-pusher-slider


def test_a_run(tmp_path):
    (run,) = imported(recordings.mit_pusher_slider(tmp_path))
    assert run.key == "mit-pusher-slider/cpush_Straight"
    assert len(run.trajectory.time) == 200
    assert run.trajectory.time[0] == 0.0
    assert run.conditions["raw_readings"] == 400
    assert [channel.name for channel in run.channels] == ["commanded", "controller"]
    assert run.scene is not None
    assert "tracking-dropouts" not in flags(run)


def test_dropouts_of_a_run_are_counted(tmp_path):
    (run,) = imported(recordings.mit_pusher_slider(tmp_path, gap_mm=-4.0))
    (flag,) = (flag for flag in run.flags if flag.name == "tracking-dropouts")
    assert "400 of 400" in flag.detail


# --- cmu-tripod


def test_pushes_on_known_supports(tmp_path):
    points, patch = imported(recordings.cmu_tripod(tmp_path))
    assert points.trajectory.time == pytest.approx([0.0, 0.59])
    assert points.pusher.pose[0] == pytest.approx([0.447, 0.0, 0.2])
    assert points.channel("force").values[0].tolist() == [4.0, -0.5]
    assert flags(points) == ["joined-sessions", "no-pose-during-push"]
    assert flags(patch) == ["joined-sessions", "no-pose-during-push", "tip-gap"]
    assert isinstance(points.scene.bodies[0].support, SupportPoints)
    assert isinstance(patch.scene.bodies[0].support, UniformPressure)


# --- cmu-two-point


def test_two_finger_pushes(tmp_path):
    points, ridge = imported(recordings.cmu_two_point(tmp_path))

    assert points.object_name == "brick_3pts"
    assert len(points.trajectory.time) == 34
    assert len(points.pusher.time) == 39
    assert np.ptp(points.pusher.pose[:, 2]) < 1e-9
    assert flags(points) == ["no-mass", "no-support", "pusher-offset", "tracking-lost"]
    assert "no-support" not in flags(ridge)
    assert "5 of 39" in points.flags[3].detail
    assert points.channel("action").values[[0, -1], 0].tolist() == [1.0, 2.0]
