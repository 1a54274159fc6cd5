# ASME 2006, table 1: the two parameter sets p1* and p2* found for one part, from the same
# experiments. Coordinates in um, after correcting the printed scale by a factor of ten (both
# triangles then lie within the part of 842 x 1621 um and hold its centre of mass); mass at the
# centre, so loads are barycentric coordinates. Radii are rounded to 1 um.
"""What the two support triangles of table 1 have in common."""

import numpy as np
from reproductions.support_features import support_features

from fixel.calibration.result import find_solutions
from fixel.model.support import triangle_shares

POINTS = 1e-6 * np.array([
    [(411.3, -563.3), (-409.1, 605.9), (-273.2, -102.1)],
    [(-412.4, 794.0), (-217.8, 774.5), (278.8, -538.8)],
])  # fmt: skip
FRICTION = np.array([[0.666, 0.757], [0.536, 0.013]])  # pusher, surface
HALF = 1e-6 * np.array([421.0, 810.5])


def test_loads():
    share = triangle_shares(POINTS)
    np.testing.assert_allclose(share[0], [0.491, 0.464, 0.044], atol=5e-4)
    np.testing.assert_allclose(share[1], [0.401, 0.003, 0.596], atol=5e-4)


def test_both_triangles_lie_within_the_part():
    assert (np.abs(POINTS) < HALF).all()


def test_mean_and_principal_radii():
    values = support_features(POINTS, triangle_shares(POINTS))
    np.testing.assert_allclose(values.mean_radius * 1e6, [695, 723], atol=0.5)
    np.testing.assert_allclose(values.radii * 1e6, [[698, 61], [736, 10]], atol=0.6)
    np.testing.assert_allclose(values.centre, 0.0, atol=1e-12)


def test_the_two_sets_differ_in_points_and_agree_in_what_a_push_feels():
    values = support_features(POINTS, triangle_shares(POINTS))
    # Of the part's half-length: points differ by the whole of it, radii and axes hardly.
    assert np.abs(POINTS[0] - POINTS[1]).max() > HALF[1]
    assert np.ptp(values.mean_radius) < 0.05 * HALF[1]
    assert np.ptp(values.angle) < np.radians(10.0)
    # Even pressure over the part would give a mean radius of 485 um; these are not that.
    x, y = np.meshgrid(*(np.linspace(-half, half, 401) for half in HALF))
    assert abs(np.hypot(x, y).mean() * 1e6 - 485.0) < 3.0
    # As parameter sets they are two solutions.
    sets = np.concatenate((FRICTION, 1e3 * POINTS.reshape(2, 6)), axis=1)
    assert len(find_solutions(sets, [1.0, 1.0], np.full(8, 0.1), 0.5)) == 2
