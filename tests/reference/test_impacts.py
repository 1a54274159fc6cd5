# Known answers A16-A18: elementary; A16 as in Drake's bouncing ball.
"""Impacts under Newton's law: discs that bounce, collide, stick and slide."""

from dataclasses import replace
from math import cos, sin

import numpy as np
import pytest

from fixel.model import Body, Disk, Fixel, PairFriction, Scene
from fixel.simulation import Adaptive, Midpoint, StewartTrinkle, simulate
from fixel.testing.scenes import box

R = 0.05
G = 9.81


def _wall(friction=0.0, restitution=0.0):
    return Fixel(
        name="wall", shape=box(20.0, 1.0), pose=(0, -0.5, 0), friction=friction,
        restitution=restitution,
    )  # fmt: skip


def _disc(height, velocity, wall, duration, weight=0.0):
    pose, force = (0, height, 0), (0, -weight, 0)
    ball = Body("ball", Disk(R), mass=0.2, pose=pose, velocity=velocity, force=force)
    return Scene(bodies=(ball,), fixels=(wall,), duration=duration)


def _ball(restitution, speed, duration):
    return _disc(R, (0, speed, 0), _wall(0.0, restitution), duration, weight=0.2 * G)


@pytest.mark.parametrize("restitution", [0.3, 0.5, 0.8])
@pytest.mark.parametrize("stepper", [Adaptive(), StewartTrinkle(step=1e-3), Midpoint(step=1e-3)])
def test_A16_a_bouncing_ball_finishes_at_rest(restitution, stepper):
    total = 2 * 1.0 / (G * (1 - restitution))
    run = simulate(_ball(restitution, 1.0, 2 * total), stepper=stepper)
    assert run.converged
    assert run.pose["ball"][-1][1] == pytest.approx(R, abs=1e-6)
    assert abs(run.twist["ball"][-1, 1]) < 1e-2


@pytest.mark.parametrize(("stepper", "tolerance"), [
    # Each bounce is found a step late at most, and the speed after it is off by g h.
    (StewartTrinkle(step=2e-5), 4e-4),
    # The tolerance of a step, 1e-7 m, at speeds of 0.2 to 1 m/s and over tens of steps.
    (Adaptive(tolerance=1e-7), 2e-5),
])  # fmt: skip
@pytest.mark.parametrize("restitution", [0.5, 0.8, 1.0])
def test_A16_bounce_n_takes_2_v_e_n_over_g(restitution, stepper, tolerance):
    run = simulate(_ball(restitution, 1.0, 0.7), stepper=stepper)
    v = run.twist["ball"][:, 1]
    hits = run.time[1:][(v[1:] > 0) & (v[:-1] < 0)]
    expected = np.cumsum(2 * 1.0 / G * restitution ** np.arange(3))
    expected = expected[expected < 0.7]
    assert hits[: len(expected)] == pytest.approx(expected, abs=tolerance)


def _pair(m1, m2, v1, v2, restitution, friction=0.0, offset=0.0, duration=0.2):
    a = Body(name="a", shape=Disk(R), mass=m1, pose=(-0.1, 0, 0), velocity=(v1, 0, 0))
    b = Body(name="b", shape=Disk(R), mass=m2, pose=(0.1, offset, 0), velocity=(v2, 0, 0))
    entry = PairFriction(pair=("a", "b"), friction=friction, restitution=restitution)
    return Scene(bodies=(a, b), contact_friction=(entry,), duration=duration)


@pytest.mark.parametrize("e", [0.0, 0.4, 1.0])
@pytest.mark.parametrize(("m1", "m2"), [(1.0, 1.0), (1.0, 3.0), (1e3, 1e-3)])
@pytest.mark.parametrize("stepper", [Adaptive(), StewartTrinkle(step=1e-3)])
def test_A17_central_impact_of_two_discs(m1, m2, e, stepper):
    v1, v2 = 1.0, -0.5
    run = simulate(_pair(m1, m2, v1, v2, e), stepper=stepper)
    after = run.twist["a"][-1, 0], run.twist["b"][-1, 0]
    expected = (
        ((m1 - e * m2) * v1 + (1 + e) * m2 * v2) / (m1 + m2),
        ((m2 - e * m1) * v2 + (1 + e) * m1 * v1) / (m1 + m2),
    )
    # Exact law, solved to 1e-9 in scaled units; a mass ratio of 10^6 costs as many digits at most.
    # With e = 0 a gap left over within a step closes in the next one, which costs nothing here.
    tolerance = 1e-8 * max(m1, m2) / min(m1, m2) ** 0.5
    assert after == pytest.approx(expected, abs=min(tolerance, 1e-6) + 1e-8)
    momentum = m1 * after[0] + m2 * after[1]
    assert momentum == pytest.approx(m1 * v1 + m2 * v2, rel=1e-9, abs=1e-9)


def _thrown(friction, restitution, steep):
    velocity = (cos(steep), -sin(steep), 0)
    return _disc(3 * R, velocity, _wall(friction, restitution), duration=0.5)


@pytest.mark.parametrize("friction", [0.05, 0.1, 0.3, 1.0])
@pytest.mark.parametrize(("stepper", "restitution", "tolerance"), [
    # A plastic impact is found by the adaptive step to within rounding.
    (Adaptive(), 0.0, 1e-6),
    # The contact point lies on the wall, up to v h = 1e-5 m below the disc: 2e-4 of its radius.
    (StewartTrinkle(step=1e-5), 0.0, 4e-4),
    (StewartTrinkle(step=1e-5), 0.6, 4e-4),
    (Midpoint(step=1e-5), 0.6, 4e-4),
    # It takes a bounce in a step of its own, of 1e-7 of the scene's time.
    (Adaptive(), 0.6, 1e-6),
])  # fmt: skip
def test_A18_oblique_impact_sticks_iff_mu_reaches_pt_over_pn(
    friction, restitution, stepper, tolerance
):
    steep = 1.0
    run = simulate(_thrown(friction, restitution, steep), stepper=stepper, output_interval=0.1)
    v = run.twist["ball"][-1]
    p_n = (1 + restitution) * sin(steep)  # over the mass
    p_t = cos(steep) / 3  # a disc sticks at a third of m v_t
    sticks = friction >= p_t / p_n
    p_t = min(p_t, friction * p_n)
    assert sticks == (friction >= 0.3)
    expected = [cos(steep) - p_t, restitution * sin(steep), -p_t * R / (0.5 * R**2)]
    # Of the velocities of the throw: 1 m/s, or 1 m/s at the rim.
    assert np.abs((v - expected) * [1, 1, R]).max() < tolerance
    assert (abs(v[0] + R * v[2]) < tolerance) == sticks


def _totals(scene, run, k):
    """Momentum and spin about the origin."""
    total = np.zeros(3)
    for body in scene.bodies:
        (vx, vy, w), (x, y, _) = run.twist[body.name][k], run.pose[body.name][k]
        spin = body.moment_of_inertia * w + body.mass * (x * vy - y * vx)
        total += [body.mass * vx, body.mass * vy, spin]
    return total


@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_A18_discs_that_meet_off_centre_keep_momentum_and_spin(restitution):
    scene = _pair(1.0, 2.0, 1.0, -0.5, restitution, friction=0.3, offset=0.04)
    exact = simulate(scene, stepper=StewartTrinkle(step=1e-3))
    # Both bodies feel one force at one point, and rows are taken where the step starts.
    assert _totals(scene, exact, -1) == pytest.approx(_totals(scene, exact, 0), abs=1e-9)
    early = simulate(scene, stepper=Adaptive())
    # Rows are taken half a step later: spin is kept to within the arm that changes meanwhile, 2
    # mm, times the momentum that is exchanged, about 1 kg m/s.
    assert _totals(scene, early, -1)[:2] == pytest.approx(_totals(scene, exact, 0)[:2], abs=1e-9)
    assert _totals(scene, early, -1)[2] == pytest.approx(_totals(scene, exact, 0)[2], abs=2e-3)


def test_frictionless_bounce_forgets_nothing_of_the_spin():
    scene = _thrown(0.0, 1.0, 1.0)
    spun = replace(scene.bodies[0], velocity=(0.5, -0.8, 3.0))
    v = simulate(replace(scene, bodies=(spun,))).twist["ball"][-1]
    assert v == pytest.approx([0.5, 0.8, 3.0], abs=1e-8)
