"""Choices among real pushes: goals, choices, widening, and one group of real pushes."""

import numpy as np
import pytest
from reproductions.mit_push import PUBLISHED
from reproductions.plans import Actions, choose, goals_of, off_goal
from reproductions.protocols import calibrated_bench, full_fit
from reproductions.result import RunOptions
from reproductions.run_scatter import (
    REPEATS,
    GroupScatter,
    ScatteredPushes,
    Widening,
    simulated_group,
    typical,
    widened,
)

from fixel.uncertainty.run_to_run import RunToRun

KEY = ("abs", "rect1")


def pushes(m, n=40, *, size=1e-3, stated=1.0, key=KEY, seed=0):
    """Pushes whose draws are too narrow by a factor, with scatter in proportion to the motion."""
    rng = np.random.default_rng(seed)
    predicted = np.column_stack((rng.uniform(0.0, 0.05, (m, 2)), rng.uniform(-0.5, 0.5, m)))
    scale = size * np.array([1.0, 1.0, 20.0])
    measured = predicted + scale * rng.standard_normal((m, 3))
    draws = predicted[:, None] + stated * scale * rng.standard_normal((m, n, 3))
    return ScatteredPushes(key, np.arange(m), predicted, measured, draws)


def test_goals_are_displaced_predictions_of_training_pushes():
    first = np.zeros((50, 3))
    second = np.full((50, 3), np.nan)
    goals = goals_of([first, second], 400, np.random.default_rng(0))
    assert np.isfinite(goals).all()
    radius = np.hypot(goals[:, 0], goals[:, 1])
    assert 2.8e-3 < radius.max() <= 3e-3
    assert np.radians(2.8) < np.abs(goals[:, 2]).max() <= np.radians(3.0)
    assert np.median(radius) == pytest.approx(3e-3 / np.sqrt(2.0), rel=0.1)  # even over the disk


def test_distances_count_in_tolerances_and_full_turns_do_not():
    off = off_goal(np.array([[2e-3, 0.0, 2.0 * np.pi + np.radians(1.0)]]), np.zeros(3), (4.0, 2.0))
    assert off[0] == pytest.approx([0.5, 0.5])


def test_the_certain_push_is_chosen_although_another_is_predicted_nearer():
    n = 2 * REPEATS
    rng = np.random.default_rng(1)
    predicted = np.array([[0.0, 0.0, 0.0], [1e-3, 0.0, 0.0]])
    draws = predicted[:, None] + np.array([[[8e-3]], [[1e-4]]]) * rng.standard_normal((2, n, 3))
    measured = np.array([[9e-3, 0.0, 0.0], [1e-3, 0.0, 0.0]])
    held = ScatteredPushes(KEY, np.arange(2), predicted, measured, draws)
    goals = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    actions = Actions(GroupScatter(RunToRun(), held, held), {"calibrated": predicted}, goals)
    found = choose(actions, (3.0, 3.0))
    assert found["calibrated"].success.tolist() == [False, False]
    assert found["probability"].success.tolist() == [True, False]
    assert found["probability"].feasible.tolist() == [True, False]
    assert found["probability"].stated.tolist() == [1.0, 0.0]


def test_draws_half_as_wide_are_widened_by_two():
    groups = [
        pushes(300, 400, stated=0.5, key=("abs", name), seed=k) for k, name in enumerate("ab")
    ]
    widening = Widening.fitted(groups)
    fresh = pushes(400, 400, stated=0.5, key=("abs", "c"), seed=9)
    assert fresh.inside().mean() < 0.65
    after = widening.applied(fresh)
    assert after.inside().mean() == pytest.approx(0.9, abs=0.03)
    assert np.median(after.half_widths() / fresh.half_widths()) == pytest.approx(2.0, rel=0.15)


def test_widening_follows_the_motion():
    """Draws right for small motions and too narrow for large ones."""
    own = pushes(800, seed=3)
    far = own.moved > 0.03
    narrow = own.predicted[:, None] + np.where(far, 0.4, 1.0)[:, None, None] * (
        own.draws - own.predicted[:, None]
    )
    known = GroupScatter(RunToRun(), own._replace(draws=narrow), own._replace(draws=narrow))
    (after,) = widened([known], [known])
    held = after.held_out.inside()
    assert abs(held[far].mean() - held[~far].mean()) < 0.12
    assert known.held_out.inside()[far].mean() < 0.6


def test_the_typical_scatter_is_the_median_of_others():
    found = typical([RunToRun(centre=x, experiments=10) for x in (0.1, 0.2, 0.9)])
    assert found.centre == 0.2
    assert found.experiments == 30


@pytest.mark.slow
def test_intervals_of_real_pushes_hold(data_root):
    options = RunOptions(
        folder=data_root / "mit_push_endpoints", progress=lambda *_: None, quick=True
    )
    bench = calibrated_bench(options)
    key = next(iter(bench.rows))
    group, (split,) = bench.group(key), bench.splits(key)
    found = simulated_group(group, full_fit(bench, group, 0, split), split).predict(draws=16)
    assert found.scatter.experiments == len(found.train.rows)
    (after,) = widened([found], [found])
    assert 0.75 <= after.held_out.inside().mean() <= 1.0
    assert PUBLISHED in bench.data.published
