"""Plans through the public function, on small problems."""

from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import refused
from tests.planning.test_seen import CoarseModel
from tests.workflows.planning.plans import plan_of

import fixel
from fixel import Belief, FreePushes, InvalidInput, PoseRegion, RigError, RigPushes, StartError
from fixel.model import Seated
from fixel.planning.belief import check_centres
from fixel.planning.pushes import PlanPush
from fixel.simulation.motion import motion_model
from fixel.testing.scenes import grasp, pushed_square
from fixel.uncertainty.predictive import EndError
from fixel.units import deg, mm
from fixel.workflows.planning.execute import run_on_testbed

GOAL = PoseRegion((0.03, 0.01, 0.1), position=3 * mm, angle=3 * deg)
BELIEF = Belief(
    parameters={"mu_pusher": (0.2, 0.4)},
    start=StartError(x=0.5 * mm, y=0.5 * mm, theta=0.5 * deg, kind="uniform"),
    rig=RigError(path=0.2 * mm, heading=0.2 * deg),
)


@pytest.fixture(scope="module")
def found():
    return fixel.plan(pushed_square(), GOAL, belief=BELIEF, rollouts=4_000, progress=False)


def test_the_same_bits_for_any_number_of_threads(found):
    one = fixel.plan(
        pushed_square(), GOAL, belief=BELIEF, rollouts=4_000, threads=1, progress=False
    )
    assert one == found


def test_a_scene_file_does_not_choose_the_method(found, tmp_path):
    """A saved scene states dynamic motion; the default is that of the calibration, quasi-static."""
    pushed_square().save(tmp_path / "square.yaml")
    path = tmp_path / "square.yaml"
    assert "motion: dynamic" in path.read_text()
    again = fixel.plan(path, GOAL, belief=BELIEF, rollouts=4_000, progress=False)
    assert again.motion.name == "quasistatic"
    np.testing.assert_array_equal(again.path, found.path)


def test_another_seed_draws_other_scenarios(found):
    other = fixel.plan(pushed_square(), GOAL, belief=BELIEF, rollouts=4_000, seed=1, progress=False)
    assert not np.array_equal(other.runs.scenarios.start, found.runs.scenarios.start)


def test_the_path_of_a_plan_is_the_simulated_one(found):
    """`simulate` of a scene with the planned tool ends where the plan says."""
    scene = pushed_square()
    tool = scene.pushers[0]
    drive = fixel.PathDrive(found.path[0])
    own = fixel.Scene(
        scene.bodies,
        [fixel.Pusher("tool", tool.shape, friction=tool.friction, drive=drive)],
        duration=float(found.path[0, -1, 0]),
    )
    end = fixel.simulate(own, {"mu_pusher": 0.3}, motion="quasistatic")["part"].pose[-1]
    assert np.allclose(end, found.end, atol=3e-6)


def test_a_push_is_animated_as_planned(found, tmp_path):
    (run,) = found.as_planned()
    assert np.allclose(run.final["part"], found.end, atol=3e-6)
    assert "<script" in found.animate().page
    assert found.animate(tmp_path / "push.gif").stat().st_size > 1000
    refused(found.animate, push=2, match="one of its pushes")


def test_failures_name_the_event_that_happened():
    """A square pushed nearly through its centre needs the friction times its weight."""
    scene, most = pushed_square(), 0.45  # [N]
    event = fixel.ForceAbove(most)
    goal = fixel.AllOf(PoseRegion((0.03, 0, 0), position=3 * mm, angle=3 * deg), never=event)
    belief = Belief(parameters={"mu_support": (0.2, 0.4)})
    plan = fixel.plan(scene, goal, FreePushes(), belief, rollouts=4_000, progress=False)
    force = plan.runs.scenarios.values["mu_support"] * scene.bodies[0].mass * 9.81
    above = np.array(plan.runs.outcome) == "a force above 0.45 N"
    assert plan.failures == {"a force above 0.45 N": pytest.approx(1.0 - plan.success.mean)}
    assert plan.explain().kinds == {"a force above 0.45 N": above.sum()}
    assert force[~above].max() < 1.01 * most
    assert force[above].min() == pytest.approx(most, rel=0.01)


def test_without_anything_unknown_success_is_certain():
    plan = fixel.plan(pushed_square(), GOAL, rollouts=4_000, progress=False)
    assert plan.success.mean == 1.0
    assert plan.failures == {}


def test_a_plan_states_its_start_error(found):
    assert "start: +-0.5 mm, +-0.5 deg uniform" in repr(found)


def test_success_in_another_engine_is_that_of_its_runs_one_by_one(found):
    plan = replace(found, belief=replace(BELIEF, rig=None), goal=replace(GOAL, position=1 * mm))
    drawn, scene = plan.draw(6, seed=4), plan.scenes[0]
    part, engine = scene.bodies[0], "pymunk:inertia_factor=10"
    met = []
    for k in range(6):
        moved = replace(scene, bodies=(replace(part, pose=part.pose + drawn.start[k]),))
        friction = {"mu_pusher": float(drawn.values["mu_pusher"][k])}
        met.append(fixel.simulate(moved, friction, motion=engine).meets(plan.goal))

    success = plan.success_in(engine, 6, seed=4)

    assert success.n == 6
    assert success.value == pytest.approx(np.mean(met))
    assert 0 < sum(met) < 6


@pytest.mark.parametrize(
    ("chosen", "expected"), [("quasistatic", "dynamic"), ("dynamic", "dynamic")]
)
def test_a_later_belief_has_its_own_motion_unless_one_was_chosen(
    found, monkeypatch, chosen, expected
):
    """Parameters of a dynamic calibration are not those of quasi-static motion."""
    plan = replace(found, motion=motion_model(chosen))
    later = Belief(parameters={"mu_pusher": 0.3})
    own = property(lambda self: motion_model("dynamic" if self is later else "quasistatic"))
    monkeypatch.setattr(Belief, "motion", own)
    assert plan.under(later).motion == motion_model(expected)
    assert plan.under(plan.belief).motion == plan.motion


@pytest.mark.parametrize(("centre", "inside"), [
    ({"friction_centre_x": (-2.0, 2.0)}, False),  # two metres
    ({"friction_centre_x": 0.05, "friction_centre_y": 0.05}, True),
    ({"friction_centre_x": 0.051, "friction_centre_y": 0.0}, False),
    ({"friction_centre_y": (-0.001, 0.06)}, False),
])  # fmt: skip
def test_a_centre_of_friction_is_on_the_part(centre, inside):
    """The square has sides of 100 mm, and its centre of mass is in the middle."""
    belief = Belief(parameters=centre)
    if inside:
        return check_centres(belief, pushed_square())
    with pytest.raises(InvalidInput, match=r"centre of friction outside.*\[-50, 50\] mm"):
        fixel.plan(pushed_square(), GOAL, belief=belief, rollouts=4_000, progress=False)


def test_continues_from_its_store(found, tmp_path):
    class Stop(Exception):
        pass

    def stop(progress):
        if progress.stage == "refinement":
            raise Stop

    with pytest.raises(Stop):
        fixel.plan(
            pushed_square(), GOAL, belief=BELIEF, rollouts=4_000, store=tmp_path, progress=stop
        )
    again = fixel.plan(
        pushed_square(), GOAL, belief=BELIEF, rollouts=4_000, store=tmp_path, progress=False
    )
    assert again == found


def test_capture_is_certain_where_nothing_is_off(found):
    near, far = found.capture(0, [[0.0, 0.0, 0.0], [0.03, 0.03, 0.5]])
    assert near > 0.9
    assert far == 0.0


def test_an_unreachable_goal_is_refused_with_the_nearest_end():
    far = PoseRegion((3.0, 0.0, 0.0), position=1 * mm)
    with pytest.raises(InvalidInput, match=r"the nearest candidate ends at 1\d\d\.?\d* mm, .* deg"):
        fixel.plan(pushed_square(), far, rollouts=1_000, progress=False)


@pytest.mark.parametrize(("travel", "likely"), [(0.0, 1.0), (2 * mm, 0.383)])
def test_a_refused_goal_says_how_likely_the_nearest_end_is(travel, likely):
    """A square before a finger goes as far as the finger: a normal error of 2 mm is within 1 mm in
    38.3 % of the runs."""
    far = PoseRegion((3.0, 0.0, 0.0), position=1 * mm)
    belief = Belief(rig=RigError(travel=travel))
    with pytest.raises(InvalidInput, match="within the same tolerances of that pose") as refused:
        fixel.plan(pushed_square(), far, belief=belief, rollouts=1_000, progress=False)
    stated = float(str(refused.value).split("with probability ")[-1].split(",")[0])
    assert stated == pytest.approx(likely, abs=0.1)


@pytest.mark.system
def test_a_goal_that_only_part_of_the_belief_reaches_has_a_plan():
    """Pushes of 10 mm along the normals of the sides reach the goal only if the start is off."""
    choose = FreePushes(angle=1e-6, length=(10 * mm, 10.001 * mm))
    goal = PoseRegion((0.01, 0.005, 0.0), position=2.5 * mm, angle=3 * deg)
    with pytest.raises(InvalidInput, match="the nearest candidate ends"):
        fixel.plan(pushed_square(), goal, choose, rollouts=2_000, progress=False)
    belief = Belief(start=StartError(y=8 * mm, kind="uniform"))
    plan = fixel.plan(pushed_square(), goal, choose, belief, rollouts=2_000, progress=False)
    assert 0.2 < plan.success.mean < 0.4  # 5 mm of the start's 16 mm, and less for those that turn


@pytest.mark.system
def test_the_tolerance_that_an_error_advises_is_enough():
    """One push of a finger on a part turns it: 30 mm aside without a rotation are out of reach."""
    pose, choose = (0.02, 0.03, 0.0), FreePushes(length=(5 * mm, 60 * mm))
    tight = PoseRegion(pose, position=4 * mm, angle=4 * deg)
    with pytest.raises(InvalidInput, match=r"tolerances .* as wide") as refusal:
        fixel.plan(pushed_square(), tight, choose, rollouts=4_000, progress=False)
    factor = float(str(refusal.value).split("tolerances ")[-1].split(" times")[0])
    assert factor > 1.0
    wide = PoseRegion(pose, position=factor * 4 * mm, angle=factor * 4 * deg)
    plan = fixel.plan(pushed_square(), wide, choose, rollouts=4_000, progress=False)
    assert plan.success.mean == 1.0


def test_a_part_that_meets_its_goal_is_left_alone(tmp_path):
    """Starts within 4 mm along x meet a tolerance of 3 mm in three quarters of the runs."""
    goal = PoseRegion((0, 0, 0), position=3 * mm)
    belief = Belief(start=StartError(x=4 * mm, kind="uniform"))
    plan = fixel.plan(pushed_square(), goal, belief=belief, rollouts=4_000, progress=False)
    assert plan.pushes == ()
    assert plan.success.mean == pytest.approx(0.75, abs=0.01)
    assert repr(plan).startswith("Plan of no push, for the part already meets the goal: success")
    assert fixel.load(plan.save(tmp_path / "alone.plan")) == plan
    assert len(plan.waypoints().rows) == 0
    assert plan.plot() is not None
    refused(run_on_testbed, tmp_path / "alone.plan", trials=2, match="no pushes")


@pytest.mark.parametrize("rollouts", [float("nan"), "many", True, None, 999, 4_000.5])
def test_numbers_of_rollouts_that_are_none(rollouts):
    with pytest.raises(InvalidInput, match=r"^rollouts.*a whole number from 1000 to"):
        fixel.plan(pushed_square(), GOAL, rollouts=rollouts, progress=False)


@pytest.mark.parametrize(("make", "where"), [
    (lambda: FreePushes(length=(-5 * mm, 60 * mm)), "choose.length"),
    (lambda: RigPushes(stroke=(-10 * mm, 60 * mm)), "choose.stroke"),
    (lambda: RigPushes(fixels={"a": ((0, 1),)}), r"choose\.fixels 'a': found 1 range"),
    (lambda: RigPushes(fixels={3: ((0, 1), (0, 1))}), r"choose\.fixels is 3, but must be a name"),
    (lambda: RigPushes(fixels={"a": ((0, 1), (1, 0))}), r"choose\.fixels 'a' is 1 to 0"),
    (lambda: Belief(conditions=3), r"belief\.conditions: found the type int"),
    (lambda: Belief(conditions={"a": []}), r"belief\.conditions 'a': found the type list"),
    (lambda: Belief(conditions={3: "a"}), r"belief\.conditions is 3, but must be a name"),
    (lambda: PlanPush(0.5, 0.0, -0.01), "push.length"),
    (lambda: FreePushes(cost="tiem"), r"choose\.cost is .*tiem.*did you mean .*time"),
])  # fmt: skip
def test_negative_lengths_and_unknown_costs_are_refused(make, where):
    refused(make, match=where)


def test_a_placement_on_the_rig_seats_the_part():
    plan = fixel.plan(
        grasp(), Seated("fixel-1", "fixel-2"),
        RigPushes(y=(-20 * mm, 20 * mm), stroke=(100 * mm, 150 * mm)),
        rollouts=2_000, progress=False,
    )  # fmt: skip
    assert plan.success.mean == 1.0
    assert len(plan.pushes) == 1


def test_a_sequence_reaches_what_no_single_push_does():
    goal = PoseRegion((0.02, 0.05, 1.0), position=5 * mm, angle=5 * deg)
    choose = FreePushes(most=2, length=(5 * mm, 60 * mm))
    plan = fixel.plan(pushed_square(), goal, choose, rollouts=10_000, progress=False)
    assert plan.success.mean == 1.0
    assert len(plan.pushes) == 2


@pytest.mark.parametrize(("cost", "column"), [("length", slice(1, 3)), ("time", slice(0, 1))])
def test_the_cheapest_of_plans_that_succeed_as_often(cost, column):
    """A goal of 12 mm about 30 mm ahead takes 18 mm at least; the default goes to its middle."""
    goal = PoseRegion((0.03, 0.0, 0.0), position=12 * mm, angle=20 * deg)

    def path(kind):
        choose = FreePushes(length=(5 * mm, 60 * mm), cost=kind)
        plan = fixel.plan(pushed_square(), goal, choose, rollouts=4_000, progress=False)
        assert plan.success.mean == 1.0
        steps = np.diff(plan.path, axis=1)[..., column]
        return float(np.linalg.norm(steps, axis=-1).sum())

    assert path(cost) < 0.95 * path("pushes")


def test_a_plan_that_depends_on_a_parameter_says_which_to_measure():
    """The part turns to the side of its load, whose place decides alone; the friction does not."""
    goal = PoseRegion((0.03, 0.0, 0.0), position=5 * mm, angle=4 * deg)
    places = {"friction_centre_y": (-8 * mm, 8 * mm), "mu_pusher": (0.2, 0.4)}
    plan = fixel.plan(
        pushed_square(), goal, belief=Belief(parameters=places), rollouts=4_000, progress=False
    )
    success = plan.success
    assert success.low <= success.stated == success.mean <= success.high
    assert success.worst < 0.2
    assert success.best > 0.9
    assert "measuring friction_centre_y would " in plan.advice
    assert plan.advice in " ".join(repr(plan).split())
    assert success.sentence in " ".join(repr(plan).split())
    again = plan.success_under(plan.belief)
    assert again.n == 2400
    assert len(again.rates) == 256
    assert again.stated == pytest.approx(success.stated, abs=0.06)
    # Without unknown parameters there is no range, and nothing to measure.
    known = plan.success_under(Belief(parameters={"friction_centre_y": 1 * mm}))
    assert known.worst is None
    assert "parameters" not in known.sentence


def test_an_error_of_the_model_is_the_same_in_all_trials_of_a_world():
    """Any end within 3 mm is a success: Student's distribution in the plane, over worlds."""
    goal = PoseRegion((0.03, 0.0, 0.0), position=3 * mm, angle=90 * deg)
    belief = Belief(parameters=CoarseModel(EndError(2 * mm, 30 * mm)))  # in each direction
    plan = plan_of(pushed_square(), goal, FreePushes(), [(0.875, 0.0, 0.03)], belief)
    found = plan.success_under(belief)
    assert found.low < 1.0 - 1.0 / (1.0 + 0.5 * 1.5**2) < found.high
    assert set(found.rates) == {0.0, 1.0}
    assert (found.worst, found.best) == (0.0, 1.0)
