"""Which poses are believed, and which part of a motion counts."""

import numpy as np
import pytest

from fixel.vision.tracking import judge
from fixel.vision.tracking.base import PartObservation, motion_of
from fixel.vision.tracking.judge import judged

TIME = np.arange(120) / 30.0


def sightings(pose):
    return [
        PartObservation(
            pose=row, residual=0.05, scale=0.55e-3, sd=np.full(3, 1e-5), marks=1, share=1.0
        )
        for row in pose
    ]


def path():
    """A push that starts at once, as far as the camera can tell."""
    x = np.where(TIME < 1.0, 0.0, 0.0135 * (TIME - 1.0))
    noise = 5e-6 * np.random.default_rng(1).standard_normal((len(TIME), 3))
    return np.column_stack((x, 0.1 * x, x)) + noise


def test_a_sudden_start_is_no_outlier():
    assert judged("object", TIME, sightings(path())).good.all()


@pytest.mark.parametrize("rate", [15.0, 30.0])
def test_what_is_hit_or_turns_back_is_no_outlier(rate):
    """120 mm/s and 2 rad/s at once, where it rested, and back the same way."""
    time = np.arange(60) / rate
    there, back = time[4] + 0.3 / rate, time[40] + 0.6 / rate
    run = np.clip(time - there, 0.0, back - there) - np.maximum(time - back, 0.0)
    pose = run[:, None] * [0.12, 0.0, 2.0]
    pose += 5e-6 * np.random.default_rng(1).standard_normal((60, 3))
    assert judged("object", time, sightings(pose)).good.all()


@pytest.mark.parametrize("wrong", [
    {50: (1.2e-3, 0.0, 0.0), 80: (0.0, 0.0, 0.05)},
    # The shortest way back from there is once around; what follows is not turned.
    {50: (0.0, 0.0, 2.2), 51: (0.0, 0.0, 4.2)},
    dict.fromkeys(range(60, 72), (3e-3, -2e-3, 0.1)),
], ids=["single", "angles", "a run"])  # fmt: skip
def test_wrong_poses_are_found(wrong):
    pose = path()
    for frame, by in wrong.items():
        pose[frame] += by
    part = judged("object", TIME, sightings(pose))
    assert np.flatnonzero(~part.good).tolist() == list(wrong)
    assert part.n_outliers == len(wrong)
    assert "outlier" in part.reason[min(wrong)]
    assert part.pose[part.good] == pytest.approx(pose[part.good])


def test_the_steady_part_of_a_motion():
    speed = np.interp(TIME, [0.0, 0.5, 0.8, 3.2, 3.4, 4.0], [0.0, 0.0, 0.0135, 0.0135, 0.0, 0.0])
    place = np.cumsum(speed)[:, None] / 30.0 * [[0.8, 0.6]]
    motion = motion_of(TIME, place, 1e-5)
    assert motion.moved
    assert motion.cruise == pytest.approx(0.0135, rel=0.01)
    assert motion.direction == pytest.approx([0.8, 0.6], abs=1e-6)
    assert 0.7 < motion.start < 1.1
    assert 2.9 < motion.end < 3.3


def test_an_actuator_that_goes_home_has_moved():
    """The useful part ends before it goes back, and there is only one."""
    along = np.interp(TIME, [0.0, 0.5, 2.5, 3.0, 3.8], [0.0, 0.0, 0.027, 0.027, 0.0])
    noise = 1e-5 * np.random.default_rng(1).standard_normal((len(TIME), 2))
    motion = motion_of(TIME, along[:, None] * [[0.8, 0.6]] + noise, 1e-5)
    assert motion.moved
    assert motion.travel == pytest.approx(0.027, abs=5e-5)
    assert motion.cruise == pytest.approx(0.0135, rel=0.01)
    assert motion.direction == pytest.approx([0.8, 0.6], abs=2e-3)
    assert 2.1 < motion.end < 2.5
    assert motion.back is None


def test_an_actuator_that_pushes_twice_is_noticed():
    along = np.interp(TIME, [0.5, 1.5, 2.0, 2.5, 3.5], [0.0, 0.0135, 0.0, 0.0, 0.0135])
    motion = motion_of(TIME, along[:, None] * [[0.8, 0.6]], 1e-5)
    assert motion.back == pytest.approx((1.5, 2.0), abs=0.2)
    assert motion.end > 3.0


def test_what_stands_does_not_move():
    still = 1e-5 * np.random.default_rng(1).standard_normal((len(TIME), 2))
    assert not motion_of(TIME, still, 1e-5).moved


# --- uneven time stamps -----------------------------------------------------------------------


def quarter_circle(time):
    """An object on an arc of 60 mm with 30 mm/s, and turning; it rests before and after."""
    turn = np.clip((time - 0.5) * 0.5, 0.0, 1.5)
    return np.column_stack((0.06 * np.sin(turn), 0.06 * (1.0 - np.cos(turn)), turn))


def arrivals(taken, mean, share, seed):
    """Stamps of frames that are held up by an exponential time and arrive in order."""
    rng = np.random.default_rng(seed)
    held = rng.exponential(mean, len(taken)) * (rng.random(len(taken)) < share)
    return np.maximum.accumulate(taken + held) + 1e-6 * np.arange(len(taken))


@pytest.mark.parametrize("share", [1.0, 0.3])
@pytest.mark.parametrize("mean", [0.005, 0.015, 0.03])
def test_no_pose_is_lost_to_uneven_time_stamps(mean, share):
    pose = quarter_circle(TIME) + 5e-6 * np.random.default_rng(1).standard_normal((120, 3))
    for seed in range(4):
        stamps = arrivals(TIME, mean, share, seed)
        assert judged("object", stamps, sightings(pose)).good.all()


@pytest.mark.parametrize("mean", [0.005, 0.03])
def test_wrong_poses_are_found_whatever_the_time_stamps(mean):
    pose = quarter_circle(TIME) + 5e-6 * np.random.default_rng(1).standard_normal((120, 3))
    pose[30, :2] += (2e-3, -2e-3)
    pose[60, 2] += 0.2
    pose[85:91] += (-3e-3, 4e-3, 0.15)  # a run of them
    wrong = [30, 60, *range(85, 91)]
    for seed in range(4):
        part = judged("object", arrivals(TIME, mean, 1.0, seed), sightings(pose))
        assert np.flatnonzero(~part.good).tolist() == wrong


def test_frames_that_are_left_out_are_no_reason_either():
    """A camera that leaves frames out, with right stamps: there is no even rate to count by."""
    kept = np.random.default_rng(3).random(len(TIME)) > 0.25
    time = TIME[kept]
    assert judged("object", time, sightings(quarter_circle(time))).good.all()


def test_scatter_of_time_stamps():
    assert not judge.stamp_scatter(TIME).any()
    assert not judge.stamp_scatter(np.round(TIME, 3)).any()  # as Matroska keeps them
    rng = np.random.default_rng(0)
    stamps = np.sort(TIME + rng.normal(0.0, 0.006, len(TIME)))
    assert np.median(judge.stamp_scatter(stamps)) == pytest.approx(0.006, rel=0.3)
    assert np.median(judge.clock_scatter(stamps)) == pytest.approx(0.006, rel=0.3)


@pytest.mark.parametrize("lost", [0.1, 0.3])
def test_lost_frames_of_an_even_clock_do_not_make_it_uneven(lost):
    kept = np.random.default_rng(1).random(3000) > lost
    time = np.round(np.arange(3000)[kept] / 30.0, 3)
    assert np.median(judge.stamp_scatter(time)) > 3e-3  # by the number of each frame
    assert not judge.clock_scatter(time).any()
