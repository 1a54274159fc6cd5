# Known answers A9 and A10: M. T. Mason (1986), the voting theorem; M. A. Peshkin, A. C. Sanderson
# (1985), CMU-RI-TR-85-18, the tip line at a^2/c.
"""Which way a pushed part turns, and how slowly at most: theorems that hold for every pressure."""

from math import pi

import numpy as np
import pytest

from fixel import QuasiStatic, StewartTrinkle, SupportPoints, simulate_batch
from fixel.testing.scenes import free_push, touching_pose

SPEED = 0.01  # [m/s]
STEP = 1e-2  # [s]; rows are taken at the start, so the first velocity is that of any step
N_TRIPOD = 50
PER_TRIPOD = 200


def _tripod(rng):
    """Three points around the centre of mass, which is then the centre of friction as well."""
    while True:
        points = rng.uniform(-0.049, 0.049, (3, 2))
        share = np.linalg.solve(np.vstack((points.T, np.ones(3))), [0.0, 0.0, 1.0])
        if share.min() > 0.02:
            return points


def _pushes(rng):
    """Random contact points on the lower edge of the box, and random directions into it."""
    along = rng.uniform(-0.049, 0.049, PER_TRIPOD)
    towards = rng.uniform(-1.3, 1.3, PER_TRIPOD)
    point = np.column_stack((along, np.full(PER_TRIPOD, -0.05)))
    return along, towards, touching_pose(point, -pi / 2, towards)


def _velocities(points, start, friction):
    scene = free_push(SupportPoints(points=points, friction=0.3), step=STEP, speed=SPEED)
    run = simulate_batch(
        scene, {"mu_pusher": friction}, start=start, motion=QuasiStatic(),
        stepper=StewartTrinkle(step=STEP),
    )  # fmt: skip
    assert run.converged.all()
    assert run.max_residual.max() <= 1e-9
    return (run.final[:, 0] - start) / STEP


def test_A9_votes_decide_the_sense_of_rotation_of_10000_tripods():
    rng = np.random.default_rng(9)
    decided = wrong = 0
    for _ in range(N_TRIPOD):
        points = _tripod(rng)
        _, towards, start = _pushes(rng)
        friction = rng.uniform(0.0, 1.2, PER_TRIPOD)
        omega = _velocities(points, start, friction)[:, 2]
        # The contact, seen from the centre of friction (0, 0 of the body).
        arm = 0.005 * np.column_stack((np.cos(towards), np.sin(towards))) - start[:, :2]
        rays = np.stack(
            [np.zeros(PER_TRIPOD), towards - np.arctan(friction), towards + np.arctan(friction)]
        )
        moment = arm[:, 0] * np.sin(rays) - arm[:, 1] * np.cos(rays)
        # Rays that all but hit the centre of friction vote on rounding: left out, as are ties.
        clear = (np.abs(moment) > 1e-6).all(axis=0)
        vote = np.sign(np.sign(moment).sum(axis=0))
        decided += int(clear.sum())
        wrong += int((clear & (np.sign(omega) != vote)).sum())
    assert decided > 0.99 * N_TRIPOD * PER_TRIPOD
    assert wrong == 0


def test_A10_no_pressure_turns_a_pushed_part_more_slowly_than_the_tip_line():
    rng = np.random.default_rng(10)
    slowest = np.inf
    for _ in range(N_TRIPOD):
        points = _tripod(rng)
        a = np.hypot(*points.T).max()
        along, towards, start = _pushes(rng)
        omega = _velocities(points, start, np.zeros(PER_TRIPOD))[:, 2]
        c = np.abs(along)
        # Without friction the finger moves the contact at its own speed along the normal only; the
        # part turns about a point at most a^2/c beyond its centre along the arm c.
        bound = SPEED * np.cos(towards) / (c + a**2 / c)
        # For arms inside the circle; farther out the centre of rotation may lie on any support.
        inside = c <= a
        slowest = min(slowest, float((np.abs(omega) / bound)[inside].min()))
    assert slowest >= 1.0 - 1e-7  # residual 1e-9, scaled


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75, 0.98])
def test_A10_two_supports_on_the_rim_across_the_arm_meet_the_bound(share):
    a = 0.05
    c = share * a
    support = SupportPoints(points=[[0.0, a], [0.0, -a]], friction=0.3)
    start = touching_pose([[c, -0.05]], -pi / 2, [0.0])
    scene = free_push(support, step=STEP, speed=SPEED)
    method = {"motion": QuasiStatic(), "stepper": StewartTrinkle(step=STEP)}
    run = simulate_batch(scene, start=start, **method)
    omega = (run.final[0, 0, 2] - start[0, 2]) / STEP
    assert abs(omega) == pytest.approx(SPEED / (c + a**2 / c), rel=1e-7)  # residual 1e-9, scaled
