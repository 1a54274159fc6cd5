# Known answers K5-K8: M. A. Peshkin, A. C. Sanderson (1988), The motion of a pushed, sliding
# workpiece; S. Goyal, A. Ruina, J. Papadopoulos (1991) for the ellipsoid.
"""Distances after which a fence is flush with a part, and rates at which point pushes turn one."""

from math import cos, pi, radians, sin, tau

import numpy as np
import pytest

from fixel.model import Body, Disk, Ellipsoid, LineDrive, Polygon, Pusher, Scene, SupportPoints
from fixel.planning.geometric import alignment_distance, flush_distance, friction_arm
from fixel.simulation import Adaptive, simulate_batch

SIDE = 0.1075  # [m], square of the thesis
CORNER = SIDE / np.sqrt(2.0)
EVEN = 0.3826 * SIDE  # torque over force of even pressure [m]
SQUARE = Polygon.rectangle(SIDE, SIDE)
LONG, SHORT, MICRO_ARM = 1.621e-3, 0.842e-3, 485.5e-6
MICRO = Polygon.rectangle(LONG, SHORT)
FINE = Adaptive(tolerance=1e-7)


@pytest.mark.parametrize(("shape", "off", "bound", "even", "arm"), [
    (SQUARE, [40, 5, 10, 22.5], [193.0, 14.31, 29.26, 72.24], [72.0, 7.36, 14.59, 32.80], EVEN),
    (MICRO, [90.5, 95, 120], [0.0161, 0.1611, 1.018], [0.0096, 0.0950, 0.5379], MICRO_ARM),
    (MICRO, [0.5, 5, 10], [0.0211, 0.2232, 0.4852], [0.0086, 0.0872, 0.1807], MICRO_ARM),
])  # fmt: skip
def test_K5_table_of_distances(shape, off, bound, even, arm):
    angles = np.radians(off)
    assert 1e3 * flush_distance(shape, angles) == pytest.approx(bound, rel=5e-3)
    assert 1e3 * flush_distance(shape, -angles) == pytest.approx(bound, rel=5e-3)
    assert 1e3 * flush_distance(shape, angles, arm) == pytest.approx(even, rel=5e-3)


def test_the_length_of_the_asme_pushes_aligns_the_long_side_from_20_degrees():
    assert 600e-6 < flush_distance(MICRO, radians(90 + 20)) < 700e-6


def _way_until_flush(shape, angle, arm):
    """Way of the fence in small turns of the part, until the corner that touches would turn it
    back: by the velocity of that corner on an ellipsoid, and no formula of fixel's."""
    corners = shape.outline - shape.centroid
    way, step, sense = 0.0, 1e-4, None
    while True:
        turned = corners @ [[cos(angle), sin(angle)], [-sin(angle), cos(angle)]]
        lever = turned[np.argmin(turned[:, 0])][1]
        if sense not in (None, np.sign(lever)):
            return way
        sense = np.sign(lever)
        way += step * (arm**2 + lever**2) / abs(lever)
        angle -= sense * step


@pytest.mark.parametrize("angle", [0.3, 1.0, 2.2, 4.0])
def test_K5_several_corners_in_turn(angle):
    shape = Polygon([(0, 0), (6, 0), (5, 3), (1, 4), (-0.2, 1.0)])
    assert flush_distance(shape, angle, 1.3) == pytest.approx(
        _way_until_flush(shape, angle, 1.3), rel=2e-3
    )


def _fenced(support, angles, travel):
    """A square on a support, and poses at which its lowest corner touches a fence along y."""
    scene = Scene(
        Body("part", SQUARE, mass=0.5, pose=(1, 0, 0), support=support),
        Pusher("fence", Polygon.rectangle(0.02, 1.0), friction=0.0, pose=(-0.01, 0, 0),
               drive=LineDrive(speed=travel)),
        duration=1.0,
    )  # fmt: skip
    depth = SIDE / 2 * (np.abs(np.cos(angles)) + np.abs(np.sin(angles)))
    return scene, np.column_stack((depth, np.zeros(len(angles)), angles))


def test_K5_the_simulator_aligns_an_ellipsoid_in_the_exact_distance():
    """Flush after the distance of the formula, and at each angle on the way."""
    start = np.radians([40.0, 22.5, 10.0, 5.0])
    ends = np.radians([30.0, 20.0, 5.0, 2.0, 0.5])
    corner = 0.25 * pi
    for begin in start:
        on_way = ends[ends < begin]
        way = alignment_distance(CORNER, corner - begin, corner - on_way, EVEN)
        support = Ellipsoid(force=1.0, torque=EVEN)
        scene, pose = _fenced(support, np.array([begin]), 0.2)
        run = simulate_batch(
            scene, start=pose, motion="quasistatic", times=way / 0.2, stepper=FINE
        )  # fmt: skip
        assert run.converged.all()
        # The error falls with the tolerance: 0.1 degrees at 1e-5, 0.02 at 1e-6, 0.003 at 1e-7.
        assert np.degrees(run.pose[0, :, 0, 2]) == pytest.approx(np.degrees(on_way), abs=5e-3)


def _pressures(n, rng, k=9):
    """Points (k, 2) in the square and loads (n, k) with their centre at the centre of mass: few
    points and many, near the rim and all over."""
    ring = np.arange(k - 1) * tau / (k - 1) + rng.uniform(0, tau)
    reach = rng.choice([0.3, 0.7, 1.0], k - 1) * SIDE / 2
    reach = reach / np.maximum(np.abs(np.cos(ring)), np.abs(np.sin(ring)))
    points = np.vstack((reach[:, None] * np.column_stack((np.cos(ring), np.sin(ring))), [[0, 0]]))
    loads = []
    while len(loads) < n:
        for weight in rng.dirichlet(np.full(k, rng.choice([0.1, 0.4, 2.0])), 50):
            centre = weight @ points
            # Carry the rest by the point on the other side, so that the centre is the origin.
            moment = (points * weight[:, None]).T @ points
            tilt = np.linalg.lstsq(moment, -centre, rcond=None)[0]
            own = weight * (1.0 + points @ tilt)
            if own.min() >= 0.0 and np.abs(own @ points).max() < 1e-12:
                loads.append(own / own.sum())
    return points, np.array(loads[:n])


def _worst_excess(n_nets, per_net, seed):
    """Largest angle [deg] by which a part is behind, after the bound of the distance to it."""
    rng = np.random.default_rng(seed)
    worst = 0.0
    for _ in range(n_nets):
        points, loads = _pressures(per_net, rng)
        support = SupportPoints(points=points, friction=0.3, loads=np.ones(len(points)))
        begin = float(rng.uniform(2.0, 43.0))
        on_way = np.radians(begin * np.array([0.8, 0.4, 0.1, 0.0]))
        bound = alignment_distance(CORNER, pi / 4 - radians(begin), pi / 4 - on_way, CORNER)
        scene, pose = _fenced(support, np.full(per_net, radians(begin)), 0.4)
        values = {f"load_{k + 1}": loads[:, k] for k in range(len(points))}
        run = simulate_batch(
            scene, values, start=pose, motion="quasistatic", times=bound / 0.4, stepper=FINE
        )
        assert run.converged.all()
        worst = max(worst, float(np.degrees(run.pose[:, :, 0, 2] - on_way).max()))
    return worst


def test_K6_no_pressure_needs_a_longer_push_than_the_bound():
    assert _worst_excess(6, 50, seed=6) < 1e-6


@pytest.mark.slow
def test_K6_no_pressure_of_10000_needs_a_longer_push_than_the_bound():
    assert _worst_excess(100, 100, seed=60) < 1e-6


def test_K7_the_shortest_push_that_aligns_every_draw_is_within_the_bound():
    """Start within 10 degrees, support unknown: flush within 0.1 degrees for every draw."""
    rng = np.random.default_rng(7)
    longest, enough = 0.0, flush_distance(SQUARE, radians(10.0))
    for _ in range(4):
        points, loads = _pressures(60, rng)
        support = SupportPoints(points=points, friction=0.3, loads=np.ones(len(points)))
        begin = np.radians(rng.choice([-1.0, 1.0], 60) * rng.uniform(9.0, 10.0, 60))
        scene, pose = _fenced(support, begin, float(enough))
        values = {f"load_{k + 1}": loads[:, k] for k in range(len(points))}
        times = np.linspace(0.0, 1.0, 200)
        run = simulate_batch(
            scene, values, start=pose, motion="quasistatic", times=times, stepper=FINE
        )
        aligned = np.abs(run.pose[:, :, 0, 2]) < radians(0.1)
        assert aligned[:, -1].all()
        longest = max(longest, float(enough * times[np.argmax(aligned, axis=1)].max()))
    # Longer than even pressure needs, and at most the bound for the disc.
    assert flush_distance(SQUARE, radians(10.0), EVEN) < longest <= 0.02926


def _point_push(part, contact, angles, arm, travel):
    """Angles (n, 5) of a part about a contact that does not slip, over the way of the tip."""
    tip = 2e-5
    scene = Scene(
        Body("part", part, mass=0.5, pose=(1, 0, 0), centre_of_mass=(0, 0),
             support=Ellipsoid(force=1.0, torque=arm)),
        Pusher("tip", Disk(tip), friction=3.0, pose=(0, 0, 0), drive=LineDrive(speed=travel)),
        duration=1.0,
    )  # fmt: skip
    c, s = np.cos(angles), np.sin(angles)
    # The face of the contact looks along -x of the part; the tip touches it.
    place = np.column_stack((tip * c - c * contact, tip * s - s * contact, angles))
    run = simulate_batch(
        scene, start=place, motion="quasistatic", times=np.linspace(0.2, 1.0, 5),
        stepper=FINE,
    )  # fmt: skip
    assert run.converged.all()
    assert run.touching("part", "tip").all()
    return run.pose[:, :, 0, 2]


@pytest.mark.parametrize("pull", [False, True])
def test_K8_point_pushes_lose_an_angle_and_pulls_gain_one_exponentially(pull):
    lever, travel = SIDE / 2, 0.059
    if pull:  # a frame open at the back: the tip pulls at the inside of its front
        arm, out = 0.01, SIDE / 2
        inside = [(-out, out - arm), (out, out - arm), (out, -out + arm), (-out, -out + arm)]
        outside = [(-out, -out), (out + arm, -out), (out + arm, out), (-out, out)]
        part = Polygon(inside + outside)
    else:
        part = SQUARE
    start = np.radians([-20.0, -1.0, 0.5, 5.0, 15.0])
    contact = lever if pull else -lever
    found = _point_push(part, contact, start, EVEN, travel)
    way = travel * np.linspace(0.2, 1.0, 5)
    sign = -1.0 if pull else 1.0
    rate = sign * lever / (lever**2 + EVEN**2)
    wanted = 2.0 * np.arctan(np.tan(0.5 * start[:, None]) * np.exp(rate * way))
    assert np.degrees(found) == pytest.approx(np.degrees(wanted), rel=3e-3)
    # Small angles halve, or double, over ln 2 (r^2 + k^2) / r = 59 mm.
    assert found[1, -1] / start[1] == pytest.approx(0.5 if pull else 2.0, rel=5e-3)


def test_arms_of_supports():
    even = Body("part", SQUARE, mass=0.5, support=Ellipsoid(force=2.0, torque=2.0 * EVEN))
    assert friction_arm(even) == pytest.approx(EVEN)
    points = [(0.03, 0), (-0.03, 0), (0, 0.04), (0, -0.04)]
    four = SupportPoints(points=points, friction=0.3, loads=[1, 1, 3, 3])
    part = Body("part", SQUARE, mass=0.5, support=four)
    assert friction_arm(part) == pytest.approx((2 * 0.03 + 6 * 0.04) / 8)
