# Known answers K1 and K2 through the planner: K. Y. Goldberg (1993), Orienting polygonal parts
# without sensors.
"""Plans of pushes by a wide fence, carried out in the simulator from every angle of the start."""

from math import pi

import numpy as np
import pytest

import fixel
from fixel import Adaptive, Belief, Body, FreePushes, Polygon, PoseRegion, Scene, StartError, Tripod
from fixel.planning.geometric import fence_pushes
from fixel.planning.plan import simulator_of
from fixel.units import deg, mm

FENCE = Polygon.rectangle(4 * mm, 1.0)
BELIEF = Belief(
    parameters={"tripod_radius": (10 * mm, 20 * mm), "mu_pusher": (0.0, 0.2)},
    start=StartError(theta=pi, kind="uniform"),
)
TRI1 = Polygon([(0.045, 0.045), (-0.0809, 0.045), (0.045, -0.08087)])


def problem(shape, symmetry, longest):
    part = Body("part", shape, mass=0.5, support=Tripod(radius=15 * mm, friction=0.3))
    reach = float(np.hypot(*(shape.outline - shape.centroid).T).max())
    choose = FreePushes(
        most=4, tool=FENCE, length=(10 * mm, longest), angle=80 * deg, clearance=1.2 * reach
    )
    scene = choose.prepared(Scene(part, duration=1.0))
    return scene, PoseRegion((0, 0, 0), angle=2 * deg, symmetry=symmetry), choose


def rate(scene, goal, choose, plan, errors=0.0, n=120):
    """Share of angles of the start from which a plan (k, 3) ends at its angle, with errors (n, k)
    of the directions of pushes, each relative to the part after the one before."""
    simulator = simulator_of(scene, goal, choose, BELIEF, None, None, None)
    numbers = np.tile(plan, (n, 1, 1))
    numbers[:, :, 1] += errors
    scenarios = BELIEF.scenarios(scene, worlds=n, runs=1, seed=1)
    runs = simulator.run(simulator.planned(numbers), np.arange(n), scenarios)
    assert (runs.failure == 0).all()
    turned = runs.pose[:, -1, 2] - np.broadcast_to(errors, numbers.shape[:2]).sum(axis=1)
    period = 2.0 * pi / goal.symmetry
    return float((np.abs(np.mod(turned + 0.5 * period, period) - 0.5 * period) < 2 * deg).mean())


def test_K1_two_pushes_do_what_one_does_for_the_share_of_its_basin():
    block = problem(Polygon.rectangle(50 * mm, 35 * mm), 2, 150 * mm)
    [plan] = fence_pushes(block[0].bodies[0], 0.0, most=2, angle=1.4, length=(0.0, 0.15))
    assert len(plan) == 2
    assert rate(*block, plan) >= 0.97
    # From the middle of a long side, at 25 of 170 mm, into the basins of 220 of 360 degrees.
    assert rate(*block, np.array([[25 / 170, 0.0, 0.15]])) == pytest.approx(0.61, abs=0.04)


def test_K22_one_of_two_angles_that_a_fence_cannot_tell_apart_is_reached_half_the_time():
    block = problem(Polygon.rectangle(50 * mm, 35 * mm), 1, 150 * mm)
    [plan] = fence_pushes(block[0].bodies[0], 0.0, most=2, angle=1.4, length=(0.0, 0.15))
    assert rate(*block, plan) == pytest.approx(0.5, abs=0.1)


def test_K7_the_shortest_push_that_always_succeeds_is_within_the_bound():
    """Start within 10 degrees, tripods of any radius in the square, flush within 0.1 degrees."""
    side = 107.5 * mm
    square = Polygon.rectangle(side, side)
    part = Body("part", square, mass=0.5, support=Tripod(radius=15 * mm, friction=0.3))
    belief = Belief(
        parameters={"tripod_radius": (10 * mm, 60 * mm)},
        start=StartError(theta=10 * deg, kind="uniform"),
    )
    choose = FreePushes(tool=FENCE, clearance=10 * mm, friction=0.0)
    scene = choose.prepared(Scene(part, duration=1.0))
    goal = PoseRegion((0, 0, 0), angle=0.1 * deg)
    simulator = simulator_of(scene, goal, choose, belief, None, Adaptive(tolerance=1e-6), None)
    lengths = np.array([5.0, 10.0, 14.59, 20.0, 25.0, 29.26]) * mm
    # The middle of the bottom edge; contact begins up to 8 mm earlier where the part is turned.
    corner = 0.5 * side * (np.cos(10 * deg) + np.sin(10 * deg) - 1.0)
    numbers = np.array([[[0.125, 0.0, x - corner]] for x in lengths])
    scenarios = belief.scenarios(scene, worlds=128, runs=1)
    runs = simulator.run(
        simulator.planned(numbers),
        np.repeat(np.arange(6), 128),
        scenarios.rows(np.tile(np.arange(128), 6)),
    )
    success = (simulator.margins(runs) >= 0.0).reshape(6, 128).mean(axis=1)
    assert np.all(np.diff(success) >= 0.0)
    assert success[0] < 0.6
    assert success[2] < 1.0  # what even pressure needs
    assert success[-1] == 1.0


def test_K2_with_an_error_of_5_degrees_four_pushes_do_what_three_do_not():
    part = problem(TRI1, 1, 0.5)
    short, robust = fence_pushes(part[0].bodies[0], 0.0, most=4, angle=1.4, length=(0.0, 0.5))
    assert (len(short), len(robust)) == (3, 4)
    errors = 4.9 * deg * np.random.default_rng(2).choice([-1.0, 1.0], (120, 4))
    assert rate(*part, short) >= 0.97
    assert rate(*part, robust, errors) >= 0.97
    assert rate(*part, short, errors[:, 1:]) < 0.9


@pytest.mark.slow
def test_K1_the_search_finds_the_two_pushes_with_their_rotation():
    scene, goal, _ = problem(Polygon.rectangle(50 * mm, 35 * mm), 2, 0.15)
    choose = FreePushes(
        most=2, tool=FENCE, length=(40 * mm, 150 * mm), angle=50 * deg, clearance=14 * mm
    )
    plain = Scene(scene.bodies, duration=1.0)
    plan = fixel.plan(plain, goal, choose, BELIEF, rollouts=2_000, progress=False)
    assert len(plan.pushes) == 2
    assert plan.success.mean > 0.9
    way = np.diff(plan.path[:, :2, 1:3], axis=1)[:, 0]
    first, last = np.arctan2(way[:, 1], way[:, 0]) / deg
    # 45 degrees, with a margin of 10, up to the symmetry of the block.
    assert abs((last - first) % 90.0 - 45.0) < 10.0
