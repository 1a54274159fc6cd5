"""What is read of tiny files of our own, and of the real ones where they are."""

import json
import math

import numpy as np
import pytest
from tests.datasets import push_files, recordings
from tests.fixtures import refused

from fixel import Disk, InvalidInput, Polygon
from fixel.datasets import IMPORTERS, importer_for
from fixel.datasets.mit_push import read_mit_pushes
from fixel.datasets.mit_push_records import plate
from fixel.datasets.rpi_2dgad import lab_simulation
from fixel.replay.runs import read_runs


def imported(folder):
    return list(importer_for(folder).read(folder).experiments())


def test_pushes_are_read_in_si(tmp_path):
    data = read_mit_pushes(push_files.mit_push(tmp_path, push_files.push(0, gap0_mm=-0.5)))
    assert len(data) == 1
    assert data.speed.tolist() == [0.01]
    assert data.gap_start.tolist() == [-0.5e-3]
    assert data.start.tolist() == [[0.2, -0.1, 0.0]]
    assert np.hypot(*(data.tip_end - data.tip_start).T) == pytest.approx([0.05])
    assert data.published["poly4"][0] == pytest.approx([0.252, -0.1, math.pi / 180])
    assert np.isnan(data.published["quad"]).all()


def test_a_plate_that_no_push_starts_outside_of_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match="no push that starts outside the plate"):
        read_mit_pushes(push_files.mit_push(tmp_path, push_files.push(0, tip_x0=0.2)))


def test_circles_are_disks_and_other_ellipses_fine_polygons(tmp_path):
    pushes = [push_files.push(0, shape="coin"), push_files.push(1, shape="egg", tip_x0=0.14)]
    coin, egg = (e.scene for e in imported(push_files.mit_push(tmp_path, *pushes)))
    assert coin.bodies[0].shape == Disk(0.03)
    assert isinstance(egg.bodies[0].shape, Polygon)
    assert egg.bodies[0].shape.area == pytest.approx(math.pi * 0.03 * 0.04, rel=1e-3)


def test_plates_without_a_known_mass_are_steel():
    square = Polygon(np.array(push_files.SQUARE))
    assert plate("block", square, np.zeros(3)).mass == pytest.approx(0.06**2 * 0.013 * 7950)
    assert plate("rect1", square, np.zeros(3)).mass == 0.837


def test_a_trial_is_read_in_si(tmp_path):
    folder = recordings.rpi_2dgad(tmp_path)
    trial = imported(folder)[0]
    lab = lab_simulation(folder, 7)

    assert trial.name == "7"
    assert trial.scene.bodies[0].inertia == pytest.approx(120e-6)
    assert trial.scene.fixels[1].pose[:2].tolist() == [-0.06, -0.09]
    assert trial.pusher.pose[0, :2].tolist() == [0.0, 0.042]
    assert trial.channel("tactile").values[-1].tolist() == [0.0, 1.0, 0.0]
    assert lab.time[0] == pytest.approx(1 / 30)
    assert lab_simulation(folder, 8) is None


def test_a_standstill_keeps_its_end(tmp_path):
    folder = push_files.mit_timeseries(tmp_path)
    rows = [
        {"t": 0.005 * k, "slider_x": 0.1, "slider_y": 0.0, "slider_th": 0.1 * (k > 0),
         "pusher_x": 0.001 * max(0, k - 20), "pusher_y": 0.0}
        for k in range(24)
    ]  # fmt: skip
    push_files.write_table(folder / "cpush_Straight.csv.gz", rows)
    (run,) = imported(folder)
    assert run.pusher.time == pytest.approx([0.0, 0.1, 0.105, 0.11, 0.115])


def test_a_raw_record_is_read(tmp_path):
    folder = push_files.mit_timeseries(tmp_path)
    rows = [[0.01 * k, 0.001 * k, 0.0, 0.1] for k in range(5)]
    record = {
        "object_pose": rows, "tip_pose": rows, "ft_wrench": rows, "surface": "felt",
        "shape": "rect1", "speed_mm_s": 100,
    }  # fmt: skip
    (folder / "push_felt.json").write_text(json.dumps(record))

    _, push = read_runs(folder)

    assert push.conditions["speed_m_s"] == pytest.approx(0.1)
    assert push.trajectory.pose[4].tolist() == [0.004, 0.0, 0.1]


def test_trials_without_their_files_are_left_out(tmp_path):
    folder = recordings.rpi_2dgad(tmp_path)
    (folder / "exp7_frames.csv").unlink()
    plan = importer_for(folder).read(folder)
    assert [experiment.name for experiment in plan] == ["8", "9"]
    assert "exp7_frames.csv" in plan.skipped[0]


@pytest.mark.parametrize(("changes", "complaint"), [
    ({"obj_x1": "much"}, r"row 1, column obj_x1 is 'much'"),
    ({"obj_x1": "nan"}, r"row 1, column obj_x1"),
    ({"obj_x1": "-1e19"}, r"row 1, column obj_x1 is '-1e19', but must be a number within"),
    ({"tip_x0": ""}, r"row 1, column tip_x0 is ''"),
    ({"shape": "star"}, r"the shape star"),
    ({"speed_mm_s": 0}, r"a positive speed"),
])  # fmt: skip
def test_wrong_pushes_are_refused(changes, complaint, tmp_path):
    folder = push_files.mit_push(tmp_path, push_files.push(0, **changes))
    refused(imported, folder, match=complaint)


def test_a_missing_column_is_named(tmp_path):
    row = push_files.push(0)
    del row["tip_y1"]
    refused(imported, push_files.mit_push(tmp_path, row), match="a column named tip_y1")


def test_a_broken_file_is_refused(tmp_path):
    folder = push_files.mit_push(tmp_path, push_files.push(0))
    (folder / "pushes.csv.gz").write_bytes(b"not compressed")
    refused(imported, folder, match=r"pushes\.csv\.gz")
    folder = push_files.mit_push(tmp_path, push_files.push(0))
    (folder / "shapes.json").write_text("{")
    refused(imported, folder, match=r"shapes\.json")


def test_trials_with_times_that_go_back_are_left_out(tmp_path):
    folder = recordings.rpi_2dgad(tmp_path)
    lines = (folder / "exp7_frames.csv").read_text().splitlines()
    (folder / "exp7_frames.csv").write_text("\n".join([lines[0], lines[2], lines[1]]))
    plan = importer_for(folder).read(folder)
    assert len(plan) == 2
    assert "increasing times" in plan.skipped[0]


def test_outlines_without_the_square_of_the_runs_are_refused(tmp_path):
    folder = push_files.mit_timeseries(tmp_path)
    (folder / "shapes.json").write_text('{"hex": [], "pusher_radius_m": 0.005}')
    refused(IMPORTERS["mit-pusher-slider"].read, folder, match="an outline of rect1")
