"""Real pushes of a plate, surface, side or speed that was left out are named as such, all of them.

Source: K.-T. Yu et al. (2016), IROS.
"""

from itertools import islice

import numpy as np
import pytest

from fixel.calibration.known_pushes import KnownPushes, with_units
from fixel.calibration.target import targets_of
from fixel.datasets import plan_import

POLYGONS = ("hex", "rect", "tri")  # smooth outlines have no sides: neighbours of a quarter are near


@pytest.fixture(scope="module")
def targets(data_root):
    plan = plan_import(data_root / "mit_push_endpoints")
    return targets_of(islice(plan.experiments(), 0, None, 4))


def named(targets, left):
    """Share of the left-out pushes that are new, and what is said to be new about them."""
    known = KnownPushes.of([t for t, own in zip(targets, left, strict=True) if not own])
    found = [known.unseen(t) for t, own in zip(targets, left, strict=True) if own]
    return np.mean([any(own.is_given for own in one) for one in found]), {
        own.what for one in found for own in one
    }


@pytest.mark.system
def test_all_pushes_of_a_left_out_plate_surface_side_or_speed_are_named(targets):
    for name in ("shape", "surface"):
        labels = np.array([target.conditions[name] for target in targets])
        for value in np.unique(labels):
            assert named(targets, labels == value) == (1.0, {name})
    speeds = np.array([target.conditions["speed_m_s"] for target in targets])
    assert named(targets, speeds > 0.015) == (1.0, {"speed"})
    sides = np.array([target.conditions["side"] for target in with_units(targets, "side")])
    polygons = [side for side in np.unique(sides) if str(side).startswith(POLYGONS)]
    assert len(polygons) >= 25
    for side in polygons[::4]:
        assert named(targets, sides == side)[0] == 1.0


@pytest.mark.system
def test_hardly_any_push_like_the_others_is_named(targets):
    left = np.random.default_rng(0).random(len(targets)) < 0.1
    assert named(targets, left)[0] <= 0.01
