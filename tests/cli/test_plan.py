"""`fixel plan`, as called from a shell."""

import csv
import shutil
from dataclasses import replace

import numpy as np
import pytest
from tests.cli.shell import fixel, invoked, json_of, missing, output, refusal
from tests.workflows.planning.plans import rig_plan

from fixel.cli.main import app
from fixel.testing.scenes import pushed_square
from fixel.workflows.planning.report import numbers_of
from fixel.workflows.planning.request import load_plan, load_trials

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
def plan(folder):
    from fixel.workflows.planning.run import plan_goal

    made = folder / "made.plan"
    plan_goal(None, str(folder / "goal.yaml"), out=made, rollouts=1000, progress=False)
    return made


def test_a_goal_file_becomes_a_plan_file(capsys, folder):
    text = output(capsys, "plan", folder / "goal.yaml", "--rollouts", 1000)
    lines = text.splitlines()
    assert lines[0].startswith("Warning: No calibration")
    goal = "A plan for the part within 5 mm and 6 deg of (31, 0) mm, 0 deg needs 1 push"
    assert lines[1].startswith(f"{goal}: success probability ")
    assert "Start: 0.5 mm, 0.5 deg standard deviation." in lines
    assert lines[-1] == f"Next: fixel plan run {folder / 'goal.plan'}"
    assert (folder / "goal.plan").is_file()
    assert "Failures" not in text
    assert "Causes of failures" not in text


def test_a_part_that_meets_its_goal_is_left_alone(capsys, folder, tmp_path):
    goal = folder / "there.yaml"
    goal.write_text(GOAL.replace("[31, 0, 0]", "[0, 0, 0]"))
    text = output(capsys, "plan", goal, "--rollouts", 1000, "--plot", tmp_path)
    assert "needs no push, for the part already meets the goal: success" in text
    assert "Next:" not in text
    assert {file.stem for file in tmp_path.iterdir()} == {"paths"}
    refusal(capsys, "plan", "run", goal.with_suffix(".plan"))


def test_causes_are_shown_where_a_plan_fails(capsys, folder, tmp_path):
    goal = folder / "fails.yaml"
    goal.write_text(GOAL.replace("0.5", "2"))
    text = output(capsys, "plan", goal, "--rollouts", 1000, "--plot", tmp_path)
    assert "Failures: " in text
    assert "Causes of failures\n" in text
    assert {file.stem for file in tmp_path.iterdir()} == {"paths", "capture", "causes"}


def test_a_plan_is_checked_run_and_written_for_other_robots(capsys, plan, tmp_path):
    answer = json_of(capsys, "plan", "run", plan, "-n", 5, "--seed", 3)
    assert answer["trials"] == 5
    assert answer["least"] <= answer["stated"]
    assert not answer["refuted"]
    way = tmp_path / "way.csv"
    answer = json_of(capsys, "plan", "check", plan, "--waypoints", way)
    assert (answer["trials"], answer["changed"]) == (5, False)
    rows = list(csv.reader(way.read_text().splitlines()))
    assert rows[0] == ["push", "time [s]", "x [m]", "y [m]", "angle [rad]"]
    assert len(rows) == 4
    assert "5 trials" in output(capsys, "plan", "check", plan)


def test_a_plan_or_an_engine_that_does_not_exist_is_named(capsys, plan):
    err = refusal(capsys, "plan", "run", plan, "--engine", "nope")
    assert "--engine is 'nope', but must be one of" in err
    assert "pymunk" in err
    err = refusal(capsys, "plan", "check", "nope.plan")
    assert err.startswith("fixel: nope.plan: found no such file or folder, but fixel needs")


@pytest.mark.parametrize("words", [("check",), ("run", "-n", 3), ("next", "--seen", "2,0,1")])
def test_json_has_every_number_of_the_text(capsys, plan, tmp_path, words):
    verb, *more = words
    own = [shutil.copy(plan, tmp_path / f"{name}.plan") for name in ("text", "json")]
    _, text, _ = fixel(capsys, "plan", verb, own[0], *more)
    code, out, _ = fixel(capsys, "plan", verb, own[1], *more, "--json")
    assert code == 0
    assert missing(text, out) == []


def test_a_plan_is_made_again_from_a_seen_pose(capsys, plan, tmp_path):
    out = tmp_path / "again.plan"
    words = ["plan", "next", plan, "--seen", "2,0,1", "--rollouts", 1000, "--save", out]
    (start, *_) = json_of(capsys, *words)["start_m_rad"]
    assert start == pytest.approx([0.002, 0.0, 0.0174533], abs=1e-6)
    assert out.is_file()


def test_a_seen_pose_in_the_goal_needs_no_push(capsys, plan):
    words = ["plan", "next", plan, "--seen", "31,0,90"]  # a square: a quarter turn is the same
    assert output(capsys, *words) == "The goal is met: no push is needed.\n"
    assert json_of(capsys, *words) == {"met": True, "push": None}
    assert not plan.with_name("made-next.plan").exists()


@pytest.fixture(scope="module")
def printed(folder):
    """Text of the command that makes a plan which sees the part twice, with wide errors of its
    start, and charts."""
    goal = folder / "looks.yaml"
    text = GOAL.replace("length_mm: [25, 40]", "length_mm: [2, 40]").replace("0.5", "2")
    goal.write_text(text.replace("free: {angle_deg: 0, ", "free: {"))
    words = ["plan", goal, "--rollouts", 2000, "--looks", 2, "--plot", folder / "charts"]
    return invoked(app, *words)[1]


@pytest.fixture
def with_looks(folder, printed):
    return folder / "looks.plan"


@pytest.mark.system
def test_a_plan_with_looks_chooses_the_next_push_at_once(capsys, with_looks):
    import fixel as package

    words = ["plan", "next", with_looks, "--seen", "21,4,10"]
    answer = json_of(capsys, *words)
    assert not answer["met"]
    assert 0.0 < answer["probability"] <= 1.0
    # The push is simulated here from the seen pose, by its waypoints alone.
    way = np.array(answer["waypoints_s_m_rad"])
    scene = pushed_square()
    drive = package.PathDrive(way)
    tool = replace(scene.pushers[0], pose=way[0, 1:], drive=drive)
    part = replace(scene.bodies[0], pose=np.array([0.021, 0.004, np.radians(10.0)]))
    pushed = replace(scene, bodies=(part,), pushers=(tool,), duration=float(way[-1, 0]))
    end = package.simulate(pushed, motion="quasistatic")["part"].pose[-1]
    assert np.hypot(*(end[:2] - (0.031, 0.0))) < np.hypot(*(part.pose[:2] - (0.031, 0.0)))
    text = output(capsys, *words)
    assert text.startswith(f"Push: {answer['push']}. It reaches the goal with probability")
    text = output(capsys, *words, "--seen", "31,0,0")
    assert text == "The goal is met: no push is needed.\n"


@pytest.mark.system
def test_a_plan_with_looks_states_what_they_are_worth(printed, with_looks):
    assert "1 push and up to 2 looks: success probability" in printed
    charts = with_looks.with_name("charts").iterdir()
    assert {file.stem for file in charts} == {"paths", "looks", "capture"}
    numbers = numbers_of(load_plan(with_looks).found)
    assert numbers["failures"] == {}
    looks = numbers["looks"]
    assert (looks["most"], len(looks["success"]), looks["lost_views"]) == (2, 3, 0.0)
    before, after, last = looks["success"]
    assert f"Look 1 raises the success probability from {before:.2f} to {after:.2f}" in printed
    assert before < after <= last
    assert looks["pushes"] <= 3.0


@pytest.fixture
def stroke(tmp_path):
    """A plan for a drive with one axis."""
    from fixel.workflows.planning.request import FoundPlan, PlanRequest, save_plan

    path = tmp_path / "stroke.plan"
    save_plan(FoundPlan(plan=rig_plan(), request=PlanRequest(goal={})), path)
    return path


def test_a_mistake_in_the_pose_of_the_end_is_found_before_the_push(capsys, stroke):
    words = ["plan", "run", stroke, "--driver", "simulated", "--start", "90,0,22.5"]
    assert "--end" in refusal(capsys, *words, "--end", "100,0")


def test_a_mistyped_pose_of_the_end_does_not_lose_the_trial(capsys, stroke, monkeypatch):
    typed = iter(["90,0,22.5", "100;0", "100,0,22"])
    monkeypatch.setattr("typer.prompt", lambda *_: next(typed))
    output(capsys, "plan", "run", stroke, "--driver", "simulated")
    (trial,) = load_trials(stroke, load_plan(stroke)).trials
    np.testing.assert_allclose(trial.end, (0.1, 0.0, np.deg2rad(22.0)))


@pytest.mark.system
def test_what_a_plan_with_looks_does_not_take_is_refused(capsys, with_looks):
    pose = ("--seen", "21,4,10")
    for words, message in (
        (("next", with_looks, *pose, *pose, *pose), "--seen"),
        (("next", with_looks, *pose, "--done", "1"), "--done"),
        (("run", with_looks, "--driver", "simulated"), "after each look: fixel plan next"),
    ):
        assert message in refusal(capsys, "plan", *words)


@pytest.mark.parametrize(("words", "message"), [
    (("plan", "check", "goal.yaml"), "a result saved by fixel"),
    (("plan", "next", "made.plan", "--seen", "1,2"), "x,y,angle"),
    (("plan", "next", "made.plan", "--seen", "0,0,0", "--done", "1"), "--done"),
    (("plan", "next", "made.plan", "--seen", "0,0,0", "--seen", "1,0,0"), "--seen"),
    (("plan", "run", "made.plan", "--driver", "simulated"), "one stroke along the axis"),
    (("plan", "run", "made.plan", "--driver", "robot"), "--driver"),
    (("plan", "bad.yaml"), "goal.pose.symmetry"),
    (("plan", "far.yaml", "--rollouts", "1000"), "at 40 mm, 0 mm, 0 deg: it misses by"),
])  # fmt: skip
def test_an_error_is_one_line(capsys, plan, folder, words, message):
    (folder / "bad.yaml").write_text(GOAL.replace("symmetry: 4", "symmetry: four"))
    (folder / "far.yaml").write_text(GOAL.replace("[31, 0, 0]", "[900, 0, 0]"))
    given = [folder / word if word.endswith((".yaml", ".plan")) else word for word in words]
    assert message in refusal(capsys, *given)
