"""Contacts of one pair of convex pieces: known values and degenerate cases, both argument orders.

Tolerances: coordinates of order one, so 1e-12 is a thousand roundings.
"""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from tests.fixtures import refused
from tests.kernels.entries import measure_contacts
from tests.kernels.test_contacts import regular

from fixel.kernels.gap import COINCIDENT, FIRST_VERTEX, VERTEX_VERTEX, separating_edge
from fixel.kernels.jit import entry
from fixel.model.shape import Disk, Polygon
from fixel.simulation.geometry import contact_pieces, gap

EXACT = 1e-12
STILL = (0.0, 0.0, 0.0)
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
WIDE = np.array([[-3.0, -1.0], [3.0, -1.0], [3.0, 0.0], [-3.0, 0.0]])  # top edge on y = 0


def turned(points, angle):
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


def shifted(points, x, y):
    return points + np.array([x, y])


def contacts(first, second, *, radius=(0.0, 0.0), real=None, margin=np.inf):
    """Contacts of one pair, as a list of (gap, normal, point, key)."""
    first, second = np.atleast_2d(first), np.atleast_2d(second)
    world = np.concatenate([first, second]).astype(float)
    flags = np.ones(len(world), np.int64) if real is None else np.array(real, np.int64)
    start = np.array([[0, len(first), len(world)]])
    count, place, key = measure_contacts(world, flags, start, np.array([radius]), margin)
    return [
        (float(row[0]), row[1:3].copy(), row[3:].copy(), int(code))
        for row, code in zip(place[0, : count[0]], key[0], strict=False)
    ]


def keys(found):
    return sorted(code for *_, code in found)


# --- polygons ------------------------------------------------------------------------------------


def test_parallel_edges_have_two_contacts():
    found = contacts(shifted(SQUARE, 0.3, 0.25), WIDE)
    assert len(found) == 2
    for distance, normal, point, _ in found:
        assert distance == pytest.approx(0.25, abs=EXACT)
        assert normal == pytest.approx([0.0, 1.0], abs=EXACT)
        assert point[1] == pytest.approx(0.125, abs=EXACT)
    assert sorted(point[0] for _, _, point, _ in found) == pytest.approx([0.3, 1.3])
    assert keys(found) == [FIRST_VERTEX, FIRST_VERTEX + 1]


def test_parallel_edges_in_the_other_order():
    found = contacts(WIDE, shifted(SQUARE, 0.3, 0.25))
    assert keys(found) == [0, 1]
    for distance, normal, _, _ in found:
        assert distance == pytest.approx(0.25, abs=EXACT)
        assert normal == pytest.approx([0.0, -1.0], abs=EXACT)


def test_edges_that_face_each_other_in_part_have_one_vertex_of_each():
    found = contacts(shifted(SQUARE, 2.5, 0.1), WIDE)
    assert sorted(point[0] for _, _, point, _ in found) == pytest.approx([2.5, 3.0])
    assert keys(found) == [2, FIRST_VERTEX]


@pytest.mark.parametrize("tilt", [0.0, 1e-15, -1e-15, 1e-12, 1e-9, -1e-9, 1e-6])
def test_sliding_along_a_longer_edge_keeps_both_features(tilt):
    for x in np.linspace(-2.9, 1.9, 25):
        for y in (1e-3, 1e-12, 0.0, -1e-12, -1e-6):
            found = contacts(shifted(turned(SQUARE, tilt), x, y), WIDE, margin=0.01)
            assert keys(found) == [FIRST_VERTEX, FIRST_VERTEX + 1], (x, y)
            back = contacts(WIDE, shifted(turned(SQUARE, tilt), x, y), margin=0.01)
            assert keys(back) == [0, 1], (x, y)


def test_vertex_on_edge_comes_first_and_has_the_gap():
    found = contacts(shifted(turned(SQUARE, 0.1), 0.3, 0.25), WIDE)
    distance, normal, point, key = found[0]
    assert distance == pytest.approx(0.25, abs=EXACT)
    assert normal == pytest.approx([0.0, 1.0], abs=EXACT)
    assert point == pytest.approx([0.3, 0.125], abs=EXACT)
    assert key == FIRST_VERTEX
    assert found[1][0] == pytest.approx(0.25 + np.sin(0.1), abs=EXACT)


def test_corner_against_corner_is_one_contact():
    pair = (shifted(SQUARE, 1.3, 1.4), SQUARE)
    for order, code in ((1, VERTEX_VERTEX + 2), (-1, VERTEX_VERTEX)):
        ((distance, normal, point, key),) = contacts(*pair[::order])
        assert distance == pytest.approx(0.5, abs=EXACT)
        assert normal == pytest.approx([order * 0.6, order * 0.8], abs=EXACT)
        assert point == pytest.approx([1.15, 1.2], abs=EXACT)
        assert key == code


def test_corner_whose_foot_lies_beyond_a_tilted_edge_is_a_corner_contact():
    # The square's lowest corner hangs past the end of the wide edge. Their edges overlap in
    # projection, but the nearest points are two corners.
    tilted = shifted(turned(SQUARE - (1.0, 0.0), -0.2), 3.05, 0.3)
    for pair in ((tilted, WIDE), (WIDE, tilted)):
        assert contacts(*pair)[0][0] == pytest.approx(np.hypot(0.05, 0.3), abs=EXACT)


@pytest.mark.parametrize("order", [1, -1])
def test_corners_that_touch_exactly(order):
    pair = (shifted(SQUARE, 1.0, 1.0), SQUARE)[::order]
    ((distance, normal, point, _),) = contacts(*pair, margin=1e-9)
    assert distance == 0.0
    assert np.hypot(*normal) == pytest.approx(1.0, abs=EXACT)
    assert point == pytest.approx([1.0, 1.0], abs=EXACT)


@pytest.mark.parametrize("off", [-1e-12, -1e-13, 0.0, 1e-13, 1e-12])
@pytest.mark.parametrize("x", [0.3, 0.0, -1e-13, 1e-13, 1.0, 1.0 - 1e-13, 1.0 + 1e-13])
def test_touching_within_rounding_is_found(off, x):
    found = contacts(shifted(SQUARE, x, 1.0 + off), SQUARE, margin=1e-9)
    assert 1 <= len(found) <= 2
    for distance, normal, _, _ in found:
        assert abs(distance) < 3.0 * COINCIDENT
        assert np.hypot(*normal) == pytest.approx(1.0, abs=EXACT)
        assert normal[1] > -EXACT


def test_shared_vertex_with_different_edges():
    triangle = np.array([[1.0, 1.0], [2.0, 1.5], [1.5, 2.0]])
    ((distance, normal, _, _),) = contacts(triangle, SQUARE, margin=1e-3)
    assert abs(distance) < EXACT
    assert normal.min() > -EXACT


def test_contained_polygon_leaves_by_the_nearest_side():
    found = contacts(shifted(0.2 * SQUARE, 2.0, -0.6), WIDE)
    assert found[0][0] == pytest.approx(-0.6, abs=EXACT)
    assert found[0][1] == pytest.approx([0.0, 1.0], abs=EXACT)


def test_equal_polygons_on_top_of_each_other():
    found = contacts(SQUARE, SQUARE)
    assert found[0][0] == pytest.approx(-1.0, abs=EXACT)


def test_nothing_beyond_the_margin():
    assert contacts(shifted(SQUARE, 0.0, 1.5), SQUARE, margin=0.5) == []
    assert contacts(shifted(SQUARE, 1.3, 1.4), SQUARE, margin=0.5 - 1e-9) == []
    assert len(contacts(shifted(SQUARE, 1.3, 1.4), SQUARE, margin=0.5 + 1e-9)) == 1
    assert len(contacts(shifted(turned(SQUARE, 0.1), 0.3, 0.25), WIDE, margin=0.3)) == 1


def test_sliver_next_to_a_square():
    sliver = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 1e-9]])
    found = contacts(shifted(sliver, 0.2, 1.5), SQUARE)
    assert min(f[0] for f in found) == pytest.approx(0.5, abs=EXACT)


# Python cannot call a kernel, only what is compiled around it.
separating_edge_ = entry(
    lambda world, m, n, start, floor, margin: separating_edge(
        world, 0, m, m, n, start, floor, margin
    )
)


def ellipse(n, width):
    return regular(n, 1.0) * (1.0, width)


outlines = st.one_of(
    st.builds(regular, st.integers(3, 70), st.sampled_from([1.0, 0.5, 0.05])),
    st.builds(ellipse, st.integers(3, 40), st.floats(0.01, 1.0)),
)
places = st.one_of(st.sampled_from([-2.0, -1.0, 0.0, 0.5, 1.0]), st.floats(-2.5, 2.5))
angles = st.one_of(
    st.integers(-8, 8).map(lambda k: k * np.pi / 8.0), st.floats(-3.0, 3.0)
)  # parallel edges in the first case


@given(outlines, outlines, places, places, angles, st.integers(0, 99))
def test_farthest_edge_is_that_of_a_search_over_all_corners(one, other, x, y, angle, start):
    first, second = one, shifted(turned(other, angle), x, y)
    world = np.concatenate([first, second])
    along = np.roll(first, -1, axis=0) - first
    normal = np.column_stack([along[:, 1], -along[:, 0]]) / np.hypot(*along.T)[:, None]
    distance = np.einsum("ijk,ik->ij", second[None] - first[:, None], normal)
    separation = distance.min(axis=1)
    m = len(first)
    begin = m + start % len(second)
    best, edge, nearest = separating_edge_(world, m, len(world), begin, -np.inf, np.inf)
    assert best == pytest.approx(separation.max(), abs=EXACT)
    assert separation[edge] == pytest.approx(best, abs=EXACT)
    assert distance[edge, nearest - m] == pytest.approx(best, abs=EXACT)
    # From another start, above a floor, and up to a margin.
    assert separating_edge_(world, m, len(world), m, best, np.inf) == (best, edge, nearest)
    assert separating_edge_(world, m, len(world), m, best + 1e-9, np.inf)[1] == -1
    found, reached, _ = separating_edge_(world, m, len(world), m, -np.inf, best - 0.1)
    assert found >= best - 0.1
    assert separation[reached] == pytest.approx(found, abs=EXACT)


# --- seams ---------------------------------------------------------------------------------------

# The right half of a body of which the left half lies beyond the edge x = 0.
HALF_REAL = [1, 1, 1, 0]


def test_seam_takes_no_contact_from_outside():
    other = 0.5 * shifted(SQUARE, -0.6, 0.25)
    assert contacts(other, SQUARE, real=[1] * 4 + HALF_REAL) == []
    assert contacts(SQUARE, other, real=HALF_REAL + [1] * 4) == []


def test_seam_takes_no_contact_in_shallow_overlap():
    other = 0.5 * shifted(SQUARE, -0.4, 0.25)
    assert contacts(other, SQUARE, real=[1] * 4 + HALF_REAL) == []


def test_corner_is_not_seen_from_beyond_its_seam():
    # Beyond the seam, above the body: the left half's upper edge is what is near.
    spike = np.array([[0.0, 0.0], [0.05, 1.0], [-0.05, 1.0]])
    beyond = shifted(spike, -0.1, 1.05)
    assert contacts(beyond, SQUARE, real=[1] * 3 + HALF_REAL) == []
    assert contacts(SQUARE, beyond, real=HALF_REAL + [1] * 3) == []
    this_side = shifted(spike, 0.1, 1.05)
    ((distance, normal, _, _), *_) = contacts(this_side, SQUARE, real=[1] * 3 + HALF_REAL)
    assert distance == pytest.approx(0.05, abs=EXACT)
    assert normal == pytest.approx([0.0, 1.0], abs=EXACT)


@pytest.mark.parametrize(("x", "n"), [(-0.1, 0), (0.1, 1)])
def test_disk_and_seam(x, n):
    assert len(contacts((x, 1.2), SQUARE, radius=(0.1, 0.0), real=[1, *HALF_REAL])) == n
    assert len(contacts(SQUARE, (x, 1.2), radius=(0.0, 0.1), real=[*HALF_REAL, 1])) == n
    assert contacts((-0.2, 0.5), SQUARE, radius=(0.1, 0.0), real=[1, *HALF_REAL]) == []


L_SHAPE = Polygon([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]])
_ARM = [(3, -1), (3, 1), (1, 1), (1, 3), (-1, 3), (-1, 1)]
PLUS = Polygon([*_ARM, *((-x, -y) for x, y in _ARM)])


@pytest.mark.parametrize("shape", [L_SHAPE, PLUS])
def test_pieces_for_contacts_are_strictly_convex(shape):
    area = 0.0
    for corners, real in contact_pieces(shape):
        assert len(corners) == len(real)
        before = corners - np.roll(corners, 1, axis=0)
        after = np.roll(corners, -1, axis=0) - corners
        assert (before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0] > 1e-6).all()
        x, y = corners.T
        area += 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    assert area == pytest.approx(shape.area)


def test_point_sliding_over_a_corner_between_pieces_meets_no_hidden_wall():
    # A small diamond slides over the top of a plus sign's arms, 1e-4 above; every normal points up.
    diamond = 0.05 * (turned(SQUARE, np.pi / 4))
    for x in np.linspace(-0.95, 0.95, 77):
        for corners, real in contact_pieces(PLUS):
            found = contacts(
                shifted(diamond, x, 3.0001), corners, real=[1] * 4 + list(real), margin=0.02
            )
            for distance, normal, _, _ in found[:1]:
                assert distance == pytest.approx(1e-4, abs=EXACT)
                assert normal == pytest.approx([0.0, 1.0], abs=EXACT)


# --- disks ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("centre", "other", "radius", "expected"), [
    ((0.0, 0.0), (0.0, 0.0), (1.0, 2.0), -3.0),  # concentric disks
    ((1.0, 1.0), SQUARE, (0.1, 0.0), -0.1),  # the centre on a corner
])  # fmt: skip
def test_a_normal_that_nothing_determines_has_length_one(centre, other, radius, expected):
    ((distance, normal, _, _),) = contacts(centre, other, radius=radius)
    assert distance == pytest.approx(expected, abs=EXACT)
    assert np.hypot(*normal) == pytest.approx(1.0, abs=EXACT)


def test_disks():
    ((distance, normal, point, key),) = contacts((3.0, 4.0), (0.0, 0.0), radius=(1.0, 2.0))
    assert distance == pytest.approx(2.0, abs=EXACT)
    assert normal == pytest.approx([0.6, 0.8], abs=EXACT)
    assert point == pytest.approx([1.8, 2.4], abs=EXACT)
    assert key == 0


@pytest.mark.parametrize(("centre", "distance", "normal"), [
    ((0.5, 1.4), 0.3, (0.0, 1.0)),  # above an edge
    ((1.3, 1.4), 0.4, (0.6, 0.8)),  # off a corner
    ((0.5, 0.9), -0.2, (0.0, 1.0)),  # centre inside
    ((0.5, 1.0), -0.1, (0.0, 1.0)),  # centre on the edge
    ((1.0, 0.5), -0.1, (1.0, 0.0)),
])  # fmt: skip
def test_disk_and_polygon(centre, distance, normal):
    ((found, n, point, _),) = contacts(centre, SQUARE, radius=(0.1, 0.0))
    assert found == pytest.approx(distance, abs=EXACT)
    assert n == pytest.approx(normal, abs=EXACT)
    ((back, m, other, _),) = contacts(SQUARE, centre, radius=(0.0, 0.1))
    assert back == pytest.approx(distance, abs=EXACT)
    assert m == pytest.approx(-n, abs=EXACT)
    assert other == pytest.approx(point, abs=EXACT)


# --- for Python ----------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1e-6, 1e-3, 1.0, 1e3])
@pytest.mark.parametrize("origin", [0.0, 100.0])
def test_gap_of_shapes_of_any_size(size, origin):
    found = gap(
        Polygon(size * SQUARE),
        (origin, origin + 1.5 * size, 0.0),
        Disk(0.25 * size),
        (origin, origin, 0.0),
    )
    assert found.distance == pytest.approx(1.25 * size, abs=1e-13 * (size + origin))
    assert np.hypot(*found.normal) == pytest.approx(1.0, abs=EXACT)
    between = found.witness_a - found.witness_b
    assert between == pytest.approx(found.distance * found.normal, abs=1e-13 * (size + origin))


@pytest.mark.parametrize("noise", [1e-11, 1e-9, 1e-6])
def test_sides_of_many_corners_are_straight_within_their_noise(noise):
    rng = np.random.default_rng(5)
    along = np.sort(rng.uniform(size=(4, 12, 1)), axis=1)
    sides = SQUARE[:, None] + along * (np.roll(SQUARE, -1, axis=0) - SQUARE)[:, None]
    outline = np.concatenate((SQUARE[:, None], sides), axis=1).reshape(-1, 2)
    traced = Polygon(outline + rng.uniform(-0.5, 0.5, outline.shape) * noise)
    for x in np.linspace(0.0, 1.0, 41):
        found = gap(traced, STILL, Disk(0.1), (x, 1.3, 0.0))
        assert found.distance == pytest.approx(0.2, abs=2 * noise)


def test_gap_of_a_shape_with_itself_in_the_notch():
    found = gap(Disk(0.1), (1.5, 1.5, 0.0), L_SHAPE, STILL)
    assert found.distance == pytest.approx(0.4, abs=EXACT)
    inside = gap(Disk(0.01), (0.5, 0.5, 0.0), L_SHAPE, STILL)
    assert inside.distance < 0.0


@pytest.mark.parametrize(("other", "reach"), [
    (Disk(0.5), 0.5),
    (Polygon.rectangle(1.0, 1.0), np.sqrt(0.5)),
])  # fmt: skip
def test_a_corner_is_seen_along_the_seam_that_ends_in_a_notch(other, reach):
    rng = np.random.default_rng(1)
    for turn in rng.uniform(-np.pi, np.pi, 200):
        x, y = rng.normal(size=2)
        seam = turn + np.pi / 4
        pose = (x - 3.0 * np.cos(seam), y - 3.0 * np.sin(seam), turn)
        found = gap(L_SHAPE, (x, y, turn), other, pose)
        assert found.distance == pytest.approx(3.0 - reach, abs=1e-9)


def test_gap_refuses_what_is_no_shape_or_pose():
    refused(gap, Disk(1.0), STILL, SQUARE, STILL, match="shape_b")
    refused(gap, Disk(1.0), (0.0, np.nan, 0.0), Disk(1.0), STILL, match="pose_a")
