"""Fans of outcomes: what they hold, and what is said about them."""

import math

import numpy as np
import pytest
from tests.fixtures import refused
from tests.uncertainty.forks import fork

from fixel import InvalidInput, Parameters, QuasiStatic, StartError, simulate
from fixel.testing.scenes import grasp, micro_push, sliding_block
from fixel.uncertainty.error_terms import ASME
from fixel.uncertainty.outcomes import group_outcomes, sensitivity_of
from fixel.uncertainty.start_ensemble import simulate_starts

SMALL = StartError(x=3e-4, y=3e-4, theta=math.radians(0.5), kind="uniform")


def test_a_rollout_of_a_fan_is_the_simulation_from_there():
    scene = micro_push(3)
    ensemble = simulate_starts(scene, ASME, 64, seed=5)
    k = int(np.argmax(ensemble.drawn[:, 0] > 1e-6))
    offset = ensemble.start[k] - scene.bodies[0].pose
    values = Parameters(start_x=offset[0], start_y=offset[1], start_theta=offset[2])
    again = simulate(scene, values, motion=QuasiStatic())
    np.testing.assert_allclose(ensemble.pose[k, -1], again.pose["part"][-1], atol=1e-7)


def test_no_bit_depends_on_threads_or_on_how_many_there_are():
    one = simulate_starts(micro_push(2), ASME, 60, threads=1)
    two = simulate_starts(micro_push(2), ASME, 100, threads=2)
    np.testing.assert_array_equal(one.pose, two.pose[:60])


def test_starts_inside_the_probe_are_moved_next_to_it():
    ensemble = simulate_starts(micro_push(1), ASME, 100)
    assert ensemble.moved_apart == pytest.approx(0.5, abs=0.06)
    assert ensemble.ended.all()
    off = ensemble.start - micro_push(1).bodies[0].pose
    # Out of the tilted side: a hundredth of the way is along it.
    np.testing.assert_allclose(off[:, 1], ensemble.drawn[:, 1], atol=0.02 * 5e-6)
    np.testing.assert_array_equal(off[:, 2], ensemble.drawn[:, 2])
    assert (off[:, 0] - ensemble.drawn[:, 0] > -1e-15).all()


def test_no_room_is_no_outcome_with_a_reason():
    # The fixel stands right behind the puck, which the plate touches.
    scene = fork()
    far = np.array([[0.0, 0.0, 0.0], [0.034, 0.0, 0.0]])
    ensemble = simulate_starts(
        scene, StartError(x=1e-4, y=1e-4, kind="uniform"), drawn=far, motion=QuasiStatic()
    )
    assert ensemble.ended.tolist() == [True, False]
    assert "fixel-1" in ensemble.reasons[1] or "no free space" in ensemble.reasons[1]


def test_a_free_slide_keeps_its_error():
    found = sensitivity_of(simulate_starts(sliding_block(), SMALL, 200, motion=None, times=[0.01]))
    assert found.amplification == pytest.approx(1.0, abs=1e-2)
    assert found.gain == pytest.approx(1.0, abs=1e-2)
    assert found.flag == "insensitive"


def test_a_fork_is_flagged_with_its_shares():
    found = sensitivity_of(simulate_starts(fork(), SMALL, 300, motion=QuasiStatic()))
    assert found.flag == "bifurcates"
    assert len(found.share) == 2
    assert found.share[0] == pytest.approx(0.5, abs=0.02)
    assert found.apart > 0.02
    assert found.summary()["flag"] == "bifurcates"


def test_a_fork_off_the_middle_parts_unevenly():
    found = sensitivity_of(simulate_starts(fork(1.5e-4), SMALL, 300, motion=QuasiStatic()))
    assert found.bifurcates
    assert found.share[0] == pytest.approx(0.75, abs=0.02)


def test_a_fork_far_off_the_middle_does_not_part():
    assert not sensitivity_of(
        simulate_starts(fork(1e-3), SMALL, 200, motion=QuasiStatic())
    ).bifurcates


def test_contact_modes_are_counted():
    found = sensitivity_of(simulate_starts(grasp("slip"), SMALL, 60))
    assert sum(found.modes.values()) == pytest.approx(1.0)
    assert all(len(mode) == 3 for mode in found.modes)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("kind", ["normal", "uniform", "skewed", "ring"])
def test_clouds_without_a_gap_stay_whole(kind, seed):
    draw = np.random.default_rng(seed)
    cloud = draw.standard_normal((500, 3))
    if kind == "uniform":
        cloud = draw.uniform(size=(500, 3))
    if kind == "skewed":
        cloud = np.exp(cloud)
    if kind == "ring":
        turn = draw.uniform(0.0, 2.0 * math.pi, 500)
        cloud = np.column_stack((np.cos(turn), np.sin(turn), 0.1 * cloud[:, 0]))
    assert group_outcomes(cloud, floor=1e-3).max() == 0


def test_groups_are_found_and_the_largest_comes_first():
    draw = np.random.default_rng(1)
    means = np.repeat([[0, 0, 0], [9, 0, 0], [0, 9, 0]], (300, 150, 50), axis=0)
    cloud = means + 0.5 * draw.standard_normal((500, 3))
    label = group_outcomes(cloud, floor=0.5)
    np.testing.assert_array_equal(np.bincount(label), [300, 150, 50])
    assert group_outcomes(cloud, floor=20.0).max() == 0


def test_few_starts_and_foreign_scenes_are_refused():
    refused(sensitivity_of, simulate_starts(micro_push(1), ASME, 20), match="at least 50")
    with pytest.raises(InvalidInput, match="one per start"):
        simulate_starts(micro_push(1), ASME, 20, values={"mu_pusher": np.ones(3)})
