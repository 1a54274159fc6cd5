"""Experiments that were done again, at the same instants."""

import math

import numpy as np

from fixel.calibration.target import Target, repetitions, same_configuration
from fixel.simulation.rollouts import RolloutCase

TIMES = np.arange(1, 31) / 30.0


def _moving(number, kept, at="here", shift=0.0):
    """A body that slides at 30 mm/s and turns through half a turn, seen in some frames."""
    times = TIMES[kept]
    angle = (3.0 + times + math.pi) % (2.0 * math.pi) - math.pi
    pose = np.column_stack((0.03 * times + shift, np.zeros(len(times)), angle))
    conditions = {"at": at, "repetition": float(number), "experiment": f"lab/{at}-{number}"}
    return Target(f"lab/{at}-{number}", conditions, RolloutCase(None, times), pose)


def test_frames_that_were_lost_do_not_shift_the_others():
    kept = np.ones(30, bool)
    lost = kept.copy()
    lost[[4, 5, 17, 29]] = False
    (rows,) = repetitions([_moving(1, kept), _moving(2, lost)])
    assert rows.shape == (2, 29, 3)  # until the first of them ends
    np.testing.assert_allclose(rows[0], rows[1], atol=1e-12)


def test_only_repetitions_of_one_configuration_are_together():
    kept = np.ones(30, bool)
    twice = [_moving(1, kept), _moving(2, kept, shift=1e-3)]
    (rows,) = repetitions([*twice, _moving(1, kept, at="there")])
    np.testing.assert_allclose(rows[1, :, 0] - rows[0, :, 0], 1e-3, rtol=1e-9)
    assert same_configuration(twice[0]) == same_configuration(twice[1])
    counted_none = twice[0]._replace(conditions={"at": "here"})
    assert same_configuration(counted_none) == counted_none.key


def test_last_poses_may_be_all_there_is():
    (rows,) = repetitions([_moving(1, [29]), _moving(2, [28])], ends=True)
    assert rows.shape == (2, 1, 3)
    assert repetitions([_moving(1, [0]), _moving(2, [29])]) == []
