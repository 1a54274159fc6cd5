"""A force-limited finger yields to what pushes it back, wherever its command is."""

import numpy as np
import pytest

from fixel.model import Body, Disk, LineDrive, NoSupport, PathDrive, Pusher, Scene, Tripod
from fixel.simulation import Adaptive, StewartTrinkle, simulate
from fixel.testing.scenes import box, row

REACH = 0.055  # [m] between the centres of a square and of a finger that touch
LIMIT = 1.0  # [N]


def _waiting(x: float, heading: float) -> dict[str, PathDrive | LineDrive]:
    """Drives that wait at x before a part arrives, and would move along `heading`."""
    ahead = heading * 0.02
    direction = row(heading, 0)
    return {
        "at rest": LineDrive(direction, speed=0.0, force_limit=LIMIT),
        "without travel": LineDrive(direction, speed=0.1, travel=0.0, force_limit=LIMIT),
        "arrived": PathDrive([[0, x - ahead, 0, 0], [1e-2, x, 0, 0]], force_limit=LIMIT),
        "not begun": PathDrive([[9.0, x, 0, 0], [10.0, x + ahead, 0, 0]], force_limit=LIMIT),
        "paused": PathDrive(
            [[0, x - ahead, 0, 0], [1e-2, x, 0, 0], [9, x, 0, 0], [10, x + ahead, 0, 0]],
            force_limit=LIMIT,
        ),
    }


def _finger(name: str, x: float, drive: PathDrive | LineDrive) -> Pusher:
    return Pusher(name=name, shape=Disk(0.005), pose=row(x, 0, 0), drive=drive, friction=0.3)


def _thrown(drive: PathDrive | LineDrive, duration: float = 2.0):
    """Square that slides without friction at -0.5 m/s towards a finger 45 mm before it."""
    square = Body(
        name="square", shape=box(0.1, 0.1), mass=0.5, pose=row(0, 0, 0),
        velocity=row(-0.5, 0, 0), support=NoSupport(),
    )  # fmt: skip
    scene = Scene(bodies=(square,), pushers=(_finger("finger", -0.1, drive),), duration=duration)
    run = simulate(scene, motion="dynamic", stepper=Adaptive(tolerance=1e-8))
    assert run.converged
    assert run.max_residual < 1e-9
    gap = run.pose["square"][:, 0] - run.pose["finger"][:, 0] - REACH
    assert gap.min() > -1e-5
    return run


@pytest.mark.parametrize("kind", _waiting(0.0, 1.0))
def test_a_thrown_part_stops_where_the_limit_has_taken_its_energy(kind):
    run = _thrown(_waiting(-0.1, 1.0)[kind])
    stopped = -0.045 - 0.5 * 0.5**2 / (2.0 * LIMIT)
    assert run.pose["square"][-1, 0] == pytest.approx(stopped, abs=2e-5)
    assert run.pose["finger"][-1, 0] == pytest.approx(stopped - REACH, abs=2e-5)


def test_a_moving_finger_is_pushed_behind_its_start_and_returns():
    speed = 0.1
    run = _thrown(LineDrive(speed=speed, force_limit=LIMIT))
    met = 0.045 / (0.5 + speed)
    turned = (0.5 + speed) * 0.5 / LIMIT  # time until the part moves with the finger
    end = -0.5 * (met + turned) + LIMIT * turned**2 / (2.0 * 0.5) + speed * (2.0 - met - turned)
    assert run.pose["finger"][:, 0].min() < -0.12  # behind its start
    assert run.pose["square"][-1, 0] == pytest.approx(end, abs=3e-4)
    assert run.pose["finger"][-1, 0] == pytest.approx(end - REACH, abs=3e-4)


@pytest.mark.parametrize("motion", ["quasistatic", "dynamic"])
@pytest.mark.parametrize("kind", [*_waiting(0.0, -1.0), "moving"])
def test_a_part_between_two_fingers_pushes_the_weaker_one_back(kind, motion):
    weak = {**_waiting(0.06, -1.0), "moving": LineDrive((-1, 0), speed=0.02, force_limit=LIMIT)}
    path = [[0, -0.0551, 0, 0], [3, -0.0251, 0, 0], [3.5, -0.0551, 0, 0]]
    square = Body(
        name="square", shape=box(0.1, 0.1), mass=0.2, pose=row(0, 0, 0),
        support=Tripod(radius=0.03, friction=0.3),
    )  # fmt: skip
    strong = _finger("strong", 0, PathDrive(path))
    scene = Scene(
        bodies=(square,), pushers=(strong, _finger("weak", 0.06, weak[kind])), duration=3.5
    )
    run = simulate(scene, motion=motion)
    assert run.converged
    x, finger = run.pose["square"][:, 0], run.pose["weak"][:, 0]
    assert np.min(finger - x) > REACH - 1e-5
    assert np.max(x) == pytest.approx(0.0299, abs=5e-5)
    # Follows the strong finger, which is faster, and needs 0.2 mm to accelerate the square.
    back = 0.02 * 0.5 if kind == "moving" else 0.0
    assert finger[-1] == pytest.approx(0.0299 + REACH - back, abs=3e-4)


def test_a_finger_dragged_past_its_end_moves_as_far_as_its_velocity_says():
    """Friction of a disk that is thrown past drags it, faster than its own 2 mm/s."""
    step = 0.01
    disk = Body(
        name="disk", shape=Disk(0.02), mass=0.2, pose=row(0.05, -0.02, 0),
        velocity=row(-0.3, 0.5, 0), support=NoSupport(),
    )  # fmt: skip
    drive = LineDrive((0, 1), speed=2e-3, travel=5e-4, force_limit=1e-2)
    wall = Pusher(name="wall", shape=box(0.02, 0.2), pose=row(0, 0, 0), drive=drive, friction=1.0)
    scene = Scene(bodies=(disk,), pushers=(wall,), duration=0.4)
    run = simulate(scene, motion="dynamic", stepper=StewartTrinkle(step=step))
    assert run.converged
    moved, velocity = np.diff(run.pose["wall"][:, 1]), run.twist["wall"][1:, 1]
    assert velocity.max() > 0.1
    assert run.pose["wall"][-1, 1] > 0.01  # far past its end
    assert moved == pytest.approx(step * velocity, abs=1e-12)
