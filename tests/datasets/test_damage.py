"""Real folders with damage at random places: only what depends on it is left out, by name."""

import csv
import gzip
import json
import random
import shutil
from dataclasses import replace

import pytest
from tests.datasets import push_files, recordings
from tests.fixtures import refused

from fixel import read_experiments
from fixel.errors import DatasetMissing
from fixel.model import Provenance

SEEDS = range(3)
# Table of each real folder, its column of experiments, and a number that every experiment needs.
TABLES = [
    ("rpi_2dgad", "experiments.csv", "experiment_id", "start_frame"),
    ("rpi_2dgad", "object_trajectory.csv.gz", "experiment_id", "x_mm"),
    ("cmu_two_point_push", "runs.csv", "run_id", None),
    ("cmu_two_point_push", "poses.csv.gz", "run_id", "obj_th"),
    ("mit_push_endpoints", "pushes.csv.gz", "push_id", "obj_x1"),
]


def _copied(folder, target):
    """Copy a folder; of a long list of pushes, one in forty."""
    shutil.copytree(folder, target)
    if (target / "pushes.csv.gz").is_file():
        _write(target / "pushes.csv.gz", _lines(target / "pushes.csv.gz")[::40])
    return target


def _by_key(folder):
    return {one.key: _content(one) for one in read_experiments(folder, progress=False)}


def _content(experiment):
    """Return an experiment without the checksum of its file."""
    return replace(experiment, provenance=Provenance(version=""))


def _lines(path):
    opened = gzip.open if path.suffix == ".gz" else open
    with opened(path, "rt", encoding="utf-8", newline="") as stream:
        return stream.read().splitlines()


def _write(path, lines):
    opened = gzip.open if path.suffix == ".gz" else open
    with opened(path, "wt", encoding="utf-8", newline="") as stream:
        stream.write("\n".join(lines) + "\n")


def _key(name, skipped):
    return skipped.split(": ")[0].split("/")[-1] == name


@pytest.mark.parametrize(("folder", "table", "column", "number"), TABLES)
def test_a_damaged_row_leaves_out_its_experiment(
    folder, table, column, number, data_root, tmp_path
):
    whole = _by_key(_copied(data_root / folder, tmp_path / "whole"))
    for seed in SEEDS:
        rng = random.Random(f"{table}{seed}")
        copy = _copied(data_root / folder, tmp_path / f"{seed}")
        lines = _lines(copy / table)
        header = next(csv.reader(lines[:1]))
        at = rng.randrange(1, len(lines))
        cells = next(csv.reader([lines[at]]))
        name = cells[header.index(column)]
        if number is None or rng.random() < 0.3:
            cells = cells[: header.index(column) + 1]  # the line was cut
        else:
            cells[header.index(number)] = rng.choice(["", "nan", "1e99", "x", "-inf"])
        _write(copy / table, [*lines[:at], ",".join(cells), *lines[at + 1 :]])

        found = read_experiments(copy, progress=False)

        lost = {key for key in whole if key.split("/")[-1] == name}
        if folder == "rpi_2dgad" and name == "141" and table.startswith("object"):
            lost = set()  # its own table of frames has the poses
        assert {one.key for one in found} == whole.keys() - lost
        assert all(_content(one) == whole[one.key] for one in found)
        assert [one for one in found.skipped if _key(name, one)] or not lost
        assert len(found.skipped) == len(lost)


@pytest.mark.parametrize("damage", ["{", "[]", "{}", '{"object": 3}', "\x00", ""])
def test_a_damaged_setup_leaves_out_its_trial(damage, data_root, tmp_path):
    whole = _by_key(data_root / "rpi_2dgad")
    copy = _copied(data_root / "rpi_2dgad", tmp_path / "copy")
    (copy / "exp141_setup.json").write_text(damage)
    (copy / "exp73_setup.json").write_text('{"format": 2}')
    (copy / "exp_old_setup.json").write_text("{}")

    found = read_experiments(copy, progress=False)

    assert [one.key for one in found] == [key for key in whole if key != "rpi-2dgad/141"]
    assert all(_content(one) == whole[one.key] for one in found)
    assert sorted(text.split(":")[0] for text in found.skipped) == [
        "exp73_setup.json", "exp_old_setup.json", "rpi-2dgad/141",
    ]  # fmt: skip
    assert len(found.simulations) == 20 - 1


def test_trials_without_the_common_table_are_left_out(data_root, tmp_path):
    copy = _copied(data_root / "rpi_2dgad", tmp_path / "copy")
    packed = (copy / "object_trajectory.csv.gz").read_bytes()
    (copy / "object_trajectory.csv.gz").write_bytes(packed[: len(packed) // 2])
    found = read_experiments(copy, progress=False)
    assert [one.name for one in found] == ["141"]
    assert len(found.skipped) == 19
    assert all("object_trajectory.csv.gz" in text for text in found.skipped)


def test_a_damaged_simulation_leaves_the_experiments(data_root, tmp_path):
    copy = _copied(data_root / "rpi_2dgad", tmp_path / "copy")
    (copy / "author_simulation_trajectory.csv.gz").write_bytes(b"cut")
    found = read_experiments(copy, progress=False)
    assert len(found) == 20
    assert [*found.simulations] == ["rpi-2dgad/141"]
    assert [text.split(":")[0] for text in found.skipped] == ["author_simulation_trajectory.csv.gz"]


def test_a_damaged_run_leaves_the_others(data_root, tmp_path):
    whole = read_experiments(data_root / "mit_timeseries", progress=False)
    for seed in SEEDS:
        copy = _copied(data_root / "mit_timeseries", tmp_path / f"{seed}")
        rng = random.Random(seed)
        path = rng.choice(sorted(copy.glob("cpush_*")))
        packed = path.read_bytes()
        path.write_bytes(packed[: rng.randrange(1, len(packed) - 8)])

        found = read_experiments(copy, progress=False)

        sound = [one for one in whole if one.name != path.name.split(".")[0]]
        assert [*found] == sound
        assert len(found.skipped) == 1
        assert path.name.split(".")[0] in found.skipped[0]


def test_pushes_of_the_tripod_are_left_out_one_by_one(tmp_path):
    whole = [*read_experiments(recordings.cmu_tripod(tmp_path / "whole"), progress=False)]
    for table, cell in (("pushes.csv", "0.51"), ("force.csv.gz", "-0.5"), ("robot.csv.gz", "20.0")):
        folder = recordings.cmu_tripod(tmp_path / table)
        lines = _lines(folder / table)
        at = next(k for k, line in enumerate(lines) if line.startswith("push_1"))
        column = {"pushes.csv": "obj_x1", "force.csv.gz": "fy_on_object", "robot.csv.gz": "x_mm"}
        cells = lines[at].split(",")
        cells[lines[0].split(",").index(column[table])] = f"{cell}?"
        _write(folder / table, [*lines[:at], ",".join(cells), *lines[at + 1 :]])

        found = read_experiments(folder, progress=False)

        assert [*found] == whole[:1] or [one.trajectory for one in found] == [whole[0].trajectory]
        assert [text.split(":")[0] for text in found.skipped] == ["cmu-tripod/push_1"]


def test_an_unknown_support_leaves_out_its_pushes(tmp_path):
    folder = recordings.cmu_tripod(tmp_path)
    setup = json.loads((folder / "setup.json").read_text())
    del setup["support_points_m"]["patch"]
    (folder / "setup.json").write_text(json.dumps(setup))
    found = read_experiments(folder, progress=False)
    assert [one.name for one in found] == ["push_0"]
    assert "the support patch" in found.skipped[0]


def test_a_push_of_an_unknown_or_damaged_shape_is_left_out(tmp_path):
    pushes = [push_files.push(k, shape=s) for k, s in enumerate(("block", "star", "egg"))]
    folder = push_files.mit_push(tmp_path, *pushes)
    shapes = json.loads((folder / "shapes.json").read_text())
    shapes["egg"]["semi_axis_x_m"] = "wide"
    (folder / "shapes.json").write_text(json.dumps(shapes))

    found = read_experiments(folder, progress=False)

    assert [one.name for one in found] == ["felt_block_0"]
    assert [text.split(":")[0] for text in found.skipped] == [
        "mit-push/felt_block_1", "mit-push/felt_block_2",
    ]  # fmt: skip


def test_records_are_left_out_one_by_one(tmp_path):
    folder = recordings.mit_records(tmp_path)
    (folder / "felt" / f"{recordings.RECORD}1.json").write_text("{")
    found = read_experiments(folder, progress=False)
    assert [one.name for one in found] == [recordings.RECORD]
    assert recordings.RECORD + "1" in found.skipped[0]


def test_outlines_that_cannot_be_read_leave_records_without_a_scene(tmp_path):
    folder = recordings.mit_records(tmp_path)
    (folder / "shapes.json").write_text("{")
    found = read_experiments(folder, progress=False)
    assert found[0].scene is None
    assert found.skipped[0].startswith("shapes.json: the whole file")


def _pushes(bad):
    yield "push,time_s,x_mm,y_mm,theta_deg"
    for push in range(5):
        for k in range(4):
            x = bad.get(push, f"{10 * k}") if k == 2 else f"{10 * k}"
            yield f"p{push},{0.1 * k:.1f},{x},0,{k}"


def test_experiments_of_an_own_table_are_left_out_one_by_one(tmp_path):
    file = tmp_path / "own.csv"
    _write(file, [*_pushes({})])
    whole = [*read_experiments(file, split_by="push", progress=False)]
    for bad in ("x", "1e30", "1,2", "90000"):
        _write(file, [*_pushes({1: bad})])

        found = read_experiments(file, split_by="push", progress=False)

        assert [one.trajectory for one in found] == [
            one.trajectory for one in whole if one.name != "p1"
        ]
        assert [text.split(":")[0] for text in found.skipped] == ["own/p1"]


def test_a_table_with_damage_in_most_experiments_is_refused(tmp_path):
    file = tmp_path / "own.csv"
    _write(file, [*_pushes(dict.fromkeys(range(3), "x"))])
    refused(read_experiments, file, split_by="push", progress=False, match="push p0")


def test_angles_in_a_doubtful_unit_are_refused_for_the_whole_table(tmp_path):
    lines = ["push,time_s,x_mm,y_mm,theta_rad"]
    for push in range(4):  # the last turns by 30 in a second, so all are in degrees
        lines += [f"p{push},{0.1 * k},{k},0,{3 * k * (push == 3)}" for k in range(11)]
    _write(file := tmp_path / "own.csv", lines)
    refused(read_experiments, file, split_by="push", progress=False, match="angle_unit")


def test_a_missing_file_is_named_before_the_importers():
    for options in ({}, {"format": "csv"}, {"format": "mit-push"}):
        with pytest.raises(DatasetMissing, match=r"^nofile\.csv: no such file or folder$"):
            read_experiments("nofile.csv", **options)
