# Known answers A14 and A15: elementary; A14 as in Drake's inclined-plane test.
"""A block on a tilted table, and one on a spring."""

from dataclasses import replace
from math import atan, cos, radians, sin

import numpy as np
import pytest

from fixel.model import Body, Scene, Spring, Tripod
from fixel.simulation import Adaptive, Dynamic, Midpoint, QuasiStatic, StewartTrinkle, simulate
from fixel.testing.scenes import box

G = 9.81


def _slope(angle, friction, duration):
    mass = 0.3
    block = Body(
        name="block", shape=box(0.1, 0.06), mass=mass, pose=(0, 0, 0.2),
        support=Tripod(radius=0.02, friction=friction), force=(mass * G * sin(angle), 0, 0),
    )  # fmt: skip
    return Scene(bodies=(block,), gravity=G * cos(angle), duration=duration)


@pytest.mark.parametrize("friction", [0.1, 0.4])
@pytest.mark.parametrize("stepper", [Adaptive(), StewartTrinkle(), Midpoint()])
def test_A14_sticks_below_the_friction_angle(friction, stepper):
    run = simulate(_slope(atan(friction) * (1 - 1e-9), friction, 60.0), stepper=stepper)
    assert run.converged
    # Nothing but the residual of each step may move it: bound asked of sticking for a minute.
    assert np.abs(run.pose["block"][-1] - [0, 0, 0.2]).max() < 1e-9


@pytest.mark.parametrize("friction", [0.0, 0.1, 0.4])
def test_A14_slides_above_it(friction):
    angle = atan(friction) + radians(5)
    run = simulate(_slope(angle, friction, 0.5), stepper=Adaptive(tolerance=1e-6))
    expected = 0.5 * G * (sin(angle) - friction * cos(angle)) * 0.5**2
    # Gliding is exact under constant forces; 1e-6 is the tolerance of a step.
    assert run.pose["block"][-1][0] == pytest.approx(expected, abs=1e-6)
    assert run.twist["block"][-1, 0] == pytest.approx(2 * expected / 0.5, rel=1e-9)
    assert run.pose["block"][-1][2] == pytest.approx(0.2, abs=1e-9)


@pytest.mark.parametrize("motion", [Dynamic(), QuasiStatic()])
def test_A14_sticks_with_a_wrench_off_the_centre(motion):
    scene = _slope(0.1, 0.4, 60.0)
    pushed = replace(scene.bodies[0], force=(0.1, -0.2, 0.002))
    run = simulate(replace(scene, bodies=(pushed,)), motion=motion)
    assert np.abs(run.pose["block"][-1] - [0, 0, 0.2]).max() < 1e-9


def _oscillator(start, friction=0.1, duration=5.0):
    mass = 1.0
    block = Body(
        name="block", shape=box(0.1, 0.1), mass=mass, pose=(start, 0, 0),
        support=Tripod(radius=0.03, friction=friction),
        spring=Spring(stiffness=40.0, anchor=(0, 0)),
    )  # fmt: skip
    return Scene(bodies=(block,), duration=duration)


def test_A15_amplitude_falls_by_2_mu_m_g_over_k_each_half_cycle():
    drop = 2 * 0.1 * G / 40.0
    run = simulate(_oscillator(0.22), stepper=StewartTrinkle(step=2e-4))
    x, v = run.pose["block"][:, 0], run.twist["block"][:, 0]
    turns = np.nonzero((v[1:] * v[:-1] < 0) & (np.abs(v[:-1]) > 1e-9))[0]
    peaks = np.abs(np.concatenate(([0.22], x[turns], x[-1:])))[:5]
    # 0.22, 0.171, 0.122, 0.073, and 0.024: inside the dead band of 0.0245.
    assert len(peaks) == 5
    # The implicit spring damps: h k / m of the velocity each step, 2 % of an amplitude a half
    # cycle here.
    assert np.diff(peaks) == pytest.approx(-drop, abs=0.002)


@pytest.mark.parametrize("start", [0.22, 0.1, -0.3])
def test_A15_rests_inside_the_dead_band(start):
    band = 0.1 * G / 40.0
    scene = _oscillator(start)
    for stepper in (StewartTrinkle(step=1e-3), Adaptive(tolerance=1e-4)):
        run = simulate(scene, stepper=stepper)
        assert run.converged
        assert abs(run.pose["block"][-1][0]) <= band + 1e-9
        assert np.abs(run.twist["block"][-1]).max() < 1e-9


@pytest.mark.parametrize("start", [-0.0245, 0.0, 0.01, 0.0245])
def test_A15_stays_anywhere_inside_the_dead_band(start):
    run = simulate(_oscillator(start, duration=60.0))
    assert abs(run.pose["block"][-1][0] - start) < 1e-9
