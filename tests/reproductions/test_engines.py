"""Comparison of engines on made-up pushes of known parameters, and on real ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from reproductions import engines
from reproductions.run import reproduce
from tests.reproductions.test_mit_push import made_up

from fixel.replay.mit_pushes import read_mit_pushes
from fixel.typing import FloatArray, IntArray

TWO = {
    "fixel": engines.SETTINGS["fixel"],
    "pymunk": engines.SETTINGS["pymunk"]._replace(motion="pymunk:step=0.02"),
}


def test_engines_are_compared_and_a_second_run_simulates_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pymunk")
    monkeypatch.setattr(engines, "SETTINGS", TWO | {"Drake": engines.SETTINGS["Drake"]})
    monkeypatch.setattr(engines, "QUICK", 8)
    monkeypatch.setattr(engines, "RESAMPLES", 200)
    data = read_mit_pushes(made_up(tmp_path / "mit_push_endpoints", 40))

    answer = reproduce("engines", tmp_path, out=tmp_path / "out", quick=True)

    rows = {(row["engine"], row["condition"]): row for row in answer.tables["overall"]}
    assert [name for name, _ in rows] == [engines.STILL, *2 * ["fixel"], *3 * ["pymunk"]]
    assert all(row["failures"] == 0 and row["held_out"] == 16 for row in rows.values())
    moved = 1e3 * np.hypot(*(data.end - data.start)[:, :2].T)
    assert rows[engines.STILL, ""]["mean_mm"] == pytest.approx(moved.mean(), rel=0.2)
    shipped, calibrated = rows["fixel", engines.SHIPPED], rows["fixel", engines.CALIBRATED]
    assert calibrated["mean_mm"] < 0.6 * shipped["mean_mm"]
    assert calibrated["more_mm"] == 0.0
    other = rows["pymunk", engines.CALIBRATED]
    assert other["mean_mm"] < rows["pymunk", engines.SHIPPED]["mean_mm"]
    assert other["more_mm"] == pytest.approx(other["mean_mm"] - calibrated["mean_mm"])
    assert other["more_mm_95"][0] <= other["more_mm"] <= other["more_mm_95"][1]
    assert sum(row["held_out"] for row in answer.tables["groups"]) == 16 * len(rows)

    monkeypatch.setattr(engines, "ensemble_of", None)
    again = reproduce("engines", tmp_path, out=tmp_path / "out", quick=True)
    assert again.tables == answer.tables


def test_a_push_that_an_engine_cannot_finish_counts_as_one_that_did_not_move(
    tmp_path: Path,
) -> None:
    cases = engines.select_cases(read_mit_pushes(made_up(tmp_path, 30)), quick=True)
    engine = engines._Engine(cases, engines.SETTINGS["fixel"])
    some = cases.members[0].held_out

    def simulate(which: IntArray, values: dict[str, FloatArray]) -> engines.Ends:
        good = np.arange(len(which)) > 0
        return engines.Ends(
            np.full((len(which), 3), np.nan) + np.where(good, 1.0, 0.0)[:, None], good
        )

    engine.simulate = simulate  # type: ignore[method-assign,assignment]
    found = engine.ends(some, {})

    assert found.pose[0].tolist() == cases.start[some[0]].tolist()
    assert found.good.tolist() == [False, *[True] * (len(some) - 1)]


def test_own_parameters_start_as_shipped() -> None:
    setting = engines.Setting("mujoco:step=0.004", ("timeconst", "impratio"))

    timeconst, impratio = engines.own_beliefs(setting)

    assert (timeconst.name, impratio.name) == ("mujoco.timeconst", "mujoco.impratio")
    assert np.exp([timeconst.mean, impratio.mean]) == pytest.approx([0.02, 1.0])
    assert np.exp([impratio.low, impratio.high]) == pytest.approx([1.0, 100.0])


def test_the_interval_of_a_difference_is_that_of_groups() -> None:
    group = np.repeat([0, 1, 2, 3], 50)
    more = np.array([0.0, 0.0, 1.0, 1.0])[group]

    mean, low, high = engines._difference(more, group)

    assert mean == 0.5
    # Four groups of two values: the mean of four draws is 0 or 1 in one case of 16 each.
    assert (low, high) == (0.0, 1.0)


@pytest.mark.slow
def test_calibration_makes_fixel_better_on_real_pushes(
    data_root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engines, "SETTINGS", {"fixel": engines.SETTINGS["fixel"]})
    still, shipped, calibrated = reproduce("engines", data_root).tables["overall"]
    assert shipped["held_out"] >= 1000
    assert calibrated["mean_mm"] < 0.9 * shipped["mean_mm"] < 0.5 * still["mean_mm"]
