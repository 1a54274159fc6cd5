"""A calibration has the same result for all ways to divide and answer its questions."""

from dataclasses import fields, is_dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

from fixel.calibration import PatternSearch, search
from fixel.calibration.least_squares import LeastSquares
from fixel.calibration.noise import Noise
from fixel.calibration.objective import Comparer
from fixel.calibration.result import FitKind
from fixel.calibration.search import ANSWERS, TIME, CalibrationSearch, CalibrationTask
from fixel.calibration.study import OUT_OF_BUDGET, run_study
from fixel.calibration.target import targets_of
from fixel.calibration.usual_parameters import search_space
from fixel.testing.pushes import example_pushes

CHECK = {"count": np.array([2, 3]), TIME: 0.0}  # instead of a comparison of ends


@pytest.fixture(scope="module")
def task():
    targets = targets_of(example_pushes(3))
    space = search_space({"mu_pusher": (0, 1), "tripod_radius": 0.038}, targets, None)
    return CalibrationTask(
        comparer=Comparer(targets, space), mode="joint", optimiser=LeastSquares(), combine="sum",
        seed=0, max_evaluations=None, noise=None, level=0.95, verdicts=True, budget=None, stored=(),
    )  # fmt: skip


def part_answer(task, question, part):
    if question.kind == "ends":
        return CHECK
    return {**ANSWERS[question.kind](task, part), TIME: 1.0}


def answers(task, question):
    return [part_answer(task, question, part) for part in question.parts()]


def backwards(task, question):
    """The same answers, computed from the last part to the first."""
    return [part_answer(task, question, part) for part in question.parts()[::-1]][::-1]


def run(task, how=answers):
    return run_study(CalibrationSearch(task).steps(), lambda question: how(task, question))


def same(one, other):
    """Return whether two values are equal bit for bit; durations are left out."""
    if is_dataclass(one):
        names = [own.name for own in fields(one) if own.name != "seconds"]
        return all(same(getattr(one, name), getattr(other, name)) for name in names)
    if isinstance(one, np.ndarray):
        return one.shape == other.shape and one.tobytes() == other.tobytes()
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[k], other[k]) for k in one)
    return one == other or (one != one and other != other)


@pytest.mark.parametrize("kind", ["squares", "frames", "shifted"])
def test_parts_are_as_large_as_they_may_be(task, kind, monkeypatch):
    """Also where a row is one rollout: a part that is too small costs more than its rollouts."""
    counts, differences = [], Comparer.differences

    def counted(comparer, which, points):
        counts.append(len(which))
        return differences(comparer, which, points)

    def how(task, question):
        if question.kind != kind:
            return answers(task, question)
        with monkeypatch.context() as patch:
            patch.setattr(Comparer, "differences", counted)
            counts.append(0)
            return answers(task, question)

    monkeypatch.setattr(search, "ROLLOUTS_A_PART", 12)
    misfit = Noise(position_m=1e-6, angle_rad=1e-6, source="stated")
    run(replace(task, noise=misfit), how)
    full = [own for own, after in pairwise(counts) if own and after]  # all but the last part
    assert set(full) == {12}


CAMPAIGN = {"mode": "campaign", "optimiser": PatternSearch(), "max_evaluations": 25}


@pytest.mark.parametrize("changed", [{}, CAMPAIGN], ids=["joint", "campaign"])
def test_size_and_order_of_the_parts_change_nothing(task, changed, monkeypatch):
    own = replace(task, **changed)
    whole = run(own)
    monkeypatch.setattr(search, "ROLLOUTS_A_PART", 7)
    monkeypatch.setattr(search, "MEMBERS_A_PART", 1)
    assert same(run(own, backwards).found, whole.found)
    assert [one.how for one in whole.found][-1] == FitKind.DIRECT
    assert whole.found[-1].prediction_check == (2, 3)


def test_known_answers_give_the_same_questions_again(task):
    asked = []

    def noted(task, question):
        asked.append((question, answers(task, question)))
        return asked[-1][1]

    whole, again = run(task, noted), iter(asked)

    def replayed(task, question):
        before, known = next(again)
        assert same(tuple(question), tuple(before))
        return known

    assert same(run(task, replayed).found, whole.found)
    assert next(again, None) is None


@pytest.mark.parametrize(
    ("kind", "note"), [("frames", "no verdicts: "), ("ends", ""), ("rollouts", "lost")]
)
def test_a_lost_answer_costs_only_what_depends_on_it(task, kind, note):
    def lossy(task, question):
        lost = question.kind == kind and question.stage != "nominal"
        return ["lost"] * len(question.parts()) if lost else answers(task, question)

    (whole,), (one,) = run(task).found, run(task, lossy).found
    assert same(one.point, whole.point)
    assert note in one.note
    assert np.isfinite(one.errors).all() == (kind != "rollouts")
    assert bool(one.estimates) == (kind == "ends")
    assert one.prediction_check is None


def test_a_budget_counts_the_times_of_the_answers(task):
    """Each answer took a second: the search has half of the budget, the verdicts the rest."""
    (whole,) = run(task).found
    (short,) = run(replace(task, budget=4.0)).found
    assert whole.trace.ended != OUT_OF_BUDGET
    assert short.trace.ended == OUT_OF_BUDGET
    n = len(short.trace.errors)
    assert same(short.trace.points, whole.trace.points[:n])
    (late,) = run(replace(task, budget=2.0 * len(whole.trace.errors))).found
    assert late.trace.ended == whole.trace.ended
