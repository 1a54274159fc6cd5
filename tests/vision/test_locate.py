"""Parts found in single pictures."""

import numpy as np
import pytest

from fixel.vision.locate import TagLocator, fitted_pose
from tests.vision.plate import plate_picture, small_rig

RIG = small_rig()


@pytest.mark.parametrize("pose", [(0.1, 0.0, 0.4), (0.2, -0.05, -2.8)])
def test_poses_are_found_to_a_twentieth_of_a_pixel(pose):
    """At 1.1 mm a pixel; the tag is 36 px wide, so 0.05 px over half of it is 0.16 degrees."""
    found = TagLocator(RIG)(plate_picture(RIG, {"object": pose, "actuator": (0.0, 0.0, 0.0)}))
    assert set(found.parts) == {"object", "actuator"}
    off = found.parts["object"] - pose
    assert np.hypot(*off[:2]) < 0.055e-3
    assert abs(off[2]) < 0.0033
    assert set(found.plate) == {20, 21, 22, 23}
    assert max(np.hypot(*way) for way in found.plate.values()) < 0.1e-3


def test_what_is_not_there_is_not_found():
    found = TagLocator(RIG)(plate_picture(RIG, {"actuator": (0.0, 0.0, 0.0)}))
    assert set(found.parts) == {"actuator"}


def test_a_gray_picture_will_do():
    picture = plate_picture(RIG, {"object": (0.1, 0.0, 0.4)})
    gray = np.ascontiguousarray(picture[..., 0])
    assert set(TagLocator(RIG)(gray).parts) == {"object"}


def test_the_fit_is_the_motion_itself():
    rng = np.random.default_rng(3)
    points = rng.normal(size=(7, 2))
    c, s = np.cos(2.1), np.sin(2.1)
    there = points @ np.array([[c, s], [-s, c]]) + [0.3, -0.2]
    np.testing.assert_allclose(fitted_pose(points, there), [0.3, -0.2, 2.1], atol=1e-12)
