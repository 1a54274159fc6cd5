"""Features of the nearest pushes with known errors, where the answer is known by hand."""

import numpy as np
import pytest
from reproductions.residuals import neighbour_features

from fixel.errors import InvalidInput


def test_neighbours_tell_how_far_off_they_were_and_whether_they_agree():
    place = np.array([[0.0], [1.0], [2.0], [10.0]])
    same = np.tile([1e-3, 0.0, 0.0], (4, 1))
    mixed = same * np.array([[1.0], [-1.0], [1.0], [-1.0]])
    names = ("nearest", "near_error", "near_common")
    agree = neighbour_features(place[:1] + 0.5, place, same, 2).columns(names)
    np.testing.assert_allclose(agree, [[0.5, 1e-3, 1e-3]])
    differ = neighbour_features(place[:1] + 0.5, place, mixed, 2).columns(names)
    np.testing.assert_allclose(differ, [[0.5, 1e-3, 0.0]], atol=1e-12)


def test_no_row_is_a_neighbour_of_itself():
    place = np.arange(4.0)[:, None]
    residual = np.diag([5e-3, 1e-3, 1e-3])[[0, 1, 2, 2]]
    itself = np.array([0, -1, -1, -1])
    found = neighbour_features(place, place, residual, 1, itself).columns(
        ("nearest", "nearest_error")
    )
    np.testing.assert_allclose(found[0], [1.0, 1e-3])
    np.testing.assert_allclose(found[1], [0.0, 1e-3])
    with pytest.raises(InvalidInput, match="at least two"):
        neighbour_features(place, place[:1], residual[:1])
