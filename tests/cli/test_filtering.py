"""`fixel filter`, as called from a shell."""

import json
import shlex
from dataclasses import replace

import pytest
from tests.filtering.recordings import push
from typer.testing import CliRunner

from fixel.cli.main import app
from fixel.database.project import Project
from fixel.errors import InvalidInput, NotStored, StoreRefused
from fixel.model import Flag, Parameters, Provenance
from fixel.model.records import CalibrationRecord, Estimate, Member


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("projects") / "my lab"
    recorded = push(duration=3.0)
    flag = Flag("no-fixels", "nobody knows where", False)
    with Project.create(place).store() as store:
        number = store.add_experiment(recorded).id
        store.add_calibration(
            CalibrationRecord(
                name="pushes",
                parameters=Parameters({"mu_pusher": 0.35}),
                members=(Member(number, 1.0, 0.01),),
                provenance=Provenance(version="1"),
                estimates=(
                    Estimate(label="mu_pusher", unit="-", value=0.35, low=0.31, verdict="at least"),
                ),
            )
        )
        store.add_experiment(
            replace(recorded, name="bare", scene=None, contact_mode="", flags=(flag,))
        )
    return place


def call(folder, *arguments):
    words = ["filter", *map(str, arguments), "--project", str(folder)]
    return CliRunner().invoke(app, words)


def good(folder, *arguments):
    result = call(folder, *arguments, "--particles", "40")
    assert result.exit_code == 0, result.output
    return result.stdout


def test_the_answer_for_people(folder, tmp_path):
    picture = tmp_path / "run.png"
    out = good(folder, "push", "--occlude", "1:2", "--plot", picture)

    for words in (
        "testbed/push: SIMULATED by",
        "frames from 0 to 3 s, hidden from 1 to 2 s, with tactile readings",
        "while seen",
        "while hidden",
        "tripod_radius [mm]",
        "not excited",
        "contact mode, recorded 000, estimated 000, the same",
        "40 particles",
        "times real time",
        "stored as filter run",
        f"wrote {picture}",
    ):
        assert words in out
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert out.splitlines()[-1].startswith("Next: fixel compare testbed/push --")
    assert f"--project {shlex.quote(str(folder))}" in out.splitlines()[-1]


def test_doubts_come_first_and_calibrations_stand_beside(folder):
    """The belief about the pusher leaves out its true friction, 0.35."""
    out = good(folder, "push", "--prior", "mu_pusher=0.4:1", "--no-save")

    assert out.index("model misfit: residuals of") < out.index("at the end")
    (believed,) = [line for line in out.splitlines() if line.startswith("mu_pusher")]
    assert "at the bound of its prior: use a wider one" in believed
    (calibrated,) = [line for line in out.splitlines() if line.startswith("calibration 1")]
    assert calibrated.split()[2:] == ["mu_pusher", "0.35", "0.31", "open", "at", "least"]


def test_more_noise_than_believed_is_reported(folder):
    noisy = replace(push(duration=2.0, noise=(1.4e-3, 0.03), ahead=0.0), name="noisy")
    with Project(folder).store() as store:
        store.add_experiment(noisy)

    words = "times the value that the filter assumes, so its intervals are too narrow"
    assert words in good(folder, "noisy", "--no-save")
    assert "its intervals are too narrow" not in good(folder, "push", "--no-save")


def test_the_answer_for_programs(folder):
    def answered(*more):
        return json.loads(good(folder, "push", "--json", "--no-save", *more))

    first = answered("--occlude", "1:2", "--seed", "3")
    again = answered("--occlude", "1:2", "--seed", "3", "--threads", "2")
    deaf = answered("--no-tactile")

    assert first["parameters"] == again["parameters"]
    assert first["hidden"] == again["hidden"]
    assert (first["particles"], first["seed"], first["occlusion_s"]) == (40, 3, [1.0, 2.0])
    assert first["filter_run_id"] is None
    assert first["files"] == {}
    assert set(first["parameters"]["mu_pusher"]) == {
        "mean",
        "q05",
        "q50",
        "q95",
        "excited",
        "at_bound",
    }
    assert (deaf["uses_tactile"], deaf["hidden"]) == (False, None)


def test_beliefs_can_be_given(folder):
    answer = json.loads(good(folder, "push", "--prior", "mu_pusher=0.3:0.4", "--json", "--no-save"))

    assert answer["parameters"]["mu_pusher"]["q05"] >= 0.3
    assert answer["parameters"]["mu_pusher"]["q95"] <= 0.4


def test_the_next_command_works_until_there_is_a_picture(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out = good(folder, "push")
    for _ in range(2):
        following = out.splitlines()[-1].removeprefix("Next: ")
        result = CliRunner().invoke(app, shlex.split(following)[1:])
        assert result.exit_code == 0, result.output
        out = result.stdout

    assert "--occlude" in following
    assert [path.name for path in tmp_path.iterdir()] == ["push-filter.png"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["bare"], "no scene: nobody knows where"),
        (["push", "--occlude", "2"], "such as 2:4"),
        (["push", "--occlude", "8:9"], "within the recording, 0 to 3 s"),
        (["push", "--particles", "1"], "at least 2"),
        (["push", "--prior", "mu_pushr=0.1:1"], "did you mean 'mu_pusher'"),
        (["push", "--prior", "mu_pusher"], "--prior mu_pusher"),
        (["push", "--seed", "-1"], "--seed: found -1, expected at least 0"),
        (["push", "--occlude", "x:1"], "--occlude: found 'x', expected a number"),
        (["push", "--plot", "a.bmp"], "a picture file"),
    ],
)
def test_bad_input_is_refused(folder, arguments, sentence):
    result = call(folder, *arguments)

    assert isinstance(result.exception, InvalidInput)
    assert sentence in str(result.exception)


def test_what_is_not_there_is_said(folder, tmp_path):
    assert isinstance(call(folder, "nothing").exception, NotStored)
    assert isinstance(call(tmp_path, "push").exception, StoreRefused)
