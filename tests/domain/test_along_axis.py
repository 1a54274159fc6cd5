"""One set of parameters along an axis: averages, relative errors, and where the domain ends."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from fixel.calibration.objective import Evaluation
from fixel.domain.along_axis import AxisEdges, edges, plan_studies
from fixel.domain.growth import ROWS, AxisPlace, ExperimentGroup, RolloutQueue, SingleCalibrations
from fixel.errors import InvalidInput

STEPS = np.arange(-5, 6)


def test_edges_are_read_between_samples():
    errors = np.array([9.0, 8.0, 8.0, 5.0, 3.0, 2.0, 3.0, 4.0, 6.0, 9.0, 1.0])
    # As the thesis says of figure 6.5: "from -2 to 2.5 y", at 5.
    assert edges(STEPS, errors, 5.0) == AxisEdges(-2.0, 2.5, False, False)


def test_an_axis_that_stays_within_is_open():
    assert edges(STEPS, np.ones(11), 5.0) == AxisEdges(-5.0, 5.0, True, True)
    assert edges(np.arange(6), np.arange(6.0), 3.25) == AxisEdges(0.0, 3.25, True, False)


def test_no_domain_where_the_nominal_sample_is_beyond():
    assert edges(STEPS, np.abs(STEPS) + 6.0, 5.0) == AxisEdges(None, None)
    errors = np.ones(11)
    errors[5] = np.nan
    assert edges(STEPS, errors, 5.0) == AxisEdges(None, None)


def test_nothing_is_read_across_a_gap():
    errors = np.ones(11)
    errors[[2, 8]] = np.nan, np.inf
    assert edges(STEPS, errors, 5.0) == AxisEdges(-2.0, 2.0, False, False)


@given(
    errors=st.lists(st.floats(0.0, 100.0), min_size=11, max_size=11),
    threshold=st.floats(0.1, 100.0),
)
def test_within_the_edges_all_is_within_the_threshold(errors, threshold):
    errors = np.array(errors)
    found = edges(STEPS, errors, threshold)
    if found.low is None:
        assert errors[5] > threshold
        return
    inside = np.linspace(found.low, found.high, 50)
    assert (np.interp(inside, STEPS, errors) <= threshold * (1.0 + 1e-9)).all()
    mirrored = edges(STEPS, errors[::-1], threshold)
    assert (mirrored.low, mirrored.high) == pytest.approx((-found.high, -found.low))


# --- studies ------------------------------------------------------------------------------------

BEST = np.random.default_rng(1).uniform(0.0, 1.0, (42, 2))
FLOOR = np.linspace(0.1, 1.0, 42)


def _evaluate(which, points):
    error = ((points - BEST[which]) ** 2).sum(axis=1) + FLOOR[which]
    return Evaluation(error, [""] * len(which))


def _groups(left_out=()):
    return [
        ExperimentGroup(
            shape="square",
            layout=layout,
            at={p: 21 * k + row for row, p in enumerate(ROWS) if (layout, p) not in left_out},
        )
        for k, layout in enumerate("ab")
    ]


def _studied(groups, evaluate=_evaluate, **sizes):
    wanted = RolloutQueue()
    read = plan_studies(groups, SingleCalibrations(points=BEST, errors=FLOOR), wanted, sizes)
    return {(s.axis, s.size): s for s in read(wanted.run(evaluate))}


def test_every_layout_has_a_set_of_its_own_interval():
    found = _studied(_groups())
    assert set(found) == {("x", 2), ("x", 4), ("y", 3), ("y", 5), ("theta", 2), ("theta", 4)}
    study = found["y", 3]
    assert study.interval == (-1, 1)
    np.testing.assert_array_equal(study.steps, STEPS)
    for row, group in enumerate(_groups()):
        inside = [group.at[p] for p in (AxisPlace("y", -1), ROWS[0], AxisPlace("y", 1))]
        weight = 1.0 / FLOOR[inside]
        point = weight @ BEST[inside] / weight.sum()
        every = [group.at[AxisPlace("y", k) if k else ROWS[0]] for k in STEPS.tolist()]
        expected = _evaluate(np.array(every), np.repeat(point[None], 11, axis=0)).error
        np.testing.assert_allclose(study.error[row], expected, rtol=1e-12)
        np.testing.assert_array_equal(study.own[row], FLOOR[every])
    np.testing.assert_allclose(study.average, study.error.mean(axis=0))
    np.testing.assert_allclose(study.average_excess, (study.error - study.own).mean(axis=0))
    np.testing.assert_allclose(study.ratio, study.average / study.own.mean(axis=0))


def test_an_experiment_that_is_missing_is_no_number_and_the_others_count():
    found = _studied(_groups({("a", AxisPlace("x", 5)), ("b", AxisPlace("theta", 1))}))
    x = found["x", 2]
    assert np.isnan(x.error[0, 5])
    assert x.average[5] == x.error[1, 5]
    assert x.counted().tolist() == [2, 2, 2, 2, 2, 1]
    assert x.own_average[5] == x.own[1, 5]
    theta = found["theta", 2]
    assert theta.sets[1].reason == "not performed: theta1"
    np.testing.assert_array_equal(theta.average, theta.error[0])


def test_a_failure_ends_the_domain():
    def evaluate(which, points):
        error = np.where(np.isin(which, [2, 3]), np.inf, 0.5)
        return Evaluation(error, [""] * len(which))

    study = _studied(_groups(), evaluate)["x", 2]
    assert np.isinf(study.average[[2, 3]]).all()
    assert study.edges(5.0) == AxisEdges(0.0, 1.0, True, False)
    assert study.relative_edges(5.0).high == 1.0


def test_sizes_are_two_to_five():
    with pytest.raises(InvalidInput, match="2 to 5"):
        _studied(_groups(), y=(6,))
    assert ("y", 4) in _studied(_groups(), y=(4,))
