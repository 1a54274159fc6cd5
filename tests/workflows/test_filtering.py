"""Filtering an experiment of a project, and what is kept of it."""

import json
from dataclasses import replace

import numpy as np
import pytest
from tests.filtering.recordings import push
from tests.fixtures import project_of

from fixel.errors import InvalidInput, NotStored
from fixel.workflows.filtering.report import report_of
from fixel.workflows.filtering.run import filter, filter_stored

FEW = {"particles": 40, "priors": {"mu_pusher": (0.2, 0.6)}}


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    recorded = push(duration=3.0)
    bare = replace(recorded, name="bare", pusher=None)
    return project_of(tmp_path_factory.mktemp("projects") / "lab", [recorded, bare])


def test_a_run_is_kept_with_its_settings(project):
    answer = filter_stored(project, "push", **FEW, occlusion=(1.0, 2.0), seed=7)
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


def test_errors_are_told_inside_and_outside_of_the_occlusion(project):
    answer = filter_stored(project, "push", **FEW, occlusion=(1.0, 2.0), save=False)
    position, angle, hidden = answer.estimates.errors(answer.estimates.experiment.trajectory)

    assert answer.run_id is None
    for inside in (True, False):
        wanted = hidden == inside
        expected = [np.sqrt(np.mean(e[wanted] ** 2)) for e in (position, angle)]
        assert answer.estimates.rms(hidden=inside) == pytest.approx(expected)
    summary = report_of(answer).analysis.numbers
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    assert summary["frames"] == len(answer.estimates.time)
    assert summary["real_time_factor"] > 0.0


def test_without_an_occlusion_there_is_no_error_inside(project):
    answer = filter_stored(project, "push", **FEW, tactile=False, save=False)

    numbers = report_of(answer).analysis.numbers
    assert (numbers["hidden"], numbers["uses_tactile"]) == (None, False)


def test_refusals_keep_nothing(project):
    with pytest.raises(NotStored):
        filter_stored(project, "nothing", **FEW)
    with pytest.raises(InvalidInput, match="no measured path of the pusher"):
        filter_stored(project, "bare", **FEW)


def test_a_filter_in_python_is_that_of_the_command(project):
    with project.store() as store:
        experiment = store.experiment(store.find("push"))
    found = filter(experiment, **FEW, occlusion=(1.0, 2.0), progress=False)
    stored = filter_stored(project, "push", **FEW, occlusion=(1.0, 2.0), save=False)
    assert found.parameters == stored.estimates.parameters
    assert repr(found).startswith(f"FilterRun of {experiment.key}")
    assert len(found.to_dict()["time"]) == len(found.time)
    number = project.add(found)
    with project.store() as store:
        assert store.filter_run(number).trajectory == found.trajectory
    with pytest.raises(InvalidInput, match="motion"):
        filter(experiment, motion="dynamic", progress=False)
