"""Round tips next to outlines: gaps, and the shortest way out."""

import math

import numpy as np
import pytest

from fixel.datasets.contact import corrected_path, moved_to_contact
from fixel.model import Disk, Polygon

SQUARE = Polygon(np.array([[0.03, 0.03], [-0.03, 0.03], [-0.03, -0.03], [0.03, -0.03]]))
TURNED = np.array([[0.5, 0.2, math.pi / 2]])


@pytest.mark.parametrize(("shape", "local", "gap", "way"), [
    (SQUARE, (0.040, 0.0), 0.005, (0.0, 0.0)),
    (SQUARE, (0.034, 0.0), -0.001, (0.001, 0.0)),
    (SQUARE, (0.033, 0.033), 0.003 * math.sqrt(2) - 0.005, (0.000536, 0.000536)),
    (SQUARE, (0.0, -0.028), -0.007, (0.0, -0.007)),
    (Disk(0.03), (0.0, 0.034), -0.001, (0.0, 0.001)),
    (Disk(0.03), (0.0, 0.036), 0.001, (0.0, 0.0)),
])  # fmt: skip
def test_tips_leave_along_the_normal(shape, local, gap, way):
    """The object is turned a quarter: its x is the y of the world, its y the -x."""
    tip = np.array([[0.5 - local[1], 0.2 + local[0]]])
    found, offset = moved_to_contact(shape, 0.005, TURNED, tip)
    assert found == pytest.approx([gap])
    assert offset[0] == pytest.approx([-way[1], way[0]], abs=1e-6)
    after, _ = moved_to_contact(shape, 0.005, TURNED, tip + offset)
    assert after[0] >= 0.0


def test_a_correction_fades():
    path = np.column_stack((np.arange(5.0), np.zeros((5, 3))))
    offset = np.array([1.0, -2.0])
    assert corrected_path(path, offset)[:, 1] == pytest.approx([1.0, 0.75, 0.5, 0.25, 0.0])
    assert corrected_path(path, offset, 2.0)[:, 2] == pytest.approx([-2.0, -1.0, 0.0, 0.0, 0.0])
    assert corrected_path(path[:1], offset)[0, 1:3].tolist() == [1.0, -2.0]
    assert not path[:, 1:].any()


@pytest.mark.parametrize("size", [1.0, 1e-3, 1e-6, 1e-9])
def test_small_objects_are_corrected_as_large_ones(size):
    square = Polygon(size * SQUARE.vertices)
    tip = size * np.array([[0.5, 0.234], [0.5, 0.24], [0.5, 0.235 + 1e-17]])
    gap, offset = moved_to_contact(square, 0.005 * size, TURNED * (size, size, 1.0), tip)
    assert gap / size == pytest.approx([-0.001, 0.005, 0.0], abs=1e-12)
    expected = [[0.0, 0.001], [0.0, 0.0], [0.0, 0.0]]
    assert offset / size == pytest.approx(np.array(expected), abs=1e-7)


def test_contact_up_to_rounding_is_no_overlap():
    tip = np.array([[0.3 + (0.235 - 1e-16 * k), 0.2] for k in range(8)])
    gap, offset = moved_to_contact(SQUARE, 0.005, TURNED, tip)
    assert not gap.any()
    assert not offset.any()
