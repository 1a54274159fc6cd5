"""Choices among real pushes: goals, choices, pairs, and one group of real pushes."""

import numpy as np
import pytest
from reproductions.mit_push import PUBLISHED
from reproductions.plans import Actions, choose, chosen_pairs, goals_of, off_goal
from reproductions.predicted_pushes import REPEATS, GroupPrediction, PredictedPushes, predict_group
from reproductions.protocols import calibrated_bench
from reproductions.result import RunOptions

KEY = ("abs", "rect1")


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
    held = PredictedPushes(KEY, np.arange(2), predicted, measured, draws)
    goals = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    actions = Actions(GroupPrediction(held, held), {"calibrated": predicted}, goals)
    found = choose(actions, (3.0, 3.0))
    assert found["calibrated"].success.tolist() == [False, False]
    assert found["probability"].success.tolist() == [True, False]
    assert found["probability"].feasible.tolist() == [True, False]
    assert found["probability"].stated.tolist() == [1.0, 0.0]


def exact(motions, error=0.0):
    """Pushes whose draws are the motions themselves, recorded with an error of the way."""
    draws = np.repeat(motions[:, None], 8 * REPEATS, axis=1)
    measured = motions + np.array([error, 0.0, 0.0])
    return PredictedPushes(KEY, np.arange(len(motions)), motions, measured, draws)


def test_a_look_corrects_what_two_blind_pushes_miss(monkeypatch):
    """Straight moves on a grid of 4 mm, of which each ends 4 mm farther along x than predicted."""
    monkeypatch.setattr("reproductions.plans.GOALS", 100)
    grid = np.stack(np.meshgrid(*2 * [np.linspace(-0.02, 0.02, 11)]), axis=-1).reshape(-1, 2)
    held = exact(np.column_stack((grid, np.zeros(len(grid)))), error=4e-3)
    few = exact(np.array([[0.01, 0.0, 0.0], [0.0, 0.01, 0.0]] * 20))
    found = chosen_pairs(GroupPrediction(few, held), np.random.default_rng(0))
    assert found.blind_met.max() == 0.0  # off by 8 mm, where 3 mm are allowed
    assert found.looked_met.mean() > 0.1  # off by the 4 mm of the second push
    sure = chosen_pairs(
        GroupPrediction(few, held._replace(measured=held.predicted)), np.random.default_rng(0)
    )
    assert sure.blind_met.mean() > 0.95
    assert sure.blind.tolist() == sure.blind_met.tolist()
    assert sure.looked.tolist() == sure.looked_met.tolist()


@pytest.mark.slow
def test_intervals_of_real_pushes_hold(data_root):
    options = RunOptions(
        folder=data_root / "mit_push_endpoints", progress=lambda *_: None, quick=True
    )
    bench = calibrated_bench(options)
    key = next(iter(bench.rows))
    found = predict_group(bench, key, bench.splits(key)[0], 0, draws=16)
    assert len(found.train.rows) == 8
    assert 0.5 <= found.held_out.inside().mean() <= 1.0
    off = np.hypot(*(found.held_out.predicted - found.held_out.measured)[:, :2].T)
    assert np.median(off) < 5e-3  # pushes of 50 mm
    assert PUBLISHED in bench.data.published
