"""`fixel simulate`, as another program would call it: standard output, error, exit code."""

import json

import pytest
from tests.cli.shell import fixel, json_of, output, refusal

from fixel.formats import SceneFile, save_scene
from fixel.testing import scenes

KEYS = {
    "status", "duration", "steps", "max_residual", "wall_time_s", "final", "pushers", "touching",
}  # fmt: skip


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "grasp.yaml"
    save_scene(SceneFile(scene=scenes.grasp("seated")), path)
    return path


@pytest.mark.parametrize("words", [("simulate",), ("plan", "find"), ("sample",)])
def test_a_table_is_one_sentence_with_the_next_command(tmp_path, capsys, words):
    table = tmp_path / "my lab.csv"
    rows = "".join(f"{k},{k},0,0\n" for k in range(5000))
    table.write_text('"time_s","x_mm","y_mm","theta_deg"\n' + rows, encoding="utf-8")
    err = refusal(capsys, *words, table)
    assert "found a table, but fixel needs a" in err
    assert f"fixel import '{table}'" in err
    assert len(err) < 300 + len(str(table)) * 2


def test_a_long_text_is_not_printed_whole(tmp_path, capsys):
    notes = tmp_path / "notes.yaml"
    notes.write_text("All that happened in the lab. " * 2000, encoding="utf-8")
    err = refusal(capsys, "simulate", notes)
    assert "found 'All that happened" in err
    assert len(err) < 700


def test_json_has_the_keys_of_the_contract(scene, capsys):
    code, out, err = fixel(capsys, "simulate", scene, "--json")
    answer = json.loads(out)

    assert code == 0
    assert err == ""
    assert set(answer) >= KEYS
    assert answer["status"] == "converged"
    assert "stopped_at" not in answer
    assert answer["pushers"]["actuator"] == {
        # Where it stalls it may go on by the tolerance of a step, 0.4 um, and give way again.
        "travel": pytest.approx(answer["final"]["actuator"][0], abs=1e-6),
        "force": pytest.approx(34.3),
        "stalled": True,
    }
    assert ["object", "actuator"] in answer["touching"]
    assert len(out.splitlines()) == 1


def test_a_jam_exits_3_with_what_was_computed(scene, tmp_path, capsys):
    path = tmp_path / "jam.csv"

    code, out, _ = fixel(
        capsys, "simulate", scene, "--json", "--trajectory", path,
        "--set", "pushers.0.drive.force_limit=null",
    )  # fmt: skip
    answer = json.loads(out)

    assert code == 3
    assert answer["status"] == "jammed"
    assert 0.0 < answer["stopped_at"] < 11.0
    assert answer["duration"] == answer["stopped_at"]
    assert len(answer["final"]["object"]) == 3
    assert path.read_text().startswith('"time_s"')


@pytest.mark.parametrize(("arguments", "reason"), [
    (["--set", "bodies.0.mas=1"], "did you mean 'mass'"),
    (["--set", "bodies.0.mass=-1"], "must be a number greater than 0"),
    (["--plot", "a.bmp"], "fixel needs a picture file"),
    (["--trajectory", "nowhere/a.csv"], "no folder nowhere"),
    (["--solver", "lemke"], "support_directions"),
    (["--step", "-1"], "must be a number greater than 0 [s]"),
    (["--step", "0.1", "--tolerance", "1"], "leave one out"),
    (["--motion", "magic"], "magic"),
    (["--solver", "magic"], "must be 'newton', 'gauss-seidel' or 'lemke'"),
])  # fmt: skip
def test_bad_input_exits_2_with_the_reason_and_no_traceback(scene, arguments, reason, capsys):
    code, out, err = fixel(capsys, "simulate", scene, "--json", *arguments)
    assert code == 2
    assert reason in json.loads(out)["error"]["sentence"]
    assert "Traceback" not in err


def test_people_get_a_table_and_a_next_command(scene, tmp_path, capsys):
    picture = tmp_path / "a.png"
    out = output(capsys, "simulate", scene, "--plot", picture)
    assert "converged, 11 s in" in out
    assert "stalled" in out
    assert "actuator, fixel-1" in out
    assert f"wrote {picture}" in out
    assert out.rstrip().splitlines()[-1].startswith(f"Next: fixel simulate {scene} --animate")
    assert max(len(line) for line in out.splitlines() if "Next" not in line) <= 110


def test_the_text_of_a_jam_says_what_to_do(scene, capsys):
    code, out, _ = fixel(capsys, "simulate", scene, "--set", "pushers.0.drive.force_limit=null")
    assert code == 3
    assert "jammed, stopped at" in out
    assert "If it has no force_limit, set one" in out
    assert out.rstrip().endswith("--set pushers.actuator.drive.force_limit=34.3")


def test_a_fixed_step_and_a_tolerance(scene, capsys):
    fixed = json_of(capsys, "simulate", scene, "--step", "0.01")
    fine = json_of(capsys, "simulate", scene, "--tolerance", "0.001")
    assert fixed["steps"] == 1100
    assert fine["method"]["stepper.tolerance"] == pytest.approx(1e-6)


def test_the_same_command_gives_the_same_answer(scene, capsys):
    first, second = (json_of(capsys, "simulate", scene) for _ in range(2))
    assert {**first, "wall_time_s": 0} == {**second, "wall_time_s": 0}


def test_ctrl_c_leaves_no_file_and_exits_130(scene, tmp_path, capsys, monkeypatch):
    def interrupted(*_args, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr("fixel.drawing.animate_simulation", interrupted)

    code, _, err = fixel(capsys, "simulate", scene, "--animate", tmp_path / "a.mp4")

    assert code == 130
    assert "stopped" in err
    assert [p.name for p in tmp_path.iterdir()] == ["grasp.yaml"]
