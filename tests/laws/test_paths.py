"""A pusher's path is followed to its corners, whatever the stepper does between them."""

import numpy as np
import pytest

from fixel.model import Body, Disk, PathDrive, Pusher, Scene, Tripod
from fixel.simulation import Adaptive, Dynamic, Midpoint, QuasiStatic, StewartTrinkle, simulate
from fixel.testing.scenes import box, row

FACE = 0.055  # [m] where the finger, 5 mm in radius, touches the square


def _pushed(waypoints, force_limit=None, duration=None) -> Scene:
    waypoints = np.asarray(waypoints, float)
    drive = PathDrive(waypoints=waypoints, force_limit=force_limit)
    finger = Pusher(name="finger", shape=Disk(0.005), pose=None, drive=drive, friction=0.3)
    square = Body(
        name="square",
        shape=box(0.1, 0.1),
        mass=0.2,
        pose=row(FACE, 0.0, 0.0),
        support=Tripod(radius=0.03, friction=0.3),
    )
    return Scene(bodies=(square,), pushers=(finger,), duration=duration or float(waypoints[-1, 0]))


def _final(scene, **method):
    run = simulate(scene, output_interval=scene.duration, **method)
    assert run.converged
    return run.pose["square"][-1]


@pytest.mark.parametrize("force_limit", [None, 20.0])
@pytest.mark.parametrize("back", [0.01, 0.03, 0.5])
@pytest.mark.parametrize("turn", [1.0, 1.37, 3.0])
def test_a_finger_that_turns_back_has_pushed_as_far_as_it_went(turn, back, force_limit):
    reach = 0.01 * turn
    path = [[0, 0, 0, 0], [turn, reach, 0, 0], [turn + 0.02 / back, reach - 0.02, 0, 0]]
    x = _final(_pushed(path, force_limit), motion=QuasiStatic())[0]
    assert x == pytest.approx(FACE + reach, abs=1e-6)
    # Let go at 10 mm/s, it slides for another v^2 / (2 mu g) at most.
    x = _final(_pushed(path, force_limit), motion=Dynamic())[0]
    assert -1e-6 < x - FACE - reach < 0.01**2 / (2 * 0.3 * 9.81) + 2e-6


def test_a_line_that_ends_leaves_the_part_there():
    path = [[0, 0, 0, 0], [1.234, 0.01234, 0, 0]]
    scene = _pushed(path, duration=5.0)
    assert _final(scene, motion=QuasiStatic())[0] == pytest.approx(FACE + 0.01234, abs=1e-7)


@pytest.mark.parametrize("motion", [QuasiStatic(), Dynamic()])
@pytest.mark.parametrize("corner", [(0.0, 0.06, 0.0), (0.06, 0.06, 0.0), (-0.06, 0.0, 0.0)])
def test_a_stalled_finger_pushes_as_hard_as_it_can_whatever_corner_lies_ahead(corner, motion):
    """Friction holds the square with up to 0.59 N, more than the finger has."""
    path = [[0, 0, 0, 0], [1.0, 0.04, 0, 0], [1.2, *corner]]
    run = simulate(_pushed(path, 0.2, duration=3.0), motion=motion, output_interval=0.1)
    finger = run.pushers["finger"]
    assert finger.stalled[1:].all()
    assert finger.force[1:] == pytest.approx(np.full(30, 0.2), rel=1e-9)


def _polyline(seed: int, n: int = 9) -> np.ndarray:
    """Random turns with reversals, standstills and changes of speed, in and out of contact."""
    rng = np.random.default_rng(seed)
    span = rng.uniform(0.1, 1.0, n)
    step = rng.uniform(-0.008, 0.012, (n, 2)) * [1.0, 0.4]
    step[rng.random(n) < 0.15] = 0.0
    path = np.zeros((n + 1, 4))
    path[1:, 0] = np.cumsum(span)
    path[1:, 1:3] = np.cumsum(step, axis=0)
    return path


def _apart(one, other) -> float:
    """Distance of two poses [m], angles counted at the radius of gyration."""
    return float(np.abs((one - other) * [1.0, 1.0, 0.041]).max())


def _compare(seed: int) -> None:
    """Against steps of Stewart and Trinkle: one in a million of `Midpoint` finds no solution."""
    path = _polyline(seed)
    scene = _pushed(path)
    own = _final(scene, motion=QuasiStatic())
    fixed = _final(scene, motion=QuasiStatic(), stepper=StewartTrinkle(step=path[-1, 0] / 20_000))
    assert _apart(own, fixed) < 2e-5
    retimed = path.copy()
    rng = np.random.default_rng(seed + 1)
    retimed[1:, 0] = np.cumsum(np.diff(path[:, 0]) * np.exp(rng.uniform(-1.5, 1.5, len(path) - 1)))
    assert _apart(own, _final(_pushed(retimed), motion=QuasiStatic())) < 2e-5


@pytest.mark.parametrize("seed", range(8))
def test_random_paths_end_as_with_fine_fixed_steps_however_they_are_timed(seed):
    _compare(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 400))
def test_many_random_paths_end_as_with_fine_fixed_steps_however_they_are_timed(seed):
    _compare(seed)


def test_a_measured_path_of_hundreds_of_frames_costs_a_few_steps_a_frame():
    """Noise makes a corner of every frame; a straight path sampled as finely has none."""
    time = np.linspace(0.0, 4.0, 401)
    path = np.zeros((401, 4))
    path[:, 0], path[:, 1] = time, 0.01 * time
    assert simulate(_pushed(path), motion=QuasiStatic()).steps < 100
    path[1:, 1:3] += np.random.default_rng(3).normal(0.0, 2e-5, (400, 2))
    scene = _pushed(path)
    noisy = simulate(scene, motion=QuasiStatic())
    assert noisy.converged
    assert noisy.steps < 8 * 400
    fixed = _final(scene, motion=QuasiStatic(), stepper=Midpoint(step=0.0005))
    assert _apart(noisy.pose["square"][-1], fixed) < 2e-5


def test_a_tolerance_decides_how_straight_a_path_is():
    """A fine wave along the way is followed or ignored, as the tolerance says."""
    time = np.linspace(0.0, 2.0, 201)
    path = np.zeros((201, 4))
    path[:, 0], path[:, 1] = time, 0.01 * time
    path[:, 2] = 1e-6 * np.sin(40.0 * time)
    scene = _pushed(path)
    coarse = simulate(scene, motion=QuasiStatic(), stepper=Adaptive(tolerance=1e-5))
    fine = simulate(scene, motion=QuasiStatic(), stepper=Adaptive(tolerance=1e-8))
    assert coarse.steps < 60
    assert fine.steps >= 200
