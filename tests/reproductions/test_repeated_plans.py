"""Regions of the final poses of repeated plans."""

import numpy as np
import pytest
from reproductions.repeated_plans import RunPrediction
from reproductions.run import reproduce


def draws(n=2000, seed=0):
    return np.random.default_rng(seed).standard_normal((n, 3)) * (1e-3, 1e-3, 0.02)


def test_levels_are_those_of_a_normal_distribution():
    """In three dimensions, 90 % lies within 2.5003 standard deviations (chi squared)."""
    near = RunPrediction("plan", draws(20000), np.array([2.5003e-3, 0.0, 0.0]))
    assert near.level == pytest.approx(0.9, abs=0.01)
    assert RunPrediction("plan", draws(), np.zeros(3)).level < 0.01


def test_runs_that_slip_off_count_but_do_not_shape_the_region():
    slipped = np.vstack((draws(1900), draws(100) + np.array([0.1, 0.0, 0.0])))
    end = np.array([0.0, 4e-3, 0.0])
    assert RunPrediction("plan", slipped, end).level == pytest.approx(0.95, abs=0.005)


@pytest.mark.slow
def test_real_repetitions(data_root, tmp_path):
    found = reproduce("repeated-plans", data_root, out=tmp_path, quick=True)
    runs = found.tables["runs"]
    assert 3 <= len(runs) <= 4  # of one plan
    assert sum(row["inside"] for row in runs) >= len(runs) - 1
