"""Searches and hypotheses on made-up data, and what reproductions leave in a folder."""

import csv
import json

import numpy as np
import pytest
import reproductions.__main__ as command
import reproductions.run as module
from reproductions import asme_2006 as asme
from reproductions.result import Reproduction
from reproductions.rpi_141 import BOUNDS, HYPOTHESES, at_bound, rms_mm
from reproductions.run import reproduce

from fixel.cli.main import run
from fixel.errors import DatasetMissing, InvalidInput


@pytest.fixture(scope="module")
def answer(tmp_path_factory):
    out = tmp_path_factory.mktemp("asme")
    return reproduce("asme-table-1", out=out, quick=True), out


@pytest.mark.system
def test_a_few_short_searches_find_sets_as_good_as_p1(answer):
    tables = answer[0].tables
    good = [row for row in tables["sets"] if row["good"]]
    assert good
    assert sum(row["sets"] for row in tables["clusters"]) == len(good)
    # What is felt of the support is found; 695 um, and the full run spans 613 to 704.
    assert good[0]["mean_radius_um"] == pytest.approx(695.0, abs=60.0)


@pytest.mark.system
def test_tables_and_picture_are_left_in_the_folder(answer):
    made, out = answer
    values = json.loads((out / "asme-table-1.json").read_text(encoding="utf-8"))
    assert values["conclusions"] == list(made.conclusions)
    with (out / "asme-table-1_sets.csv").open(encoding="utf-8") as stream:
        assert len(list(csv.DictReader(stream))) == len(made.tables["sets"])
    assert (out / "asme-table-1.png").stat().st_size > 10_000


@pytest.mark.system
def test_noise_of_the_camera_is_the_error_of_the_truth(answer):
    # Evenly spread errors: a third of a pixel squared for x and y, and L times the angle.
    expected = np.sqrt((2 * asme.PIXEL**2 + (asme.LENGTH * asme.ANGLE_ERROR) ** 2) / 3)
    assert answer[0].settings["error_of_p1_um"] == pytest.approx(1e6 * expected, rel=0.05)


@pytest.mark.system
def test_friction_of_the_plane_changes_nothing(answer):
    # Below a thousandth of a pixel over three decades.
    assert all(row["f_um"] < 5e-3 for row in answer[0].tables["plane_friction"])


def test_unknown_names_and_missing_folders_are_refused(tmp_path):
    with pytest.raises(InvalidInput, match="cmu-tripod, rpi-141, asme-table-1"):
        reproduce("asme")
    for name in ("rpi-141", "repeats", "error-bounds", "rates"):
        with pytest.raises(DatasetMissing):
            reproduce(name, tmp_path)
    for name in ("cmu-tripod", "rates"):
        with pytest.raises(DatasetMissing):
            reproduce(name)


def test_hypotheses_have_one_name_each_and_fit_only_what_has_bounds():
    names = [hypothesis.name for hypothesis in HYPOTHESES]
    assert len(set(names)) == len(names)
    for hypothesis in HYPOTHESES:
        assert set(hypothesis.fitted) <= set(BOUNDS)


def test_error_counts_angles_by_35_mm():
    assert rms_mm(np.array([[3e-3, 4e-3, 0.0]])) == pytest.approx(5.0)
    assert rms_mm(np.array([[0.0, 0.0, 0.1]])) == pytest.approx(3.5)


def test_values_that_ended_on_a_bound_are_named():
    assert at_bound({"mu_pusher": 0.0, "tripod_radius": 0.03}) == ["mu_pusher"]


@pytest.mark.system
def test_bounds_on_real_pushes_that_were_held_out(data_root, tmp_path):
    found = reproduce("coverage", data_root, out=tmp_path, quick=True)
    curve = {row["level"]: row for row in found.tables["curve"]}
    # 72 pushes of three plates and rough fits: a look. Both ends of what chance alone allows.
    assert found.settings["pushes_held_out"] == 72
    assert curve[0.5]["position_held"] > 0.3
    assert curve[0.9]["position_held"] > 0.75
    assert curve[0.9]["angle_held"] > 0.75
    held = [row["position_held"] for row in found.tables["curve"]]
    assert held == sorted(held)
    parts = {row["part"]: row["across_mm"] for row in found.tables["parts"]}
    whole = np.hypot(np.hypot(parts["parameters"], parts["start"]), parts["model"])
    assert parts["total"] == pytest.approx(whole, rel=0.01)
    assert (tmp_path / "coverage.png").stat().st_size > 10_000
    assert list((tmp_path / "fits").glob("calibrated_0_*.json"))


def test_a_reproduction_that_needs_no_data_takes_none(capsys, monkeypatch):
    asked = []

    def found(name, data, **more):
        asked.append((name, data))
        return Reproduction(
            name=name, tables={}, conclusions=["done"], settings={}, figure=None, seconds=0.0
        )

    monkeypatch.setattr(module, "reproduce", found)
    with pytest.raises(SystemExit) as end:
        run(["--only", "asme-table-1"], program=command.app, name="python -m reproductions")
    assert end.value.code == 0
    assert capsys.readouterr().out == "done\n"
    assert asked == [("asme-table-1", None)]
    with pytest.raises(SystemExit):
        run(["--only", "asme-table-1", "--quick"], program=command.app, name="x")
    assert "its figures mean nothing" in capsys.readouterr().out
    with pytest.raises(SystemExit) as end:
        run([], program=command.app, name="python -m reproductions")
    assert end.value.code == 2
    assert "--data" in capsys.readouterr().err
