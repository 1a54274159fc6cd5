"""Features of supports that affect a push."""

import math

import numpy as np
import pytest
from reproductions.support_features import support_features
from tests.fixtures import refused


def test_features_of_two_points_and_of_a_ring():
    two = np.array([[[0.03, 0.0], [-0.03, 0.0]]])
    values = support_features(two + np.array([0.1, 0.2]), [[1.0, 1.0]], (0.1, 0.2))
    assert values.mean_radius[0] == pytest.approx(0.03)
    np.testing.assert_allclose(values.radii[0], [0.03, 0.0], atol=1e-12)
    assert values.angle[0] == pytest.approx(0.0, abs=1e-12)
    a = np.linspace(0.0, 2.0 * math.pi, 12, endpoint=False)
    ring = np.stack((np.cos(a), np.sin(a)), axis=1)[None]
    values = support_features(ring, np.full((1, 12), 5.0))
    np.testing.assert_allclose(values.radii[0], math.sqrt(0.5), rtol=1e-12)
    assert values.mean_radius[0] == pytest.approx(1.0)
    np.testing.assert_allclose(values.share, 1.0 / 12.0)


@pytest.mark.parametrize("angle", [-1.5, -0.4, 0.0, 0.9, 1.57])
def test_features_turn_with_the_support(angle):
    c, s = math.cos(angle), math.sin(angle)
    points = np.array([[0.03, 0.0], [-0.02, 0.004], [-0.02, -0.004]]) @ [[c, s], [-s, c]]
    values = support_features(points[None], [[1.0, 0.7, 0.7]])
    assert math.remainder(values.angle[0] - angle, math.pi) == pytest.approx(0.0, abs=1e-9)
    assert -math.pi / 2 < values.angle[0] <= math.pi / 2


def test_centre_of_load_apart_from_the_mass():
    values = support_features([[[0.0, 0.0], [0.04, 0.0]]], [[1.0, 3.0]])
    np.testing.assert_allclose(values.centre[0], [0.03, 0.0])


def test_refusals():
    refused(support_features, np.zeros((1, 3, 2)), np.ones((1, 2)), match="support")
    refused(support_features, np.zeros((1, 2, 2)), [[1.0, -1.0]], match="loads")
