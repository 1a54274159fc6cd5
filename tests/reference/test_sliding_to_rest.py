# Known answers A1-A4 and A21: elementary mechanics of Coulomb friction on a plane; for A4 Z.
# Farkas, G. Bartels, T. Unger, D. E. Wolf (2003), Frictional coupling between sliding and spinning
# motion.
"""Blocks and disks that slide, spin or both, until friction stops them."""

from dataclasses import replace

import numpy as np
import pytest

from fixel.model import Body, Disk, Polygon, Scene, Tripod, UniformPressure, support_points
from fixel.simulation import Adaptive, StewartTrinkle, simulate
from fixel.testing.scenes import box, sliding_block, spinning_disk

G = 9.81


@pytest.mark.parametrize(("speed", "friction"), [(0.5, 0.25), (0.05, 0.6), (2.0, 0.1)])
@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_A1_block_stops_after_v2_over_2_mu_g(speed, friction, heading):
    scene = sliding_block(speed, friction, heading, duration=1.5 * speed / (friction * G))
    moved = simulate(scene).pose["block"][-1]
    expected = speed**2 / (2 * friction * G)
    # The adaptive step glides exactly under constant friction; only the step in which it stops
    # errs, by its own tolerance of a thousandth of the characteristic length (0.04 m).
    assert np.hypot(*moved[:2]) == pytest.approx(expected, abs=4e-5)
    assert np.arctan2(moved[1], moved[0]) == pytest.approx(heading, abs=1e-9)
    assert moved[2] == pytest.approx(0.0, abs=1e-9)


def test_A1_block_stops_after_v_over_mu_g_seconds():
    run = simulate(sliding_block(0.5, 0.25), stepper=StewartTrinkle(step=1e-3))
    moving = np.hypot(*run.twist["block"][:, :2].T) > 1e-9
    # Read off samples a step apart.
    assert run.time[moving].max() == pytest.approx(0.5 / (0.25 * G), abs=1.1e-3)


def test_A2_spinning_disk_stops_after_3_R_spin_over_4_mu_g_seconds():
    scene = spinning_disk(spin=10.0, friction=0.25, n_points=1024)
    expected = 3 * 0.05 * 10.0 / (4 * 0.25 * G)
    run = simulate(scene, stepper=StewartTrinkle(step=1e-3))
    moving = np.abs(run.twist["disk"][:, 2]) > 1e-9
    # One step, and 2e-4 of quadrature.
    assert run.time[moving].max() == pytest.approx(expected, abs=1.2e-3)
    # Half the first spin over the whole time; the friction torque is constant.
    final = simulate(scene, stepper=Adaptive(tolerance=1e-6)).pose["disk"][-1]
    assert final[2] == pytest.approx(0.5 * 10.0 * expected, rel=1e-3)


_PENTAGON = Polygon([[np.cos(a), np.sin(a)] for a in 2 * np.pi * np.arange(5) / 5])
_SIDE = 2 * np.sin(np.pi / 5)


@pytest.mark.parametrize(("shape", "expected"), [
    (Disk(1.0), 2 / 3),
    (box(1.0, 1.0), (np.sqrt(2) + np.log(1 + np.sqrt(2))) / 6),
    (box(0.1075, 0.1075), 0.04113),  # the thesis's square
    (box(842e-6, 1621e-6), 485.5e-6),  # the part of the 2006 paper
    (_PENTAGON, 0.49644 * _SIDE),
    (box(1e-4, 1.0), 0.25),
])  # fmt: skip
def test_A3_mean_distance_of_a_footprint_from_its_centre(shape, expected):
    pressure = UniformPressure(friction=0.3, n_points=4096)
    points, loads, _ = support_points(pressure, shape, shape.centroid, 1.0, 1.0)
    # Printed with four digits; the quadrature of 4096 cells is good for three or four.
    assert loads @ np.hypot(*points.T) == pytest.approx(expected, rel=5e-4)


def test_A3_tripod_at_the_mean_distance_spins_down_like_the_disk():
    disk = spinning_disk(n_points=1024)
    tripod = replace(disk.bodies[0], support=Tripod(radius=2 / 3 * 0.05, friction=0.25))
    stepper = StewartTrinkle(step=1e-3)
    a = simulate(disk, stepper=stepper).pose["disk"][-1]
    b = simulate(replace(disk, bodies=(tripod,)), stepper=stepper).pose["disk"][-1]
    assert b[2] == pytest.approx(a[2], rel=5e-4)  # quadrature


@pytest.mark.parametrize("ratio", [0.4, 0.653, 1.2])
def test_A4_disk_stops_sliding_and_spinning_together_at_ratio_0_653(ratio):
    spin = 10.0
    scene = spinning_disk(spin=spin, speed=ratio * 0.05 * spin, n_points=1024)
    run = simulate(scene, stepper=Adaptive(tolerance=1e-7))
    twist = run.twist["disk"]
    now = np.abs(twist[:, 0]) / (0.05 * np.abs(twist[:, 2]) + 1e-300)
    speed = np.abs(twist[:, 0]) / 0.05 + np.abs(twist[:, 2])
    moving = speed > 0.02 * speed[0]
    distance = np.abs(now[moving] - 0.653)
    # From the fixed point it stays there; from elsewhere it comes closer all the way, slowly:
    # about half way by the time a fiftieth of the speed is left. 0.005 is what 1024 points make of
    # 0.65300.
    assert distance[-1] < max(0.5 * abs(ratio - 0.653), 0.005)
    assert (np.diff(distance) < 2e-3).all()
    stopped = speed < 1e-9
    assert stopped.any()
    # Together: no sample has one motion without the other.
    assert not ((np.abs(twist[:, 2]) < 1e-9) ^ (np.abs(twist[:, 0]) < 1e-9)).any()


def _stops(scene, steps):
    name = scene.bodies[0].name
    return np.array([simulate(scene, stepper=StewartTrinkle(step=h)).pose[name][-1] for h in steps])


@pytest.mark.parametrize("scene", [
    sliding_block(0.5, 0.25, duration=0.3),
    spinning_disk(10.0, n_points=256, duration=0.3),
    spinning_disk(10.0, speed=0.3, n_points=256, duration=0.3),
], ids=["A1", "A2", "A4"])  # fmt: skip
def test_A21_error_of_the_first_order_step_halves_with_the_step(scene):
    steps = 0.02 / 2.0 ** np.arange(5)
    fine = _stops(scene, np.array([steps[-1] / 32]))[0]
    error = np.linalg.norm((_stops(scene, steps) - fine) * [1.0, 1.0, 0.05], axis=1)
    slope = np.polyfit(np.log(steps), np.log(error), 1)[0]
    # 0.9 to 1.1 is asked for by the list of known answers; a fine reference of the same scheme
    # leans the slope by 1/64.
    assert 0.9 < slope < 1.12


def test_block_thrown_across_the_plane_at_rest_stays_at_rest():
    body = Body(
        name="b", shape=box(0.1, 0.1), mass=1.0, pose=(0, 0, 0),
        support=Tripod(radius=0.03, friction=0.3),
    )  # fmt: skip
    run = simulate(Scene(bodies=(body,), duration=5.0))
    assert np.array_equal(run.pose["b"][-1], np.zeros(3))
