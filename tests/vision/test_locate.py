"""Parts and fixels found in a live picture."""

import numpy as np
import pytest
from tests.vision.plate import plate_picture, small_rig
from tests.workflows.acquisition.test_overlay import AT_HOME, SCENE

from fixel.vision.frame import Frame
from fixel.vision.tracking.follow import NOW_AND_THEN, Locator

RIG = small_rig()


@pytest.mark.parametrize("pose", [(0.1, 0.0, 0.4), (0.2, -0.05, -2.8)])
def test_poses_are_found_to_a_twentieth_of_a_pixel(pose):
    """At 1.1 mm a pixel; the tag is 36 px wide, so 0.05 px over half of it is 0.16 degrees."""
    picture = plate_picture(RIG, {"object": pose, "actuator": (0.0, 0.0, 0.0)})
    found = Locator(RIG, SCENE).see(Frame(0.0, picture))
    assert set(found.parts) == {"object", "actuator"}
    off = found.parts["object"].pose - pose
    assert np.hypot(*off[:2]) < 0.055e-3
    assert abs(off[2]) < 0.0033
    assert not found.problems


def test_what_is_not_there_has_a_reason():
    picture = plate_picture(RIG, {"actuator": (0.0, 0.0, 0.0)})
    found = Locator(RIG, SCENE).see(Frame(0.0, picture))
    assert found.parts["object"].pose is None
    assert found.parts["object"].reason
    assert found.parts["actuator"].pose is not None


def test_fixels_are_found_by_their_tops_and_again_after_a_move():
    fixel = SCENE.fixels[0]
    locator, time, places = Locator(RIG, SCENE), 0.0, []
    for off in ((0.0, 0.0), (0.002, -0.001)):
        place = fixel.pose[:2] + off
        picture = plate_picture(RIG, AT_HOME, tops=[(place, fixel.shape.radius)])
        for _ in range(6 * NOW_AND_THEN):
            time += 0.03
            found = locator.see(Frame(time, picture))
        places.append(np.hypot(*(found.fixels[fixel.name] - place)))
    assert max(places) < 0.2e-3


def test_no_fixel_is_found_where_none_stands():
    locator = Locator(RIG, SCENE)
    picture = plate_picture(RIG, AT_HOME)
    for k in range(5):
        found = locator.see(Frame(0.03 * k, picture))
    assert found.fixels == {}
