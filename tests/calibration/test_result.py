"""Clusters of nearly equal solutions."""

import numpy as np
from tests.fixtures import refused

from fixel.calibration.result import find_solutions


def test_clusters_are_found_best_first():
    rng = np.random.default_rng(2)
    near = [0.2, 0.3] + 0.005 * rng.normal(size=(20, 2))
    far = [0.7, 0.3] + 0.005 * rng.normal(size=(10, 2))
    points = np.concatenate((near, far, [[0.5, 0.9], [0.1, 0.1]]))
    errors = np.concatenate((1.0 + rng.random(20), 0.5 + rng.random(10), [9.0, np.inf]))
    found = find_solutions(points, errors, [0.1, 0.1], threshold=2.0)
    assert [group.size for group in found] == [10, 20]
    assert found[0].error == errors[20:30].min()
    assert np.array_equal(found[0].point, points[found[0].members[0]])
    assert (found[1].low >= 0.17).all()
    assert (found[1].high <= 0.33).all()
    assert sorted(np.concatenate([group.members for group in found]).tolist()) == list(range(30))


def test_a_valley_is_one_solution():
    t = np.linspace(0.0, 1.0, 30)
    found = find_solutions(np.c_[t, 1 - t], np.zeros(30), [0.1, 0.1], threshold=1.0)
    assert len(found) == 1
    assert found[0].high[0] - found[0].low[0] == 1.0


def test_none_and_one():
    assert find_solutions(np.zeros((3, 2)), np.full(3, np.inf), [1, 1], 1.0) == ()
    (only,) = find_solutions(np.zeros((1, 2)), [3.0], [1, 1], 1.0)
    assert only.size == 1


def test_refusals():
    refused(find_solutions, np.zeros((3, 2)), np.zeros(2), [1, 1], 1.0, match="solutions")
