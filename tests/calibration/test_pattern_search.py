"""Dakota's pattern search, rule by rule, and the thesis's own."""

import math

import numpy as np
import pytest

from fixel.calibration import FixedStepSearch, PatternSearch, SearchBox
from fixel.errors import InvalidInput
from fixel.testing.optimiser_contract import run

# The four unknowns of the thesis: fixel, pusher, tripod radius [m], surface.
LOW, HIGH = np.zeros(4), np.array([1.0, 1.0, 0.06, 1.0])
THESIS = SearchBox(LOW, HIGH, np.array([0.2, 0.2, 0.025, 0.25]), 0.1 * HIGH)


def box(n=2, start=0.5):
    return SearchBox(np.zeros(n), np.ones(n), np.full(n, start), np.full(n, 0.1))


def tell(search, *errors):
    search.tell(np.array(errors))


def test_start_alone_then_the_whole_pattern():
    search = PatternSearch().start(THESIS)
    assert search.ask().tolist() == [THESIS.start.tolist()]
    tell(search, 7.0)
    trials = search.ask()
    assert len(trials) == 8
    # First steps of 0.05 for each friction and 3 mm for the radius, up first.
    steps = trials - THESIS.start
    assert steps[:4] == pytest.approx(np.diag([0.05, 0.05, 0.003, 0.05]))
    assert steps[4:] == pytest.approx(-np.diag([0.05, 0.05, 0.003, 0.05]))


def test_without_success_1001_evaluations():
    # 0.5 x 0.9^125 is the first step not above 1e-6: 125 x 8 + 1, "over 1000 simulator iterations".
    search = PatternSearch().start(THESIS)
    run(search, lambda point: 1.0)
    assert search.evaluations == 1001
    assert search.iterations == 125
    assert search.delta <= 1e-6 < search.delta / 0.9
    assert search.reason == "the step shrank to 1e-06 of the scale"


def test_step_contracts_after_failure_only():
    search = PatternSearch().start(box())
    tell(search, 9.0)
    tell(search, 8.0, 9.0, 9.0, 9.0)
    assert search.delta == 0.5
    tell(search, 9.0, 9.0, 9.0, 9.0)
    assert search.delta == pytest.approx(0.45)


def test_step_contracts_always_in_the_thesis_prose():
    search = PatternSearch(contract_always=True).start(box())
    tell(search, 9.0)
    for k in range(1, 7):
        trials = len(search.ask())
        tell(search, *[9.0 - k] * trials)
        assert search.delta == pytest.approx(0.5 * 0.9**k)


def successes(search, count):
    for _ in range(count):
        errors = np.full(len(search.ask()), math.inf)
        errors[0] = search.best.error - 1.0
        search.tell(errors)


def test_five_successes_in_a_row_expand():
    search = PatternSearch(initial_delta=0.1).start(box())
    tell(search, 99.0)
    successes(search, 4)
    assert search.delta == 0.1
    successes(search, 1)
    assert search.delta == pytest.approx(0.1 / 0.9)
    successes(search, 4)
    assert search.delta == pytest.approx(0.1 / 0.9)
    successes(search, 1)
    assert search.delta == pytest.approx(0.1 / 0.9**2)


def test_a_failure_ends_the_row():
    search = PatternSearch(initial_delta=0.1).start(box())
    tell(search, 99.0)
    successes(search, 4)
    tell(search, *[99.0] * len(search.ask()))
    successes(search, 4)
    assert search.delta == pytest.approx(0.09)
    successes(search, 1)
    assert search.delta == pytest.approx(0.1)


def test_expansion_switched_off():
    search = PatternSearch(initial_delta=0.1, expand_after=None).start(box())
    tell(search, 99.0)
    successes(search, 12)
    assert search.delta == 0.1


@pytest.mark.parametrize(("options", "error", "moves"), [
    # 0.01 x 0.5^2 = 0.0025 below the iterate's.
    ({}, 0.9976, False),
    ({}, 0.9974, True),
    # 1e-8 is more than 0.01 x 1e-4^2, but within the accuracy of a simulation.
    ({"initial_delta": 1e-4, "resolution": 1e-6}, 1.0 - 1e-8, False),
    ({"initial_delta": 1e-4, "resolution": 1e-9}, 1.0 - 1e-8, True),
    ({"initial_delta": 1e-4, "resolution": 0.0}, 1.0 - 1e-8, True),
])  # fmt: skip
def test_decrease_has_to_be_sufficient_and_above_the_resolution(options, error, moves):
    search = PatternSearch(**options).start(box())
    tell(search, 1.0)
    first = search.ask()[0].copy()
    tell(search, error, 1.0, 1.0, 1.0)
    centre = search.ask().mean(axis=0)
    assert centre == pytest.approx(first if moves else [0.5, 0.5], abs=1e-9)
    assert search.best.error == error  # what it will not follow it still remembers


@pytest.mark.parametrize(("resolution", "limit"), [(3e-7, 501), (0.0, 20_001)])
def test_a_flat_direction_is_not_followed_for_ever(resolution, limit):
    # From a step of 1e-4 on, each step along the second unknown gains up to 1e-10.
    search = PatternSearch(resolution=resolution).start(box())
    run(search, lambda point: 1.0 + abs(point[0] - 0.5) - 1e-5 * point[1], limit)
    assert search.evaluations == limit


@pytest.mark.parametrize(("search", "start", "trials"), [
    (PatternSearch(initial_delta=5.0), box(),
     [[1.0, 0.5], [0.5, 1.0], [0.0, 0.5], [0.5, 0.0]]),  # a bound itself is within
    (PatternSearch(), box(2, start=0.98), [[0.93, 0.98], [0.98, 0.93]]),  # left out, not moved
    (FixedStepSearch(), box(1, start=0.02), [[0.07], [0.0]]),  # moved onto the bound
])  # fmt: skip
def test_trials_at_the_bounds(search, start, trials):
    search = search.start(start)
    tell(search, 1.0)
    assert search.ask() == pytest.approx(np.array(trials))
    tell(search, *[2.0] * len(trials))
    assert search.evaluations == 1 + len(trials)


def test_no_trial_within_bounds_counts_as_failure():
    search = PatternSearch(initial_delta=100.0).start(box())
    tell(search, 1.0)
    assert len(search.ask()) == 4
    assert search.delta <= 5.0
    assert search.evaluations == 1


def test_stops_at_the_accuracy_if_there_is_one():
    search = PatternSearch().start(box())
    tell(search, 1e-6)
    assert search.done
    assert search.reason == "the error fell to 1e-06"
    assert len(search.ask()) == 0
    search = PatternSearch(solution_accuracy=None).start(box())
    tell(search, -1.0)
    assert not search.done


@pytest.mark.parametrize(("limit", "evaluations", "reason"), [
    ({"max_iterations": 3}, 1 + 3 * 4, "3 iterations were made"),
    ({"max_function_evaluations": 10}, 13, "10 evaluations were made"),  # a whole iteration
])  # fmt: skip
def test_stops_at_a_limit_but_finishes_its_iteration(limit, evaluations, reason):
    search = PatternSearch(**limit).start(box())
    run(search, lambda point: 1.0)
    assert search.evaluations == evaluations
    assert search.reason == reason


@pytest.mark.parametrize(("start", "errors", "best"), [
    (9.0, (8.0, 5.0, 7.0, 5.0), 1),  # of equal ones the first
    (math.nan, (math.inf, math.nan, 1e6, math.inf), 2),  # any that works
])  # fmt: skip
def test_best_of_all_trials_is_taken(start, errors, best):
    search = PatternSearch().start(box())
    tell(search, start)
    trials = search.ask()
    tell(search, *errors)
    assert search.ask().mean(axis=0) == pytest.approx(trials[best])


# --- the thesis's own, appendix C.5 ---------------------------------------------------------------


def test_fixed_steps_of_the_thesis():
    search = FixedStepSearch(steps=(0.05, 0.05, 0.002, 0.05)).start(THESIS)
    tell(search, 6.0)
    steps = search.ask() - THESIS.start
    assert len(steps) == 8
    assert steps[0::2] == pytest.approx(np.diag([0.05, 0.05, 0.002, 0.05]))
    assert steps[1::2] == pytest.approx(-np.diag([0.05, 0.05, 0.002, 0.05]))


def test_fixed_steps_stop_at_the_first_round_without_a_better_one():
    search = FixedStepSearch().start(box())
    tell(search, 6.0)
    tell(search, 5.0, 4.0, 6.0, 7.0)
    assert search.ask().mean(axis=0) == pytest.approx([0.45, 0.5])
    tell(search, 4.0, 4.0, 4.0, 4.0)
    assert search.reason == "no step along any parameter decreased the error"
    assert search.best.error == 4.0


def test_fixed_steps_go_ten_rounds():
    search = FixedStepSearch().start(box())
    run(search, lambda point: 1.0 - float(point[0]) / 100.0 - float(point[1]))
    assert search.evaluations == 1 + 10 * 4
    assert search.reason == "10 rounds were made"
    assert search.best.point == pytest.approx([0.5, 1.0])


def test_fixed_steps_have_to_be_as_many_as_unknowns():
    with pytest.raises(InvalidInput, match="found 3 steps, but fixel needs 2"):
        FixedStepSearch(steps=[0.1, 0.1, 0.1]).start(box())
