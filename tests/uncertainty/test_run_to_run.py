"""Scatter between runs: fits to known scatter, draws, and bad input."""

from dataclasses import replace

import numpy as np
import pytest

from fixel import InvalidInput, PairFriction, RunToRun, learn_run_to_run
from fixel.testing.pushes import TRUTH, example_pushes
from fixel.testing.scenes import grasp, pushed_square
from fixel.uncertainty.run_to_run import (
    CENTRE,
    FRICTION,
    REST_ANGLE,
    TURN,
    RunEffects,
    arm_of,
    rest_at,
)


def synthetic(k, centre, rest, seed=0, freedom=200.0):
    """Errors of pushes with effects of random size, drawn from a known scatter."""
    rng = np.random.default_rng(seed)
    turned = rng.uniform(0.0, 0.6, k)
    start = np.zeros((k, 3, 3))
    by_centre = 0.05 * turned[:, None, None] * rng.standard_normal((k, 3, 2))
    by_friction = np.zeros((k, 3, 1))
    factor = np.sqrt(freedom / rng.chisquare(freedom, k))[:, None]
    residual = np.einsum("kij,kj->ki", by_centre, rng.standard_normal((k, 2))) * centre / CENTRE
    size = np.array([rest[0], rest[0], rest[1]])
    residual += turned[:, None] * size * rng.standard_normal((k, 3))
    residual += 0.005 * rng.standard_normal((k, 3))
    return RunEffects(factor * residual, start, by_centre, by_friction, turned)


def test_a_known_scatter_is_found_from_many_experiments():
    found = RunToRun.learned(synthetic(800, 0.2, (0.01, 0.08)))
    assert found.centre == pytest.approx(0.2, rel=0.15)
    assert found.rest_angle == pytest.approx(0.08, rel=0.15)
    assert found.noise_position == pytest.approx(0.005, rel=0.2)
    assert found.freedom > 8.0
    assert found.experiments == 800


def test_few_experiments_stay_near_the_default():
    default = RunToRun()
    few = RunToRun.learned(synthetic(4, 0.4, (0.1, 0.2)))
    many = RunToRun.learned(synthetic(400, 0.4, (0.1, 0.2)))
    assert default.centre < few.centre < many.centre
    assert few.friction == pytest.approx(FRICTION, rel=0.05)  # nothing says anything about it


def test_errors_of_fitted_experiments_count_for_more():
    effects = synthetic(20, 0.12, (0.02, 0.04))
    assert RunToRun.learned(effects, fitted=30).rest_angle > RunToRun.learned(effects).rest_angle


def test_draws_have_the_stated_scales():
    scene = pushed_square()
    scatter = RunToRun(centre=0.1, friction=0.2, freedom=1e6)
    runs = scatter.drawn(20000, seed=3, scene=scene, values={"mu_pusher": np.full(20000, 0.3)})
    arm = arm_of(scene)
    assert np.std(runs.values["friction_centre_x"]) == pytest.approx(0.1 * arm, rel=0.03)
    assert np.std(np.log(runs.values["mu_pusher"])) == pytest.approx(0.2, rel=0.03)
    assert np.median(runs.values["mu_pusher"]) == pytest.approx(0.3, rel=0.02)
    assert np.std(runs.start[:, 2]) == pytest.approx(scatter.start, rel=0.03)
    assert np.std(runs.rest[:, 2]) == pytest.approx(TURN * scatter.rest_angle, rel=0.03)
    assert np.corrcoef(runs.rest[:, 0], runs.values["friction_centre_x"])[0, 1] < 0.05


def test_the_remainder_is_zero_where_nothing_turned_and_grows():
    rest = np.ones((3, 3))
    assert rest_at(rest, np.array([0.0, TURN, -2.0 * TURN])).tolist() == [[0] * 3, [1] * 3, [2] * 3]


def test_fixels_of_one_friction_scatter_and_equal_seeds_agree():
    scene = grasp("seated")
    one, two = (RunToRun().drawn(10, seed=5, scene=scene) for _ in range(2))
    assert np.ptp(one.values["mu_fixel"]) > 0.0
    assert all((one.values[name] == two.values[name]).all() for name in one.values)


def test_the_friction_of_a_pair_is_that_about_which_runs_scatter():
    scene = pushed_square()
    pair = PairFriction((scene.bodies[0].name, scene.pushers[0].name), friction=0.07)
    runs = RunToRun(friction=0.0).drawn(3, seed=0, scene=replace(scene, contact_friction=(pair,)))
    assert runs.values["mu_pusher"] == pytest.approx(0.07)


def test_starts_scatter_by_a_small_share_of_the_part():
    scene = pushed_square()
    runs = RunToRun().drawn(4, seed=0, scene=scene)
    assert np.abs(runs.start[:, :2]).max() < 0.02 * arm_of(scene)


def test_experiments_that_the_model_predicts_narrow_the_scatter():
    pushes = example_pushes(10, duration=1.0)
    found = learn_run_to_run(pushes, TRUTH)
    assert found.experiments == 10
    assert found.centre < 0.5 * CENTRE
    assert found.rest_angle < REST_ANGLE
    assert found == learn_run_to_run(pushes, TRUTH, threads=1)


def test_the_remainder_makes_up_for_simulated_effects_that_are_too_small():
    """Draws without any effect of the scatter: all errors become noise and remainder."""
    rng = np.random.default_rng(4)
    turned = rng.uniform(0.0, 0.6, 500)
    size = np.column_stack((0.05 * turned, 0.05 * turned, 0.1 * turned))
    found = RunToRun(freedom=50.0).with_remainder(
        size * rng.standard_normal((500, 3)), np.zeros((500, 8, 3)), turned
    )
    assert found.rest_position == pytest.approx(0.05, rel=0.1)
    assert found.rest_angle == pytest.approx(0.1, rel=0.1)


def test_the_remainder_is_found_where_draws_have_heavy_tails():
    """Effects and remainder share the factor of a run, as `drawn` has it."""
    rng = np.random.default_rng(6)
    turned = rng.uniform(0.2, 0.6, 3000)
    factor = np.sqrt(3.0 / rng.chisquare(3.0, (3000, 1)))
    known, left = rng.standard_normal((2, 3000, 3))
    residual = factor * (0.02 * known + 0.05 * turned[:, None] * left)
    drawn = np.sqrt(3.0 / rng.chisquare(3.0, (3000, 64, 1))) * rng.standard_normal((3000, 64, 3))
    found = RunToRun(noise_position=1e-4, noise_angle=1e-4).with_remainder(
        residual, 0.02 * drawn, turned
    )
    assert found.rest_position == pytest.approx(0.05, rel=0.06)
    assert found.rest_angle == pytest.approx(0.05, rel=0.06)


@pytest.mark.parametrize("bad", [
    lambda: RunToRun(centre=-1.0),
    lambda: RunToRun(friction=float("nan")),
    lambda: RunToRun(freedom=1.0),
    lambda: RunToRun.learned(synthetic(2, 0.1, (0.02, 0.04))),
    lambda: RunToRun.learned(synthetic(3, 0.1, (0.02, 0.04)), fitted=9),
    lambda: learn_run_to_run([], {}),
    lambda: learn_run_to_run(["no experiment"], {}),
])  # fmt: skip
def test_bad_input_is_refused(bad):
    with pytest.raises(InvalidInput):
        bad()
