"""Scores of the benchmark of planning, on rows whose scores are known."""

import math

import numpy as np
import pytest
from benchmarks import planning

from fixel.planning.success import SuccessProbability


def row(mean, held):
    return planning.Row("task", "push", mean, 0.0, held, 0.1, mean, held, 1, 200, 1000, 1.0)


def test_bias_scores_and_reliability_of_known_rows():
    """Two tasks state 0.9 and hold 0.9 and 0.7; two state 0.5 and hold what a coin would."""
    rows = [row(0.9, 0.9), row(0.9, 0.7), row(0.5, 0.4), row(0.5, 0.6)]
    found = {own.name: own.median for own in planning.figures(rows, bar=True)}
    assert found["plans, stated mean less held (bias)"] == pytest.approx(5.0)
    assert found["plans, size of the bias"] == pytest.approx(5.0)
    assert found["plans, difference of stated mean and held"] == pytest.approx(10.0)
    assert found["plans, difference that the belief expects"] == pytest.approx(10.0)
    coin, often = math.log(2.0), -(0.8 * math.log(0.9) + 0.2 * math.log(0.1))
    assert found["plans, log score"] == pytest.approx(0.5 * (coin + often))
    assert found["plans, 2 stated 0.8 to 0.95: held"] == pytest.approx(80.0)
    assert found["plans, 2 stated 0.4 to 0.6: held"] == pytest.approx(50.0)


def test_the_log_score_is_least_for_the_truth_and_finite_for_certainty():
    held = np.array([0.3])
    scores = [planning.log_score(np.array([p]), held) for p in (0.0, 0.2, 0.3, 0.4, 1.0)]
    assert np.argmin(scores) == 2
    assert np.isfinite(scores).all()


def test_the_expected_difference_of_known_beliefs():
    """Worlds that always or never succeed; and equal worlds, where only executions scatter."""
    split = np.repeat([[1.0], [-1.0]], 32, axis=0) * np.ones((64, 64))
    assert planning.expected_difference(SuccessProbability.of(split), 200) == pytest.approx(0.5)
    equal = np.tile(np.repeat([1.0, -1.0], 32), (64, 1))
    found = planning.expected_difference(SuccessProbability.of(equal), 200)
    assert found == pytest.approx(math.sqrt(2.0 / math.pi * 0.25 / 200), rel=0.01)
