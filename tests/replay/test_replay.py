"""The replay workflow and its command, on tiny datasets whose answers are known."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.datasets import push_files, recordings
from tests.fixtures import refused
from typer.testing import CliRunner

from fixel.cli import main
from fixel.cli.screen import require_picture
from fixel.errors import DatasetMissing, InvalidInput
from fixel.replay import Replay, ReplayRequest, replay_dataset
from fixel.replay.base import columns_and_values, spread
from fixel.replay.trials import contact_mode

MAKERS: dict[str, Callable[..., Path]] = {
    "mit_push": push_files.mit_push,
    "rpi_2dgad": recordings.rpi_2dgad,
    "mit_timeseries": push_files.mit_timeseries,
}

# Position of a straight push: the engine moves the object by the measured stroke exactly, but for
# the tolerance of its steps.
EXACT = 1e-3  # [mm]


def replayed(folder: Path, *select: str, **options: object) -> Replay:
    settings = options.pop("settings", {})
    choice = ReplayRequest(select=columns_and_values(select), settings=settings, **options)  # type: ignore[arg-type]
    return replay_dataset(folder, choice)


def test_a_straight_push_ends_where_the_tip_does(tmp_path: Path) -> None:
    answer = replayed(push_files.mit_push(tmp_path, push_files.push(0)))

    (row,) = answer.pushes
    assert row["status"] == "converged"
    assert row["fixel_position_mm"] == pytest.approx(0.0, abs=EXACT)
    assert row["fixel_angle_deg"] == pytest.approx(0.0, abs=EXACT)
    assert row["poly4_position_mm"] == pytest.approx(2.0)
    assert row["poly4_angle_deg"] == pytest.approx(1.0)
    assert math.isnan(row["quad_position_mm"])
    assert math.isnan(row["quad_angle_deg"])


def test_an_overlap_at_the_start_is_pushed_out(tmp_path: Path) -> None:
    """Half a millimetre of overlap along the stroke moves the object half a millimetre farther."""
    shift = 0.5e-3
    tip = 0.2 - 0.03 - push_files.TIP + shift
    deep = push_files.push(0, tip_x0=tip, tip_x1=tip + 0.05, gap0_mm=-0.5)

    (row,) = replayed(push_files.mit_push(tmp_path, deep)).pushes

    assert row["status"] == "converged"
    assert row["end"] == pytest.approx([0.25 + shift, -0.1, 0.0], abs=1e-6)


def test_doubtful_pushes_are_left_out_and_counted(tmp_path: Path) -> None:
    pushes = [push_files.push(0), push_files.push(1, gap0_mm=3.5), push_files.push(2, tip_x1=0.25)]
    folder = push_files.mit_push(tmp_path, *pushes)

    answer = replayed(folder)
    every = replayed(folder, everything=True)

    assert [row["push_id"] for row in answer.pushes] == ["felt_block_0"]
    assert sorted(answer.left_out.values()) == [1, 1]
    assert len(every.pushes) == 3
    assert every.left_out == {}


def test_groups_are_pooled(tmp_path: Path) -> None:
    fast = push_files.push(1, speed_mm_s=20, author_poly4_x1=0.254)
    answer = replayed(push_files.mit_push(tmp_path, push_files.push(0), fast))

    assert [group["speed_mm_s"] for group in answer.groups] == [10, 20, None]
    # No model may win by leaving pushes out: rows without a quadratic answer count for no model.
    assert answer.groups[-1]["pushes"] == 0


def test_selection_limit_and_settings(tmp_path: Path) -> None:
    pushes = [push_files.push(k, surface="felt" if k % 2 else "glass") for k in range(6)]
    folder = push_files.mit_push(tmp_path, *pushes)

    assert len(replayed(folder, "surface=glass").pushes) == 3
    assert len(replayed(folder, "surface=glass", "surface=felt", "speed_mm_s=10.0").pushes) == 6
    assert len(replayed(folder, limit=2).pushes) == 2
    assert replayed(folder, settings={"mu_pusher": 0.1}).settings["mu_pusher"] == 0.1
    assert spread(10, 3).tolist() == [0, 3, 6]


@pytest.mark.parametrize(("options", "complaint"), [
    ({"select": columns_and_values(["shap=hex"])}, "did you mean 'shape'"),
    ({"select": columns_and_values(["shape=hex"])}, "is 'hex', but must be one of block"),
    ({"settings": {"mu_pushr": 0.1}}, "did you mean 'mu_pusher'"),
    ({"settings": {"support_points": 16.5}}, "a whole number"),
    ({"settings": {"mu_pusher": -1.0}}, "at least 0"),
])  # fmt: skip
def test_wrong_choices_are_refused(
    options: dict[str, object], complaint: str, tmp_path: Path
) -> None:
    folder = push_files.mit_push(tmp_path, push_files.push(0))

    with pytest.raises(InvalidInput, match=complaint):
        replay_dataset(folder, ReplayRequest(**({"select": {}, "settings": {}} | options)))  # type: ignore[arg-type]


@pytest.mark.parametrize("pair", ["shape", "=hex", "shape="])
def test_pairs_need_both_sides(pair: str) -> None:
    refused(columns_and_values, [pair], match="COLUMN=VALUE")


def test_a_trial_pushed_straight_follows_the_actuator(tmp_path: Path) -> None:
    answer = replayed(recordings.rpi_2dgad(tmp_path))

    marker, smoothed, lab, repeated = answer.pushes
    for row in (marker, smoothed):
        assert row["status"] == "converged"
        assert row["position_mm_rms"] == pytest.approx(0.0, abs=EXACT)
        assert row["contact_mode"] == 0
        assert row["contact_mode_measured"] == 2
    assert lab["status"] == "stored"
    assert lab["error_mm2"] == pytest.approx(0.0)
    # The driver leads by one step of 0.3 mm.
    assert repeated["position_mm_rms"] == pytest.approx(0.3, abs=0.05)
    assert answer.left_out == {"no actuator path or fixel positions": 2}


def test_an_incomplete_trial_cannot_be_selected(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="a complete trial: 7"):
        replayed(recordings.rpi_2dgad(tmp_path), "experiment_id=8")


def test_contact_mode_counts_fixels_from_the_left() -> None:
    assert contact_mode([("object", "fixel-1"), ("object", "actuator")], 3) == 4
    assert contact_mode([("object", "fixel-2"), ("object", "fixel-3")], 3) == 3


def test_windows_of_a_straight_run_follow_the_tip(tmp_path: Path) -> None:
    folder = push_files.mit_timeseries(tmp_path)

    answer = replayed(folder, window=0.25)
    whole = replayed(folder, window=0.0, motion="dynamic")

    assert len(answer.pushes) == 4
    for row in answer.pushes:
        assert row["status"] == "converged"
        assert row["motion"] == "quasistatic"
        assert row["position_mm_rms"] < 0.01
    (row,) = whole.pushes
    assert row["duration_s"] == pytest.approx(0.995)
    # From rest: the object jumps to the speed of the tip at once.
    assert row["position_mm_rms"] < 0.1
    assert len(row["error"]["time_s"]) == len(row["error"]["position_mm"]) == 10


@pytest.mark.parametrize("dataset", ["mit_push", "rpi_2dgad", "mit_timeseries"])
def test_command_prints_json_and_draws(dataset: str, tmp_path: Path) -> None:
    make = MAKERS[dataset]
    pushes = (push_files.push(0),) if dataset == "mit_push" else ()
    folder = make(tmp_path / "data", *pushes)
    picture = tmp_path / "replay.png"

    result = CliRunner().invoke(main.app, ["replay", str(folder), "--json", "--plot", str(picture)])

    assert result.exit_code == 0, result.output
    answer = json.loads(result.stdout)
    assert answer["pushes"]
    assert answer["timing"]["simulated"] == len(answer["pushes"])
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("dataset", ["mit_push", "rpi_2dgad", "mit_timeseries"])
def test_command_prints_a_plain_table_and_the_next_step(dataset: str, tmp_path: Path) -> None:
    make = MAKERS[dataset]
    pushes = (push_files.push(0, author_quad_x1=0.25, author_quad_y1=-0.1, author_quad_th1=0),)
    folder = make(tmp_path / "data", *(pushes if dataset == "mit_push" else ()))

    result = CliRunner().invoke(main.app, ["replay", str(folder)])

    assert result.exit_code == 0, result.output
    assert "Next: fixel replay" in result.stdout
    assert "\x1b" not in result.stdout


@pytest.mark.parametrize(("words", "where"), [
    (("--set", "mu_pusher=low"), "--set mu_pusher is 'low', but must be a number"),
    (("--set", "mu_pushr=0.1"), "--set is 'mu_pushr'"),
    (("--select", "shape=hex"), "--select shape is 'hex'"),
    (("--window", "-1"), "--window is -1.0, but must be at least 0"),
])  # fmt: skip
def test_command_names_its_flags(
    words: tuple[str, ...], where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = push_files.mit_push(tmp_path, push_files.push(0))
    with pytest.raises(SystemExit):
        main.run(["replay", str(folder), *words])
    assert where in capsys.readouterr().err


def test_command_refuses_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in ([], ["--plot", "replay.gif"], ["--plot", "nowhere/replay.png"]):
        with pytest.raises(SystemExit) as end:
            main.run(["replay", str(tmp_path), *arguments])

        assert end.value.code == 2
        printed = capsys.readouterr().err
        assert printed.startswith("fixel: ")
        assert "Traceback" not in printed


def test_pictures_are_refused_before_the_work(tmp_path: Path) -> None:
    refused(require_picture, tmp_path / "replay.gif", match="a picture file")
    refused(require_picture, tmp_path / "nowhere" / "replay.png", match="no folder")


def test_an_unknown_folder_says_what_was_looked_for(tmp_path: Path) -> None:
    wanted = r"pushes\.csv\.gz and shapes\.json"
    for name in ("empty", "one"):
        (tmp_path / name).mkdir()
    push_files.mit_push(tmp_path / "one" / "inside", push_files.push(0))
    for folder, message in (
        (tmp_path / "empty", wanted),
        (recordings.cmu_tripod(tmp_path / "known"), wanted),
        (tmp_path / "one", "data found in: inside"),
    ):
        with pytest.raises(DatasetMissing, match=message):
            replay_dataset(folder)


def test_windows_in_which_the_object_was_not_read_again_are_left_out(tmp_path: Path) -> None:
    folder = push_files.mit_timeseries(tmp_path)
    rows = []
    for k in range(800):  # pushed for half a second, at rest for one, pushed for half a second
        x = 0.02 * 0.0025 * (min(k, 200) + max(k - 600, 0))
        tip = x - 0.045 - push_files.TIP
        rows.append(
            {"t": 0.0025 * k, "slider_x": x, "slider_y": 0.0, "slider_th": 0.0,
             "pusher_x": tip, "pusher_y": 0.0}
        )  # fmt: skip
    push_files.write_table(folder / "cpush_Straight.csv.gz", rows)

    for everything in (False, True):
        answer = replayed(folder, window=0.25, everything=everything)

        (reason,) = answer.left_out
        assert "no new reading" in reason
        assert answer.left_out[reason] == 3
        assert len(answer.pushes) == 5
        assert answer.not_solved == 0
