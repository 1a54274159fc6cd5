# Known answers K18-K20 and K22 of plans: laws of the search, the success and the motion.
"""Plans of turned, mirrored and rescaled problems; certainty, larger goals, impossible goals."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

import fixel
from fixel import (
    AnyOf,
    Belief,
    Body,
    Disk,
    FreePushes,
    InvalidInput,
    Polygon,
    PoseRegion,
    Scene,
    StartError,
    Tripod,
)
from fixel.model.goals import BodyTrack
from fixel.planning.plan import simulator_of
from fixel.simulation import StewartTrinkle
from fixel.units import deg

OUTLINE = np.array([(-0.05, -0.03), (0.05, -0.03), (0.05, 0.03), (-0.03, 0.05)])
FAST = StewartTrinkle(step=0.05)


def problem(scale=1.0, outline=OUTLINE, pose=(0.0, 0.0, 0.0), goal=(0.03, 0.0, 0.05)):
    support = Tripod(radius=0.02 * scale, friction=0.3)
    pose = np.asarray(pose) * (scale, scale, 1.0)
    part = Body("part", Polygon(scale * outline), mass=0.5, support=support, pose=pose)
    choose = FreePushes(
        tool=Disk(0.004 * scale), length=(0.01 * scale, 0.06 * scale), clearance=0.004 * scale,
        speed=0.02 * scale, friction=0.4,
    )  # fmt: skip
    goal = PoseRegion(np.asarray(goal) * (scale, scale, 1.0), position=0.006 * scale, angle=8 * deg)
    belief = Belief(
        parameters={"mu_pusher": (0.1, 0.4), "tripod_radius": (0.015 * scale, 0.035 * scale)},
        start=StartError(x=0.001 * scale, y=0.001 * scale, theta=1 * deg, kind="uniform"),
    )
    return Scene(part, duration=1.0), goal, choose, belief


def plan_of(*own, **options):
    return fixel.plan(*own, rollouts=1000, stepper=FAST, progress=False, **options)


@pytest.fixture(scope="module")
def found():
    return plan_of(*problem())


def test_K18_another_unit_of_length_has_the_same_plan_with_the_same_success_bit_for_bit(found):
    small = plan_of(*problem(2.0**-6))
    assert small.success == found.success
    for a, b in zip(small.pushes, found.pushes, strict=True):
        assert (a.contact, a.angle, a.length) == (b.contact, b.angle, 2.0**-6 * b.length)


def ends(own, numbers, start_errors):
    """Nominal poses (m, 3) and ends (m, 3) with errors of the start, of single pushes."""
    scene, goal, choose, belief = own
    simulator = simulator_of(choose.prepared(scene), goal, choose, belief, None, FAST, 1)
    planned = simulator.planned(numbers[:, None])
    scenarios = belief.scenarios(simulator.scene, worlds=len(numbers), runs=1)
    runs = simulator.run(planned, np.arange(len(numbers)), scenarios._replace(start=start_errors))
    return planned.nominal.pose[:, -1], runs.pose[:, -1]


PUSHES = np.column_stack((
    (np.arange(12) + 0.37) / 12, np.linspace(-0.5, 0.5, 12), np.linspace(0.02, 0.05, 12)
))  # fmt: skip
ERRORS = np.random.default_rng(18).uniform(-1, 1, (12, 3)) * (1e-3, 1e-3, 0.02)


def test_K18_pushes_of_a_turned_part_end_at_the_turned_poses():
    turn, shift = 0.8, (0.3, -0.2)
    c, s = np.cos(turn), np.sin(turn)
    spin = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    there = ends(problem(pose=(*shift, turn)), PUSHES, ERRORS @ spin.T)
    for own, other in zip(ends(problem(), PUSHES, ERRORS), there, strict=True):
        assert other == pytest.approx(own @ spin.T + (*shift, turn), abs=1e-6)


def test_K18_pushes_of_a_mirrored_part_end_at_the_mirrored_poses():
    flip = np.array([1.0, -1.0, -1.0])
    outline = OUTLINE * flip[:2]
    point = shapely.line_interpolate_point(
        shapely.LinearRing(OUTLINE), PUSHES[:, 0], normalized=True
    )
    mirrored = shapely.points(shapely.get_coordinates(point) * flip[:2])
    ring = shapely.LinearRing(Polygon(outline).outline)
    pushes = np.column_stack(
        (shapely.line_locate_point(ring, mirrored, normalized=True), -PUSHES[:, 1], PUSHES[:, 2])
    )
    # The tripod is symmetric about the x axis of the part, as its first point lies on it.
    there = ends(problem(outline=outline), pushes, ERRORS * flip)
    for own, other in zip(ends(problem(), PUSHES, ERRORS), there, strict=True):
        assert other == pytest.approx(own * flip, abs=1e-6)


def test_K19_without_anything_unknown_success_is_0_or_1_and_the_plan_is_as_good_as_the_nominal():
    scene, goal, choose, _ = problem()
    plan = plan_of(scene, goal, choose)
    assert plan.success.mean == plan.nominal_success.mean == 1.0
    assert np.ptp(plan.runs.margin) == 0.0
    assert plan.runs.end[0] == pytest.approx(plan.end, abs=1e-12)


def test_K20_a_larger_goal_never_has_a_lower_success_on_the_same_samples(found):
    tracks = BodyTrack.of_ends(found.runs.end)
    carried_out = np.isfinite(found.runs.margin) & (found.runs.margin > -1e3)

    def success(goal):
        return (goal.met(found.scene, tracks) & carried_out).mean()

    goal, last = found.goal, 0.0
    assert success(goal) == found.success.mean
    for factor in (0.3, 0.5, 1.0, 1.5, 2.0, 4.0):
        now = success(
            replace(goal, position=factor * goal.position, angle=factor * goal.angle)
        )  # fmt: skip
        assert now >= last
        last = now
    assert success(AnyOf(goal, PoseRegion((0.0, 0.05, 0.0), position=0.01))) >= success(goal)


@pytest.mark.slow
def test_K22_a_turn_on_the_spot_is_refused_with_the_distance_that_is_left():
    with pytest.raises(InvalidInput, match=r"it misses by \d[\d.]* tolerances"):
        plan_of(*problem(goal=(0.0, 0.0, 3.1)))
