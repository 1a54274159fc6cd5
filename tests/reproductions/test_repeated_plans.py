"""Regions of the final poses of repeated plans."""

import numpy as np
import pytest
from reproductions.repeat_groups import RepeatGroup
from reproductions.repeated_plans import LEARNED, RunPrediction, _weights
from reproductions.run import reproduce


def draws(n=2000, seed=0):
    return np.random.default_rng(seed).standard_normal((n, 3)) * (1e-3, 1e-3, 0.02)


def test_levels_are_those_of_a_normal_distribution():
    """In three dimensions, 90 % lies within 2.5003 standard deviations (chi squared)."""
    near = RunPrediction("plan", draws(20000), np.array([2.5003e-3, 0.0, 0.0]), 1.0)
    assert near.level == pytest.approx(0.9, abs=0.01)
    assert RunPrediction("plan", draws(), np.zeros(3), 1.0).level < 0.01


def test_runs_that_slip_off_count_but_do_not_shape_the_region():
    slipped = np.vstack((draws(1900), draws(100) + np.array([0.1, 0.0, 0.0])))
    end = np.array([0.0, 4e-3, 0.0])
    assert RunPrediction("plan", slipped, end, 1.0).level == pytest.approx(0.95, abs=0.005)


def test_rigs_near_the_measured_ends_have_the_weight():
    end = draws(3, seed=1)
    group = RepeatGroup("a #1", "a", "tri", True, end, end, np.zeros((2, 4)))
    off = np.array([[0.0, 0.0, 0.0], [5e-3, 0.0, 0.0], [np.nan, 0.0, 0.0]])
    weight = _weights(off, [group], 2)
    assert weight.sum() == pytest.approx(1.0)
    assert weight[0] > 0.9
    assert weight[2] == 0.0


@pytest.mark.slow
def test_real_repetitions(data_root, tmp_path):
    found = reproduce("repeated-plans", data_root, out=tmp_path, quick=True)
    inside = [row["inside"] for row in found.tables["runs"] if row["scatter"] == LEARNED]
    assert len(inside) == 28
    assert 18 <= sum(inside) <= 28  # a few rigs: narrower regions than on the page
