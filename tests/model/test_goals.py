"""Margins of goals against shapely and distances of centres; K20; goals that are rejected."""

import time

import numpy as np
import pytest
import shapely
from scipy.stats import binomtest
from tests.fixtures import refused

from fixel import (
    AllOf,
    AnyOf,
    Beyond,
    Body,
    Contact,
    Disk,
    Exit,
    Fixel,
    ForceAbove,
    Inside,
    InvalidInput,
    NoSupport,
    Polygon,
    PoseRegion,
    Scene,
    Seated,
)
from fixel.io.saved import load, save
from fixel.model import BodyTrack, Probability
from fixel.model.goal_checks import check_goal
from fixel.model.goals import MIN_MARGIN
from fixel.testing.scenes import row

FIXELS = (
    Fixel(name="left", shape=Disk(0.01), pose=row(0.0, 0.0, 0.0), friction=0.1),
    Fixel(name="low", shape=Disk(0.01), pose=row(0.03, -0.03, 0.0), friction=0.1),
)
PUCK = Body(name="puck", shape=Disk(0.02), mass=0.1, pose=row(0.1, 0.1, 0.0), support=NoSupport())
SCENE = Scene(bodies=(PUCK,), fixels=FIXELS, duration=1.0)
CORNERS = np.array(
    [(-0.03, -0.01), (0.03, -0.01), (0.03, 0.02), (0.0, 0.02), (0.0, 0.01), (-0.03, 0.01)]
)
SLOT = [(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (0.03, 0.1), (0.03, 0.0), (-0.05, 0.0), (-0.1, 0.1)]


def resting(shape, pose=(0.3, 0.3, 0.0), fixels=FIXELS):
    body = Body(name="part", shape=shape, mass=0.1, pose=row(*pose), support=NoSupport())
    return Scene(bodies=(body,), fixels=fixels, duration=1.0)


def poses(n, spread, seed=0):
    return np.random.default_rng(seed).normal(size=(n, 3)) * (spread, spread, 2.0)


def outline(corners, pose):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return shapely.Polygon(corners @ np.array([[c, s], [-s, c]]) + pose[:2])


def test_a_disk_is_seated_where_distances_of_centres_say_so():
    ends = np.random.default_rng(0).uniform((0.0, -0.01, -3), (0.06, 0.01, 3), (500, 3))
    ends[:100, 0] = np.sqrt(0.03**2 - ends[:100, 1] ** 2)  # on the first fixel
    apart = [np.hypot(*(ends[:, :2] - fixel.pose[:2]).T) - 0.03 for fixel in FIXELS]
    left, low = (1.0 - gap / (1e-3 * 0.04) for gap in apart)
    track = BodyTrack.of_ends(ends)

    for goal, expected in (
        (Seated("left"), left),
        (Seated("left", "low"), np.minimum(left, low)),
        (Seated("left", only=True), np.minimum(left, -low)),
    ):
        np.testing.assert_allclose(
            goal.margin(SCENE, track), np.minimum(expected, 1), rtol=1e-9, atol=1e-9
        )
    assert Seated("left").met(SCENE, {"puck": track}).sum() >= 100


def test_fixels_may_be_elsewhere_in_each_run():
    moved = np.zeros((3, 2, 3))
    moved[:, 0, 0] = 0.0, 1e-5, 0.001
    track = BodyTrack(np.tile(row(0.03, 0.0, 0.0), (3, 4, 1)), fixels=moved)
    expected = np.minimum(1.0, 1.0 + np.array([0.0, 0.25, 25.0]))  # closer ones overlap
    np.testing.assert_allclose(Seated("left").margin(SCENE, track), expected)
    away = track._replace(fixels=-moved)
    np.testing.assert_allclose(Seated("left").margin(SCENE, away), (1.0, 0.75, -24.0))
    np.testing.assert_allclose(Contact("left").margin(SCENE, away), (-1.0, -0.75, 24.0))


def test_a_seat_may_demand_that_the_drive_stalled():
    touching = BodyTrack.of_ends([[0.03, 0.0, 0.0]] * 2)._replace(stalled=np.array([True, False]))
    assert Seated("left", stalled=True).met(SCENE, touching).tolist() == [True, False]
    with pytest.raises(InvalidInput, match="no stalls"):
        Seated("left", stalled=True).met(SCENE, BodyTrack.of_ends([[0.03, 0.0, 0.0]]))


@pytest.mark.parametrize("region", [SLOT, CORNERS * 4, [(0, 0), (0.1, 0.0), (0.0, 0.1)]])
def test_inside_agrees_with_shapely(region):
    scene, ring, tolerance = resting(Polygon(CORNERS)), shapely.Polygon(region), 0.002
    ends = poses(2000, 0.03)
    margin = Inside(region, tolerance=tolerance).margin(scene, BodyTrack.of_ends(ends))
    clearance = (margin - 1.0) * tolerance
    for pose, own in zip(ends, clearance, strict=True):
        part = outline(CORNERS, pose)
        assert ring.contains(part) == (own > 0.0)
        if own > 0.0 and ring.equals(ring.convex_hull):
            assert own == pytest.approx(part.distance(ring.exterior), rel=1e-9)
        if own < 0.0 and ring.equals(ring.convex_hull):
            grown = ring.buffer(-own * (1 + 1e-6), join_style="mitre", mitre_limit=100)
            assert grown.contains(part)
    assert 20 < (clearance > 0).sum() < 1900 or len(region) == 3


def test_a_disk_inside_and_beyond_is_a_matter_of_its_centre():
    ends = poses(500, 0.05)
    track = BodyTrack.of_ends(ends)
    box = [(-0.06, -0.05), (0.06, -0.05), (0.06, 0.05), (-0.06, 0.05)]
    depth = np.minimum(0.06 - np.abs(ends[:, 0]), 0.05 - np.abs(ends[:, 1])) - 0.02
    margin = Inside(box, tolerance=0.001).margin(SCENE, track)
    np.testing.assert_allclose(margin, 1 + depth / 0.001, atol=1e-9)
    line = [(0.01, 0.0), (0.01, -1.0)]
    whole, centre = Beyond(line, tolerance=0.001), Beyond(line, feature=(0, 0), tolerance=0.001)
    np.testing.assert_allclose(whole.margin(SCENE, track), 1 + (ends[:, 0] - 0.03) / 1e-3)
    np.testing.assert_allclose(centre.margin(SCENE, track), 1 + (ends[:, 0] - 0.01) / 1e-3)


def test_a_rotation_that_covers_the_part_is_as_good():
    """A square of side 0.04 with its frame at a corner, turned about its centre."""
    scene = resting(Polygon([(0, 0), (0.04, 0), (0.04, 0.04), (0, 0.04)]))
    goal = PoseRegion((0.1, 0.2, 0.3), position=0.004, angle=0.1, symmetry=4)
    plain = PoseRegion((0.1, 0.2, 0.3), position=0.004, angle=0.1)
    ends = np.array([0.1, 0.2, 0.3]) + poses(300, 0.002) * (1, 1, 0.03)
    centre = ends[:, :2] + 0.02 * np.sqrt(2) * np.column_stack(
        (np.cos(ends[:, 2] + np.pi / 4), np.sin(ends[:, 2] + np.pi / 4))
    )
    expected = plain.margin(scene, BodyTrack.of_ends(ends))
    assert 0 < (expected >= 0).sum() < 300
    for quarter in (1, 2, 3, -5):
        angle = ends[:, 2] + quarter * np.pi / 2
        way = np.column_stack((np.cos(angle + np.pi / 4), np.sin(angle + np.pi / 4)))
        turned = np.column_stack((centre - 0.02 * np.sqrt(2) * way, angle))
        own = goal.margin(scene, BodyTrack.of_ends(turned))
        np.testing.assert_allclose(own, expected, atol=1e-9)
        assert (plain.margin(scene, BodyTrack.of_ends(turned)) < 0).all()
    margins = plain.margin(
        scene, BodyTrack.of_ends([(0.102, 0.2, 0.3), (0.1, 0.2, 0.3 - 6 * np.pi + 0.15)])
    )
    np.testing.assert_allclose(margins, (0.5, -0.5), atol=1e-9)


def test_larger_goals_are_met_more_often():
    """K20, on the same samples."""
    scene, track = resting(Polygon(CORNERS)), BodyTrack.of_ends(poses(3000, 0.04))
    for make in (
        lambda size: PoseRegion((0.0, 0.0, 0.0), position=0.05 * size, angle=0.5 * size),
        lambda size: Seated("left", tolerance=0.004 * size),
        lambda size: Inside(SLOT, tolerance=0.01 * size),
        lambda size: Beyond([(0, 0), (1, 1)], tolerance=0.01 * size),
    ):
        met = [make(size).met(scene, track) for size in (1.0, 1.3, 2.0)]
        assert 0 < met[0].sum() < met[2].sum()
        assert (met[1] >= met[0]).all()
        assert (met[2] >= met[1]).all()


def test_all_is_the_smallest_and_any_the_largest_margin():
    track = BodyTrack.of_ends(poses(200, 0.05))
    parts = [PoseRegion((0.05, 0, 0), position=0.02), Inside(SLOT), Beyond([(0, 0), (0, 1)])]
    every = np.array([goal.margin(SCENE, track) for goal in parts])
    np.testing.assert_array_equal(AllOf(*parts).margin(SCENE, track), every.min(axis=0))
    np.testing.assert_array_equal(AnyOf(*parts).margin(SCENE, track), every.max(axis=0))
    nested = AnyOf(AllOf(*parts[:2]), parts[2])
    expected = np.maximum(every[:2].min(axis=0), every[2])
    np.testing.assert_array_equal(nested.margin(SCENE, track), expected)


def test_events_count_at_any_time():
    """The puck passes `low` on its way to a free place, and starts partly outside the tray."""
    way = np.stack([np.linspace(0.1, -0.1, 41), np.full(41, -0.05), np.zeros(41)], axis=1)
    track = BodyTrack(way[None], force=np.array([3.0]))
    there = PoseRegion((-0.1, -0.05, 0.0), position=0.01)
    tray = [(-0.2, -0.08), (0.11, -0.08), (0.11, 0.08), (-0.2, 0.08)]
    for event, happens in (
        (Contact("low"), True),
        (Contact("left"), False),
        (Exit(tray), True),
        (Exit(np.multiply(tray, 2)), False),
        (ForceAbove(2.0), True),
        (ForceAbove(4.0), False),
    ):
        assert AllOf(there, never=event).met(SCENE, track).tolist() == [not happens], event
        assert there.met(SCENE, track).all()
    refused(ForceAbove(1.0).margin, SCENE, BodyTrack(way[None]), match="no forces")


def test_a_failed_simulation_has_a_finite_margin_and_meets_nothing():
    ends = np.array([[np.nan, 0, 0], [1e9, 0, 0], [np.inf, 0, 0], [0.03, 0, 0]])
    track = BodyTrack(
        np.repeat(ends[:, None], 2, axis=1), np.ones(4, bool), np.array([1, 1, np.nan, 1])
    )
    far = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    goal = AllOf(
        PoseRegion((0.03, 0, 0), position=0.1), Seated("left"), never=[Exit(far), ForceAbove(9)]
    )
    margin = goal.margin(SCENE, track)
    assert np.isfinite(margin).all()
    assert (margin[:3] == MIN_MARGIN).all()
    assert margin[3] >= 0


def test_a_hundred_thousand_poses_take_well_under_a_second():
    scene, ends = resting(Polygon(CORNERS)), BodyTrack.of_ends(poses(100_000, 0.05))
    goal = AllOf(
        PoseRegion((0, 0, 0), position=0.1, symmetry=4), Inside(SLOT), never=[Contact("low")]
    )
    start = time.process_time()
    goal.margin(scene, ends)
    assert time.process_time() - start < 1.0


# --- goals that are rejected ----------------------------------------------------------------------


def test_goals_refuse_what_makes_no_sense():
    refused(Seated, match="names of fixels")
    for bad in ({}, {"position": -1.0}, {"position": 1.0, "symmetry": 1.5}, {"angle": np.nan}):
        refused(PoseRegion, (0, 0, 0), **bad, match="goal")
    refused(Beyond, [(0, 0), (0, 0)], match="two different points")
    refused(AllOf, Contact("left"), match="never")
    refused(AllOf, Seated("left"), never=[Seated("low")], match=r"goal\.never\[0\]")
    refused(AnyOf, match="one at least")


@pytest.mark.parametrize(("goal", "message"), [
    (Seated("right"), "one of left, low"),
    (Seated("left", body="object"), r"goal\.body"),
    (AllOf(Seated("left"), never=[Contact("lef")]), "did you mean 'left'"),
    (PoseRegion((0.2, 0, 0), position=0.01, symmetry=3), "changes .* % of 'part'"),
    (PoseRegion((0.0, 0, 0), position=0.001, angle=0.01), "overlaps 'left' by"),
    (Inside([(0, 0), (0.1, 0), (0.1, 0.015), (0, 0.015)]), "does not fit"),
    (AllOf(PoseRegion((0.2, 0, 0), position=0.01), PoseRegion((0.2, 0.03, 0), position=0.01)),
     "no pose meets together"),
    (AllOf(PoseRegion((0.2, 0, 0), angle=0.1), PoseRegion((0, 0, 1), angle=0.1)),
     "no pose meets together"),
    (AllOf(Inside([(0.1, 0), (0.3, 0), (0.3, 0.1), (0.1, 0.1)]), Beyond([(0.31, 0), (0.31, -1)])),
     "no pose meets together"),
    (AllOf(Seated("left"), Inside([(0.1, 0), (0.3, 0), (0.3, 0.1), (0.1, 0.1)])),
     "no pose meets together"),
    (AllOf(Seated("left"), never=[Contact("left")]), "no pose meets together"),
    (AllOf(Seated("left"), never=[Exit([(0.2, 0.2), (0.4, 0.2), (0.4, 0.4), (0.2, 0.4)])]),
     "no pose meets together"),
    (AllOf(Seated("left"), never=[Exit([(-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2)])]),
     "the start already does"),
    (PoseRegion((0.9, 0, 0), position=0.01), "outside the field"),
])  # fmt: skip
def test_goals_that_do_not_fit_the_scene_are_refused(goal, message):
    field = Polygon([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    with pytest.raises(InvalidInput, match=message):
        check_goal(
            goal,
            resting(Polygon([(-0.03, -0.01), (0.03, -0.01), (0.03, 0.01), (-0.03, 0.01)])),
            field,
        )


def test_fixels_too_far_apart_for_the_part_are_refused():
    far = (FIXELS[0], Fixel(name="far", shape=Disk(0.01), pose=row(0.2, 0, 0), friction=0.1))
    with pytest.raises(InvalidInput, match="too far apart"):
        check_goal(Seated("left", "far"), resting(Disk(0.02), fixels=far))
    with pytest.raises(InvalidInput, match="a fixel of the scene"):
        check_goal(Seated("left"), resting(Disk(0.02), fixels=()))


def test_goals_that_can_be_met_pass():
    scene = resting(Polygon.rectangle(0.06, 0.02))
    tight = Inside([(0.1, 0), (0.3, 0.1), (0.29, 0.12), (0.09, 0.02)])  # a slot at an odd angle
    for goal in (
        tight,
        AllOf(tight, Beyond([(0.2, 0), (0.2, -1)], feature=(0.03, 0))),
        AnyOf(
            AllOf(Seated("left"), never=[Contact("left")]), PoseRegion((0.2, 0, 0), position=0.1)
        ),
        PoseRegion((0.2, 0, 0), position=0.001, angle=1e-4, symmetry=2),
        Seated("left", "low", only=True, stalled=True),
    ):
        check_goal(goal, scene)


def test_a_goal_has_a_plain_text():
    assert repr(Seated("a", "b", body="part")) == "Seated('a', 'b', body='part')"
    assert Seated("a") == Seated("a")
    goal = AnyOf(
        AllOf(PoseRegion((0.18, 0, 0), position=2e-3, angle=0.1), never=Contact("b")), Seated("a")
    )
    assert str(goal) == (
        "(the part within 2 mm and 5.73 deg of (180, 0) mm, 0 deg, never the part touching b)"
        " or the part touching a"
    )
    assert goal == AnyOf(*goal.goals)


def test_goals_are_saved_and_loaded(tmp_path):
    region = PoseRegion((0.18, 0, 0), position=2e-3, symmetry=4)
    goal = AnyOf(AllOf(region, Inside(SLOT), never=Contact("b")), Seated("a", "b", only=True))
    assert load(save(goal, tmp_path / "goal.fixel")) == goal


@pytest.mark.parametrize(("good", "n"), [(0, 7), (3, 7), (7, 7), (930, 1000)])
def test_the_interval_of_a_probability_is_exact(good, n):
    exact = binomtest(good, n).proportion_ci(0.9, "exact")
    own = Probability.of(good, n, level=0.9)
    assert (own.low, own.high) == pytest.approx((exact.low, exact.high), abs=1e-12)
    assert (own.value, own.n) == (good / n, n)


def test_probabilities_of_no_cases_are_refused():
    refused(Probability.of, 0, 0)
    refused(Probability.of, 1, 2, level=1.0)
