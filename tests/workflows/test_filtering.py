"""Filtering an experiment of a project: answers of the command, and what the project stores."""

import json
import shlex
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from tests.filtering.recordings import push
from tests.fixtures import calibration_record, project_of
from typer.testing import CliRunner

from fixel.cli.main import app
from fixel.database import schema
from fixel.errors import InvalidInput, NotStored, StoreRefused
from fixel.model import Flag
from fixel.model.records import Estimate
from fixel.workflows import jobs
from fixel.workflows.capabilities import prepare
from fixel.workflows.filtering.run import FILTER, filter, filter_stored

FEW = {"particles": 40, "priors": {"mu_pusher": (0.2, 0.6)}, "occlusion": (1.0, 2.0)}


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    recorded = push(duration=3.0)
    flag = Flag("no-fixels", "fixels not located", False)
    bare = replace(recorded, name="bare", scene=None, contact_mode="", flags=(flag,))
    found = project_of(tmp_path_factory.mktemp("projects") / "my lab", [recorded, bare])
    known = Estimate(label="mu_pusher", unit="-", value=0.35, low=0.31, verdict="at least")
    with found.store() as store:
        record = calibration_record({1: 0.01}, {"mu_pusher": 0.35}, estimates=(known,))
        store.add_calibration(record)
    return found


def call(folder, *arguments):
    words = ["filter", *map(str, arguments), "--project", str(folder)]
    return CliRunner().invoke(app, words)


def good(project, *arguments):
    result = call(project.folder, *arguments, "--particles", "40")
    assert result.exit_code == 0, result.output
    return result.stdout


def test_the_answer_for_people(project, tmp_path):
    picture = tmp_path / "run.png"
    out = good(project, "push", "--occlude", "1:2", "--plot", picture)

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
    assert f"--project {shlex.quote(str(project.folder))}" in out.splitlines()[-1]


def test_doubts_come_first_and_calibrations_follow(project):
    """The belief about the pusher leaves out its true friction, 0.35."""
    out = good(project, "push", "--prior", "mu_pusher=0.4:1", "--no-save")

    assert out.index("model misfit: residuals of") < out.index("at the end")
    (believed,) = [line for line in out.splitlines() if line.startswith("mu_pusher")]
    assert "at the bound of its prior: use a wider one" in believed
    (calibrated,) = [line for line in out.splitlines() if line.startswith("calibration 1")]
    assert calibrated.split()[2:] == ["mu_pusher", "0.35", "0.31", "open", "at", "least"]


@pytest.mark.system
def test_more_noise_than_believed_is_reported(project):
    noisy = replace(push(duration=2.0, noise=(1.4e-3, 0.03), ahead=0.0), name="noisy")
    with project.store() as store:
        store.add_experiment(noisy)

    words = "times the value that the filter assumes, so its intervals are too narrow"
    assert words in good(project, "noisy", "--no-save")
    assert "its intervals are too narrow" not in good(project, "push", "--no-save")


def test_the_answer_for_programs(project):
    def answered(*more):
        return json.loads(good(project, "push", "--json", "--no-save", *more))

    first = answered("--occlude", "1:2", "--seed", "3")
    again = answered("--occlude", "1:2", "--seed", "3", "--threads", "2")
    deaf = answered("--no-tactile", "--prior", "mu_pusher=0.3:0.4")

    assert first["parameters"] == again["parameters"]
    assert first["hidden"] == again["hidden"]
    assert (first["particles"], first["seed"], first["occlusion_s"]) == (40, 3, [1.0, 2.0])
    assert (first["filter_run_id"], first["files"]) == (None, {})
    assert (deaf["uses_tactile"], deaf["hidden"]) == (False, None)
    own = deaf["parameters"]["mu_pusher"]
    assert set(own) == {"mean", "q05", "q50", "q95", "excited", "at_bound"}
    assert 0.3 <= own["q05"] <= own["q95"] <= 0.4


@pytest.mark.system
def test_the_next_command_works_until_there_is_a_picture(project, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out = good(project, "push")
    for _ in range(2):
        following = out.splitlines()[-1].removeprefix("Next: ")
        result = CliRunner().invoke(app, [*shlex.split(following)[1:], "--particles", "40"])
        assert result.exit_code == 0, result.output
        out = result.stdout

    assert "--occlude" in following
    assert [path.name for path in tmp_path.iterdir()] == ["push-filter.png"]


def test_a_run_is_kept_with_its_settings(project):
    answer = filter_stored(project, "push", **FEW, seed=7)
    with project.store() as store:
        run = store.filter_run(answer.run_id)
        settings = store.filter_parameters(run.filter_parameters_id)

    found = answer.estimates
    assert (run.experiment_id, run.uses_tactile, run.occlusion) == (1, True, (1.0, 2.0))
    assert run.trajectory == found.trajectory
    assert run.contact_mode == found.contact_mode
    assert run.provenance.seed == 7
    assert run.provenance.command.startswith("fixel filter push --prior mu_pusher=0.2:0.6")
    columns = dict(zip(run.estimate_names, run.estimates.T, strict=True))
    np.testing.assert_array_equal(columns["mu_pusher"], found.mean[:, 1])
    np.testing.assert_array_equal(columns["tripod_radius_q95"], found.quantiles[:, 3, 2])
    assert settings.is_particle_filter
    assert settings.values["n_particles"] == 40.0
    assert (settings.values["mu_pusher_low"], settings.values["mu_pusher_high"]) == (0.2, 0.6)
    position, angle, hidden = found.errors(found.experiment.trajectory)
    for inside in (True, False):
        expected = [np.sqrt(np.mean(e[hidden == inside] ** 2)) for e in (position, angle)]
        assert found.rms(hidden=inside) == pytest.approx(expected)


def test_a_filter_in_python_is_that_of_the_command(project):
    with project.store() as store:
        experiment = store.experiment(store.find("push"))
    found = filter(experiment, **FEW, progress=False)
    stored = filter_stored(project, "push", **FEW, save=False)
    assert found.parameters == stored.estimates.parameters
    assert repr(found).startswith(f"FilterRun of {experiment.key}")
    assert len(found.to_dict()["time"]) == len(found.time)
    number = project.add(found)
    with project.store() as store:
        assert store.filter_run(number).trajectory == found.trajectory
    with pytest.raises(InvalidInput, match="motion"):
        filter(experiment, motion="dynamic", progress=False)


@pytest.mark.parametrize(("arguments", "sentence"), [
    (["bare"], "no scene: fixels not located"),
    (["push", "--occlude", "2"], "such as 2:4"),
    (["push", "--occlude", "x:1"], "--occlude is 'x', but must be a number"),
    (["push", "--prior", "mu_pusher"], "--prior mu_pusher"),
    (["push", "--occlude", "8:9"], "within the recording, 0 to 3 s"),
    (["push", "--prior", "mu_pushr=0.1:1"], "did you mean 'mu_pusher'"),
    (["push", "--plot", "a.bmp"], "a picture file"),
])  # fmt: skip
def test_bad_input_is_refused(project, arguments, sentence):
    result = call(project.folder, *arguments)

    assert isinstance(result.exception, InvalidInput)
    assert sentence in str(result.exception)


def test_what_is_not_there_is_said(project, tmp_path):
    assert isinstance(call(project.folder, "nothing").exception, NotStored)
    assert isinstance(call(tmp_path, "push").exception, StoreRefused)


KILLED = """
import os, signal, sys
from pathlib import Path
from fixel.jobs import coordinator
coordinator.write_whole = lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL)
coordinator.coordinate(Path(sys.argv[1]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="of systems with SIGKILL")
def test_a_job_killed_after_it_stored_its_run_stores_it_once(project):
    request = FILTER.request({"experiment": "push", "particles": 20, "seed": 5})
    folder, before = prepare(FILTER, request, project), runs(project)
    killed = subprocess.run([sys.executable, "-c", KILLED, folder], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert jobs.status_of(folder).state == "lost"
    (new,) = set(runs(project)) - set(before)
    assert jobs.run_here(folder).state == "done"
    assert runs(project) == [*before, new]


def runs(project):
    """Ids of the filter runs of a project."""
    with project.store() as store:
        return store._ids(schema.filter_run)
