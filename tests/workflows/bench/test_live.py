"""Calibration while a campaign runs, also after a pause."""

import pytest

from fixel.model import PlannedExperiment
from fixel.testing.pushes import example_pushes
from fixel.workflows.bench.estimates import estimate_rows

SPACE = {"mu_pusher": (0.0, 1.0), "tripod_radius": 0.038}
PUSHES = example_pushes(5)
LEFT = [PlannedExperiment(name=own.name, scene=own.scene) for own in PUSHES[3:]]


def estimated(pushes=PUSHES[:3], **options):
    usual = {"until": "", "left": LEFT, "choosing": False, "previous": None}
    return estimate_rows(pushes, SPACE, "dynamic", **{**usual, **options})


def test_the_table_states_intervals_now_and_after_the_rows_that_are_left():
    found = estimated(until="mu_pusher=0.3")
    label, value, now, later, wanted, _ = found.table.rows[0]
    assert label == "mu_pusher"
    assert abs(float(value) - 0.25) < 0.02
    assert float(later) <= float(now)
    assert float(wanted) == pytest.approx(0.3)
    assert "after 2 more" in found.table.columns[3].head


def test_a_campaign_that_goes_on_after_a_pause_can_end_at_once():
    assert estimated(until="mu_pusher=0.3").finish
    assert not estimated(until="mu_pusher=0.000001").finish
    assert not estimated().finish


def test_a_row_is_chosen_among_those_that_are_left():
    found = estimated(choosing=True, until="mu_pusher=0.000001")
    assert found.chosen in [row.name for row in LEFT] or found.finish
    assert estimated().chosen == ""


def test_the_last_row_leaves_nothing_ahead():
    heads = [column.head for column in estimated(left=[]).table.columns]
    assert heads == ["parameter", "value", "+/-", "wanted", "verdict"]
