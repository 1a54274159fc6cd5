"""`fixel plan`, as called from a shell."""

import csv
import json
from pathlib import Path

import pytest
from tests.cli.shell import fixel

from fixel.testing.scenes import pushed_square

GOAL = """
fixel: 1
scene: square.yaml
goal:
  pose: {pose_mm_deg: [31, 0, 0], position_mm: 5, angle_deg: 6, symmetry: 4}
choose:
  free: {angle_deg: 0, length_mm: [25, 40]}
belief:
  start: {x_mm: 0.5, y_mm: 0.5, theta_deg: 0.5, kind: normal}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a scene, a goal and its plan."""
    own = tmp_path_factory.mktemp("plans")
    pushed_square().save(own / "square.yaml")
    (own / "goal.yaml").write_text(GOAL)
    return own


@pytest.fixture(scope="module")
def plan(folder: Path):
    from fixel.workflows.planning.run import plan_goal

    made = folder / "made.plan"
    plan_goal(None, str(folder / "goal.yaml"), out=made, rollouts=1000, progress=False)
    return made


def test_a_goal_file_becomes_a_plan_file(capsys, folder):
    code, text, _ = fixel(capsys, "plan", folder / "goal.yaml", "--rollouts", 1000)
    assert code == 0
    lines = text.splitlines()
    assert lines[0].startswith("Warning: No calibration")
    assert lines[1] == "Goal: the part within 5 mm and 6 deg of (31, 0) mm, 0 deg"
    assert "success probability" in text
    assert "Start: 0.5 mm, 0.5 deg standard deviation." in lines
    assert lines[-1] == f"Next: fixel plan run {folder / 'goal.plan'}"
    assert (folder / "goal.plan").is_file()


def test_a_part_that_meets_its_goal_is_left_alone(capsys, folder, tmp_path):
    goal = folder / "there.yaml"
    goal.write_text(GOAL.replace("[31, 0, 0]", "[0, 0, 0]"))
    code, text, _ = fixel(capsys, "plan", goal, "--rollouts", 1000, "--plot", tmp_path)
    assert code == 0
    assert "No push, for the part already meets the goal: success" in text
    assert "Next:" not in text
    assert {file.stem for file in tmp_path.iterdir()} == {"paths", "causes"}
    assert fixel(capsys, "plan", "run", goal.with_suffix(".plan"))[0] == 2


def test_a_plan_is_checked_run_and_written_for_other_robots(capsys, plan, tmp_path):
    code, text, _ = fixel(capsys, "plan", "run", plan, "-n", 5, "--seed", 3, "--json")
    answer = json.loads(text)
    assert code == 0
    assert answer["trials"] == 5
    assert answer["least"] <= answer["stated"]
    assert not answer["refuted"]
    way = tmp_path / "way.csv"
    code, text, _ = fixel(capsys, "plan", "check", plan, "--waypoints", way, "--json")
    answer = json.loads(text)
    assert code == 0
    assert (answer["trials"], answer["changed"]) == (5, False)
    rows = list(csv.reader(way.read_text().splitlines()))
    assert rows[0] == ["push", "time [s]", "x [m]", "y [m]", "angle [rad]"]
    assert len(rows) == 4
    code, text, _ = fixel(capsys, "plan", "check", plan)
    assert "5 trials" in text


def test_a_plan_is_made_again_from_a_seen_pose(capsys, plan, tmp_path):
    out = tmp_path / "again.plan"
    words = ["plan", "next", plan, "--seen", "2,0,1", "--rollouts", 1000, "--save", out, "--json"]
    code, text, _ = fixel(capsys, *words)
    assert code == 0
    start = json.loads(text)["start_m_rad"][0]
    assert start == pytest.approx([0.002, 0.0, 0.0174533], abs=1e-6)
    assert out.is_file()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("plan", "check", "goal.yaml"), "a result saved by fixel"),
        (("plan", "next", "made.plan", "--seen", "1,2"), "x,y,angle"),
        (("plan", "next", "made.plan", "--seen", "0,0,0", "--done", "1"), "--done"),
        (("plan", "next", "made.plan", "--seen", "31,0,90"), "no push is needed"),
        (("plan", "run", "made.plan", "--driver", "simulated"), "one stroke along the axis"),
        (("plan", "run", "made.plan", "--driver", "robot"), "--driver"),
        (("plan", "bad.yaml"), "goal.pose.symmetry"),
        (("plan", "far.yaml", "--rollouts", "1000"), "at 40 mm, 0 mm, 0 deg: it misses by"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(capsys, plan, folder, words, message):
    (folder / "bad.yaml").write_text(GOAL.replace("symmetry: 4", "symmetry: four"))
    (folder / "far.yaml").write_text(GOAL.replace("[31, 0, 0]", "[900, 0, 0]"))
    given = [folder / word if word.endswith((".yaml", ".plan")) else word for word in words]
    code, _, err = fixel(capsys, *given)
    assert code == 2
    assert message in err
    assert "Traceback" not in err
