"""Plans of any kind: offsets, order, refusals, and what the checks find."""

from dataclasses import replace
from math import inf, nan, pi

import numpy as np
import pytest

from fixel.errors import InvalidInput
from fixel.model import Disk, Polygon, placed
from fixel.sampling import (
    FixelLayout,
    Grid,
    Nominal,
    OffsetAxis,
    OffsetList,
    OffsetSample,
    PlannedShape,
    RegularPolygon,
    rehearse,
    thesis_plan,
)

SMALL = replace(
    thesis_plan(),
    shapes=thesis_plan().shapes[:1],
    layouts=(FixelLayout(name="one", pegs=((0.6, 0.5),)),),
    schemes=(Nominal(),),
)


def sentences(**changes) -> list[str]:
    return [problem.sentence for problem in replace(SMALL, **changes).check()]


# --- offsets ---


def test_steps_of_an_axis_leave_out_the_nominal_pose():
    offsets = OffsetAxis(name="y", step=0.008, first=-2, last=2).offsets()

    assert [offset.y for offset in offsets] == [-0.016, -0.008, 0.008, 0.016]
    assert [offset.label for offset in offsets] == ["y-2", "y-1", "y1", "y2"]
    assert {offset.axis for offset in offsets} == {"y"}


def test_a_grid_has_every_combination():
    grid = Grid(x=(0.0, 0.01), y=(0.0,), theta=(0.0, 0.1, 0.2))

    assert len(grid) == len(grid.offsets()) == 6
    assert [(o.x, o.theta) for o in grid.offsets()[:4]] == [
        (0.0, 0.0),
        (0.0, 0.1),
        (0.0, 0.2),
        (0.01, 0.0),
    ]


@pytest.mark.parametrize("method", ["sobol", "halton", "uniform"])
def test_samples_fill_their_box_and_repeat_with_their_seed(method):
    scheme = OffsetSample(
        method=method, count=100, seed=7, x=(0.0, 0.02), y=(-0.04, 0.04), theta=(0.0, pi)
    )
    points = np.array([(o.x, o.y, o.theta) for o in scheme.offsets()])

    assert scheme.offsets() == scheme.offsets()
    assert replace(scheme, seed=8).offsets() != scheme.offsets()
    assert (points >= (0.0, -0.04, 0.0)).all()
    assert (points <= (0.02, 0.04, pi)).all()
    # Each eighth of every side holds its share, within what 100 random numbers do.
    for column, high, low in zip(points.T, (0.02, 0.04, pi), (0.0, -0.04, 0.0), strict=True):
        counts, _ = np.histogram(column, bins=8, range=(low, high))
        assert counts.min() >= (3 if method == "uniform" else 9)


def test_low_discrepancy_is_lower_than_that_of_random_numbers():
    from scipy.stats import qmc

    def discrepancy(method: str) -> float:
        unit = {"x": (0.0, 1.0), "y": (0.0, 1.0), "theta": (0.0, 1.0)}
        offsets = OffsetSample(method=method, count=64, seed=1, **unit).offsets()
        return float(qmc.discrepancy([(o.x, o.y, o.theta) for o in offsets]))

    assert max(discrepancy("sobol"), discrepancy("halton")) < 0.5 * discrepancy("uniform")


@pytest.mark.parametrize(("build", "where"), [
    (lambda: OffsetAxis(name="z", step=1.0, first=1, last=2), r"axis\.name"),
    (lambda: OffsetAxis(name="x", step=0.0, first=1, last=2), r"axis\.step"),
    (lambda: OffsetAxis(name="x", step=1.0, first=2, last=1), r"axis\.last"),
    (lambda: OffsetAxis(name="x", step=1.0, first=1, last=10**9), r"axis\.last"),
    (lambda: Grid(x=()), r"grid\.x"),
    (lambda: Grid(x=(nan,)), r"grid\.x"),
    (lambda: Grid(x=(0.0,) * 1000, y=(0.0,) * 1000), "at most 100000"),
    (lambda: OffsetList(()), "at least one"),
    (lambda: OffsetList(((0.0, 0.0, inf),)), r"list\[0\]"),
    (lambda: OffsetSample(count=0), "at least one point"),
    (lambda: OffsetSample(count=4, method="dice"), r"sample\.method"),
    (lambda: OffsetSample(count=4, y=(0.1, -0.1)), r"sample\.y"),
    (lambda: RegularPolygon(sides=2, side=0.1), r"regular\.sides"),
    (lambda: RegularPolygon(sides=5, side=-0.1), r"regular\.side"),
    (lambda: FixelLayout(name="a", pegs=((0.5, 1.1),)), r"pegs\[0\]"),
    (lambda: FixelLayout(name="a", pegs=((0.5, nan),)), r"pegs\[0\]"),
    (lambda: FixelLayout(name="a", pegs=((0.5, 0.5),) * 101), "at most 100"),
    (lambda: FixelLayout(name="a", pegs=(), number=0), r"number is 0"),
    (lambda: FixelLayout(name="a/b", pegs=((0.5, 0.5),)), r"layout\.name"),
    (lambda: replace(SMALL, name=""), r"plan\.name"),
    (lambda: replace(SMALL, repetitions=0), "repetitions"),
    (lambda: replace(SMALL, repetitions=10**6), "at most 100000"),
    (lambda: replace(SMALL, schemes=()), "offsets"),
    (lambda: replace(SMALL, layouts=SMALL.layouts * 2), r"layouts\[1\]\.name"),
    (lambda: replace(SMALL.rig, speed=0.0), r"rig\.speed"),
])  # fmt: skip
def test_what_cannot_be_is_refused(build, where):
    with pytest.raises(InvalidInput, match=where):
        build()


# --- plans ---


def test_a_regular_polygon_turns_a_side_to_the_head():
    shape = RegularPolygon(sides=5, side=0.1).polygon
    left = np.sort(shape.vertices[:, 0])[:2]

    assert left == pytest.approx(-0.05 / np.tan(pi / 5))
    assert np.hypot(*np.diff(shape.vertices, axis=0).T) == pytest.approx(0.1)


def test_an_offset_turns_the_object_about_its_centroid():
    lopsided = PlannedShape(
        name="wedge", outline=Polygon([[0, 0], [0.1, 0], [0, 0.06]]), mass=0.2, zone_start=0.125
    )
    plan = replace(SMALL, shapes=(lopsided,), schemes=(Nominal(), Grid(theta=(1.0, 2.0))))
    bodies = [experiment.scene.bodies[0] for experiment in plan.experiments]
    places = np.array([placed(body.shape.centroid, body.pose) for body in bodies])

    assert places == pytest.approx(np.tile(places[0], (3, 1)))
    assert places[0, 1] == pytest.approx(0.0, abs=1e-12)
    assert [body.pose[2] for body in bodies] == pytest.approx([pi / 8, pi / 8 + 1, pi / 8 + 2])


def test_repetitions_follow_one_another():
    plan = replace(SMALL, repetitions=2, schemes=(OffsetList(((0, 0, 0), (0.01, 0, 0))),))

    assert [e.name for e in plan.experiments] == [
        "1-square-one-list1-r1",
        "2-square-one-list1-r2",
        "3-square-one-list2-r1",
        "4-square-one-list2-r2",
    ]
    assert [e.conditions["repetition"] for e in plan.experiments] == [1.0, 2.0, 1.0, 2.0]


def test_a_disk_is_an_object_too():
    disk = PlannedShape(name="disk", outline=Disk(0.05), mass=0.2, zone_start=0.125)

    assert replace(SMALL, shapes=(disk,)).check() == ()


# --- checks ---


def test_an_overlap_is_reported_and_left_out():
    plan = replace(SMALL, schemes=(Nominal(), OffsetList(((0.060, 0.0, 0.0),))))
    (problem,) = plan.check()

    assert problem.name == "2-square-one-list1"
    assert "overlap" in problem.sentence
    assert [e.name for e in plan.experiments] == ["1-square-one-nominal"]
    assert plan.total == 2


@pytest.mark.parametrize(("changes", "problem"), [
    ({"schemes": (OffsetList(((0.0, 0.2, 0.0),)),)}, "the head passes the object without contact"),
    ({"layouts": (FixelLayout(name="far", pegs=((0.99, 0.0), (0.99, 1.0))),)},
     "the object cannot reach a fixel: the distance"),
    (  # a peg in the gap between the head and the object
        {
            "shapes": (replace(SMALL.shapes[0], zone_start=0.03),),
            "layouts": (FixelLayout(name="blocked", pegs=((0.0, 0.5), (1.0, 0.5))),),
        },
        "the head collides with fixel-1",
    ),
])  # fmt: skip
def test_an_experiment_that_cannot_work_is_reported(changes, problem):
    assert any(sentence.startswith(problem) for sentence in sentences(**changes))


def test_a_head_that_stops_short():
    rig = replace(SMALL.rig, travel=0.040)
    (sentence,) = sentences(rig=rig)

    # The corner stands next to the head; the face meets the side behind it, further on.
    short = float(sentence.removeprefix("the head stops ").split(" mm")[0])
    assert 10.0 < short < 30.0


def test_a_rehearsal_tells_which_fixels_are_touched():
    near = FixelLayout(name="near", pegs=((0.60, 0.5), (0.99, 0.0)))
    aside = FixelLayout(name="aside", pegs=((0.9, 0.95),))
    plan = replace(SMALL, layouts=(near, aside), repetitions=2)

    rehearsal = rehearse(plan)

    assert rehearsal.touched == {
        "1-square-near-nominal-r1": [True, False],
        "3-square-aside-nominal-r1": [False],
    }
    assert [problem.name for problem in rehearsal.problems] == ["3-square-aside-nominal-r1"]
