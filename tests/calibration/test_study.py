"""Studies ask for the right rollouts and do with the answers what the thesis says."""

import math

import numpy as np
import pytest

from fixel.calibration import FixedStepSearch, PatternSearch, SearchBox
from fixel.calibration.objective import Evaluation
from fixel.calibration.study import (
    RolloutRequest,
    best_subset,
    calibrate_each,
    calibrate_joint,
    exchange_with_neighbours,
    minimax_of_stored,
    neighbours,
    run_study,
    weighted,
    weighted_mean,
)
from fixel.errors import InvalidInput

BOX = SearchBox(np.zeros(2), np.ones(2), np.full(2, 0.3), np.full(2, 0.1))
# What each of five experiments would like the parameters to be.
LIKED = np.array([[0.2, 0.4], [0.3, 0.4], [0.25, 0.45], [0.9, 0.9], [0.28, 0.41]])


def bowls(ask):
    distance = np.sum((ask.points - LIKED[ask.which]) ** 2, axis=1)
    return Evaluation(distance, [""] * len(distance))


def total(errors):
    return errors.sum(axis=1)


def test_each_alone_finds_what_each_likes():
    traces = run_study(calibrate_each(range(5), BOX, PatternSearch(solution_accuracy=None)), bowls)
    assert np.array([trace.point for trace in traces]) == pytest.approx(LIKED, abs=1e-3)
    for trace in traces:
        assert trace.error == trace.errors.min()
        assert len(trace.points) == len(trace.errors) == len(trace.reasons)
        assert trace.ended


def test_points_of_recent_requests_are_simulated_once_unless_they_failed():
    seen, failed = [], []

    def partly(ask):
        answer = bowls(ask)
        bad = ask.points[:, 0] > 0.35
        seen.extend(map(bytes, ask.points[~bad]))
        failed.extend(map(bytes, ask.points[bad]))
        answer.error[bad] = math.inf
        return answer._replace(reasons=["jammed" if own else "" for own in bad])

    (trace,) = run_study(calibrate_each([2], BOX, PatternSearch()), partly)

    search = PatternSearch().start(BOX)  # the same without a memory
    errors, reasons = [], []
    while not search.done:
        points = search.ask()
        answer = partly(RolloutRequest(np.full(len(points), 2), points))
        search.tell(answer.error)
        errors += answer.error.tolist()
        reasons += answer.reasons
    assert trace.errors.tolist() == errors
    assert trace.reasons == reasons
    points = [bytes(point) for point in trace.points]
    of_memory = seen[: len(seen) - len([r for r in reasons if not r])]
    assert len(of_memory) < len([r for r in reasons if not r])
    assert set(of_memory) | set(failed) == set(points)
    assert 2 * sum(bool(r) for r in reasons) == len(failed)


def test_together_minimises_what_is_combined():
    trace, search = run_study(calibrate_joint(range(5), BOX, PatternSearch(), total), bowls)
    assert trace.point == pytest.approx(LIKED.mean(axis=0), abs=2e-3)
    assert search.best.error == trace.error
    worst, _ = run_study(
        calibrate_joint(range(5), BOX, PatternSearch(), lambda errors: errors.max(axis=1)), bowls
    )
    assert bowls_at(worst.point).max() < bowls_at(trace.point).max()


def bowls_at(point):
    return np.sum((point - LIKED) ** 2, axis=1)


def test_neighbours_share_what_is_better():
    points = LIKED.copy()
    points[0] = [0.6, 0.6]
    errors = np.array([np.sum((p - q) ** 2) for p, q in zip(points, LIKED, strict=True)])
    better, least = run_study(exchange_with_neighbours(points, errors, [[0, 1, 2], [3, 4]]), bowls)
    assert better[0].tolist() == LIKED[2].tolist()
    assert least[0] == pytest.approx(np.sum((LIKED[2] - LIKED[0]) ** 2))
    assert (better[1:] == points[1:]).all()
    assert (least[1:] == 0.0).all()


def test_groups_of_neighbours_share_the_nominal_experiment():
    conditions = [
        {"shape": "square", "layout": "a", "axis": "nominal"},
        {"shape": "square", "layout": "a", "axis": "x"},
        {"shape": "square", "layout": "a", "axis": "x"},
        {"shape": "square", "layout": "a", "axis": "y"},
        {"shape": "square", "layout": "b", "axis": "x"},
        {"surface": "plywood"},
    ]
    assert neighbours(conditions) == [[0, 1, 2], [0, 3], [4]]


def test_a_mean_leaves_out_those_who_could_not_say():
    points = np.array([[0.0, 3.0], [1.0, 9.0], [2.0, 5.0]])  # the second kept its start
    informed = np.array([[True, True], [True, False], [True, True]])
    found = weighted_mean(points, np.array([1.0, 0.1, 3.0]), informed)
    plain = weighted_mean(points, np.array([1.0, 0.1, 3.0]))
    assert found[0] == plain[0]
    assert found[1] == pytest.approx((3.0 + 5.0 / 3.0) / (1.0 + 1.0 / 3.0))


def test_the_mean_is_weighted_with_inverse_errors():
    points = np.array([[0.0, 1.0], [1.0, 3.0]])
    assert weighted_mean(points, np.array([1.0, 3.0])) == pytest.approx([0.25, 1.5])
    assert weighted_mean(points, np.array([2.0, math.inf])) == pytest.approx([0.0, 1.0])
    assert np.isfinite(weighted_mean(points, np.zeros(2))).all()
    with pytest.raises(InvalidInput, match="no calibrated member"):
        weighted_mean(points, np.full(2, math.inf))


def test_a_subset_without_the_odd_one_does_better():
    # The odd one fitted perfectly, so the inverse of its error alone would rule.
    errors = np.array([1e-3, 1e-3, 1e-3, 1e-6, 1e-3])
    everyone = run_study(weighted(range(5), LIKED, errors), bowls)
    assert everyone.point == pytest.approx([0.9, 0.9], abs=0.01)
    best = run_study(best_subset(range(5), LIKED, errors, total), bowls)
    assert best.members.sum() < everyone.members.sum()
    assert 3 not in best.used
    assert run_study(best_subset(range(5), LIKED, errors, total), bowls).used == best.used


def test_the_best_stored_one_has_the_smallest_largest_error():
    stored = np.array([[0.25, 0.42], [0.6, 0.6], [0.9, 0.9]])
    assert run_study(minimax_of_stored(range(5), stored), bowls).used == (1,)


def test_a_member_that_cannot_be_simulated_spoils_the_point_with_its_reason():
    def failing(ask):
        good = ask.points[:, 0] < 0.35
        error = np.where(good, 1.0, math.inf)
        return Evaluation(error, ["" if g else "jammed at 2 s" for g in good])

    trace, _ = run_study(calibrate_joint(range(2), BOX, FixedStepSearch(), total), failing)
    failed = np.isinf(trace.errors)
    assert failed.any()
    assert all(("jammed" in r) == f for r, f in zip(trace.reasons, failed, strict=True))
