"""Searches with fewer corners: which outlines, and whose outline states the success."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

import fixel
from fixel import Belief, Disk, PoseRegion, StartError
from fixel.planning.simplified import simplified
from fixel.testing.scenes import pushed_square
from fixel.units import deg, mm

GOAL = PoseRegion((20 * mm, 5 * mm, 0.1), position=6 * mm, angle=8 * deg)


def traced(n, noise=0.05 * mm):
    """Return the square's scene with a smooth part of n corners, as if traced in a picture."""
    angle = np.arange(n) * 2.0 * np.pi / n
    radius = 30 * mm + 5 * mm * np.cos(2.0 * angle + 0.4) + 3 * mm * np.cos(3.0 * angle + 1.1)
    corners = radius[:, None] * np.column_stack((np.cos(angle), np.sin(angle)))
    corners += np.random.default_rng(n).normal(0.0, noise, (n, 2))
    scene = pushed_square()
    return replace(scene, bodies=(replace(scene.bodies[0], shape=fixel.Polygon(corners)),))


def apart(a, b):
    """Return the Hausdorff distance of the outlines of two scenes [m]."""
    rings = [
        shapely.LinearRing(own.bodies[0].shape.outline).segmentize(0.02 * mm) for own in (a, b)
    ]
    return rings[0].hausdorff_distance(rings[1])


@pytest.mark.parametrize("shape", [None, Disk(30 * mm), fixel.Polygon.regular(60, 30 * mm)])
def test_an_outline_of_few_corners_is_the_simulated_one(shape):
    scene = pushed_square()
    if shape is not None:
        scene = replace(scene, bodies=(replace(scene.bodies[0], shape=shape),))
    assert simplified(scene, GOAL) is scene


@pytest.mark.system
@pytest.mark.parametrize("noise", [0.0, 0.05 * mm])
def test_a_traced_outline_loses_most_corners_and_little_else(noise):
    scene = traced(500, noise)
    fewer = simplified(scene, GOAL)
    assert len(fewer.bodies[0].shape.outline) <= 40
    assert apart(scene, fewer) < 0.016 * scene.bodies[0].shape.radius
    assert fewer.bodies[0].shape.area == pytest.approx(scene.bodies[0].shape.area, rel=0.01)


@pytest.mark.system
def test_a_fine_goal_has_a_fine_outline():
    """Within a quarter of the tolerance, however many corners that leaves."""
    scene = traced(500)
    fine = PoseRegion((20 * mm, 0, 0), position=0.2 * mm)
    fewer = simplified(scene, fine)
    assert 64 < len(fewer.bodies[0].shape.outline) <= 500
    assert apart(scene, fewer) < 0.05 * mm


def test_success_is_stated_with_the_traced_outline():
    """`simulate` of each run ends where the plan says with this outline, not with a simpler one."""
    scene = traced(160)
    belief = Belief(
        parameters={"mu_pusher": (0.2, 0.4)},
        start=StartError(x=0.3 * mm, y=0.3 * mm, theta=0.5 * deg, kind="uniform"),
    )
    plan = fixel.plan(scene, GOAL, belief=belief, rollouts=2_000, progress=False)
    scenarios = plan.runs.scenarios
    rows = np.linspace(0, scenarios.n - 1, 12).astype(int)
    fewer = simplified(scene, GOAL)
    ends = {"traced": [], "fewer": []}
    for name, own in (("traced", scene), ("fewer", fewer)):
        for row in rows:
            body = replace(own.bodies[0], pose=plan.start[0] + scenarios.start[row])
            tool = replace(
                plan.scene.pushers[0], pose=plan.path[0, 0, 1:], drive=fixel.PathDrive(plan.path[0])
            )
            pushed = replace(
                own, bodies=(body,), pushers=(tool,), duration=float(plan.path[0, -1, 0])
            )
            mu = {"mu_pusher": float(scenarios.values["mu_pusher"][row])}
            ends[name].append(fixel.simulate(pushed, mu, motion="quasistatic")["part"].pose[-1])
    traced_off, fewer_off = (
        np.abs(np.array(own) - plan.runs.end[rows]).max(axis=0) for own in ends.values()
    )
    assert (traced_off < (1e-6, 1e-6, 3e-5)).all()
    assert (fewer_off > 10.0 * traced_off).all()


def test_a_flat_tool_is_put_against_the_traced_outline():
    """A micrometre before it touches, it is clear of the outline; a micrometre on, it is not."""
    scene = traced(300)
    tool = fixel.Polygon([(-10 * mm, -9 * mm), (0, -9 * mm), (0, 9 * mm), (-10 * mm, 9 * mm)])
    choose = fixel.FreePushes(tool=tool, clearance=7 * mm)
    rng = np.random.default_rng(3)
    numbers = np.column_stack((rng.random(50), rng.uniform(-0.4, 0.4, 50), np.full(50, 20 * mm)))
    begin = choose.motions(choose.prepared(scene), numbers, np.zeros((50, 3))).path[:, 0, 1:]
    part = shapely.Polygon(scene.bodies[0].shape.outline)
    for x, y, angle in begin:
        c, s = np.cos(angle), np.sin(angle)
        corners = tool.outline @ np.array([[c, s], [-s, c]]) + (x, y)
        on = [
            part.intersects(shapely.Polygon(corners + way * np.array([c, s])))
            for way in (7 * mm - 1e-6, 7 * mm + 1e-6)
        ]
        assert on == [False, True]
