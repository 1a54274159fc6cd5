"""Domains grow: which set of parameters, which errors, and what is said where there is none."""

import numpy as np
import pytest
from tests.fixtures import refused

from fixel.calibration.objective import Evaluation
from fixel.domain import growth

# A toy: every experiment has a best point of its own, and its error is the squared distance to it.
BEST = np.random.default_rng(4).uniform(0.0, 1.0, (21, 2))
FLOOR = np.linspace(0.1, 1.0, 21)


def _evaluate(which, points):
    error = ((points - BEST[which]) ** 2).sum(axis=1) + FLOOR[which]
    return Evaluation(error, [""] * len(which))


def _singles(**joint):
    return growth.SingleCalibrations(points=BEST, errors=FLOOR, **joint)


def grow(groups, singles, evaluate, index="corrected"):
    wanted = growth.RolloutQueue()
    read = growth.plan_growth(groups, singles, wanted, index)
    return read(wanted.run(evaluate))


def _group(rows=growth.ROWS):
    return growth.ExperimentGroup(
        shape="square", layout="a", at={place: growth.ROWS.index(place) for place in rows}
    )


def _by_hand(members):
    """Largest error under the mean weighted with inverse errors."""
    weight = 1.0 / FLOOR[members]
    mean = (weight[:, None] * BEST[members]).sum(axis=0) / weight.sum()
    return max(((mean - BEST[m]) ** 2).sum() + FLOOR[m] for m in members)


# Members row by row, from 0, written out: corrected, and as printed.
CORRECTED = [[0], [1, 10, 11, 16], [2, 9, 12, 17], [3, 8, 13, 18], [4, 7, 14, 19], [5, 6, 15, 20]]
PRINTED = [[0], [1, 10, 11, 15], [2, 9, 12, 16], [3, 8, 13, 17], [4, 7, 14, 18], [5, 6, 15, 19]]


@pytest.mark.parametrize(("index", "rows"), [("corrected", CORRECTED), ("printed", PRINTED)])
def test_largest_errors_are_those_computed_by_hand(index, rows):
    found = grow([_group()], _singles(), _evaluate, index)
    expected = [_by_hand(np.concatenate(rows[: k + 1]).astype(int)) for k in range(6)]
    np.testing.assert_allclose(found.matrix[0], expected, rtol=1e-12)
    assert found.steps[0][0].used.source == growth.OWN
    assert found.matrix[0][0] == FLOOR[0]
    assert {step.used.source for step in found.steps[0][1:]} == {growth.AVERAGED}


def test_small_errors_weigh_more():
    share = growth.weights([0, 20], _singles())
    np.testing.assert_allclose(share, [10.0 / 11.0, 1.0 / 11.0])
    point = growth.group_parameters([0, 20], _singles()).point
    np.testing.assert_allclose(point, share @ BEST[[0, 20]])
    np.testing.assert_allclose(growth.group_parameters([0, 20, 20], _singles()).point,
                               (10.0 * BEST[0] + 2.0 * BEST[20]) / 12.0)  # fmt: skip


def test_a_stored_set_for_exactly_these_members_is_used():
    stored = 7, np.array([0.5, 0.5])
    singles = _singles(joint={(0, 1, 10, 11, 16): stored})
    found = grow([_group()], singles, _evaluate)
    first, second = found.steps[0][1:3]
    assert (first.used.source, first.used.calibration) == (growth.STORED, 7)
    members = list(first.used.members)
    expected = ((0.5 - BEST[members]) ** 2).sum(axis=1) + FLOOR[members]
    np.testing.assert_allclose(first.errors, expected)
    assert second.used.source == growth.AVERAGED


def test_a_step_that_lacks_a_member_is_empty_and_so_are_those_after_it():
    rows = [place for place in growth.ROWS if place != growth.AxisPlace("y", -3)]
    found = grow([_group(rows)], _singles(), _evaluate)
    whole = grow([_group()], _singles(), _evaluate)
    assert found.matrix[0][:3] == whole.matrix[0][:3]
    assert found.matrix[0][3:] == [None, None, None]
    assert found.steps[0][3].reason == "not performed: y-3"


def test_a_simulation_that_fails_is_a_reason_and_no_number():
    def evaluate(which, points):
        answer = _evaluate(which, points)
        bad = which == 17
        answer.error[bad] = np.inf
        return Evaluation(answer.error, ["stalled" if b else "" for b in bad])

    found = grow([_group()], _singles(), evaluate)
    assert found.matrix[0][1] is not None
    assert found.matrix[0][2] is None
    assert found.steps[0][2].reason == "no simulation of theta2: stalled"


def test_experiments_whose_own_calibration_failed_do_not_weigh():
    errors = FLOOR.copy()
    errors[[0, 16]] = np.inf
    singles = growth.SingleCalibrations(points=BEST, errors=errors)
    found = grow([_group()], singles, _evaluate)
    assert found.matrix[0][0] is None
    assert "no error" in found.steps[0][0].reason
    members = [1, 10, 11]
    weight = 1.0 / FLOOR[members]
    np.testing.assert_allclose(
        found.steps[0][1].used.point, weight @ BEST[members] / weight.sum(), rtol=1e-12
    )


def test_too_few_experiments_to_grow_are_refused():
    refused(grow, [_group(growth.ROWS[:11])], _singles(), _evaluate, match="lacks y-1, theta1")
    refused(grow, [], _singles(), _evaluate, match="groups")


def test_the_same_rollout_is_run_once():
    wanted = growth.RolloutQueue()
    first = wanted.add(3, BEST[0])
    assert wanted.add(3, BEST[0].copy()) == first
    assert wanted.add(4, BEST[0]) != first
    asked = []

    def evaluate(which, points):
        asked.append((which.tolist(), points.shape))
        return _evaluate(which, points)

    wanted.run(evaluate)
    assert asked == [([3, 4], (2, 2))]
