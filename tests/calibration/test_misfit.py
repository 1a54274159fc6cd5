"""Noise estimated from measured poses, compared with residuals."""

import numpy as np
import pytest

from fixel import Noise, Tripod
from fixel.calibration.misfit import counting_frames, misfit_of, noise_from_differences
from fixel.calibration.target import Target
from fixel.simulation.rollouts import RolloutCase
from fixel.testing.scenes import free_push

SCENE = free_push(Tripod(radius=0.03, friction=0.3))
NOISE = Noise(position_m=8e-5, angle_rad=3e-3)


def _track(seed, *, noise=True, lost=0.1, smooth=False, frames=200):
    """A curved motion with a jolt in the middle, seen by a camera that loses frames."""
    draw = np.random.default_rng(seed)
    t = np.arange(1, frames + 1) / 30.0
    pose = np.column_stack((0.0135 * t, 1e-3 * np.sin(t), 0.3 * np.sin(0.7 * t)))
    pose[frames // 2 :] += [1e-3, 0.0, 0.05]
    if noise:
        pose += NOISE.standard_deviations * draw.standard_normal(pose.shape)
    if smooth:
        kernel = np.ones(5) / 5.0
        pose = np.column_stack([np.convolve(column, kernel, "same") for column in pose.T])[5:-5]
        t = t[5:-5]
    seen = draw.random(len(t)) >= lost
    return Target("a/b", {}, RolloutCase(SCENE, t[seen]), pose[seen])


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_read_off_without_a_model(seed):
    found = noise_from_differences([_track(seed), _track(seed + 100)])
    assert found.source == "differences"
    # Of 600 second differences, correlated, a median absolute deviation is good to 5 %.
    assert found.position_m == pytest.approx(NOISE.position_m, rel=0.15)
    assert found.angle_rad == pytest.approx(NOISE.angle_rad, rel=0.15)


def test_noise_of_smoothed_poses_and_of_few_is_not_known():
    assert noise_from_differences([_track(0, smooth=True, lost=0.0)]) is None
    assert noise_from_differences([_track(0, noise=False)]) is None
    assert noise_from_differences([_track(0, frames=4)]) is None


def _residuals(scale, seed=0, n=6):
    draw = np.random.default_rng(seed)
    sizes = scale * NOISE.standard_deviations * [1.0, 1.0, 0.9]
    return [sizes * draw.standard_normal((300, 3)) for _ in range(n)]


def test_a_wrong_one_is_with_its_size_first():
    found = misfit_of(_residuals(30.0), list("abcdef"), NOISE)
    assert found.warned
    assert found.sentences[0].startswith("model misfit: residuals of 2.4 mm are 30 times the noise")
    huge = misfit_of(_residuals(460.0), list("abcdef"), NOISE)
    assert f" are {huge.ratio:.0f} times the noise" in huge.sentences[0]
    slight = misfit_of(_residuals(2.0), list("abcdef"), NOISE)
    assert slight.noted
    assert not slight.warned
    assert slight.sentences[0].startswith("slight model misfit")


def test_experiments_that_fit_far_worse_are_named():
    residuals = _residuals(5.0)
    residuals[2] *= 10.0
    found = misfit_of(residuals, list("abcdef"), NOISE)
    assert found.worst == ("c",)
    assert found.share == pytest.approx(100.0 / 105.0, abs=0.02)
    assert found.sentences[1].endswith("come from 1 of 6 experiments: c.")


def test_short_experiments_have_a_small_share_of_the_squared_residuals():
    residuals = _residuals(5.0)
    residuals[2] = 10.0 * residuals[2][:30]
    found = misfit_of(residuals, list("abcdef"), NOISE)
    squares = [np.square(one / NOISE.standard_deviations).sum() for one in residuals]
    assert found.worst == ("c",)
    assert found.share == pytest.approx(squares[2] / sum(squares))  # two thirds, not 95 %


def test_of_one_experiment_the_variation_between_experiments_cannot_be_seen():
    assert "only one experiment" in misfit_of(_residuals(5.0, n=1), ["a"], NOISE).sentences[1]


def test_residuals_are_compared_with_the_noise_of_the_start_as_well():
    """Ten errors of starts, each common to 300 frames and growing along the way."""
    rng = np.random.default_rng(3)
    growth = np.linspace(1.0, 3.0, 300)[:, None] * NOISE.standard_deviations
    residuals = [one + growth * rng.standard_normal(3) for one in _residuals(1.0, n=10)]
    keys = list("abcdefghij")
    assert misfit_of(residuals, keys, NOISE).ratio > 1.5
    found = misfit_of(residuals, keys, NOISE, [growth] * 10)
    assert found.ratio == pytest.approx(1.0, abs=0.3)
    assert found.sentences == ()
    wrong = misfit_of([10.0 * one for one in residuals], keys, NOISE, [growth] * 10)
    assert wrong.warned
    assert "(as stated, with noise of the start poses)" in wrong.sentences[0]


def test_of_unknown_noise_the_warning_states_that_and_no_ratio():
    noise = Noise(position_m=1e-4, angle_rad=1e-3, source="residuals")
    found = misfit_of(_residuals(1.0), list("abcdef"), noise)
    assert np.isnan(found.ratio)
    assert found.warned
    assert found.sentences[0].startswith("noise unknown")


def test_frames_before_the_first_motion_do_not_count_unless_a_push_is_missed():
    start = np.array(SCENE.bodies[0].pose)
    rng = np.random.default_rng(4)
    simulated = start + np.maximum(0.0, np.arange(-10, 20))[:, None] * [1e-3, 0.0, 1e-2]
    simulated[:, 2] += 2.0 * np.pi  # the same pose
    noise = [rng.normal(size=(30, 3)) * NOISE.standard_deviations for _ in range(3)]
    case = RolloutCase(SCENE, np.arange(1.0, 31.0))
    moving = Target("a", {}, case, simulated - noise[0])
    still = Target("b", {}, case, start - noise[1])
    missed = Target("c", {}, case, simulated - noise[2])
    residuals = [noise[0], noise[1], noise[2] + start - simulated]
    frames = [np.arange(30)] * 3
    first, second, third = counting_frames([moving, still, missed], frames, residuals)
    assert first.tolist() == [False] * 11 + [True] * 19
    assert not second.any()
    assert third.all()
    assert counting_frames([still], frames[:1], residuals[1:2])[0].all()
