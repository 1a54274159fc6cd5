"""Support points from made-up pushes whose supports are known, and the parts on the way there."""

import math

import numpy as np
import pytest
from reproductions import cmu_tripod
from reproductions.tripod_pushes import GRAVITY, SAMPLES, STEP, TripodPush, fit_points, unit_forces

from fixel import Body, Disk, LineDrive, Polygon, Pusher, Scene, StewartTrinkle, SupportPoints
from fixel.calibration.least_squares import LeastSquares
from fixel.calibration.target import Target
from fixel.simulation.ensemble import Ensemble
from fixel.simulation.rollouts import RolloutCase

OUTLINE = np.array([[-0.05, -0.05], [0.1, -0.05], [-0.05, 0.1]])
POINTS = np.array([[-0.02, -0.02], [0.04, -0.02], [-0.02, 0.04]])
MU = {"hardboard": 0.28, "plywood": 0.34}
MU_FINGER = 0.5
DURATION = 6.0


def scene(place, slant, mu):
    """A finger against the edge y = -50 mm or x = -50 mm, at a place from -1 to 1 along it."""
    upright = place > 0.0
    along = -0.03 + 0.1 * abs(place)
    start = (-0.0511, along) if upright else (along, -0.0511)
    heading = slant + (0.0 if upright else 0.5 * math.pi)
    block = Body(
        name="block", shape=Polygon(OUTLINE), mass=1.518, centre_of_mass=np.zeros(2),
        pose=np.zeros(3), support=SupportPoints(points=POINTS, friction=mu),
    )  # fmt: skip
    finger = Pusher(
        name="finger",
        shape=Disk(0.001),
        pose=np.array([*start, 0.0]),
        drive=LineDrive(
            direction=np.array([math.cos(heading), math.sin(heading)]), speed=0.0025, travel=0.015
        ),
        friction=MU_FINGER,
    )
    return Scene(bodies=(block,), pushers=(finger,), duration=DURATION)


@pytest.fixture(scope="module")
def pushes():
    made = []
    for k, place in enumerate((-0.95, -0.7, -0.45, -0.2, -0.05, 0.05, 0.2, 0.45, 0.7, 0.95)):
        surface = "plywood" if k % 2 else "hardboard"
        times = np.linspace(0.0, DURATION, SAMPLES + 1)[1:]
        case = RolloutCase(scene(place, 0.3 * (-1) ** k, MU[surface]), times)
        way = Ensemble([case], stepper=StewartTrinkle(step=STEP)).simulate(np.zeros(1, int), {})
        full = np.concatenate((np.zeros((1, 1, 3)), way.pose), axis=1)
        unit = unit_forces(full, POINTS[None], np.full((1, 3), 1 / 3))[0]
        conditions = {"support": "3pts3", "surface": surface}
        target = Target(f"made/{k}", conditions, case, np.tile(way.pose[0, -1], (SAMPLES, 1)))
        made.append(TripodPush(target, MU[surface] * 1.518 * GRAVITY * unit))
    return made


@pytest.fixture(scope="module")
def found(pushes):
    options = LeastSquares(starts=2, most_iterations=25)
    return fit_points(pushes, options, forces=True)


def test_exact_poses_and_forces_give_the_points_back(found):
    # The model made the data: what is left is where the search ends.
    assert np.hypot(*(found.points - POINTS).T).max() < 1e-3


def test_and_the_friction_of_finger_and_surfaces(found):
    assert found.values["mu_pusher"] == pytest.approx(MU_FINGER, abs=0.02)
    assert found.friction == pytest.approx(MU, abs=0.005)


def test_known_points_leave_only_the_finger_to_fit(pushes):
    known = fit_points(pushes, LeastSquares(most_iterations=15), forces=False, known=True)
    np.testing.assert_array_equal(known.points, POINTS)
    # The finger sticks in most of these pushes: any friction that holds it does.
    assert known.values["mu_pusher"] > 0.35
    assert known.deviance < 0.1


def test_friction_of_the_surface_from_forces(pushes):
    rows = cmu_tripod.surface_friction(pushes, MU_FINGER)
    found = {row["surface"]: row["mu"] for row in rows if row["support"] == "all"}
    assert found == pytest.approx(MU, abs=1e-4)


def test_force_of_a_block_that_only_slides_is_its_friction_along_the_way():
    way = np.array([[[0.0, 0.0, 0.3], [3e-3, 4e-3, 0.3]]])
    force = unit_forces(way, POINTS[None], np.full((1, 3), 1 / 3))
    np.testing.assert_allclose(force, [[[0.6, 0.8]]], atol=1e-12)


def test_a_block_that_turns_about_its_centre_needs_no_force():
    points = 0.03 * np.array([[[1.0, 0.0], [-0.5, 0.75**0.5], [-0.5, -(0.75**0.5)]]])
    way = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]])
    force = unit_forces(way, points, np.full((1, 3), 1 / 3))
    np.testing.assert_allclose(force, 0.0, atol=1e-12)


def test_no_motion_no_force():
    force = unit_forces(np.zeros((1, 3, 3)), POINTS[None], np.full((1, 3), 1 / 3))
    np.testing.assert_array_equal(force, 0.0)
