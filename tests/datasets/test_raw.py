"""Readers of recorded pushes, on tiny files of our own and on the real ones where they are."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from tests.datasets import push_files

from fixel.datasets.raw import MitPushes, PushRuns, RpiTrials, read_dataset
from fixel.datasets.raw.mit_push import mass_of
from fixel.errors import DatasetMissing, InvalidInput
from fixel.model import Disk, Polygon


def test_pushes_are_read_in_si(tmp_path: Path) -> None:
    data = read_dataset(push_files.mit_push(tmp_path, push_files.push(0, gap0_mm=-0.5)))

    assert isinstance(data, MitPushes)
    assert len(data) == 1
    assert data.speed.tolist() == [0.01]
    assert data.gap_start.tolist() == [-0.5e-3]
    assert data.start.tolist() == [[0.2, -0.1, 0.0]]
    assert data.stroke == pytest.approx([0.05])
    assert data.predictions["poly4"][0] == pytest.approx([0.252, -0.1, math.pi / 180])
    assert np.isnan(data.predictions["quad"]).all()


def test_circles_are_disks_and_other_ellipses_fine_polygons(tmp_path: Path) -> None:
    data = read_dataset(push_files.mit_push(tmp_path, push_files.push(0)))

    assert isinstance(data, MitPushes)
    assert data.shapes["coin"] == Disk(0.03)
    egg = data.shapes["egg"]
    assert isinstance(egg, Polygon)
    assert egg.area == pytest.approx(math.pi * 0.03 * 0.04, rel=1e-3)


def test_plates_without_a_known_mass_are_steel(tmp_path: Path) -> None:
    data = read_dataset(push_files.mit_push(tmp_path, push_files.push(0)))

    assert isinstance(data, MitPushes)
    assert mass_of("block", data.shapes["block"]) == pytest.approx(0.06**2 * 0.013 * 7950)
    assert mass_of("rect1", data.shapes["block"]) == 0.837


def test_a_trial_is_read_in_si(tmp_path: Path) -> None:
    data = read_dataset(push_files.rpi_2dgad(tmp_path))

    assert isinstance(data, RpiTrials)
    assert data.incomplete == (8,)
    (trial,) = data.trials
    assert trial.experiment_id == 7
    assert trial.inertia == pytest.approx(120e-6)
    assert trial.fixels[1].tolist() == [-0.06, -0.09]
    assert trial.parameters["tripod_radius"] == pytest.approx(0.02)
    assert trial.marker[0].tolist() == [0.0, 0.042]
    assert trial.tactile[-1].tolist() == [False, True, False]
    assert trial.lab is not None
    assert trial.lab.frame[0] == 2


def test_repeated_readings_of_a_run_are_dropped(tmp_path: Path) -> None:
    data = read_dataset(push_files.mit_timeseries(tmp_path))

    assert isinstance(data, PushRuns)
    (run,) = data.runs
    assert run.readings == 400
    assert len(run.pusher) == len(run.object.time) == 200
    assert run.name == "cpush_Straight"


def test_a_standstill_keeps_its_end(tmp_path: Path) -> None:
    folder = push_files.mit_timeseries(tmp_path)
    rows = [
        {"t": 0.005 * k, "slider_x": 0.1, "slider_y": 0.0, "slider_th": 0.1 * (k > 0),
         "pusher_x": 0.001 * max(0, k - 20), "pusher_y": 0.0}
        for k in range(24)
    ]  # fmt: skip
    push_files.write_table(folder / "cpush_Straight.csv.gz", rows)

    data = read_dataset(folder)

    assert isinstance(data, PushRuns)
    assert data.runs[0].pusher[:, 0] == pytest.approx([0.0, 0.1, 0.105, 0.11, 0.115])


def test_a_raw_record_is_read(tmp_path: Path) -> None:
    folder = push_files.mit_timeseries(tmp_path)
    rows = [[0.01 * k, 0.001 * k, 0.0, 0.1] for k in range(5)]
    record = {
        "object_pose": rows, "tip_pose": rows, "surface": "felt", "shape": "rect1",
        "speed_mm_s": 100,
    }  # fmt: skip
    (folder / "push_felt.json").write_text(json.dumps(record))

    data = read_dataset(folder)

    assert isinstance(data, PushRuns)
    assert data.runs[1].commanded_speed == pytest.approx(0.1)
    assert data.runs[1].object.pose[4].tolist() == [0.004, 0.0, 0.1]


def test_an_unknown_folder_says_what_was_looked_for(tmp_path: Path) -> None:
    with pytest.raises(DatasetMissing, match=r"pushes\.csv\.gz and shapes\.json"):
        read_dataset(tmp_path)


def test_a_folder_of_datasets_says_where_they_are(tmp_path: Path) -> None:
    push_files.mit_push(tmp_path / "inside", push_files.push(0))

    with pytest.raises(DatasetMissing, match="look inside: inside"):
        read_dataset(tmp_path)


def test_trials_without_their_files_are_missing(tmp_path: Path) -> None:
    folder = push_files.rpi_2dgad(tmp_path)
    (folder / "exp7_frames.csv").unlink()

    with pytest.raises(DatasetMissing, match=r"exp7_frames\.csv"):
        read_dataset(folder)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"obj_x1": "much"}, r"row 1, column obj_x1: found 'much'"),
        ({"obj_x1": "nan"}, r"row 1, column obj_x1"),
        ({"tip_x0": ""}, r"row 1, column tip_x0: found ''"),
        ({"shape": "star"}, r"the shape star"),
        ({"speed_mm_s": 0}, r"a positive speed"),
    ],
)
def test_wrong_pushes_are_refused(
    changes: dict[str, object], complaint: str, tmp_path: Path
) -> None:
    folder = push_files.mit_push(tmp_path, push_files.push(0, **changes))

    with pytest.raises(InvalidInput, match=complaint):
        read_dataset(folder)


def test_a_missing_column_is_named(tmp_path: Path) -> None:
    row = push_files.push(0)
    del row["tip_y1"]

    with pytest.raises(InvalidInput, match="a column tip_y1"):
        read_dataset(push_files.mit_push(tmp_path, row))


def test_a_broken_file_is_refused(tmp_path: Path) -> None:
    folder = push_files.mit_push(tmp_path, push_files.push(0))
    (folder / "pushes.csv.gz").write_bytes(b"not compressed")
    with pytest.raises(InvalidInput, match=r"pushes\.csv\.gz"):
        read_dataset(folder)

    folder = push_files.mit_push(tmp_path, push_files.push(0))
    (folder / "shapes.json").write_text("{")
    with pytest.raises(InvalidInput, match=r"shapes\.json"):
        read_dataset(folder)


def test_times_that_go_back_are_refused(tmp_path: Path) -> None:
    folder = push_files.rpi_2dgad(tmp_path)
    lines = (folder / "exp7_frames.csv").read_text().splitlines()
    (folder / "exp7_frames.csv").write_text("\n".join([lines[0], lines[2], lines[1]]))

    with pytest.raises(InvalidInput, match="increasing times"):
        read_dataset(folder)


def test_the_real_data_are_recognised(data_root: Path) -> None:
    pushes = read_dataset(data_root / "mit_push_endpoints")
    trials = read_dataset(data_root / "rpi_2dgad")
    runs = read_dataset(data_root / "mit_timeseries")

    assert isinstance(pushes, MitPushes)
    assert len(pushes) == 4835
    assert isinstance(trials, RpiTrials)
    assert [trial.experiment_id for trial in trials.trials] == [141]
    assert isinstance(runs, PushRuns)
    assert len(runs.runs) == 6
