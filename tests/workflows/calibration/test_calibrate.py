"""`fixel.calibrate` from Python: values, refusals, stores, interruptions, and what is shown."""

import json
import math
import random
import re
import signal
import subprocess
import sys
import time
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import refused

import fixel
from fixel.testing.pushes import ANGLE_NOISE, POSITION_NOISE, TRUTH, example_parts, example_pushes
from fixel.workflows import jobs

BOUNDS = {"mu_pusher": (0, 1), "tripod_radius": (0.01, 0.06)}
QUIET = {"progress": False, "threads": 1}


@pytest.fixture(scope="module")
def pushes():
    return example_pushes(4)


@pytest.fixture(scope="module")
def fit(pushes):
    return fixel.calibrate(pushes, BOUNDS, **QUIET)


def test_the_true_values_are_in_their_intervals(fit):
    assert fit.status == "finished"
    assert fit.identified == ("mu_pusher", "tripod_radius")
    for name, truth in TRUTH.items():
        own = fit.estimates[name]
        assert own.low <= own.value <= own.high
        assert (
            own.low - 0.2 * (own.high - own.low) <= truth <= own.high + 0.2 * (own.high - own.low)
        )
        assert (own.level, own.identified, own.partners) == (0.95, True, ())
    assert set(fit) == set(TRUTH)
    assert fit.rms_error < fit.nominal_rms_error


def test_experiments_of_one_name_are_refused(pushes):
    namesake = replace(pushes[1], name=pushes[0].name, dataset=pushes[0].dataset)
    for several in ([pushes[0], namesake], [pushes[0], pushes[0]]):
        match = f"{pushes[0].key} twice, but fixel needs different names"
        refused(fixel.calibrate, several, BOUNDS, **QUIET, match=match)
        refused(fixel.posterior, several, BOUNDS, **QUIET, match=match)


def test_a_project_stores_no_calibration_of_other_measurements(pushes, tmp_path):
    # Its pages and comparisons would call an experiment fitted that no calibration has used.
    project = fixel.Project.create(tmp_path / "lab")
    with project.store() as store:
        for push in pushes[:2]:
            store.add_experiment(push)
    other = replace(pushes[2], name=pushes[0].name, dataset=pushes[0].dataset)
    asked = {**QUIET, "verdicts": False, "store": project}
    match = f"other measurements of {pushes[0].key}"
    refused(fixel.calibrate, [other, pushes[1]], BOUNDS, **asked, match=match)
    in_memory = fixel.calibrate([other, pushes[1]], BOUNDS, **QUIET, verdicts=False)
    refused(project.add, in_memory, match=match)
    with project.store() as store:
        assert not store.calibration_summaries()
    assert fixel.calibrate(pushes[:2], BOUNDS, **asked).run.ids == (1,)


def test_residuals_are_the_difference_of_a_simulation_and_the_measurement(fit, pushes):
    """The simulation is made here by `fixel.simulate`, without the calibration's own code."""
    push = pushes[1]
    run = fixel.simulate(push.scene, dict(fit), output_interval=0.05)
    wanted = run.pose["part"][1 : len(push.trajectory.time)] - push.trajectory.pose[1:]
    np.testing.assert_allclose(fit.residuals(push), wanted, atol=2e-5)
    scaled = fit.residuals(push) * (1.0, 1.0, 0.035)
    errors = [
        np.sum((fit.residuals(own) * (1.0, 1.0, 0.035)) ** 2, axis=1).mean() for own in pushes
    ]
    assert fit.rms_error == pytest.approx(math.sqrt(np.mean(errors)), rel=1e-9)
    assert np.abs(scaled).max() < 6 * max(POSITION_NOISE, 0.035 * ANGLE_NOISE)
    again = fit.simulate(push, output_interval=0.05)
    np.testing.assert_allclose(again.pose["part"], run.pose["part"], atol=1e-12)


def test_the_call_repeats_it_bit_for_bit(fit, pushes):
    assert eval(fit.call, {"fixel": fixel, "experiments": pushes}) == fit
    prior = {"mu_pusher": fixel.Parameter(0, 1, prior=(0.3, 0.2), scale=0.05), "mass": 0.15}
    noise = fixel.Noise(position_m=1e-4, angle_rad=1e-3)
    error = {"name": "robust", "distance": 1e-3}
    options = {"error": error, "noise": noise, "optimiser": "nelder-mead", "max_evaluations": 30}
    one = fixel.calibrate(
        pushes[:2], prior, **options, seed=3, motion="quasistatic", verdicts=False
    )
    call = one.call
    assert "prior=(0.3, 0.2)" in call
    assert eval(call, {"fixel": fixel, "experiments": pushes[:2]}) == one


def test_a_file_opens_though_a_class_has_moved_to_another_module(fit, tmp_path):
    with zipfile.ZipFile(fit.save(tmp_path / "fit.fixel")) as file:
        members = {name: file.read(name) for name in file.namelist()}
    now, earlier = b"fixel.calibration.result:", b"fixel.workflows.calibration.result:"
    assert now in members["result.json"]
    members["result.json"] = members["result.json"].replace(now, earlier)
    with zipfile.ZipFile(tmp_path / "earlier.fixel", "w") as file:
        for name, content in members.items():
            file.writestr(name, content)
    assert fixel.load(tmp_path / "earlier.fixel") == fit


def test_a_result_has_its_values_as_columns(fit):
    frame = fit.to_dict()
    assert frame["parameter"] == ["mu_pusher", "tripod_radius"]
    assert frame["value"][0] == fit.estimates["mu_pusher"].value


def test_what_is_shown(fit):
    text = repr(fit)
    assert text.startswith("Calibration of 4 experiments (dynamic): finished after ")
    value = f"{fit.estimates['mu_pusher'].value:.4g}"
    assert value in text
    assert value in fit._repr_html_()
    assert "mm" in text


def test_a_misfit_is_one_paragraph(fit):
    misfitting = replace(
        fit.found, misfit=("slight model misfit: 5 mrad.", "Half of it is of one.")
    )
    outcome = replace(fit.run.outcome, found=(misfitting,))
    lines = repr(replace(fit, run=replace(fit.run, outcome=outcome))).splitlines()
    assert [line.strip() for line in lines if "misfit" in line] == [" ".join(misfitting.misfit)]
    assert re.search(r"error: [\d.]+ mm before, [\d.]+ mm after calibration", "\n".join(lines))


def test_a_parameter_that_is_not_identified_is_not_shown_as_known(fit):
    """The estimates are replaced, so that the representation alone is tested."""
    found = fit.found
    open_ones = tuple(
        replace(own, verdict="not identified", low=None, high=None, reason="no value fits worse")
        if own.label == "mu_pusher"
        else own
        for own in found.estimates
    )
    outcome = replace(fit.run.outcome, found=(replace(found, estimates=open_ones),))
    text = repr(replace(fit, run=replace(fit.run, outcome=outcome)))
    row = next(line for line in text.splitlines() if "mu_pusher" in line)
    assert row.split()[1] == "-"
    assert "anything in 0 to 1" in row
    assert f"{fit.estimates['mu_pusher'].value:.4g}" not in row


@pytest.mark.parametrize("kind", ["parameters", "profiles", "search", "errors"])
def test_plots_are_axes(fit, kind):
    from matplotlib import pyplot

    assert np.ravel(fit.plot(kind))[0].figure is not None
    pyplot.close("all")


@pytest.mark.parametrize(("parameters", "said"), [
    ({"mu_pusher": (1, 0)},
     "mu_pusher: found bounds 1 to 0, but fixel needs the lower bound first"),
    ({"tripod_radius_mm": (10, 60)}, "(10 * mm, 60 * mm)"),
    ({"mu_pushr": (0, 1)}, "did you mean 'mu_pusher'?"),
    ({"mu_fixel": (0, 1)}, "no fixel in any of the experiments"),
    ({"ellipsoid_torque": (0.1, 1)}, "a body on Tripod"),
    ({"mu_pusher[surface=steel]": (0, 1)}, "no experiment with mu_pusher[surface=steel]"),
    ({"mu_pusher": fixel.Parameter(0, 1, by="surface")}, "no experiment with surface"),
    ({"mu_pusher": "wide"}, "(low, high), a number to fix it"),
    ({"mu_pusher": (0, math.nan)}, "mu_pusher.high"),
    ({"mu_pusher": (0, 1, 2)}, "3 numbers, but fixel needs two bounds"),
    ({"mu_pusher": 0.3}, "no parameter that is free"),
    ({"support_1_x": (0, 0.1)}, "a body on Tripod"),
    (3, "parameters: found the type int"),
    ([3], "parameters: found the type int, but fixel needs a text, or several"),
])  # fmt: skip
def test_spaces_that_cannot_be_searched_are_refused(pushes, parameters, said):
    assert said in str(refused(fixel.calibrate, pushes[:1], parameters, **QUIET))


@pytest.mark.parametrize(("options", "said"), [
    ({"error": "mean-sqare"}, "did you mean 'mean-square'"),
    ({"motion": "dynamics"}, "did you mean 'dynamic'"),
    ({"optimiser": "least-square"}, "did you mean 'least-squares'"),
    ({"level": 95}, "level"),
    ({"starts": 0}, "starts"),
    ({"seed": -1}, "seed"),
    ({"combine": "product"}, "combine"),
    ({"max_evaluations": 0}, "max_evaluations"),
    ({"budget": 0.0}, "budget"),
    ({"workers": -1}, "workers is -1, but must be at least 0"),
    ({"optimiser": {"name": "pattern-search", "delta": 1}}, "pattern-search is 'delta'"),
])  # fmt: skip
def test_options_that_cannot_be_are_refused(pushes, options, said):
    given = pushes[:1], {"mu_pusher": (0, 1)}
    assert said in str(refused(fixel.calibrate, *given, **QUIET, **options))


def test_experiments_that_cannot_be_compared_are_refused(pushes):
    with pytest.raises(fixel.InvalidInput, match="no scene"):
        fixel.calibrate([pushes[0], replace(pushes[1], scene=None)], BOUNDS, **QUIET)
    refused(fixel.calibrate, [], BOUNDS, match="found none", **QUIET)
    with pytest.raises(fixel.InvalidInput, match="budget: found mode each"):
        fixel.calibrate_each(pushes[:1], BOUNDS, budget=10.0, **QUIET)


def test_parts_of_different_shapes_that_share_a_support_are_named():
    """One value for them is right only if they stand alike, which their outlines do not show."""
    feet = fixel.Tripod(radius=0.03, friction=0.25)
    pushes = [
        replace(own, scene=replace(own.scene, bodies=(replace(own.scene.bodies[0], support=feet),)))
        for own in example_parts(3, 2)
    ]
    for used, by, shared in ((pushes, (), 3), (pushes[:4], (), 2), (pushes[:2], (), 0),
                             (pushes, "part", 0)):  # fmt: skip
        space = {"mu_pusher": (0, 1), "tripod_radius": fixel.Parameter(0.01, 0.06, by=by)}
        text = str(fixel.calibrate(used, space, motion="quasistatic", verdicts=False, **QUIET))
        found = re.findall(r"(\d) different parts share tripod_radius; the key where", text)
        assert found == [str(shared)] * (shared > 0)


def test_one_value_for_each_condition(pushes):
    by_side = {"mu_pusher": fixel.Parameter(0, 1, by="side"), "tripod_radius": 0.038}
    fit = fixel.calibrate(pushes, by_side, verdicts=False, **QUIET)
    assert set(fit) == {"mu_pusher[side=left]", "mu_pusher[side=right]", "tripod_radius"}
    assert fit.values_for(side="left")["mu_pusher"] == fit["mu_pusher[side=left]"]
    assert fit.values_for(pushes[0])["mu_pusher"] == fit["mu_pusher[side=right]"]
    refused(fit.simulate, pushes[0].scene, match=r"fit.values_for\(side=")
    refused(fixel.simulate, pushes[0].scene, fit, match="values_for")
    assert eval(fit.call, {"fixel": fixel, "experiments": pushes}) == fit


@pytest.mark.parametrize("optimiser", ["least-squares", "pattern-search", "nelder-mead", "cma-es"])
@pytest.mark.parametrize("function", [fixel.calibrate, fixel.calibrate_each])
@pytest.mark.parametrize("limit", [1, 10])
def test_a_limit_of_evaluations_is_exact(pushes, optimiser, function, limit):
    if (optimiser, function) == ("least-squares", fixel.calibrate_each):
        pytest.skip("least squares is for several experiments")
    found = function(
        pushes[:2], BOUNDS, optimiser=optimiser, starts=2, max_evaluations=limit, verdicts=False,
        motion="quasistatic", progress=False, threads=1,
    )  # fmt: skip
    for fit in [found] if isinstance(found, fixel.Calibration) else found:
        trace = fit.found.trace
        assert fit.evaluations == len(trace.points) == limit
        assert fit.status == "budget"
        best = int(np.argmin(trace.errors))
        assert trace.error == trace.errors[best]
        assert trace.point.tolist() == trace.points[best].tolist()


def test_a_store_continues_and_refuses_another_call(pushes, tmp_path):
    store = tmp_path / "fit"
    whole = fixel.calibrate(pushes[:2], BOUNDS, **QUIET)

    def interrupt(progress):
        if progress.stage.startswith("verdicts") and progress.done > 4:
            raise KeyboardInterrupt

    with pytest.raises(fixel.Interrupted) as stopped:
        fixel.calibrate(pushes[:2], BOUNDS, store=store, progress=interrupt)
    best = stopped.value.result
    assert best.status == "interrupted"
    assert dict(best) == dict(whole)  # the search had ended
    assert "the same request" in str(stopped.value)
    assert fixel.calibrate(pushes[:2], BOUNDS, store=store, **QUIET) == whole
    for changed, said in (
        ({"seed": 1}, "another seed: 0"),
        ({"level": 0.9}, "another level: 0.95"),
        ({"parameters": {"mu_pusher": (0, 1)}}, "another parameters"),
        ({"experiments": pushes[2:]}, "other experiments"),
    ):
        call = {"experiments": pushes[:2], "parameters": BOUNDS, **QUIET, **changed}
        assert said in str(refused(fixel.calibrate, **call, store=store, match="store"))
    # A job as earlier versions made it for calibrations.
    made = json.loads((store / "job.json").read_text())
    made |= {"maker": "calibration:calibration_work", "options": {}}
    (store / "job.json").write_text(json.dumps(made))
    with pytest.raises(fixel.InvalidInput, match="another job, or one of an earlier version"):
        fixel.calibrate(pushes[:2], BOUNDS, store=store, **QUIET)
    (store / "result").unlink()
    with pytest.raises(fixel.InvalidInput, match="older version of fixel cannot be resumed"):
        jobs.run_here(store)


def test_an_interrupted_search_gives_the_best_so_far(pushes, fit):
    def interrupt(progress):
        if progress.done >= 6:
            raise KeyboardInterrupt

    with pytest.raises(fixel.Interrupted) as stopped:
        fixel.calibrate(pushes, BOUNDS, progress=interrupt)
    best = stopped.value.result
    assert best.status == "interrupted"
    assert fit.rms_error <= best.rms_error < best.nominal_rms_error
    assert "interrupted" in repr(best)
    assert fixel.calibrate(pushes, BOUNDS, **QUIET) == fit


@pytest.mark.parametrize("stored", [False, True])
def test_interrupted_singles_are_those_that_finished(stored, tmp_path):
    six, space = example_pushes(6), {"mu_pusher": (0, 1), "tripod_radius": 0.038}
    options = {"verdicts": False, "max_evaluations": 10}

    def interrupt(progress):
        if progress.stage == "each experiment" and progress.done > 1:
            raise KeyboardInterrupt

    store = tmp_path / "job" if stored else None
    with pytest.raises(fixel.Interrupted) as stopped:
        fixel.calibrate_each(six, space, progress=interrupt, store=store, **options)
    found = stopped.value.result
    whole = fixel.calibrate_each(six, space, progress=False, **options)
    assert 0 < len(found) < len(whole) == 6
    assert [dict(one) for one in found] == [dict(one) for one in whole][: len(found)]
    assert {one.status for one in found} == {"budget"}
    assert "(interrupted)" in repr(found)


def test_a_plot_of_several_has_a_row_for_each_parameter_of_each(pushes):
    fits = fixel.calibrate_each(pushes[:2], BOUNDS, **QUIET)
    axes = fits.plot()[0]
    labels = [" ".join(text.get_text().split()) for text in axes.get_yticklabels()]
    names = [e.key for e in pushes[:2]]
    assert labels == [f"{label} {name}" for label in fits[0].space.labels for name in names]
    spans = [line.get_xdata() for line in axes.lines if line.get_linewidth() == 5.0]
    first = fits[0].estimates["mu_pusher"]
    assert len(spans) == 4
    assert list(spans[0]) == pytest.approx([first.low, first.high])  # its bounds are 0 and 1


def test_each_and_campaign(pushes):
    space = {"mu_pusher": (0, 1), "tripod_radius": 0.038}
    each = fixel.calibrate_each(pushes[:2], space, verdicts=False, **QUIET)
    assert [one.keys_of_experiments for one in each] == [(own.key,) for own in pushes[:2]]
    campaign = fixel.calibrate_campaign(pushes[:2], space, verdicts=False, **QUIET)
    assert [dict(one) for one in campaign.each] == [dict(one) for one in each]
    assert campaign.joint["mu_pusher"] == pytest.approx(0.25, abs=0.02)
    assert eval(each.call, {"fixel": fixel, "experiments": pushes[:2]}) == each


SCRIPT = """
import sys, threading, _thread, time
import fixel
from fixel.testing.pushes import example_pushes
pushes = example_pushes(2, duration=0.5)
space = {"mu_pusher": (0, 1), "tripod_radius": (0.01, 0.06)}
whole = fixel.calibrate(pushes, space, progress=False)
fixel.calibrate(pushes, space, progress=False, store=sys.argv[1])  # everything is imported
print("ready", flush=True)
while True:
    try:
        store = sys.stdin.readline().strip()
    except KeyboardInterrupt:  # both calibrations had ended
        continue
    if not store:
        break
    try:
        try:
            print("begin", flush=True)
            fixel.calibrate(pushes, space, progress=False, store=None if store == "-" else store)
            print("finished", flush=True)
        except KeyboardInterrupt as problem:
            began = time.monotonic()
            print(type(problem).__name__, flush=True)
        same = fixel.calibrate(pushes, space, progress=False, store=None if store == "-" else store)
        print("same" if same == whole else "other", flush=True)
    except KeyboardInterrupt:
        print("late", flush=True)
"""


def _interrupted(folder, delays, stores):
    """Interrupt calibrations in another interpreter after delays; yield how each ended."""
    with subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(folder / "first")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout.readline().strip() == "ready"
            for delay, store in zip(delays, stores, strict=True):
                process.stdin.write(f"{store}\n")
                process.stdin.flush()
                assert process.stdout.readline().strip() == "begin"
                time.sleep(delay)
                process.send_signal(signal.SIGINT)
                sent = time.monotonic()
                said = process.stdout.readline().strip()
                waited = time.monotonic() - sent
                assert said in ("Interrupted", "KeyboardInterrupt", "finished"), said
                if said != "finished":
                    assert waited < 60.0
                    assert process.stdout.readline().strip() == "same"
                else:
                    process.stdout.readline()
                yield said
        finally:
            process.kill()


@pytest.mark.system
def test_the_interpreter_is_usable_after_an_interruption(tmp_path):
    # A busy machine takes longer until there is a first result, which `Interrupted` has.
    delays = [0.05 * 2.0**k for k in range(8)]
    stores = [tmp_path / f"{k}" if k % 2 else "-" for k in range(8)]
    assert "Interrupted" in _interrupted(tmp_path, delays, stores)


@pytest.mark.slow
def test_any_instant_can_be_interrupted(tmp_path):
    rng = random.Random(1)
    delays = [rng.uniform(0.0, 0.6) for _ in range(100)]
    stores = [tmp_path / f"{k}" if k % 2 else "-" for k in range(100)]
    ends = list(_interrupted(tmp_path, delays, stores))
    assert ends.count("Interrupted") + ends.count("KeyboardInterrupt") > 20
