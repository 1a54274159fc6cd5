# Known answers K1-K4: K. Y. Goldberg (1993), Orienting polygonal parts without sensors; the table
# of polygons was computed once by an exhaustive search over sets of stable orientations.
"""Pushes by a wide fence that orient a part of unknown angle."""

from math import atan, cos, degrees, pi, radians, sin, tau

import numpy as np
import pytest
import shapely

from fixel import InvalidInput, orienting_plan, simulate_batch
from fixel.model import Body, LineDrive, Polygon, Pusher, Scene, SupportPoints
from fixel.planning.orienting import PushFunction

TRI1 = Polygon([(0.045, 0.045), (-0.0809, 0.045), (0.045, -0.08087)])
TRI3 = Polygon([(0.045, 0.045), (-0.1315, 0.045), (0.045, -0.08061)])
CMU150 = Polygon([(0, 0), (0.15, 0), (0, 0.15)])
CMU58 = Polygon([(0, 0), (0.058, 0), (0, 0.0275)])
ASME = Polygon.rectangle(1.621e-3, 0.842e-3)
BLOCK = Polygon.rectangle(0.050, 0.035)
RECT3 = Polygon.rectangle(0.13501, 0.08994)
SQUARE = Polygon.rectangle(0.1075, 0.1075)
QUAD = Polygon([(0, 0), (6, 0), (5, 3), (1, 4)])

# Part, widths of its basins [deg], pushes, and pushes where every margin is at least 5 degrees.
TABLE = {
    "square": (SQUARE, [90] * 4, 1, 1),
    "pentagon": (Polygon.regular(5, 0.1), [72] * 5, 1, 1),
    "hexagon": (Polygon.regular(6, 0.0605), [60] * 6, 1, 1),
    "asme": (ASME, [125.10, 125.10, 54.90, 54.90], 2, 2),
    "block": (BLOCK, [110.02, 110.02, 69.98, 69.98], 2, 2),
    "rect3": (RECT3, [112.66, 112.66, 67.34, 67.34], 2, 2),
    "tri1": (TRI1, [143.13, 108.45, 108.42], 3, 4),
    "cmu150": (CMU150, [143.13, 108.43, 108.43], 3, 4),
    "tri3": (TRI3, [144.68, 124.97, 90.35], 3, 3),
    "cmu58": (CMU58, [149.86, 141.30, 68.85], 3, 3),
    "quad": (QUAD, [122.36, 96.03, 81.68, 59.92], 4, 4),
}
# Plans of the table that need not be the ones found here: rotations, and the errors under which
# every single orientation still ends on the same edge [deg].
KNOWN_PLANS = {
    "asme": [([45], [17.55])],
    "block": [([45], [10.01])],
    "rect3": [([45], [11.33])],
    "tri1": [([54.2, 67.5], [9.22, 4.06]), ([54.2, 247.5, 54.2], [9.2, 40.9, 9.2])],
    "cmu150": [([54.2, 67.5], [9.22, 4.06]), ([54.2, 247.5, 54.2], [9.2, 40.9, 9.2])],
    "tri3": [([52.9, 70.5], [17.5, 0.058]), ([295.5, 295.5], [9.62, 9.62])],
    "cmu58": [([74.3, 48.6], [2.39, 23.3]), ([288.7, 153.7], [6.67, 12.96])],
    "quad": [([28.9, 57.3, 48.2], [15.1, 5.0, 4.16])],
}
GRID = 7200  # directions of the independent push function


def rests(polygon):
    """Direction of rest (GRID,) [deg] from every direction: descent of the support function."""
    direction = np.arange(GRID) * tau / GRID
    corners = polygon.outline - polygon.centroid
    radius = (corners @ [np.cos(direction), np.sin(direction)]).max(axis=0)
    lower = np.arange(GRID)
    left, right = np.roll(radius, 1), np.roll(radius, -1)
    lower = np.where((left < radius) & (left <= right), lower - 1, lower)
    lower = np.where((right < radius) & (right < left), lower + 1, lower) % GRID
    for _ in range(20):  # follow 2^20 steps
        lower = lower[lower]
    return lower * 360.0 / GRID


def carried_out(polygon, rotations, errors):
    """Directions of rest [deg] after a plan from all directions, with errors (m, n - 1) [deg]."""
    after = rests(polygon)
    state = np.broadcast_to(after, (len(errors), GRID))
    for rotation, error in zip(rotations, errors.T, strict=True):
        turned = (state + rotation + error[:, None]) % 360.0
        state = after[np.rint(turned * GRID / 360.0).astype(int) % GRID]
    return state


def corners_of(margins, n=8):
    """Errors (m, n_margin): random ones and all corners, just inside the margins."""
    rng = np.random.default_rng(1)
    signs = np.vstack((rng.uniform(-1, 1, (n, len(margins))), [[1], [-1]] * np.ones(len(margins))))
    return signs * np.maximum(np.asarray(margins, float) - 0.11, 0.0)


def unlike(directions, symmetry):
    """Number of directions of rest that differ by more than the grid and the symmetry."""
    folded = np.unique(np.round(directions % (360.0 / symmetry), 0) % (360.0 / symmetry))
    return len(folded) - int(len(folded) > 1 and folded[-1] - folded[0] > 360.0 / symmetry - 1.5)


@pytest.mark.parametrize("name", TABLE)
def test_K1_lengths_and_basins_of_known_polygons(name):
    polygon, widths, pushes, robust = TABLE[name]
    function = PushFunction.of(polygon)
    ahead = np.degrees(np.mod(np.roll(function.borders, -1) - function.borders, tau))
    assert sorted(ahead, reverse=True) == pytest.approx(widths, abs=0.006)
    assert orienting_plan(polygon).pushes == pushes
    assert orienting_plan(polygon, angle_error=radians(5)).pushes == robust


@pytest.mark.parametrize("name", TABLE)
def test_K1_plans_hold_in_another_model_up_to_their_margins(name):
    polygon = TABLE[name][0]
    for least in (0.0, 5.0, 9.9):
        plan = orienting_plan(polygon, angle_error=radians(least))
        assert plan.margin >= radians(least)
        errors = corners_of(np.degrees(plan.margins))
        ends = carried_out(polygon, np.degrees(plan.rotations), errors)
        assert unlike(ends, plan.symmetry) == 1
        assert np.abs((180.0 - ends - degrees(plan.angle) + 1) % (360 / plan.symmetry)).max() < 2


@pytest.mark.parametrize("name", KNOWN_PLANS)
def test_K1_known_plans_orient_the_part(name):
    polygon = TABLE[name][0]
    for rotations, margins in KNOWN_PLANS[name]:
        ends = carried_out(polygon, rotations, corners_of(margins))
        assert unlike(ends, orienting_plan(polygon).symmetry) == 1
        found = orienting_plan(polygon, angle_error=radians(min(margins) - 0.05))
        assert found.pushes <= len(rotations) + 1


@pytest.mark.parametrize("name", TABLE)
def test_K1_no_plan_is_shorter(name):
    polygon, _, pushes, _ = TABLE[name]
    after = np.rint(rests(polygon) * GRID / 360.0).astype(int)
    symmetry = orienting_plan(polygon).symmetry
    level = {tuple(np.unique(after))}
    for _ in range(1, pushes):
        assert all(unlike(np.array(own) * 360.0 / GRID, symmetry) > 1 for own in level)
        level = {
            tuple(np.unique(row))
            for own in level
            for row in after[(np.array(own) + np.arange(0, GRID, 5)[:, None]) % GRID]
        }


def test_K2_robustness_decides_before_length():
    shortest = orienting_plan(TRI1)
    assert degrees(shortest.margin) == pytest.approx(4.06, abs=0.01)
    robust = orienting_plan(TRI1, angle_error=radians(5))
    assert (shortest.pushes, robust.pushes) == (3, 4)
    assert degrees(robust.margin) > 9.2
    # The three pushes of tri3 with a margin of 0.058 degrees are never chosen.
    plan = orienting_plan(TRI3, angle_error=radians(5))
    assert plan.pushes == 3
    assert np.degrees(plan.rotations) == pytest.approx([295.5, 295.5], abs=0.2)
    assert degrees(plan.margin) == pytest.approx(9.62, abs=0.01)
    assert orienting_plan(CMU58, angle_error=radians(7.5)).pushes == 4


def test_K2_an_error_that_no_plan_survives_is_refused_with_the_largest_that_one_does():
    with pytest.raises(InvalidInput, match=r"at most 13\.3 deg"):
        orienting_plan(TRI1, angle_error=radians(15))
    assert degrees(orienting_plan(TRI1, angle_error=radians(13.2)).margin) > 13.2


def test_K3_no_plan_is_longer_than_the_number_of_edges():
    rng = np.random.default_rng(3)
    longest = 0
    for _ in range(1000):
        points = rng.normal(size=(rng.integers(3, 16), 2))
        hull = shapely.MultiPoint(points).convex_hull
        polygon = Polygon(shapely.get_coordinates(hull.exterior)[:-1])
        plan = orienting_plan(polygon)
        assert plan.pushes <= len(polygon.outline)
        assert len(np.unique(plan.ends(rng.uniform(0, tau, 50)).round(6))) <= plan.symmetry
        longest = max(longest, plan.pushes)
    assert longest >= 5


def _tripods(polygon, n, rng):
    """Triples of support points (n, 3, 2) with the centroid inside."""
    corners = polygon.outline
    found = []
    while len(found) < n:
        share = rng.dirichlet(np.ones(len(corners)), 3)
        points = share @ corners
        x = np.linalg.solve(np.vstack((points.T, np.ones(3))), [*polygon.centroid, 1.0])
        if x.min() > 0.05:
            found.append(points)
    return np.array(found)


def _fence_ends(polygon, angles, friction, oblique, rng):
    """Angles (n,) of parts after a long push by a fence that moves at an angle to its normal."""
    span = np.ptp(polygon.outline, axis=0).max()
    travel = 12.0 * span
    scene = Scene(
        Body("part", polygon, mass=0.5, pose=(2 * span, 0, 0),
             support=SupportPoints(points=_tripods(polygon, 1, rng)[0], friction=0.3)),
        Pusher("fence", Polygon.rectangle(0.1 * span, 80 * span), friction=friction,
               pose=(0, 0, 0), drive=LineDrive((cos(oblique), sin(oblique)), speed=travel)),
        duration=1.0,
    )  # fmt: skip
    corners = polygon.outline - polygon.centroid
    depth = np.array([(corners @ [cos(a), -sin(a)]).min() for a in angles])
    centre = 0.05 * span - depth
    c, s = np.cos(angles), np.sin(angles)
    x, y = polygon.centroid
    start = np.column_stack((centre - c * x + s * y, -s * x - c * y, angles))
    points = _tripods(polygon, len(angles), rng)
    values = {f"support_{k + 1}_{'xy'[j]}": points[:, k, j] for k in range(3) for j in range(2)}
    run = simulate_batch(scene, values, start=start, motion="quasistatic", threads=1)
    assert run.converged.all()
    return run.final[:, 0, 2]


@pytest.mark.parametrize("oblique", [0.0, 10.0, -40.0])
@pytest.mark.parametrize("friction", [0.1, 0.4])
def test_K4_friction_moves_the_borders_of_basins_by_the_angle_of_its_cone_at_most(
    friction, oblique
):
    """It moves them by the direction of the push clipped to the cone, and not at all where the
    fence moves along its normal: two of the three rays of Mason's theorem are on the same side."""
    rng = np.random.default_rng(4)
    function = PushFunction.of(QUAD)
    shift = np.clip(radians(oblique), -atan(friction), atan(friction))
    assert abs(shift) <= atan(friction)
    n = 12
    borders = np.repeat(function.borders, 2 * n)
    off = np.concatenate((rng.uniform(-0.3, -0.02, n), rng.uniform(0.02, 0.3, n)))
    directions = borders + np.tile(off, len(function.borders))
    # The part turns as if the fence pushed along the shifted direction.
    ends = _fence_ends(QUAD, pi - directions + shift, friction, radians(oblique), rng)
    rest = np.mod(pi - ends, tau)
    wanted = function.stable[function.rest(directions)]
    assert np.abs(np.mod(rest - wanted + pi, tau) - pi).max() < 1e-3
