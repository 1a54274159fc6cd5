# Known answers K9 and K10: K. M. Lynch, M. T. Mason (1996), Stable pushing: mechanics,
# controllability, and planning.
"""Pushes by a flat tool that a part follows without slip, whatever its pressure on the plate."""

from itertools import combinations
from math import atan, cos, degrees, radians, sin

import numpy as np
import pytest
from scipy.optimize import linprog

from fixel.model import Body, LineDrive, PathDrive, Polygon, Pusher, Scene, SupportPoints
from fixel.planning.geometric import stable_push_angle
from fixel.simulation import StewartTrinkle, simulate_batch


@pytest.mark.parametrize(("friction", "half_width", "depth", "angle"), [
    (0.2, 0.05375, 0.05375, 11.31),  # square, flush
    (0.3, 0.009, 0.0175, 16.70),  # fingers on the long edge of CMU's block
    (0.3, 0.009, 0.0250, 16.70),  # and on the short one
    (2.0, 0.009, 0.0175, 27.2),  # what geometry alone allows
    (2.0, 0.009, 0.0250, 19.8),
])  # fmt: skip
def test_K9_table_of_angles(friction, half_width, depth, angle):
    assert degrees(stable_push_angle(friction, half_width, depth)) == pytest.approx(angle, abs=0.05)


def _supports(n, width, depth, rng):
    """Points (8, 2) under a part and loads (n, 8) with their centre at the centre of mass."""
    points = rng.uniform(-1, 1, (8, 2)) * (depth, width)
    points[:4] = [(depth, width), (-depth, width), (-depth, -width), (depth, -width)]
    loads = np.zeros((n, 8))
    for row in loads:
        cost = rng.normal(size=8)
        row[:] = linprog(cost, A_eq=np.vstack((points.T, np.ones(8))), b_eq=[0, 0, 1]).x
    return points, np.maximum(loads, 0.0)


@pytest.mark.parametrize(
    ("friction", "half_width"), [(0.2, 0.02), (0.3, 0.009), (1.0, 0.009), (0.6, 0.02)]
)
def test_K9_the_simulator_finds_the_same_limit_for_every_pressure(friction, half_width):
    rng = np.random.default_rng(9)
    depth, width, n = 0.0175, 0.025, 40
    points, loads = _supports(n, width, depth, rng)
    support = SupportPoints(points=points, friction=0.3, loads=np.ones(8))
    limit = stable_push_angle(friction, half_width, depth)
    values = {f"load_{k + 1}": loads[:, k] for k in range(8)}
    for angle, stays in ((0.97 * limit, True), (-0.97 * limit, True), (1.04 * limit, False)):
        direction = (cos(angle), sin(angle))
        scene = Scene(
            Body("part", Polygon.rectangle(2 * depth, 2 * width), mass=0.2, support=support,
                 pose=(0.005 + depth, 0, 0)),
            Pusher("tool", Polygon.rectangle(0.01, 2 * half_width), pose=(0, 0, 0),
                   friction=friction, drive=LineDrive(direction, speed=0.01)),
            duration=1.0,
        )  # fmt: skip
        run = simulate_batch(scene, values, motion="quasistatic", stepper=StewartTrinkle(step=0.1))
        assert run.converged.all()
        slip = run.final[:, 0] - scene.bodies[0].pose - [*(0.01 * np.array(direction)), 0.0]
        moved = np.abs(slip @ np.diag([1, 1, depth])).max(axis=1)
        assert (moved < 1e-8).all() if stays else (moved > 1e-6).any()


GRID = np.stack(np.meshgrid(*2 * (np.linspace(-0.5, 0.5, 21),), indexing="ij"), -1).reshape(-1, 2)


def _least_slack(friction, radius):
    """Least slack of the contact's cone of wrenches over all pressures on the square of side 1,
    and the worst pressure. The tool lies along the edge x = -1/2 and turns the square about
    (0, radius); it can only supply wrenches in the cone of its two ends."""
    speed = np.column_stack(
        (-(GRID[:, 1] - radius), GRID[:, 0])
    )  # forward, along +x, at the centre of mass
    size = np.hypot(*speed.T)
    unit = np.divide(speed, size[:, None], out=np.zeros_like(speed), where=size[:, None] > 0)
    wrench = np.column_stack((unit, GRID[:, 0] * unit[:, 1] - GRID[:, 1] * unit[:, 0]))
    rays = [
        (1.0, mu, -0.5 * mu - end)  # force (1, mu) at (-1/2, end)
        for end in (-0.5, 0.5)
        for mu in (-friction, friction)
    ]
    least, worst = np.inf, None
    for one, other in combinations(np.array(rays), 2):
        normal = np.cross(one, other)
        side = np.array(rays) @ normal
        if side.min() < -1e-12 and side.max() > 1e-12:
            continue
        normal *= np.sign(side[np.abs(side).argmax()]) / np.linalg.norm(normal)
        found = linprog(
            wrench @ normal, A_eq=np.vstack((GRID.T, np.ones(len(GRID)))), b_eq=[0, 0, 1]
        )
        if found.fun < least:
            least, worst = found.fun, found.x
    return least, worst


@pytest.mark.parametrize(("friction", "radius"), [(0.2, 1.0954), (0.3, 1.0), (0.6, 1.0)])
def test_K10_the_smallest_radius_that_holds_for_every_pressure(friction, radius):
    """Lynch and Mason's tip line r^2/p is at the side of the square; less friction needs more."""
    assert _least_slack(friction, 1.002 * radius)[0] >= -1e-9
    assert _least_slack(friction, 0.99 * radius)[0] < -1e-4


@pytest.mark.parametrize(("friction", "radius"), [(0.2, 1.0954), (0.3, 1.0)])
def test_K10_the_simulator_keeps_the_part_there_and_loses_it_on_a_tighter_bend(friction, radius):
    side = 0.1
    worst = _least_slack(friction, 0.9 * radius)[1]
    for factor, stays in ((1.01, True), (0.9, False)):
        points, loads = side * GRID[worst > 1e-9], worst[worst > 1e-9]
        # Loads of three points cannot be given; halves of the same points have the same friction.
        points, loads = np.repeat(points, 2, axis=0), np.repeat(0.5 * loads, 2)
        turn = np.linspace(0.0, 0.02, 21)
        centre = np.array([0.0, factor * radius * side])
        arm = np.array([-side / 2 - 0.005, 0.0]) - centre
        c, s = np.cos(turn), np.sin(turn)
        place = centre + np.column_stack((c * arm[0] - s * arm[1], s * arm[0] + c * arm[1]))
        path = np.column_stack((np.linspace(0, 1, 21), place, turn))
        scene = Scene(
            Body("part", Polygon.rectangle(side, side), mass=0.2,
                 support=SupportPoints(points=points, friction=0.3, loads=loads)),
            Pusher("tool", Polygon.rectangle(0.01, side), friction=friction,
                   drive=PathDrive(path)),
            duration=1.0,
        )  # fmt: skip
        run = simulate_batch(scene, motion="quasistatic", stepper=StewartTrinkle(step=0.05))
        assert run.converged.all()
        end = run.final[0, 0]
        c, s = cos(turn[-1]), sin(turn[-1])
        wanted = centre + np.array([[c, -s], [s, c]]) @ -centre
        off = np.hypot(*(end[:2] - wanted)) + side * abs(end[2] - turn[-1])
        assert off < 1e-6 if stays else off > 1e-5, (factor, off)


def test_the_limit_is_the_smaller_of_friction_and_geometry():
    assert stable_push_angle(0.2, 1.0, 0.01) == atan(0.2)
    assert stable_push_angle(0.2, 0.0, 0.01) == 0.0
    assert radians(26) < stable_push_angle(9.0, 0.005, 0.01) < radians(27)
