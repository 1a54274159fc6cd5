"""`fixel calibrate` from the shell: tables, JSON, refusals."""

import json
import shlex

import pytest
from tests.cli.shell import exit_code, fixel, json_of, missing, output, refusal


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab") / "lab"
    for arguments in (["new", str(folder)], ["testbed", "run", "-p", str(folder), "--limit", "3"]):
        assert exit_code(*arguments) == 0
    return folder


QUICK = ("--option", "threshold_delta=0.05", "--no-verdicts")


def test_one_experiment_is_a_table_and_a_next_command(capsys, project):
    out = output(capsys, "calibrate", 1, "-p", project, *QUICK)
    lines = out.splitlines()
    assert lines[0].startswith("Calibration of testbed/")
    assert lines[1].startswith("error: ")
    assert any(line.startswith("tripod_radius") and " mm" in line for line in lines)
    assert lines[-1].startswith("Next: fixel compare testbed/")


def test_least_squares_finds_one_set_for_all(capsys, project):
    options = ("--optimiser", "least-squares", "--no-verdicts")
    fit = ("--fit", "mu_pusher", "--fit", "tripod_radius_mm=10:60:30")
    answer = json_of(capsys, "calibrate", "-p", project, "--mode", "joint", *fit, *options)
    (one,) = answer["found"]
    assert one["how"] == "direct minimisation"
    assert one["evaluations"] < 200
    assert sum(one["errors"]) < sum(answer["nominal_error"])


def test_verdicts_are_said(capsys, project):
    options = ("--option", "threshold_delta=0.05", "--fit", "mu_pusher", "--name", "judged")
    out = output(capsys, "calibrate", 1, "-p", project, *options)
    row = next(line for line in out.splitlines() if line.startswith("mu_pusher "))
    words = ("identified", "not excited", "at bound", "at most", "at least", "precise")
    assert any(word in row for word in words)
    assert "noise" in out


def test_the_best_of_those_stored(capsys, project):
    stored = ("calibrate", "-p", project, "--mode", "stored", "--fit")
    (one,) = json_of(capsys, *stored, "mu_pusher")["found"]
    assert one["how"] == "best of the stored sets"
    assert len(one["errors"]) == 3
    assert "no stored calibration" in refusal(capsys, *stored, "start_x")


def test_an_experiment_counts_once_under_whatever_names(capsys, project):
    keys = (1, "testbed/001-square-collinear-tight-nominal")
    answer = json_of(capsys, "calibrate", *keys, "-p", project, *QUICK)
    assert (answer["mode"], len(answer["experiments"])) == ("each", 1)


def test_the_next_command_is_the_worst_under_what_it_was_calibrated_with(capsys, project):
    options = ("--mode", "each", "--fit", "mu_pusher", "--set", "mu_support=0.3")
    more = ("--motion", "quasistatic", "--option", "threshold_delta=0.05")
    out = output(capsys, "calibrate", "-p", project, *options, *more)
    found = json_of(capsys, "calibrate", "-p", project, *options, *more)["found"]
    worst = max(found, key=lambda one: one["errors"][0])
    last = out.splitlines()[-1]
    assert last.startswith(f"Next: fixel compare {worst['experiments'][0]} --calibration ")
    compared = json_of(capsys, *shlex.split(last)[2:])
    assert compared["error_mm2"] == pytest.approx(worst["errors"][0], rel=1e-2)
    verdicts = next(line for line in out.splitlines() if line.startswith("mu_pusher: "))
    assert " in 3" in verdicts or ", " in verdicts
    assert worst["noise"].startswith("noise ")


def test_a_campaign_lists_every_experiment_once(capsys, project):
    out = output(capsys, "calibrate", "-p", project, "--mode", "campaign", *QUICK)
    assert len([line for line in out.splitlines() if line.startswith("testbed/")]) == 3


@pytest.mark.parametrize(("arguments", "said"), [
    (("--option", "delta"), "NAME=VALUE"),
    (("--fit", "mu_pushr"), "known names; did you mean 'mu_pusher'?"),
    (("--fit", "tripod_radius=10:60"), "is 10 to 60 m, but must be bounds in metres"),
    (("--fit", "tripod_radius=10:60"), "write tripod_radius_mm=LOW:HIGH"),
    (("--fit", "tripod_radius[shape=square]"), "--fit: found tripod_radius for some conditions"),
    (("--fit", "tripod_radius[shape=square]"), "fixel calibrate --space FILE"),
    (("--fit", "start_theta=-5:5"), "write start_theta_deg=LOW:HIGH"),
    (("--fit", "mu_pusher=1:0"), "--fit mu_pusher: found bounds 1 to 0, but fixel needs the lower"),
    (("--fit", "mu_pusher=-1:2"), "--fit mu_pusher: found bounds -1 to 2, but fixel needs bounds"),
    (("--fit", "tripod_radius_mm=60:10"), "--fit tripod_radius_mm: found bounds 0.06 to 0.01 m,"),
    (("--set", "mu_pusher=-1"), "--set mu_pusher is -1.0, but must be a number of at least 0"),
    (("--set", "mass=0"), "--set mass is 0.0, but must be a number greater than 0 [kg]"),
    (("--fit", "mu_pusher", "--fit", "mu_pusher=0:1"), "--fit: found mu_pusher twice"),
    (("--set", "mu_fixel=0", "--set", "mu_fixel=1"), "--set: found mu_fixel twice"),
    (("--fit", "mu_pusher=0:1:2"), "outside the bounds"),
    (("--optimiser", "least-squares", "--mode", "each"), "mode joint"),
    (("nowhere",), "no experiment 'nowhere'"),
    (("--noise-mm", "-1", "--noise-mrad", "1"), "--noise-mm is -1 mm, but must be more than 0"),
    (("--name", "../mine"), "--name is '../mine'"),
    (("1", "--where", "shape=none"), "--where: found names of experiments too"),
])  # fmt: skip
def test_what_cannot_be_is_refused_in_a_sentence(capsys, project, arguments, said):
    assert said in refusal(capsys, "calibrate", "-p", project, *arguments)


def test_stored_calibrations_are_listed_and_shown_again(capsys, project):
    made = json_of(capsys, "calibrate", "-p", project, "--fit", "mu_pusher", "--name", "again")
    number = made["found"][0]["calibration"]
    out = output(capsys, "calibrations", "-p", project)
    assert out.splitlines()[1].split()[:2] == [str(number), "again:"]
    shown = output(capsys, "calibrations", number, "-p", project)
    out = output(capsys, "calibrations", number, "-p", project, "--json")
    answer = json.loads(out)
    (estimate,) = answer["estimates"]
    assert estimate["label"] == "mu_pusher"
    assert estimate["verdict"] in shown
    assert f"after {answer['evaluations']} evaluations" in shown
    assert f"Calibration of {len(answer['experiments'])} experiments" in shown
    assert missing(shown, out, without=("Repeat it",)) == []
    folder = project / "jobs"
    folder.rename(project / "away")  # its record alone is enough
    try:
        assert fixel(capsys, "calibrations", number, "-p", project)[1] == shown
    finally:
        (project / "away").rename(folder)
