"""Plans among other parts, against single simulations."""

from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import refused

import fixel
from fixel.model import Body, Fixel, PairFriction, Tripod
from fixel.planning.belief import Belief
from fixel.planning.plan import search_of
from fixel.planning.pushes import FreePushes, scene_of_push
from fixel.planning.rollout import FAILURES
from fixel.testing.scenes import box, pushed_square, row
from fixel.units import deg, mm

STRAIGHT = np.array([0.875, 0.0, 0.03])  # a push of 30 mm along x
START = fixel.StartError(x=2 * mm, y=2 * mm, theta=3 * deg, kind="uniform")


def scene(x=0.075):
    """Return the square, named second, with a block in its way."""
    support = Tripod(radius=0.01, friction=0.3)
    block = Body(name="block", shape=box(0.03, 0.03), mass=0.1, pose=row(x, 0.005, 0.3),
                 support=support)  # fmt: skip
    own = pushed_square()
    pair = PairFriction(pair=("block", "part"), friction=0.2)
    return replace(own, bodies=(block, *own.bodies), contact_friction=(pair,))


def goal(x=0.03):
    return fixel.PoseRegion((x, 0.0, 0.0), position=5 * mm, angle=10 * deg, body="part")


def simulator(where=None, **choice):
    choose = FreePushes(most=2, **choice)
    return search_of(where or scene(), goal(), choose, Belief(), rollouts=1000, seed=0).simulator


def carried_out(own, pushes, n, start=START):
    plans = own.planned(np.tile(STRAIGHT, (1, pushes, 1)))
    scenarios = Belief(start=start).scenarios(own.scene, worlds=n, runs=1)
    return plans, scenarios, own.run(plans, np.zeros(n, int), scenarios)


def test_pushes_of_several_parts_are_those_of_single_simulations():
    own = simulator()
    plans, scenarios, runs = carried_out(own, 2, 4)
    for k in range(4):
        part, others = plans.start[0, 0] + scenarios.start[k], [own.scene.bodies[1].pose]
        for path in plans.path[0]:
            done = fixel.simulate(scene_of_push(own.scene, part, path, others), motion=own.motion)
            part, others = np.array(done.final["part"]), [np.array(done.final["block"])]
        np.testing.assert_allclose(runs.pose[k, -1], part, atol=2e-5)
        assert others[0][0] > 0.08  # pushed away, by some 35 mm
    np.testing.assert_allclose(plans.others[0, 0], [own.scene.bodies[1].pose])
    assert plans.others[0, 1, 0, 0] > 0.08


def test_a_part_that_must_stay_is_not_moved():
    _, _, runs = carried_out(simulator(keep=["block"]), 1, 4)
    assert {FAILURES[k] for k in runs.failure} == {"a part that must stay is moved"}
    _, _, runs = carried_out(simulator(scene(x=0.2), keep=["block"]), 1, 4)
    assert not runs.failure.any()


def test_nothing_is_put_down_on_another_part():
    behind = scene(x=-0.08)  # where the tool starts
    _, _, runs = carried_out(simulator(behind), 1, 2)
    assert {FAILURES[k] for k in runs.failure} == {"the part or the tool starts on another part"}
    near = scene(x=0.07)  # a corner of the turned square reaches it
    turned = fixel.StartError(theta=30 * deg, kind="uniform")
    _, _, runs = carried_out(simulator(near), 1, 40, turned)
    assert 0 < np.count_nonzero(runs.failure) < 40


def test_another_part_stops_the_part_as_a_fixel_does():
    wall = Fixel(name="wall", shape=box(0.02, 0.3), pose=row(0.11, 0.0, 0.0), friction=0.2)
    ends = []
    for where in (scene(), replace(scene(), bodies=pushed_square().bodies, contact_friction=())):
        own = simulator(replace(where, fixels=(wall,)), force_limit=5.0)
        _, _, runs = carried_out(own, 1, 1, None)
        ends.append(runs.pose[0, -1, 0])
    assert ends[1] == pytest.approx(0.03, abs=1e-4)
    assert ends[0] < 0.022  # the block of 30 mm is between the part and the wall


def test_the_goal_names_the_part():
    assert [body.name for body in simulator().scene.bodies] == ["part", "block"]
    both = fixel.AllOf(goal(), replace(goal(), body="block"))
    refused(search_of, scene(), both, FreePushes(), Belief(), rollouts=1000, seed=0,
            match="conditions on block and part")  # fmt: skip


@pytest.mark.parametrize(("options", "text"), [
    ({"choose": FreePushes(keep=["blok"])}, "did you mean 'block'"),
    ({"looks": 1}, "2 free bodies"),
])  # fmt: skip
def test_what_several_parts_do_not_allow_is_refused(options, text):
    refused(fixel.plan, scene(), goal(), rollouts=1000, progress=False, match=text, **options)


def test_one_name_needs_no_list():
    assert FreePushes(keep="block").keep == ("block",)


def test_a_plan_names_its_other_parts():
    plan = fixel.plan(scene(), goal(0.04), FreePushes(), rollouts=1000, progress=False)
    assert plan.other_parts == "other parts: block may be pushed"
    assert plan.other_parts in repr(plan)
    assert plan.scenes[0].bodies[1].name == "block"
    legend = plan.plot().figure.legends[0]
    assert "other part, at the start" in [own.get_text() for own in legend.get_texts()]
    assert (
        replace(plan, choose=FreePushes(keep="block")).other_parts == "other parts: block must stay"
    )
