"""Accelerated motion along a wall has closed forms, which the default stepper meets to its
tolerance."""

from math import cos, sqrt

import numpy as np
import pytest

from fixel.model import Body, Fixel, FrictionMap, NoSupport, Plane, Scene, UniformPressure
from fixel.simulation import Adaptive, simulate
from fixel.testing.scenes import box, row

MASS, PRESS, PULL, WALL = 0.5, 1.0, 1.0, 0.3  # kg, N, N, friction of the wall
ARM = 0.03  # [m] from the wall to the centre of mass


def _along_a_wall(duration, speed=0.0, pull=PULL, press=PRESS, support=None, plane=None):
    """A block that a force presses on a wall and pulls along it, without turning it."""
    block = Body(
        name="block", shape=box(0.1, 2.0 * ARM), mass=MASS, pose=row(0.0, ARM, 0.0),
        velocity=row(speed, 0.0, 0.0), force=row(pull, -press, -WALL * press * ARM),
        support=support or NoSupport(),
    )  # fmt: skip
    wall = Fixel(name="wall", shape=box(40.0, 0.02), pose=row(10.0, -0.01, 0.0), friction=WALL)
    return Scene(bodies=(block,), fixels=(wall,), duration=duration, plane=plane or Plane())


def _run(scene, tolerance):
    run = simulate(scene, stepper=Adaptive(tolerance=tolerance))
    assert run.converged
    return run


def _end(scene, tolerance):
    return _run(scene, tolerance).pose["block"][-1]


@pytest.mark.parametrize("duration", [0.5, 2.0])
@pytest.mark.parametrize("tolerance", [None, 1e-5, 1e-6, 1e-7, 1e-8])
def test_a_block_dragged_along_a_wall_moves_by_half_a_t_squared(duration, tolerance):
    way = 0.5 * (PULL - WALL * PRESS) / MASS * duration**2
    x, y, angle = _end(_along_a_wall(duration), tolerance)
    assert x == pytest.approx(way, abs=3.0 * (tolerance or 1.2e-6))
    assert y == pytest.approx(ARM, abs=1e-8)
    assert angle == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize("tolerance", [None, 1e-5, 1e-6, 1e-7])
def test_a_block_slides_to_rest_along_a_wall(tolerance):
    slowing = WALL * PRESS / MASS
    x = _end(_along_a_wall(2.5, speed=1.0, pull=0.0), tolerance)[0]
    assert x == pytest.approx(1.0 / (2.0 * slowing), abs=5.0 * (tolerance or 1.2e-6))


@pytest.mark.parametrize("tolerance", [None, 1e-5, 1e-6])
def test_a_block_dragged_onto_rougher_ground_swings(tolerance):
    """The plane's friction grows with x: x'' = a - w^2 x, until the block turns."""
    slope, friction = 4.0, 0.1  # [1/m] of the friction map
    factor = np.tile(1.0 + slope * np.linspace(-0.2, 2.0, 45), (2, 1))
    ground = Plane(friction_map=FrictionMap(factor=factor, origin=(-0.2, -1.0), cell=(0.05, 2.0)))
    press = 0.5
    scene = _along_a_wall(
        0.8, pull=2.0, press=press, support=UniformPressure(friction=friction), plane=ground
    )
    start = (2.0 - WALL * press) / MASS - friction * 9.81
    swing = sqrt(friction * 9.81 * slope)
    way = start / swing**2 * (1.0 - cos(swing * 0.8))
    run = _run(scene, tolerance)
    # A tolerance for each step.
    assert run.pose["block"][-1, 0] == pytest.approx(way, abs=run.steps * (tolerance or 1.2e-6))
