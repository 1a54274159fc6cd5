"""Calibrations of stored experiments: the whole way, interrupted, refused, and stored."""

import json
import shutil
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from tests import calibrating as run
from tests.fixtures import project_of, refused

from fixel.calibration import search
from fixel.calibration.objective import outliers
from fixel.calibration.usual_parameters import default_unknowns, fixed_unknowns, searched_unknowns
from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.jobs.work import StopRequest
from fixel.model import Trajectory, UniformPressure
from fixel.model.records import Estimate
from fixel.model.selection import ExperimentQuery
from fixel.sampling.published import thesis_plan
from fixel.simulation.load_profile import TABLE_NAMES
from fixel.testbed.simulated import SimulatedTestbed
from fixel.web.views.calibration_views import list_calibrations
from fixel.workflows.calibration import plan
from fixel.workflows.calibration.plan import outcome_bytes, outcome_of
from fixel.workflows.calibration.request import (
    CalibrationRequest,
    NamedOptions,
    command_of,
    options_of,
    read_targets,
    target_files,
)
from fixel.workflows.calibration.stored import load_values, searched_space
from fixel.workflows.jobs import run_here, status_of
from fixel.workflows.project.filters import view_of

PLANNED = thesis_plan().experiments
QUICK = NamedOptions(name="pattern-search", options={"threshold_delta": 0.05})


@pytest.fixture(scope="module")
def experiments():
    return list(SimulatedTestbed.ideal().run([PLANNED[k] for k in (0, 1, 2, 7)]))


@pytest.fixture
def project(tmp_path, experiments):
    made = project_of(tmp_path / "lab", experiments)
    return made


@pytest.fixture
def chosen(project):
    with project.store() as store:
        return run.select_experiments(store, (), ExperimentQuery())


def _request(chosen, **changes):
    scenes = [target.case.scene for target in chosen.targets]
    names = ["mu_pusher", "tripod_radius_mm=10:60:30"]
    unknowns = searched_unknowns(names, scenes)
    return CalibrationRequest(
        **({"unknowns": unknowns, "optimiser": QUICK, "verdicts": False} | changes)
    )


def test_each_experiment_by_itself(project, chosen):
    done = run.done(project, chosen, _request(chosen, mode="each"))
    assert done.outcome.keys == tuple(target.key for target in chosen.targets)
    assert [one.members for one in run.alone(done)] == [(0,), (1,), (2,), (3,)]
    for one in run.alone(done):
        assert one.errors[0] < done.outcome.nominal[one.members[0]]
        assert one.trace.errors.min() == one.errors[0]
    with project.store() as store:
        record = store.calibration(done.ids[0])
    assert record.members[0].error_mm2 == done.outcome.found[0].errors[0]
    assert record.evaluations.names == ("mu_pusher", "tripod_radius")
    assert record.parameters["tripod_radius"] == done.outcome.found[0].point[1]
    assert json.loads(json.dumps(done.summary()))["found"][0]["evaluations"] > 20


def test_a_campaign_is_all_the_ways_of_the_thesis(project, chosen):
    done = run.done(project, chosen, _request(chosen, mode="campaign"))
    ways = [one.how for one in run.together(done)]
    assert ways == ["weighted mean", "weighted mean of a subset", "direct minimisation"]
    totals = [one.errors.sum() for one in run.together(done)]
    assert totals[1] <= totals[0]
    assert totals[2] <= totals[1]
    assert totals[2] < done.outcome.nominal.sum()


def test_the_box_that_was_searched_is_found_again_and_outlives_its_job(project, chosen):
    request = _request(chosen, mode="joint")
    scenes = [target.case.scene for target in chosen.targets]
    kept = fixed_unknowns(["mu_support=0.4"])
    centre = searched_unknowns(["friction_centre_x_mm=-2:3"], scenes)
    request = request.model_copy(update={"unknowns": [*request.unknowns, *kept, *centre]})
    done = run.done(project, chosen, request)
    with project.store() as store:
        one = load_values(store, done.ids[-1])
    for end in (lambda folder: None, shutil.rmtree):
        end(done.folder)
        space = searched_space(project, one, scenes)
        assert space.labels == ("mu_pusher", "tripod_radius", "friction_centre_x")
        np.testing.assert_allclose(space.low, [0.0, 0.01, -2e-3])
        np.testing.assert_allclose(space.high, [1.0, 0.06, 3e-3])
        np.testing.assert_array_equal(space.nominal, done.outcome.found[-1].point)
        assert [u.nominal for u in space.unknowns if u.frozen] == [0.4]

    # Stored by an earlier version, without the box: its own parameters within their usual bounds.
    method = {k: v for k, v in one.record.method.items() if k != "unknowns"}
    earlier = replace(one, record=replace(one.record, method=method, request=None))
    space = searched_space(project, earlier, scenes)
    assert {u.name for u in space.unknowns} == {u.name for u in request.space.unknowns}
    assert space.values(space.nominal) == {**one.record.parameters}
    shared = Estimate(label="mu_pusher[shape=square]", unit="-", value=0.2)
    parted = replace(earlier, record=replace(earlier.record, estimates=(shared,)))
    refused(searched_space, project, parted, scenes, match="no bounds of mu_pusher")


def test_verdicts_and_what_they_stand_on(project, chosen):
    few = replace(chosen, ids=chosen.ids[:1], targets=chosen.targets[:1])
    request = _request(few, mode="each", verdicts=True, noise_position=5e-5, noise_angle=2e-3)
    one = run.alone(run.done(project, few, request))[0]
    words = {e.label: e.verdict for e in one.estimates}
    assert set(words) == {"mu_pusher", "tripod_radius"}
    assert all(words.values())
    assert [curve.label for curve in one.profiles] == ["mu_pusher", "tripod_radius"]
    for curve in one.profiles:
        assert (np.diff(curve.values) > 0.0).all()
        assert curve.deviances.min() >= 0.0
    assert "as stated" in one.noise


def test_the_same_command_continues_and_then_has_nothing_to_do(project, chosen, monkeypatch):
    request = _request(chosen, mode="campaign")
    folder = run.prepare(project, chosen, request)
    seen = []

    def stop_soon(progress):
        seen.append(progress.done)
        if progress.done >= 1:
            raise KeyboardInterrupt

    with pytest.raises((KeyboardInterrupt, StopRequest)):
        run.run(folder, progress=stop_soon)
    assert run.prepare(project, chosen, request) == folder
    run.run(folder)
    resumed = run.collect(project, folder, "test", {})
    assert run.collect(project, folder, "test", {}).ids == resumed.ids

    other = Project.create(project.folder.parent / "other")
    elsewhere = run.prepare(other, chosen, request)
    run.run(elsewhere)
    undisturbed = outcome_of((elsewhere / "result").read_bytes())
    for a, b in zip(resumed.outcome.found, undisturbed.found, strict=True):
        assert (a.point == b.point).all()
        assert (a.errors == b.errors).all()
        assert (a.trace is None) == (b.trace is None)
        if a.trace is not None:
            assert (a.trace.points == b.trace.points).all()


@pytest.mark.system
def test_verdicts_killed_at_any_round_continue_with_the_same_bits(project, chosen):
    """Every answer that verdicts stand on is in the journal: none is computed a second time."""
    few = replace(chosen, ids=chosen.ids[:2], targets=chosen.targets[:2])
    request = _request(few, mode="joint", verdicts=True, noise_position=5e-5, noise_angle=2e-3)
    done = run.done(project, few, request)
    other = Project.create(project.folder.parent / "other")
    folder = run.prepare(other, few, request)
    rounds = []

    def stop_later(progress):
        """Stop at every sixth word of the verdict stage."""
        if progress.note.startswith("verdicts"):
            rounds.append(progress.done)
            if progress.rate and len(rounds) % 6 == 0:
                raise KeyboardInterrupt

    sessions, kept = 0, [0]
    while status_of(folder).state != "done":
        sessions += 1
        try:
            run.run(folder, progress=stop_later)
        except KeyboardInterrupt:
            kept.append(status_of(folder).kept)
            assert kept[-1] > kept[-2]  # each session gets further
    assert sessions > 1
    assert status_of(folder).kept == status_of(done.folder).kept == run_here(folder).kept
    again = outcome_of((folder / "result").read_bytes())
    assert outcome_bytes(outcome_of(outcome_bytes(again))) == outcome_bytes(again)
    for a, b in zip(again.found, done.outcome.found, strict=True):
        assert a.estimates == b.estimates
        for mine, theirs in zip(a.profiles, b.profiles, strict=True):
            assert (mine.values == theirs.values).all()
            assert (mine.deviances == theirs.deviances).all()


@pytest.mark.system
def test_a_killed_calibration_of_each_loses_one_chunk(project, chosen, monkeypatch):
    """The journal has whole chunks of experiments, verdicts included; none is computed again."""
    monkeypatch.setattr(search, "MEMBERS_A_PART", 2)
    request = _request(chosen, mode="each", verdicts=True, noise_position=5e-5, noise_angle=2e-3)
    folder = run.prepare(project, chosen, request)
    command = f"""
from pathlib import Path
from fixel.workflows import jobs
from fixel.calibration import search
search.MEMBERS_A_PART = 2
jobs.run_here(Path({str(folder)!r}))
"""
    with subprocess.Popen([sys.executable, "-c", command]) as running:
        while status_of(folder).kept < 2:  # the nominal values, and the first two experiments
            assert running.poll() is None
            time.sleep(0.01)
        running.kill()
    computed = []
    real = plan.answer_bytes
    monkeypatch.setattr(
        plan,
        "answer_bytes",
        lambda own, payload: computed.append(payload) or real(own, payload),
    )
    run.run(folder)
    assert len(computed) == 1
    done = run.collect(project, folder, "test", {})
    assert [one.members for one in run.alone(done)] == [(0,), (1,), (2,), (3,)]
    assert all(one.estimates for one in run.alone(done))


def test_errors_are_stored_in_the_unit_that_their_names_say(project, chosen):
    """A root mean square is kept as its square, and shown in mm."""
    request = _request(chosen, mode="joint", error=NamedOptions(name="root-mean-square"))
    done = run.done(project, chosen, request)
    (one,) = run.together(done)
    with project.store() as store:
        record = store.calibration(done.ids[0])
        (shown,) = (row for row in list_calibrations(store) if row.id == done.ids[0])
        best = store.experiments(view_of(limit=4), details=True).details
    squares = [float(error) ** 2 for error in one.errors]
    assert [member.error_mm2 for member in record.members] == squares
    assert record.mean_error_mm2 == pytest.approx(np.mean(squares))
    assert record.errors == pytest.approx(one.errors.tolist())
    assert shown.unit == "mm"
    assert shown.after == pytest.approx(one.errors.mean())
    # The table of experiments shows roots of what is stored.
    assert sorted(row.after_mm2 for row in best) == pytest.approx(sorted(squares))


def _many(chosen, speeds=3, each=20):
    """Targets that differ in a condition and in a number of their own."""
    targets = [
        chosen.targets[0]._replace(
            key=f"lab/{speed}-{k}", conditions={"speed": speed, "run": float(100 * speed + k)}
        )
        for speed in range(speeds)
        for k in range(each * (speed + 1))
    ]
    return run.ExperimentSelection(ids=list(range(len(targets))), targets=targets, left_out={})


def test_a_sample_keeps_the_share_of_every_condition_and_follows_its_seed(chosen):
    many = _many(chosen)  # 20, 40 and 60 of three speeds
    few = run.draw_sample(many, 12, seed=1)
    counts = np.bincount([t.conditions["speed"] for t in few.targets])
    assert counts.tolist() == [2, 4, 6]
    assert few.ids == run.draw_sample(many, 12, seed=1).ids
    assert few.ids != run.draw_sample(many, 12, seed=2).ids
    assert [t.key for t in few.targets] == [many.targets[k].key for k in few.ids]
    assert run.draw_sample(many, 500, seed=1) == many
    # Each experiment is as likely as any other.
    drawn = np.bincount(
        np.concatenate([run.draw_sample(many, 30, seed).ids for seed in range(400)]), minlength=120
    )
    assert drawn.sum() == 30 * 400
    assert np.abs(drawn - 100).max() < 45  # 5 standard deviations of a binomial count


def test_experiments_that_stand_out_are_the_strange_ones():
    """Independent of the rule: ordinary errors are log-normal, strange ones put in by hand."""
    draw = np.random.default_rng(5)
    false = found = 0
    for _ in range(100):
        errors = np.exp(draw.normal(0.0, 0.6, 60)) ** 2
        false += len(outliers(errors, "mm^2"))
        errors[[3, 40]] = (60.0**2, 90.0**2)
        found += outliers(errors, "mm^2")[:2] == [40, 3]
        assert outliers(np.sqrt(errors), "mm") == outliers(errors, "mm^2")
    assert found == 100
    assert false < 0.01 * 100 * 60
    assert outliers(np.ones(5), "mm") == []
    assert outliers(np.array([1.0] * 10 + [np.inf]), "mm") == []


@pytest.mark.parametrize(("mode", "combine", "error", "n", "expected"), [
    ("joint", "sum", "mean-square", 2, "least-squares"),
    ("joint", "mean", "robust", 2, "least-squares"),
    ("joint", "mean", "root-mean-square", 2, "pattern-search"),
    ("joint", "largest", "mean-square", 2, "pattern-search"),
    ("each", "sum", "mean-square", 2, "pattern-search"),
    ("joint", "sum", "end-pose", 2, "pattern-search"),
    ("joint", "sum", "mean-square", 1, "pattern-search"),
])  # fmt: skip
def test_least_squares_is_the_usual_search_for_sums_of_squares(
    chosen, mode, combine, error, n, expected
):
    usual = {"mode": mode, "combine": combine, "error": NamedOptions(name=error)}
    request = _request(chosen, optimiser=NamedOptions(name="auto"), **usual)
    assert request.with_usual_search(chosen.targets[:n]).optimiser.name == expected


@pytest.mark.parametrize("optimiser", ["pattern-search", "least-squares"])
def test_a_budget_ends_a_search_at_the_same_place_after_an_interruption(project, chosen, optimiser):
    request = _request(
        chosen, mode="joint", optimiser=NamedOptions(name=optimiser), budget=1e-6, verdicts=True
    )
    folder = run.prepare(project, chosen, request)

    def stop_soon(progress):
        if progress.note.startswith(("all together", "least squares")) and progress.rate:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run.run(folder, progress=stop_soon)
    run.run(folder)
    (one,) = run.together(run.collect(project, folder, "test", {}))
    assert one.trace.ended == "the budget is used up"
    assert np.isfinite(one.errors).all()
    assert "budget" in one.note
    # None of the stored answers was computed again, and only those of the first round were new.
    assert len(one.trace.errors) <= 10
    kept = status_of(folder).kept
    assert run_here(folder).kept == kept


def test_experiments_travel_bit_by_bit(chosen, tmp_path):
    for name, data in target_files(chosen.targets).items():
        (tmp_path / name).write_bytes(data)
    for a, b in zip(read_targets(tmp_path), chosen.targets, strict=True):
        assert a.key == b.key
        assert a.case.scene == b.case.scene
        assert (a.case.times == b.case.times).all()
        assert (a.pose == b.pose).all()


def test_start_and_bounds_are_the_scenes_own(chosen):
    scenes = [target.case.scene for target in chosen.targets]
    unknowns = {u.name: u for u in default_unknowns(scenes)}
    assert set(unknowns) == {"mu_pusher", "mu_fixel", "mu_support", "tripod_radius"}
    assert unknowns["tripod_radius"].nominal == scenes[0].bodies[0].support.radius
    (radius,) = searched_unknowns(["tripod_radius_mm=10:60"], scenes)
    assert (radius.low, radius.high) == pytest.approx((0.010, 0.060))
    (angle,) = searched_unknowns(["start_theta_deg=-1:1:0"], scenes)
    assert angle.high == pytest.approx(np.pi / 180)
    (mu,) = fixed_unknowns(["mu_fixel=0.3"])
    assert (mu.frozen, mu.nominal) == (True, 0.3)


def test_a_table_may_be_searched_under_even_pressure(chosen):
    scene = chosen.targets[0].case.scene
    body = replace(scene.bodies[0], support=UniformPressure(friction=0.3))
    found = searched_unknowns(TABLE_NAMES, [replace(scene, bodies=(body,))])
    assert [u.name for u in found] == list(TABLE_NAMES)
    assert all(u.low == -u.high and u.nominal == 0.0 for u in found)


def test_the_command_for_the_same_calibration_says_all_of_it(chosen):
    request = _request(
        chosen,
        error=NamedOptions(name="end-pose", options={"angle_scale": 0.05}),
        noise_position=1e-4,
        noise_angle=2e-3,
        motion="quasistatic",
    )
    words = command_of(options_of(request, [3]) | {"project": "/lab"})
    assert words.startswith("fixel calibrate 3 ")
    assert words.endswith(" --project /lab")
    for said in ("--error end-pose", "--angle-scale-mm 50.0", "--noise-mm 0.1", "--noise-mrad 2.0",
                 "--motion quasistatic"):  # fmt: skip
        assert said in words
    by_engine = _request(chosen, motion="pymunk:step=0.01")
    by_engine = command_of(options_of(by_engine, [3]))
    assert "--motion pymunk:step=0.01" in by_engine


def test_experiments_that_cannot_be_compared(project, experiments):
    scene_less = replace(experiments[0], name="lost", scene=None, contact_mode="")
    one_frame = replace(
        experiments[0],
        name="one",
        trajectory=Trajectory(time=[0.0], pose=experiments[0].trajectory.pose[:1]),
        channels=(),
        effective=None,
        pusher=None,
    )
    with project.store() as store:
        for experiment in (scene_less, one_frame):
            store.add_experiment(experiment)
        found = run.select_experiments(store, (), ExperimentQuery())
        assert len(found.targets) == 4
        assert "no scene" in found.left_out["testbed/lost"]
        assert "no measured pose" in found.left_out["testbed/one"]
        refused(run.select_experiments, store, ("lost",), ExperimentQuery(), match="no scene")
        with pytest.raises(InvalidInput, match="must be one of testbed"):
            run.select_experiments(store, (), ExperimentQuery(dataset="nowhere"))


def test_a_name_given_again_is_looked_up_once(project, monkeypatch):
    with project.store() as store:
        find, keys = store.find, []
        monkeypatch.setattr(type(store), "find", lambda _, key: keys.append(key) or find(key))
        named = store.experiments(ExperimentQuery()).rows[0].key
        assert run.select_experiments(store, (named,) * 1000, ExperimentQuery()).ids == [1]
    assert keys == [named]
