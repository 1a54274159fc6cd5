"""The table of experiments, and marks of many in one act, on both engines."""

from dataclasses import replace

import numpy as np
import pytest
from tests.database.records import simulation
from tests.fixtures import bare_experiment, calibration_record, refused

from fixel.errors import NotStored
from fixel.model import Flag, Trajectory
from fixel.model.selection import Bound, ExperimentQuery
from fixel.workflows.project.filters import coverage, view_of, vocabulary


def experiment(k, **conditions):
    track = Trajectory(time=[0.0, 1.0 + k], pose=[[0.0, 0.0, 0.0], [0.001 * k, 0.0, 0.1 * k]])
    return bare_experiment(f"{k:02d}", dataset="push", trajectory=track, conditions=conditions)


@pytest.fixture
def pushes(store):
    """Five of them: the third flagged, one condition now a number and now a text."""
    surfaces = ("abs", "plywood", "abs", 3.0, "plywood")
    for k, surface in enumerate(surfaces, 1):
        store.add_experiment(experiment(k, surface=surface, speed_m_s=0.01 * k))
    store.flag([3], Flag("late", "by 0.2 s"))
    for parameters, error in (({}, 9.0), ({}, 4.0), ({"mu_support": 0.3}, 1.0)):
        store.add_simulation(simulation(1, error, parameters))
    for error in (2.0, 0.25):
        store.add_calibration(calibration_record({1: error, 2: 16.0}, {"mu_support": 0.3}))
    return store


def test_errors_are_the_newest(pushes):
    first, second, third = pushes.experiments(view_of(limit=3), details=True).details
    assert (first.before_mm2, first.after_mm2) == (4.0, 0.25)
    assert (second.before_mm2, second.after_mm2) == (None, 16.0)
    assert (third.before_mm2, third.after_mm2) == (None, None)
    assert pushes.experiment_ids(view_of("error>=4")) == [2]
    assert pushes.experiment_ids(view_of("before<2.1")) == [1]
    found = pushes.tally(view_of("error>0"), ("id", "after_mm"))
    assert sorted(found) == [(1, 0.5, 1), (2, 4.0, 1)]


def test_a_condition_may_be_a_text_here_and_a_number_there(pushes):
    assert pushes.experiment_ids(view_of("surface=abs")) == [1, 3]
    assert pushes.experiment_ids(view_of("surface!=abs")) == [2, 4, 5]
    assert pushes.experiment_ids(view_of("surface>2")) == [4]
    assert pushes.experiment_ids(view_of(sort="surface")) == [4, 1, 3, 2, 5]
    assert pushes.experiment_ids(view_of(sort="speed_m_s", descending=True)) == [5, 4, 3, 2, 1]
    assert pushes.experiment_ids(view_of(sort="unknown_column")) == [1, 2, 3, 4, 5]
    assert pushes.experiment_ids(view_of("speed_m_s>=0.02 speed_m_s<0.04")) == [2, 3]


def test_words_stand_anywhere_in_either_case(pushes):
    assert pushes.experiment_ids(view_of("PLYWOOD")) == [2, 5]
    assert pushes.experiment_ids(view_of("push/03")) == [3]
    assert pushes.experiment_ids(view_of('"by 0.2"')) == [3]
    assert pushes.experiment_ids(view_of("_")) == [1, 2, 3, 4, 5]  # of speed_m_s
    assert pushes.experiment_ids(view_of("%")) == []
    assert pushes.experiment_ids(view_of("'; drop table flag; --")) == []


def test_pages_and_counts(pushes):
    page = pushes.experiments(
        view_of(limit=2, offset=2, sort="moved_m", descending=True), details=True
    )
    assert ([row.id for row in page.rows], page.total, page.faulty) == ([3, 2], 5, 1)
    assert page.details[0].flags == [Flag("late", "by 0.2 s", True)]
    assert pushes.experiments(view_of("is:clean", limit=1)).total == 4
    # A correction takes the place of what it corrects.
    again = pushes.add_experiment(experiment(2, surface="abs")).id
    assert pushes.experiment_ids(view_of("push/02")) == [again]
    assert pushes.experiment_ids(view_of("push/02 is:replaced")) == [2, again]


def test_marks_tell_what_changed(pushes):
    assert pushes.flag([2, 3, 3], Flag("late")) == [2]
    assert pushes.unflag([1, 2, 3], "late") == [2, 3]
    assert pushes.delete([1, 2]) == [1, 2]
    assert pushes.delete([2, 3]) == [3]
    assert pushes.experiment_ids(view_of("is:deleted")) == [1, 2, 3]
    assert pushes.delete([1, 2, 3, 4], back=True) == [1, 2, 3]
    made = pushes.annotate([4, 1], "slipped")
    assert [note.text for note in pushes.notes(4)] == ["slipped"]
    assert pushes.experiment_ids(view_of("is:noted slip")) == [1, 4]
    assert pushes.delete_notes(made) == made
    assert pushes.notes(4) == []
    assert pushes.delete_notes(made, back=True) == made


def test_an_act_is_done_whole_or_not_at_all(pushes):
    for act in (
        lambda: pushes.flag([1, 99], Flag("odd")),
        lambda: pushes.delete([1, 99]),
        lambda: pushes.annotate([1, 99], "text"),
    ):
        with pytest.raises(NotStored, match="experiment 99"):
            act()
    assert pushes.experiment_ids(view_of("is:flagged")) == [3]
    assert pushes.experiment_ids(view_of("is:deleted")) == []
    assert pushes.notes(1) == []
    refused(pushes.annotate, [1], "  ", match="characters")


def test_what_there_is_to_filter_by(pushes):
    found = vocabulary(pushes)
    assert found.conditions["surface"].texts == {"abs": 2, "plywood": 2}
    assert found.conditions["surface"].total == 5
    assert (found.conditions["speed_m_s"].low, found.conditions["speed_m_s"].high) == (0.01, 0.05)
    assert coverage(pushes, view_of(), "speed_m_s", "end_x_m").number == np.eye(5).tolist()


def test_coverage_counts_what_is_at_the_same_place(pushes):
    for k, (shape, layout) in enumerate([("square", "a"), ("square", "a"), (3.0, "b")]):
        pushes.add_experiment(experiment(10 + k, shape=shape, layout=layout, speed_m_s=0.05))
    seen = coverage(pushes, view_of(), "speed_m_s", "speed_m_s")
    assert np.diagonal(seen.number).tolist() == [1, 1, 1, 1, 4]
    assert (seen.shapes, seen.layouts) == (["3", "square"], ["a", "b"])
    assert seen.table == [[0, 1], [2, 0]]
    # Where it is a text, it is at no place.
    assert coverage(pushes, view_of(), "surface", "speed_m_s").without == 7
    assert ("abs", 1) in pushes.tally(view_of("is:clean"), ("surface",))


def test_names_that_no_condition_has_are_refused(pushes):
    for name in ('a"b', "$", "a'b", "", "x" * 101, "\n"):
        for query in (
            ExperimentQuery(sort=name),
            ExperimentQuery(bounds=(Bound(name, "=", "x"),)),
        ):
            refused(pushes.experiments, query, match="column")


def test_a_small_turn_across_half_a_turn_is_small(store):
    """170 to -163.5 degrees are 26.5 by the short way, not -333.5; longer records go on."""
    angles = np.radians([[170.0, -163.5], [-170.0, 163.5], [10.0, 20.0]])
    for k, (start, end) in enumerate(angles):
        ends = Trajectory(time=[0.0, 1.0], pose=[[0.0, 0.0, start], [0.1, 0.0, end]])
        store.add_experiment(replace(experiment(k), trajectory=ends))
    turn = np.radians(np.linspace(0.0, 400.0, 50))
    whole = Trajectory(time=np.arange(50.0), pose=np.c_[0.0 * turn, 0.0 * turn, turn])
    store.add_experiment(replace(experiment(9), trajectory=whole))
    assert store.experiment_ids(view_of("turned>20 turned<30")) == [1]
    assert store.experiment_ids(view_of("turned<-20")) == [2]
    assert store.experiment_ids(view_of("turned>390")) == [4]
    assert store.experiment_ids(view_of(sort="turned")) == [2, 3, 1, 4]
    turned = [row.turned_rad for row in store.experiments(view_of()).rows]
    assert np.degrees(turned) == pytest.approx([26.5, -26.5, 10.0, 400.0])
