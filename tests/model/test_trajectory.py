"""Trajectories: interpolation with wrapped angles, errors between two."""

from math import pi

import numpy as np
import pytest
from hypothesis import given, strategies as st
from tests.fixtures import refused

from fixel.model import Trajectory, pose_error, wrapped


def test_interpolation_takes_angles_the_short_way():
    made = Trajectory(time=[0, 1], pose=[[0, 0, 3.0], [2, 4, -3.0]])
    assert made.at(0.5)[:2] == pytest.approx([1, 2])
    assert made.at(0.5)[2] == pytest.approx(pi)
    assert made.at([-1, 5])[:, 0] == pytest.approx([0, 2])


def test_resampling_and_rms():
    made = Trajectory(time=[0, 1, 2], pose=[[0, 0, 0], [1, 0, 0], [2, 0, 0]])
    finer = made.resampled(np.linspace(0, 2, 9))
    assert finer.pose[:, 0] == pytest.approx(finer.time)
    assert made.position_rms(finer) == pytest.approx(0)
    moved = Trajectory(time=made.time, pose=made.pose + np.array([3, 4, 1]))
    assert made.position_rms(moved) == pytest.approx(5)


def test_the_error_of_poses_wraps():
    position, angle = pose_error([[3, 4, 3.0]], [[0, 0, -3.0]])
    assert position == pytest.approx([5])
    assert angle == pytest.approx([6 - 2 * pi])


@given(st.floats(-1e3, 1e3))
def test_wrapped_angles_differ_by_whole_turns(angle):
    turned = float(wrapped(angle))
    assert -pi <= turned < pi
    turns = (angle - turned) / (2 * pi)
    assert turns == pytest.approx(round(turns), abs=1e-9)
    assert float(wrapped(turned)) == turned


def test_what_is_no_angle_stays_none():
    assert np.isnan(wrapped(np.array([np.nan, 0.1]))).tolist() == [True, False]


@pytest.mark.parametrize(("time", "pose", "where"), [
    ([0, 0], [[0, 0, 0]] * 2, "trajectory.time"),
    ([1, 0], [[0, 0, 0]] * 2, "trajectory.time"),
    ([0, float("nan")], [[0, 0, 0]] * 2, "trajectory.time"),
    ([0], [[0, 0, 0]] * 2, "trajectory.time"),
    ([0, 1], [[0, 0, 0], [0, 0, float("nan")]], "trajectory.pose[1]"),
    ([], [], "trajectory.pose"),
])  # fmt: skip
def test_a_trajectory_that_cannot_be_is_refused(time, pose, where):
    assert refused(Trajectory, time=time, pose=pose).where == where
