"""Trajectory files: columns, round trips, and never half a file."""

import json
import os

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from tests.fixtures import refused

from fixel import StewartTrinkle, simulate
from fixel.formats.trajectory_file import save_trajectory, trajectory_columns
from fixel.io.atomic import written_whole
from fixel.io.document import plain_numbers
from fixel.testing import scenes


@pytest.fixture(scope="module")
def run():
    return simulate(scenes.grasp("seated"), stepper=StewartTrinkle(step=0.02))


def read(path):
    reader = pyarrow.csv.read_csv if path.suffix == ".csv" else pyarrow.parquet.read_table
    return reader(path)


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_numbers_survive_the_round_trip(run, ending, tmp_path):
    path = tmp_path / f"run.{ending}"
    save_trajectory(run, path)
    table = read(path)
    expected = trajectory_columns(run)
    assert table.column_names == list(expected)
    for name, column in expected.items():
        np.testing.assert_array_equal(table[name].to_numpy(zero_copy_only=False), column)
    assert list(tmp_path.iterdir()) == [path]


def test_parquet_carries_the_summary(run, tmp_path):
    save_trajectory(run, tmp_path / "run.parquet")
    about = json.loads(pyarrow.parquet.read_schema(tmp_path / "run.parquet").metadata[b"fixel"])
    assert about["status"] == run.status
    assert about["method"]["stepper"] == "stewart-trinkle"


def test_columns_are_those_of_the_contract(run):
    columns = trajectory_columns(run)

    assert list(columns)[:7] == [
        "time_s", "object.x_m", "object.y_m", "object.theta_rad", "object.vx_m_per_s",
        "object.vy_m_per_s", "object.omega_rad_per_s",
    ]  # fmt: skip
    touched = {name.split(".")[0] for name in columns if name.endswith(".touching")}
    assert {f"{a}|{b}" for a, b in run.touching} <= touched
    for pair in touched:
        assert f"{pair}.normal_impulse_Ns" in columns
        assert f"{pair}.tangential_impulse_Ns" in columns
    assert {"actuator.force_N", "actuator.stalled"} <= set(columns)
    assert {len(column) for column in columns.values()} == {len(run.time)}


def test_impulse_is_force_times_step_and_zero_without_touching(run):
    columns = trajectory_columns(run)
    force = columns["object|actuator.normal_force_N"]
    impulse = columns["object|actuator.normal_impulse_Ns"]
    np.testing.assert_allclose(impulse[1:-1], 0.02 * force[1:-1], rtol=1e-6)
    assert (force[~columns["object|actuator.touching"]] == 0.0).all()


@pytest.mark.parametrize(("name", "sentence"), [
    ("run", r"\.csv, \.parquet"),
    ("run.xlsx", r"\.csv, \.parquet"),
    ("run.csv.gz", r"\.csv, \.parquet"),
    ("nowhere/run.csv", r"no folder .*nowhere, but fixel needs an existing folder"),
])  # fmt: skip
def test_other_endings_and_missing_folders_are_refused(run, name, sentence, tmp_path):
    refused(save_trajectory, run, tmp_path / name, match=sentence)


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder_is_a_plain_sentence(run, tmp_path):
    tmp_path.chmod(0o500)
    refused(save_trajectory, run, tmp_path / "run.csv", match="no write permission")


@pytest.mark.parametrize("end", [KeyboardInterrupt, RuntimeError])
def test_nothing_half_written_survives(end, tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("old")

    def write():
        with written_whole(path) as temporary:
            temporary.write_text("half")
            raise end

    with pytest.raises(end):
        write()

    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_is_a_plain_sentence(tmp_path):
    def write():
        with written_whole(tmp_path / "run.csv"):
            raise OSError(28, "No space left on device")

    refused(write, match="no space left on device")


def test_strict_json_has_no_infinities():
    assert plain_numbers({"a": [1.0, float("nan")], "b": float("inf")}) == {
        "a": [1.0, None],
        "b": None,
    }
