"""What particles say: angles on the circle, quantiles by weight."""

import math

import numpy as np
import pytest

from fixel.filtering import particles
from fixel.simulation.geometry import gap
from fixel.testing.scenes import grasp


@pytest.mark.parametrize("near", [math.pi, -math.pi, 7.0 * math.pi])
def test_angles_on_both_sides_of_half_a_turn(near):
    pose = np.array([[0.0, 0.0, math.pi - 0.1], [2.0, 0.0, -math.pi + 0.3]])
    weight = np.array([0.5, 0.5])
    mean = particles.mean_pose(pose, weight, near)

    np.testing.assert_allclose(mean[:2], [1.0, 0.0])
    assert abs(mean[2] - near) <= math.pi
    assert math.remainder(mean[2] - (math.pi + 0.1), 2 * math.pi) == pytest.approx(0.0, abs=1e-12)
    covariance = particles.pose_covariance(pose, weight, mean)
    np.testing.assert_allclose(np.diag(covariance), [1.0, 0.0, 0.04], atol=1e-12)
    assert covariance[0, 2] == pytest.approx(0.2)


def test_quantiles_follow_the_weights():
    values = np.arange(1.0, 102.0)[:, None]
    even = particles.quantiles(values, np.full(101, 1 / 101), (0.05, 0.5, 0.95))
    np.testing.assert_allclose(even, [[5.55, 51.0, 96.45]])
    alone = np.zeros(101)
    alone[9] = 1.0
    np.testing.assert_allclose(particles.quantiles(values, alone, (0.05, 0.5, 0.95)), 10.0)


def test_gaps_are_those_of_the_shapes():
    scene = grasp("slip")
    random = np.random.default_rng(2)
    pose = scene.bodies[0].pose + random.normal(0.0, 1.0, (20, 3)) * (0.1, 0.05, 1.0)
    found = particles.FixelGaps(scene).of(pose)

    for row, one in zip(found, pose, strict=True):
        for value, fixel in zip(row, scene.fixels, strict=True):
            exact = gap(scene.bodies[0].shape, one, fixel.shape, fixel.pose).distance
            if exact < 5e-3:
                assert value == pytest.approx(exact, abs=1e-12)
            else:  # bounded, not measured
                assert 0.0 < value <= exact + 1e-12 or value >= 5e-3


def test_readings_count_by_their_reliability():
    contact = np.array([[1.0, 0.0], [0.0, 0.5]])
    score, after = particles.reading_likelihood(
        contact, np.array([1.0, 0.0]), np.array([0.0, 2.0]), 0.9, 0.8
    )

    both = 0.5 * 0.2**2 + 0.5 * 0.9**2
    np.testing.assert_allclose(np.exp(score), [0.8 * 0.9**2, 0.1 * both])
    np.testing.assert_allclose(after, [[1.0, 0.0], [0.0, 0.5 * 0.2**2 / both]])
    unread, same = particles.reading_likelihood(contact, np.zeros(2), np.zeros(2), 0.9, 0.8)
    np.testing.assert_array_equal(unread, 0.0)
    np.testing.assert_array_equal(same, contact)


def test_contact_is_certain_in_overlap_and_impossible_far_away():
    sure = particles.contact_probability(np.array([[-1e-3, 2e-3, 5e-4]]), 1e-3, np.zeros((1, 1)))
    np.testing.assert_allclose(sure, [[1.0, 0.0, 0.5]], atol=1e-2)
    vague = particles.contact_probability(np.array([[0.0, 2e-3]]), 1e-3, np.full((1, 1), 2e-3))
    assert ((vague > 0.1) & (vague < 0.9)).all()


def test_unclear_contacts_last():
    found = particles.lasting(np.array([[0.5, 0.0]]), np.array([[1.0, 1.0]]), np.array([[0.8]]))
    np.testing.assert_allclose(found, [[0.9, 0.0]])
