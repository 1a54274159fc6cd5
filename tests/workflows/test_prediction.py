"""Predictions against single simulations from the same starts."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import project_of, refused
from tests.uncertainty import test_likelihood
from tests.uncertainty.forks import fork

import fixel
from fixel.calibration.noise import Noise
from fixel.errors import InvalidInput
from fixel.model import Probability, Seated
from fixel.testing.pushes import ANGLE_NOISE, POSITION_NOISE, TRUTH, example_pushes
from fixel.testing.scenes import grasp, micro_push, pushed_square
from fixel.uncertainty.error_terms import ASME, StartError
from fixel.uncertainty.run_to_run import RunToRun
from fixel.workflows.prediction import predict

QUIET = {"progress": False, "threads": 1}
NOISE_OF_EXAMPLE = Noise(position_m=POSITION_NOISE, angle_rad=ANGLE_NOISE)
LOOSE = StartError(x=4e-3, y=20e-3, theta=math.radians(8.0), kind="uniform")


def test_a_scene_file_is_predicted_with_its_own_motion(tmp_path):
    path, options = tmp_path / "push.yaml", {"start": ASME, "samples": 8, **QUIET}
    text = micro_push(1).save(path).read_text()
    path.write_text(text.replace("motion: dynamic", "motion: quasistatic"))
    own = predict(path, **options)
    assert own.motion == "quasistatic"
    again = predict(fixel.load_scene(path).scene, motion="quasistatic", **options)
    assert np.array_equal(own.ends, again.ends)
    assert predict(fixel.load_scene(path), motion="dynamic", **options).motion == "dynamic"


def test_the_probability_of_seating_is_that_of_single_simulations():
    scene, values = grasp("slip"), {"mu_support": 0.3}
    found = predict(scene, values, start=LOOSE, samples=24, **QUIET)
    touched = []
    for start in found.start:
        x, y, theta = start - scene.bodies[0].pose
        own = fixel.simulate(
            scene, fixel.Parameters(values | {"start_x": x, "start_y": y, "start_theta": theta})
        )
        touched.append({other for pair in own.touching for other in pair if "object" in pair})
    for goal in (Seated("fixel-1"), Seated("fixel-3"), Seated("fixel-1", "fixel-2")):
        good = sum(set(goal.fixels) <= own for own in touched)
        assert found.probability(goal) == Probability.of(good, 24)
    assert sum(one.value for one in found.modes.values()) == pytest.approx(1.0)
    assert len(found.modes) > 1


def test_a_prediction_tells_its_ends():
    found = predict(fork(), start=LOOSE, samples=40, motion="quasistatic", **QUIET)
    low, high = found.bands(0.8)[1:]
    inside = (found.ends >= low[-1]) & (found.ends <= high[-1])
    assert inside.mean() == pytest.approx(0.8, abs=0.07)
    text = repr(found)
    assert text.startswith("Prediction: 40 runs, start: +-4 mm (x), +-20 mm (y), +-8 deg uniform (")


def test_model_error_widens_the_ends_and_leaves_the_contacts():
    own = predict(micro_push(1), start=ASME, samples=200, **QUIET)
    more = predict(micro_push(1), start=ASME, samples=200, model_error=1e-3, **QUIET)
    np.testing.assert_array_equal(own.pose, more.pose)
    off = (more.ends - own.ends)[:, :2]
    assert off.std(axis=0) == pytest.approx([1e-3, 1e-3], rel=0.2)
    assert "model error" in repr(more)


@pytest.fixture(scope="module")
def sampled():
    comparer, posterior = test_likelihood.sampled(60, 40)
    return comparer.targets[0].case.scene, posterior


def test_every_run_has_the_parameters_of_a_sample(sampled):
    scene, posterior = sampled
    found = predict(scene, posterior, samples=100, **QUIET)
    for name, values in found.parameters.items():
        assert set(values) <= set(posterior.samples[name])
    assert found.drift is not None
    assert predict(scene, posterior, model_error=False, samples=10, **QUIET).drift is None


def test_what_is_certain_or_unknown_is_refused(sampled):
    refused(predict, micro_push(1), match="uncertain input", **QUIET)
    refused(predict, micro_push(1), start=ASME, model_error=True, match="model_error", **QUIET)
    with pytest.raises(InvalidInput, match="goal"):
        predict(micro_push(1), start=ASME, samples=9, **QUIET).probability(Seated("fixel-1"))
    refused(predict, micro_push(1), start=ASME, samples=1, match="samples", **QUIET)
    refused(predict, micro_push(1), start=ASME, model_error=-1.0, match="model_error", **QUIET)


def test_a_calibration_predicts_with_its_values_and_motion_model():
    pushes = example_pushes(2, duration=0.5)
    fit = fixel.calibrate(
        pushes, {"mu_pusher": (0, 1)}, motion="quasistatic", verdicts=False, progress=False
    )
    found = predict(pushes[0], fit, start=ASME, samples=8, **QUIET)
    assert found.motion == "quasistatic"
    assert set(found.parameters["mu_pusher"]) == {fit["mu_pusher"]}
    assert found.time[-1] == pytest.approx(0.5)


@pytest.mark.system
def test_the_posterior_holds_the_truth_and_predicts_another_push(tmp_path, monkeypatch):
    monkeypatch.setattr("fixel.workflows.analysis.write_picture", lambda *_: [])
    pushes = example_pushes(2, duration=0.3)
    found = fixel.posterior(
        pushes[0],
        {"mu_pusher": (0, 1), "tripod_radius": TRUTH["tripod_radius"]},
        noise=NOISE_OF_EXAMPLE,
        model_error=False,
        samples=20,
        **QUIET,
    )
    assert found.experiments == (pushes[0].key,)
    assert TRUTH["mu_pusher"] == pytest.approx(np.median(found.samples["mu_pusher"]), abs=0.05)
    assert "mu_pusher" in repr(found)
    assert found.evidence.log == found.log_evidence
    assert found.summary().rows[0][0] == "mu_pusher"
    values = predict(pushes[1], found, samples=60, **QUIET)
    assert set(values.shares) >= {"parameters", "start", "noise"}
    assert max(values.levels_of(pushes[1].trajectory.pose[-1])) < 0.999
    kept = project_of(tmp_path / "lab", pushes).add(found)
    assert kept.analysis.numbers["parameters"]["mu_pusher"]["best"] == found.best[0]
    with pytest.raises(InvalidInput, match="did you mean 'mu_pusher'"):
        fixel.posterior(pushes[0], {"mu_pushr": (0, 1)}, **QUIET)


# --- scatter between runs -----------------------------------------------------------------------


def test_the_scatter_between_runs_grows_with_the_motion():
    scatter = RunToRun()
    ends = {}
    for duration in (0.6, 1.2):
        scene = pushed_square(duration)
        found = predict(scene, run_to_run=scatter, samples=200, progress=False)
        ends[duration] = found.ends.std(axis=0)
        assert found.drift is not None
        assert found.failed == 0
    assert (ends[1.2] > ends[0.6]).all()


def test_a_part_that_is_not_touched_has_the_error_of_its_start_alone():
    scene = pushed_square(0.5)
    away = replace(scene.bodies[0], pose=scene.bodies[0].pose + np.array([0.0, 0.5, 0.0]))
    scene = replace(scene, bodies=(away,))
    found = predict(scene, run_to_run=RunToRun(start=0.0), samples=20, progress=False)
    assert np.ptp(found.ends, axis=0).max() < 1e-9


def test_a_seated_part_has_no_remainder_and_bits_do_not_depend_on_threads():
    scene = grasp("seated")
    given = {"run_to_run": RunToRun(), "samples": 30, "seed": 3, "progress": False}
    one = predict(scene, {"mu_support": 0.3}, threads=1, **given)
    assert (one.ends == predict(scene, {"mu_support": 0.3}, threads=2, **given).ends).all()
    seated = one.meets(Seated("fixel-1"))
    assert (one.drift[one.ended][seated] == 0.0).all()


def test_scatter_and_model_error_together_are_refused():
    with pytest.raises(InvalidInput, match="one of the two"):
        predict(pushed_square(), run_to_run=RunToRun(), model_error=1e-3)
    refused(predict, pushed_square(), run_to_run="learned", match="RunToRun")


def test_the_error_of_the_model_is_as_far_on_as_the_motion_at_instants_before_its_end():
    scene, tau = pushed_square(), 2e-3
    instants = scene.duration * np.array([0.2, 0.4, 0.5])
    found = predict(scene, {}, model_error=tau, times=instants, samples=4000, **QUIET)
    path = fixel.simulate(scene)["part"]
    way = np.hypot(*(path.at(instants) - path.pose[0])[:, :2].T)
    share = way / np.hypot(*(path.pose[-1] - path.pose[0])[:2])  # straight on, without a turn
    np.testing.assert_allclose(found.drift[..., 0].std(axis=0), tau * np.sqrt(share), rtol=0.05)
