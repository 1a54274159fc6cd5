"""A calibration whose model is wrong: what is said first, and one value wherever one looks."""

import json
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from tests import calibrating as run
from tests.fixtures import project_of

from fixel.calibration.target import scene_of
from fixel.calibration.usual_parameters import searched_unknowns
from fixel.model import Parameters
from fixel.model.selection import ExperimentQuery
from fixel.sampling.published import thesis_plan
from fixel.testbed.simulated import SimulatedTestbed
from fixel.web.views.calibration_views import load_detail
from fixel.web.views.live_comparison import LiveComparison
from fixel.workflows.calibration.report import pictures_of
from fixel.workflows.calibration.request import CalibrationRequest, NamedOptions, enlarged_command
from fixel.workflows.calibration.stored import load_values, searched_space
from fixel.workflows.demo.laboratory_demo import _compared_with_truth
from fixel.workflows.report.sections import calibration_warnings, parameters_section

LARGER = ("pressure_spread", "friction_centre_x", "friction_centre_y")


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    experiments = SimulatedTestbed(seed=4).run(thesis_plan().experiments[2:202:40])
    project = project_of(tmp_path_factory.mktemp("misfit") / "lab", experiments)
    with project.store() as store:
        chosen = run.select_experiments(store, (), ExperimentQuery())
    scenes = [target.case.scene for target in chosen.targets]
    request = CalibrationRequest(
        mode="joint",
        unknowns=searched_unknowns(["mu_pusher", "tripod_radius_mm=20:75:40"], scenes),
        optimiser=NamedOptions(name="least-squares"),
        motion="quasistatic",
    )
    return project, run.done(project, chosen, request, "")


def test_misfit_is_said_before_anything_else(found):
    project, done = found
    misfit = done.outcome.found[-1].misfit
    lines = done.analysis.lines()
    assert lines[0] == f"Warning: {' '.join(misfit)}"
    assert misfit[0].startswith("model misfit: residuals of ")
    assert float(done.outcome.found[-1].misfit_ratio) > 10.0
    assert any(line.startswith("a larger model may fit better: fixel calibrate") for line in lines)
    with project.store() as store:
        detail = load_detail(project, store, done.ids[-1])
    assert calibration_warnings(done.joint)[0] == misfit[0] == detail.misfit[0]
    assert json.loads(json.dumps(done.summary()))["found"][-1]["misfit"] == [*misfit]


def test_the_check_of_predictions_is_one_sentence_wherever_one_looks(found):
    project, done = found
    text = "predictions not checked: that takes 4 experiments without fixels"  # these are grasps
    with project.store() as store:
        page = load_detail(project, store, done.ids[-1]).analysis
    for lines in (done.analysis.lines(), page.headline, parameters_section(done.joint, []).notes):
        assert [line.strip() for line in lines].count(text) == 1
    assert text in " ".join(repr(done.joint).split())
    summary = json.loads(json.dumps(done.summary()))["found"][-1]
    assert summary["prediction_check"] == {"held": 0, "of": 0, "probability": 0.9}


def test_one_value_inside_its_interval_wherever_one_looks(found):
    project, done = found
    with project.store() as store:
        detail = load_detail(project, store, done.ids[-1])
        one = load_values(store, done.ids[-1])
    summary = done.summary()["found"][-1]
    charts = {p.name: p.chart for p in pictures_of(done)}
    values = {row[0]: row[5] for row in charts["parameters"].data.rows}
    curves = {row[0]: row for row in charts["profiles"].data.rows}
    table = done.joint.analysis.tables[0].lines()
    assert parameters_section(done.joint, []).tables[0].lines() == table
    assert [line.strip() for line in repr(done.joint).splitlines()[1 : 1 + len(table)]] == [
        line.strip() for line in table
    ]
    assert {*table} <= {*done.analysis.lines()}
    rows = {row[0]: (row, below) for row, below in pairwise([line.split() for line in table])}
    assert [*values] == [row.label for row in detail.parameters]
    for row in detail.parameters:
        low = -math.inf if row.low is None else row.low
        high = math.inf if row.high is None else row.high
        assert low <= row.value <= high
        assert summary["parameters"][row.label] == row.value == values[row.label]
        shown, below = rows[row.label]
        assert shown[1] == row.value_text.split()[0]
        # What noise alone would state is a labelled line below, and what the profile shows.
        assert below[:3] == ["noise", "alone", row.noise_alone.value_text.split()[0]]
        assert curves[row.label][6:] == (row.low, row.high, row.noise_low, row.noise_high)
        (curve,) = (own for own in done.joint.found.profiles if own.label == row.label)
        assert abs(row.noise_value - curve.best) <= 0.02 * (row.bounds[1] - row.bounds[0])
        assert summary["best_fit"][row.label] == row.best_fit == one.record.parameters[row.label]
    assert any(row.value != row.best_fit for row in detail.parameters)


def test_the_radius_of_a_tripod_that_is_not_there_is_effective(found):
    _, done = found
    verdicts = {e.label: e.verdict for e in done.outcome.found[-1].estimates}
    assert verdicts["tripod_radius"] != "identified"


def test_a_larger_model_is_offered_as_a_command_once(found):
    _, done = found
    options = {"optimiser": "least-squares", "project": "lab"}
    command = "fixel calibrate --optimiser least-squares"
    added = " ".join(f"--fit {name}" for name in LARGER)
    larger = enlarged_command(options, done.request)
    assert larger == f"{command} --fit mu_pusher {added} --project lab"
    own = {"fit": ["mu_pusher=0:1", "tripod_radius_mm=20:75:40"], "fixed": ["start_x=0"]}
    longer = enlarged_command(options | own, done.request)
    assert longer == f"{command} --fit mu_pusher=0:1 {added} --set start_x=0 --project lab"
    whole = [done.request.unknowns[0], *(replace_name(done.request, name) for name in LARGER)]
    assert enlarged_command(options, done.request.model_copy(update={"unknowns": whole})) == ""
    assert enlarged_command(options | {"space": "a.yaml"}, done.request) == ""


def replace_name(request, name):
    return replace(request.unknowns[0], name=name)


@pytest.fixture(scope="module")
def enlarged(found):
    """The same experiments with the larger model that was offered."""
    project, done = found
    with project.store() as store:
        chosen = run.select_experiments(store, (), ExperimentQuery())
    scenes = [target.case.scene for target in chosen.targets]
    unknowns = searched_unknowns(["mu_pusher", *LARGER], scenes)
    request = done.request.model_copy(update={"unknowns": unknowns})
    return run.done(project, chosen, request, "")


@pytest.mark.system
def test_pressure_under_the_whole_body_misfits_less(found, enlarged):
    _, done = found
    before, after = (one.outcome.found[-1].misfit_ratio for one in (done, enlarged))
    assert after < 0.6 * before
    verdicts = {e.label: e.verdict for e in enlarged.outcome.found[-1].estimates}
    assert verdicts["pressure_spread"] != "identified"


@pytest.mark.system
def test_what_reads_a_calibration_simulates_with_its_pressure(found, enlarged):
    """The errors stored with the calibration result again where only its parameters are passed on.

    Steppers differ, so a hundredth of an error is left."""
    project, _ = found
    with project.store() as store:
        one = load_values(store, enlarged.ids[-1])
        for member in one.record.members:
            experiment = store.experiment(member.experiment_id)
            values = Parameters(one.values_for(experiment))
            assert "pressure_spread" in values
            assert "tripod_radius" not in values
            live = LiveComparison(store)
            held = live.compared(member.experiment_id, values, one.motion.name, project.folder)
            assert held.error_mm2 == pytest.approx(member.error_mm2, rel=1e-2)
        scenes = [scene_of(store.experiment(m.experiment_id)) for m in one.record.members]
        space = searched_space(project, one, scenes)
    assert "pressure_spread" in space.labels


def test_truth_is_compared_with_what_was_found(found):
    project, done = found
    table = _compared_with_truth(project, done.ids[-1])
    truth = {row[0]: row[3] for row in table.rows}
    with project.store() as store:
        ratios = [
            store.experiment(m.experiment_id).conditions["truth_pusher_friction_ratio"]
            for m in store.calibration(done.ids[-1]).members
        ]
    assert float(truth["mu_pusher"]) == pytest.approx(0.2 * np.mean(ratios), rel=5e-3)
    assert truth["tripod_radius"] == "none"


def test_a_job_that_is_continued_asks_for_nothing_twice(found, tmp_path):
    project, done = found
    again = run.collect(project, done.folder, "", {})
    one, other = again.outcome.found[-1], done.outcome.found[-1]
    assert (one.misfit, one.misfit_ratio) == (other.misfit, other.misfit_ratio)
    assert replace(one.estimates[0]) == other.estimates[0]
