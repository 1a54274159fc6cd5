"""Regions that neither part nor tool may touch, checked with Shapely and normal distributions."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from scipy.stats import norm
from shapely.affinity import rotate, translate

import fixel
from fixel import Belief, FreePushes, InvalidInput, PoseRegion, RigError, RigPushes, Seated
from fixel.testing.scenes import grasp, pushed_square
from fixel.units import deg, mm

GOAL = PoseRegion((30 * mm, 0.0, 0.0), position=6 * mm, angle=8 * deg)
PUSHES = FreePushes(length=(5 * mm, 60 * mm))


def box(*corners):
    """Return a box of two corners [mm] in Shapely's form and as corners [m]."""
    found = shapely.box(*np.array(corners) * 1e-3)
    return found, np.array(found.exterior.coords)[:-1]


def motion(plan, push):
    """Return the regions that tool and part pass in a push, by the public simulation."""
    scene = plan.scenes[push]
    tool = shapely.LineString(plan.path[push][:, 1:3]).buffer(scene.pushers[0].shape.radius)
    outline = shapely.Polygon(scene.bodies[0].shape.outline)
    poses = fixel.simulate(scene, motion="quasistatic")["part"].pose
    placed = [
        translate(rotate(outline, angle, origin=(0, 0), use_radians=True), x, y)
        for x, y, angle in poses
    ]
    return tool, shapely.union_all(placed)


@pytest.fixture(scope="module")
def free():
    return fixel.plan(pushed_square(), GOAL, PUSHES, rollouts=4_000, progress=False)


def test_a_plan_goes_round_what_the_tool_would_touch(free):
    x, y = 1e3 * free.path[0, 0, 1:3]
    region, corners = box(x - 8, y - 3, x + 2, y + 3)
    assert motion(free, 0)[0].intersects(region)
    choose = replace(PUSHES, obstacles=[corners])
    plan = fixel.plan(pushed_square(), GOAL, choose, rollouts=4_000, progress=False)
    assert plan.success.mean == 1.0
    assert not any(own.intersects(region) for own in motion(plan, 0))
    assert "obstacle" in [own.get_text() for own in plan.plot().figure.legends[0].get_texts()]


def test_the_part_may_not_touch_it_on_its_way():
    """The part starts 50 mm wide about the origin; the goal's 30 mm ahead put its edge at 80 mm."""
    _, corners = box(77, -20, 79, 20)
    choose = replace(PUSHES, obstacles=[corners])
    near = PoseRegion((30 * mm, 0.0, 0.0), position=2 * mm, angle=8 * deg)
    with pytest.raises(InvalidInput, match="the nearest candidate ends at 2"):
        fixel.plan(pushed_square(), near, choose, rollouts=2_000, progress=False)


@pytest.mark.system
def test_a_sequence_of_pushes_avoids_obstacles():
    """The obstacle lies where the square starts in the table of displacements: away from it."""
    region, corners = box(60, -60, 80, -30)
    goal = PoseRegion((20 * mm, 50 * mm, 1.0), position=6 * mm, angle=8 * deg)
    choose = FreePushes(most=2, length=(5 * mm, 60 * mm), obstacles=[corners])
    plan = fixel.plan(pushed_square(), goal, choose, rollouts=8_000, progress=False)
    assert plan.success.mean == 1.0
    for push in range(len(plan.pushes)):
        assert not any(own.intersects(region) for own in motion(plan, push))


def test_a_touch_by_the_errors_of_the_tool_is_a_failure(free):
    """A tool that passes at 0.5 mm touches where its error across the path, 1 mm, is larger."""
    begin, after = free.path[0, :2, 1:3]
    along = (after - begin) / np.hypot(*(after - begin))
    across = np.array([-along[1], along[0]])
    near = free.scene.pushers[0].shape.radius + 0.5 * mm
    corners = [
        begin + a * along + b * across
        for a, b in ((-20 * mm, near), (2 * mm, near), (2 * mm, 40 * mm), (-20 * mm, 40 * mm))
    ]
    wide = replace(free, goal=PoseRegion((0.03, 0.0, 0.0), position=0.03))
    belief = Belief(rig=RigError(path=1 * mm))
    assert wide.success_under(belief).mean == 1.0
    narrow = replace(wide, choose=replace(PUSHES, obstacles=[corners]))
    assert narrow.success_under(belief).mean == pytest.approx(norm.cdf(0.5), abs=0.03)


def test_the_pusher_of_a_rig_may_not_touch_it_either():
    choose = RigPushes(y=(-20 * mm, 20 * mm), stroke=(100 * mm, 150 * mm))
    scene = grasp()
    x, y, _ = scene.pushers[0].pose * 1e3
    _, corners = box(x - 1, y - 1, x + 1, y + 1)
    with pytest.raises(InvalidInput, match="no push of the candidates can be carried out"):
        fixel.plan(
            scene, Seated("fixel-1", "fixel-2"), replace(choose, obstacles=[corners]),
            rollouts=2_000, progress=False,
        )  # fmt: skip


@pytest.mark.parametrize("given", [3, "x", [None], [[(0.0, 0.0)]], [[(0, 0), (1, 0), (2, 0)]]])
def test_obstacles_that_are_no_regions(given):
    with pytest.raises(InvalidInput, match=r"^choose\.obstacles"):
        FreePushes(obstacles=given)
