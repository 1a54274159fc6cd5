"""The way of the head past the part, checked by points along it instead of distances of shapes."""

from itertools import pairwise

import numpy as np
import pytest
from matplotlib.path import Path as Outline

from fixel.workflows.bench.devices import clear_way

SQUARE = 0.05 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
ELL = np.array([[0, 0], [0.08, 0], [0.08, 0.02], [0.02, 0.02], [0.02, 0.08], [0, 0.08]])
ROOM = 0.012


def nearest(outline, points):
    """Distance of points to a dense sampling of an outline; 0 inside."""
    ends = np.roll(outline, -1, axis=0)
    share = np.linspace(0.0, 1.0, 400)[:, None, None]
    dense = (outline + share * (ends - outline)).reshape(-1, 2)
    apart = np.hypot(*(points[:, None] - dense[None]).transpose(2, 0, 1)).min(axis=1)
    return np.where(Outline(outline).contains_points(points), 0.0, apart)


@pytest.mark.parametrize("outline", [SQUARE, ELL], ids=["square", "ell"])
@pytest.mark.parametrize("seed", range(40))
def test_a_way_ends_at_its_end_and_keeps_its_distance(outline, seed):
    rng = np.random.default_rng(seed)
    places = rng.uniform(-0.2, 0.2, (50, 2))
    here, there = places[nearest(outline, places) > ROOM][:2]
    way = clear_way(outline, here, there, ROOM)
    assert way is not None
    assert np.array_equal(way[-1], there)
    corners = np.array([here, *way])
    along = np.concatenate([
        a + np.linspace(0.0, 1.0, 300)[:, None] * (b - a)
        for a, b in pairwise(corners)
    ])  # fmt: skip
    assert nearest(outline, along).min() > ROOM - 2e-4


def test_a_start_that_touches_the_part_is_reached_from_outside():
    here, there = np.array([-0.2, 0.0]), np.array([0.056, 0.01])
    way = clear_way(SQUARE, here, there, ROOM)
    assert way is not None
    assert len(way) > 1
    last = way[-2] + np.linspace(0.0, 1.0, 300)[:, None] * (there - way[-2])
    assert nearest(SQUARE, last).min() > 0.0059


def test_a_head_in_a_notch_that_it_cannot_leave_has_no_way():
    cup = np.array([[0, 0], [0.1, 0], [0.1, 0.1], [0.09, 0.1], [0.09, 0.01], [0.01, 0.01],
                    [0.01, 0.1], [0.0, 0.1]])  # fmt: skip
    assert clear_way(cup, np.array([0.05, 0.05]), np.array([0.05, -0.1]), 0.045) is None
