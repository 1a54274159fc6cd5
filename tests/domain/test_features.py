"""What configurations say before they are tried, where the answer is known by hand."""

import numpy as np
from reproductions.residuals import configuration_features

from fixel.calibration.known_pushes import Configurations
from fixel.domain import features
from fixel.model import Disk, Polygon

SQUARE = Polygon(0.03 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]))
RADIUS = 0.005
K = 10


def two_pushes():
    """Into the left side, 10 mm above the middle: straight, and on a plate turned by a quarter."""
    start = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.5 * np.pi]])
    tip = np.array([[-0.035, 0.01], [0.09, -0.035]])
    way = np.array([[0.05, 0.0], [0.0, 0.05]])
    return Configurations(SQUARE, RADIUS, start, tip, tip + way)


def test_the_same_push_on_a_turned_plate_has_the_same_place():
    found = configuration_features(two_pushes())
    names = ("tip_x", "tip_y", "along_x", "along_y", "incidence", "arm", "corner")
    both = found.columns(names)
    np.testing.assert_allclose(both[0], both[1], atol=1e-12)
    np.testing.assert_allclose(
        both[0], [-0.035, 0.01, 1.0, 0.0, 0.0, -0.01, np.hypot(0.005, 0.02) - RADIUS], atol=1e-12
    )


def carried(which, values):
    """The plate goes with the pusher; friction at the pusher adds an angle, one push fails."""
    asked = two_pushes()
    share = np.arange(1, K + 1)[None, :, None] / K
    way = (asked.tip_end - asked.tip_start)[which]
    pose = np.repeat(asked.start[which][:, None], K, axis=1)
    pose[:, :, :2] += share * way[:, None]
    for axis, name in enumerate(("start_x", "start_y")):
        if name in values:
            pose[:, :, axis] += values[name][:, None]
    if "mu_pusher" in values:
        pose[:, :, 2] += 0.1 * values["mu_pusher"][:, None]
    good = np.ones(len(which), bool)
    if "friction_centre_x" in values:
        good = ~((which == 1) & (values["friction_centre_x"] > 0.0))
    return pose, good


def test_motion_contact_and_sensitivity_of_rollouts():
    found = features.simulated_features(two_pushes(), carried, 0.2)
    names = ("distance", "turned", "slid", "stuck", "parted", "sensitive_sideways", "lost")
    table = found.columns(names)
    np.testing.assert_allclose(table[:, 0], 0.05)
    np.testing.assert_allclose(table[:, 1:3], 0.0, atol=1e-12)
    np.testing.assert_allclose(table[:, 3], 1.0)
    np.testing.assert_allclose(table[:, 4], 0.0)
    np.testing.assert_allclose(table[:, 5], features.SIDEWAYS)
    np.testing.assert_allclose(table[:, 6], [0.0, 0.1])
    # Half of the difference of the two angles, at 35 mm.
    expected = 0.5 * 0.035 * 0.1 * 0.2 * (features.FRICTION - 1.0 / features.FRICTION)
    np.testing.assert_allclose(found.columns(("sensitive_friction",))[:, 0], expected)
    assert np.isfinite(found.table).all()


def test_corners_of_polygons_and_of_round_things():
    points = np.array([[0.03, 0.04], [0.0, 0.035]])
    np.testing.assert_allclose(
        features.corner_distance(SQUARE, points, RADIUS), [0.005, np.hypot(0.03, 0.005) - RADIUS]
    )
    assert (features.corner_distance(Disk(0.03), points, RADIUS) > 0.1).all()
    turn = np.linspace(0.0, 2.0 * np.pi, 65)[:-1]
    smooth = Polygon(0.03 * np.column_stack((np.cos(turn), np.sin(turn))))
    assert (features.corner_distance(smooth, points, RADIUS) > 0.1).all()
