"""Orienting plans and flush distances: bad input, hollows, another centre of mass, printing."""

from math import pi, tau
from time import process_time

import numpy as np
import pytest
from tests.fixtures import refused

from fixel import Body, Disk, NoSupport, Polygon, UniformPressure, orienting_plan
from fixel.planning.geometric import flush_distance, friction_arm, stable_push_angle
from fixel.planning.orienting import PushFunction

L_SHAPE = Polygon([(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)])


def _body(shape, **options):
    return Body("part", shape, mass=1.0, support=options.pop("support", NoSupport()), **options)


def test_a_hollow_does_not_touch_the_fence():
    hull = Polygon([(0, 0), (3, 0), (3, 1), (1, 3), (0, 3)])
    own, filled = (
        PushFunction.of(L_SHAPE),
        PushFunction.of(_body(hull, centre_of_mass=L_SHAPE.centroid)),
    )
    assert own.stable == pytest.approx(filled.stable)
    assert own.borders == pytest.approx(filled.borders)


def test_the_centre_of_mass_decides_where_a_part_rests():
    square = Polygon.rectangle(2, 2)
    part = _body(square, centre_of_mass=(0.5, 0.2))
    assert PushFunction.of(square).symmetry == 4
    assert PushFunction.of(part).symmetry == 1
    assert len(np.unique(orienting_plan(part).ends(np.linspace(0, 6, 100)).round(9))) == 1


def test_turning_the_outline_turns_directions_and_leaves_rotations():
    turn = 0.7
    c, s = np.cos(turn), np.sin(turn)
    turned = Polygon(L_SHAPE.outline @ [[c, s], [-s, c]])
    plan, other = orienting_plan(L_SHAPE), orienting_plan(turned)
    assert other.rotations == pytest.approx(plan.rotations)
    assert other.margins == pytest.approx(plan.margins)
    off = np.mod(other.function.stable - turn, tau)
    assert np.sort(np.minimum(off, tau - off)) == pytest.approx(
        np.sort(np.minimum(plan.function.stable, tau - plan.function.stable))
    )


def test_ends_and_the_angle_of_the_plan_agree():
    plan = orienting_plan(L_SHAPE, angle_error=0.05)
    rng = np.random.default_rng(1)
    starts = rng.uniform(0, tau, 200)
    errors = rng.uniform(-1, 1, (200, plan.pushes - 1)) * 0.05
    assert plan.ends(starts, errors) == pytest.approx(np.full(200, plan.angle))
    assert plan.ends(0.3).shape == ()


def test_a_plan_prints_its_pushes_with_margins():
    text = repr(orienting_plan(L_SHAPE, angle_error=0.01))
    assert text.startswith("Orienting plan of ")
    assert "margin [deg]" in text
    assert repr(orienting_plan(Polygon.rectangle(1, 1))).startswith("Orienting plan of 1 push by")


def test_outlines_with_many_corners_take_a_second_at_most():
    angle = np.sort(np.random.default_rng(5).uniform(0, tau, 40))
    rough = Polygon(np.column_stack((np.cos(angle), np.sin(angle))))
    begin = process_time()
    plan = orienting_plan(rough)
    assert process_time() - begin < 2.0
    assert 10 < plan.pushes <= 40
    assert plan.ends(np.linspace(0, tau, 1000)) == pytest.approx(np.full(1000, plan.angle))


@pytest.mark.parametrize(("build", "part", "options", "message"), [
    (orienting_plan, Disk(0.1), {}, "fixel needs a part with corners"),
    (orienting_plan, _body(Disk(0.1)), {}, "fixel needs a part with corners"),
    (PushFunction.of, "square", {}, "part"),
    (PushFunction.of, None, {}, "part"),
    (PushFunction.of, _body(Polygon.rectangle(1, 1), centre_of_mass=(2, 0)), {},
     "outside the outline"),
    (orienting_plan, L_SHAPE, {"angle_error": -0.1}, "angle_error"),
    (orienting_plan, L_SHAPE, {"angle_error": np.nan}, "angle_error"),
    (orienting_plan, L_SHAPE, {"angle_error": np.inf}, "angle_error"),
])  # fmt: skip
def test_what_cannot_be_oriented_is_refused(build, part, options, message):
    refused(build, part, **options, match=message)


def test_distances_of_bad_arms_and_supports_are_refused():
    refused(flush_distance, L_SHAPE, 0.1, arm=0.0, match="arm")
    refused(friction_arm, _body(L_SHAPE), match="support")
    refused(friction_arm, _body(L_SHAPE, support=UniformPressure(friction=0.0)), match="support")
    refused(stable_push_angle, 0.2, 0.1, 0.0, match="depth")


def test_distances_are_finite_except_from_a_balanced_corner():
    square = Polygon.rectangle(1, 1)
    assert flush_distance(square, [0.0, pi / 2]) == pytest.approx([0.0, 0.0])
    assert flush_distance(square, pi / 4 - 1e-3) > 2.0
    assert not np.isnan(flush_distance(square, np.linspace(0, tau, 9))).any()
