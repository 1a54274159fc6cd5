"""The shift between tracker and robot, from tips that touch."""

import numpy as np
import pytest
from reproductions.registration import registration_from_gaps

from fixel import Disk, InvalidInput, Polygon
from fixel.model.overlap import gaps_and_normals

SQUARE = Polygon([[0.03, 0.03], [-0.03, 0.03], [-0.03, -0.03], [0.03, -0.03]])
RADIUS = 4.75e-3
SHIFT = np.array([1.1e-3, -0.7e-3])


def touching(shape, n, seed, sides=4):
    """Poses of a shape, and tips that touch it on the first so many sides."""
    rng = np.random.default_rng(seed)
    pose = np.column_stack((rng.uniform(-0.2, 0.2, (n, 2)), rng.uniform(-np.pi, np.pi, n)))
    if isinstance(shape, Disk):
        angle = rng.uniform(-np.pi, np.pi, n)
        reach = shape.radius + RADIUS
        local = reach * np.column_stack((np.cos(angle), np.sin(angle)))
    else:
        along = rng.uniform(-0.025, 0.025, n)
        turn = 0.5 * np.pi * rng.integers(0, sides, n)
        local = _turned(np.column_stack((np.full(n, 0.03 + RADIUS), along)), turn)
    return pose, pose[:, :2] + _turned(local, pose[:, 2])


def _turned(points, angle):
    c, s = np.cos(angle), np.sin(angle)
    x, y = points.T
    return np.column_stack((c * x - s * y, s * x + c * y))


def test_gaps_of_a_square_are_plain():
    pose = np.array([[0.1, 0.2, 0.5 * np.pi], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    tip = np.array([[0.1, 0.2 + 0.03 + RADIUS + 0.002], [0.03 + RADIUS - 0.001, 0.0], [0.029, 0.0]])
    gap, normal = gaps_and_normals(SQUARE, RADIUS, pose, tip)
    assert gap == pytest.approx([0.002, -0.001, -0.001 - RADIUS], abs=1e-12)
    assert normal == pytest.approx(np.array([[0.0, 1.0], [1.0, 0.0], [1.0, 0.0]]), abs=1e-9)


@pytest.mark.parametrize("shape", [SQUARE, Disk(0.03)], ids=["square", "disk"])
def test_a_known_shift_is_found(shape):
    pose, tip = touching(shape, 60, 1)
    noise = np.random.default_rng(2).normal(0.0, 0.1e-3, tip.shape)
    found = registration_from_gaps(shape, RADIUS, pose, tip - SHIFT + noise)
    assert found.shift == pytest.approx(SHIFT, abs=0.05e-3)
    assert found.scatter_after < 0.15e-3 < found.scatter_before


def test_tips_that_slid_off_count_nothing():
    pose, tip = touching(SQUARE, 80, 3)
    off = np.random.default_rng(4).uniform(0.5e-3, 20e-3, 30)
    _, normal = gaps_and_normals(SQUARE, RADIUS, pose, tip)
    tip[:30] += off[:, None] * normal[:30]
    found = registration_from_gaps(SQUARE, RADIUS, pose, tip - SHIFT)
    assert found.shift == pytest.approx(SHIFT, abs=0.15e-3)
    assert found.n_touching < 70


def test_what_is_left_open_stays_as_expected():
    pose, tip = touching(SQUARE, 20, 5, sides=1)
    pose[:, 2] = 0.0
    tip = pose[:, :2] + np.array([0.03 + RADIUS, 0.0])
    found = registration_from_gaps(SQUARE, RADIUS, pose, tip - SHIFT, prior=(0.0, 0.4e-3))
    assert found.shift == pytest.approx([SHIFT[0], 0.4e-3], abs=0.05e-3)


def test_tips_far_away_are_refused():
    pose, tip = touching(SQUARE, 5, 6)
    with pytest.raises(InvalidInput, match="no tip close to the object"):
        registration_from_gaps(SQUARE, RADIUS, pose, tip + 0.5)
