"""Candidate plans towards regions that random pushes hardly ever find."""

from dataclasses import replace

import numpy as np
import shapely
from shapely import affinity

import fixel
from fixel.model import Fixel
from fixel.planning.candidates import poses_within
from fixel.planning.plan import simulator_of
from fixel.testing.scenes import box, pushed_square, row
from fixel.units import mm

HALF = 51 * mm  # of a slot for the square with sides of 100 mm
WALLS = tuple(
    Fixel(name, box(150 * mm, 20 * mm), pose=row(0.2, side * (HALF + 10 * mm), 0.0), friction=0.3)
    for name, side in (("upper", 1.0), ("lower", -1.0))
)
CORNERS = np.array([(0.14, -HALF), (0.3, -HALF), (0.3, HALF), (0.14, HALF)])


def test_poses_within_a_region_are_inside_it_and_outside_the_walls():
    scene, choose = replace(pushed_square(), fixels=WALLS), fixel.FreePushes(most=2)
    prepared = choose.prepared(replace(scene, duration=1.0))
    goal = fixel.Inside(CORNERS)
    simulator = simulator_of(prepared, goal, choose, fixel.Belief(), None, None, 1)
    poses = poses_within(simulator, seed=0)
    assert len(poses) > 10
    square, slot = shapely.box(-0.05, -0.05, 0.05, 0.05), shapely.Polygon(CORNERS).buffer(1e-4)
    for x, y, theta in poses:
        part = affinity.translate(affinity.rotate(square, np.degrees(theta), (0, 0)), x, y)
        assert slot.covers(part)
        for side in (1.0, -1.0):
            wall = shapely.box(0.125, HALF, 0.275, HALF + 20 * mm)
            assert not affinity.scale(wall, 1.0, side, origin=(0, 0)).buffer(-1e-6).intersects(part)
    turned = np.abs(np.mod(poses[:, 2] + np.pi / 4, np.pi / 2) - np.pi / 4)
    assert turned.max() < 0.03  # a square of 100 mm in a slot of 102 mm


def test_goals_without_a_region_have_no_poses_within():
    choose = fixel.FreePushes()
    scene = choose.prepared(pushed_square())
    goal = fixel.PoseRegion((0.02, 0.0, 0.0), position=5 * mm)
    simulator = simulator_of(scene, goal, choose, fixel.Belief(), None, None, 1)
    assert len(poses_within(simulator, seed=0)) == 0
