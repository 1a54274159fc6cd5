"""Plans that look at the part between pushes, against pushes that are simulated one by one."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from tests.fixtures import refused

import fixel
from fixel import Belief, FreePushes, InvalidInput, PoseRegion, Seated, StartError
from fixel.drawing.planning import looks_chart
from fixel.model import Disk, Fixel
from fixel.planning.corrections import Correction, CorrectionTable, likelihoods
from fixel.planning.looks import Policy, looks_of
from fixel.planning.plan import search_of
from fixel.planning.pushes import scene_of_push
from fixel.planning.search import DRAWS, SearchStage, Views
from fixel.testing.scenes import grasp, pushed_square
from fixel.units import deg, mm

CAMERA = StartError(x=0.1 * mm, y=0.1 * mm, theta=0.2 * deg, kind="normal")
GOAL = PoseRegion((30 * mm, 10 * mm, 0.2), position=3 * mm, angle=4 * deg)
UNKNOWN = Belief(
    parameters={"mu_pusher": (0.1, 0.5), "friction_centre_y": (-3 * mm, 3 * mm)},
    start=StartError(x=1 * mm, y=1 * mm, theta=1.5 * deg, kind="normal"),
)


@pytest.fixture(scope="module")
def plan():
    return fixel.plan(
        pushed_square(), GOAL, FreePushes(length=(2 * mm, 60 * mm)), UNKNOWN,
        looks=2, camera=CAMERA, rollouts=8_000, progress=False,
    )  # fmt: skip


def met(plan, pose):
    """Whether a pose meets the goal, by its definition."""
    goal = plan.goal
    off = pose - goal.pose
    turn = (off[2] + np.pi) % (2.0 * np.pi) - np.pi
    return np.hypot(*off[:2]) <= goal.position and abs(turn) <= goal.angle


def in_one_world(plan, rng):
    """Carry out a plan in one world drawn here, by single simulations."""
    world = {"mu_pusher": rng.uniform(0.1, 0.5), "friction_centre_y": rng.uniform(-3 * mm, 3 * mm)}
    size = UNKNOWN.start.size
    state = {"pose": plan.first_pose + size * rng.standard_normal(3)}

    def push(scene):
        begun = replace(scene, bodies=(replace(scene.bodies[0], pose=state["pose"]),))
        state["pose"] = fixel.simulate(begun, world, motion="quasistatic")["part"].pose[-1]

    def look():
        return state["pose"] + CAMERA.size * rng.standard_normal(3)

    blind = []

    def first_look():
        blind.append(met(plan, state["pose"]))
        return look()

    chosen = plan.perform(push, first_look)
    return blind[0], met(plan, state["pose"]), chosen


@pytest.mark.system
def test_stated_success_holds_where_the_plan_is_carried_out_push_by_push(plan):
    rng = np.random.default_rng(4)
    runs = [in_one_world(plan, rng) for _ in range(60)]
    for k, stated in ((0, plan.looks.worth[0].mean), (1, plan.success.mean)):
        held = np.mean([own[k] for own in runs])
        error = np.sqrt(max(stated * (1 - stated), 0.02) / len(runs))
        assert abs(held - stated) < 3.5 * error
    assert plan.success.mean > plan.looks.worth[0].mean + 0.1


@pytest.mark.system
def test_each_look_is_worth_something_and_the_sentences_say_it(plan):
    means = [own.mean for own in plan.looks.worth]
    assert len(means) == 3
    assert means[0] < means[1] <= means[2] + 0.01
    assert f"from {means[0]:.2f} to {means[1]:.2f}" in str(plan)


@pytest.mark.system
def test_a_tight_goal_is_stated_by_fewer_scenarios_and_each_is_counted(plan):
    """Most of its corrections are refined, which takes far longer than a lookup in the table."""
    tight = replace(GOAL, position=0.5 * mm, angle=0.5 * deg)
    for goal, draws in ((GOAL, 2_400), (tight, 833)):
        own = replace(plan.policy, simulator=replace(plan.policy.simulator, goal=goal))
        assert own.stages(UNKNOWN)[0].worlds == draws
    shown = []
    looks_of(plan.policy, [SearchStage(DRAWS, 300, 1)], 1, report=shown.append)
    assert [(one.done, one.total) for one in shown] == [(k, 600) for k in (150, 300, 450, 600)]


def test_entries_of_the_table_are_pushes_of_their_length():
    """Poses on the way of one long push; here each is the end of a push of its own."""
    scene = pushed_square()
    search = search_of(scene, GOAL, FreePushes(), UNKNOWN, rollouts=4_000, seed=0)
    table = CorrectionTable.of(search.simulator, UNKNOWN, 4_000, 3)
    rng = np.random.default_rng(1)
    for row in rng.choice(len(table.numbers), 6, replace=False):
        world = int(rng.integers(table.moved.shape[1]))
        values = {name: float(x[world]) for name, x in table.worlds.values.items()}
        simulator = search.simulator
        planned = simulator.planned(table.numbers[row][None, None], np.zeros((1, 3)))
        single = fixel.planning.pushes.scene_of_push(
            simulator.scene, np.zeros(3), planned.path[0, 0]
        )
        end = fixel.simulate(single, values, motion="quasistatic")["part"].pose[-1]
        # Within the tolerances of the stepper.
        assert (np.abs(table.moved[row, world] - end) < (3e-5, 3e-5, 5e-4)).all()


@pytest.mark.system
def test_a_goal_beyond_one_push_has_a_plan_with_a_look():
    """No push is as long as the way to the goal; what is stated holds push by push."""
    goal = PoseRegion((40 * mm, 0.0, 0.0), position=4 * mm, angle=5 * deg)
    given = (pushed_square(), goal, FreePushes(length=(2 * mm, 25 * mm)), UNKNOWN)
    options = dict(rollouts=2_000, progress=False)
    refused(fixel.plan, *given, **options, match="the nearest candidate ends")
    plan = fixel.plan(*given, looks=1, camera=CAMERA, **options)
    assert plan.looks.worth[0].mean == 0.0
    assert plan.success.mean > 0.3
    rng = np.random.default_rng(4)
    held = np.mean([in_one_world(plan, rng)[1] for _ in range(60)])
    assert abs(held - plan.success.mean) < 3.5 * np.sqrt(0.25 / 60)


@pytest.mark.system
def test_a_goal_that_no_correction_reaches_is_refused():
    far = PoseRegion((3.0, 0.0, 0.0), position=1 * mm)
    with pytest.raises(InvalidInput, match="the nearest candidate ends"):
        fixel.plan(pushed_square(), far, looks=1, rollouts=1_000, progress=False)


def searched(goal=GOAL, looks=1, choose=FreePushes(length=(2 * mm, 60 * mm))):  # noqa: B008
    return search_of(
        pushed_square(), goal, choose, UNKNOWN, rollouts=4_000, seed=0, views=Views(looks, CAMERA)
    )


@pytest.fixture(scope="module")
def policy():
    """Policy that looks before any push, at a goal tighter than the pushes of its table."""
    goal = replace(GOAL, position=0.7 * mm, angle=1.0 * deg)
    search = searched(goal)
    table = CorrectionTable.of(search.simulator, UNKNOWN, 4_000, 3)
    planned = search.simulator.planned(np.zeros((1, 0, 3)))
    return Policy(
        simulator=search.simulator, belief=UNKNOWN, planned=planned, table=table, views=search.views
    )


def test_a_refined_push_reaches_a_goal_that_the_table_misses(policy):
    """Carried out by single simulations, in a world that is known to the policy."""
    known = replace(
        policy.table,
        worlds=policy.table.worlds._replace(
            values={"mu_pusher": np.full(32, 0.3), "friction_centre_y": np.zeros(32)}
        ),
    )
    seen = pushed_square().bodies[0].pose + np.array([[1, 2, 0.05], [0, -1, 0.0]]) * (mm, mm, 1.0)
    ends = {}
    for refined in (False, True):
        own = replace(policy, table=known, refined=refined)
        start = np.repeat(seen[:, None], 32, axis=1)
        found = own._chosen(seen, np.ones((2, 32)), start)
        path = own.simulator.choice.motions(own.simulator.scene, found.numbers, seen).path
        for k in range(2):
            push = fixel.planning.pushes.scene_of_push(own.simulator.scene, seen[k], path[k])
            world = {"mu_pusher": 0.3, "friction_centre_y": 0.0}
            end = fixel.simulate(push, world, motion="quasistatic")["part"].pose[-1]
            ends[k, refined] = np.hypot(*(end - GOAL.pose)[:2])
    assert max(ends[k, True] for k in range(2)) < 0.7 * mm
    assert min(ends[k, False] for k in range(2)) > 0.7 * mm


def test_parts_near_a_tight_goal_are_refined_by_pushes_shorter_than_those_of_a_plan(policy):
    """Without lengths of the user, corrections may be shorter, also while they are refined."""
    search = searched(policy.simulator.goal, choose=FreePushes())
    table = CorrectionTable.of(search.simulator, Belief(), 4_000, 3)
    own = replace(policy, simulator=search.simulator, belief=Belief(), table=table)
    off = np.random.default_rng(1).uniform(-1.0, 1.0, (20, 3)) * (3 * mm, 3 * mm, 3 * deg)
    seen = GOAL.pose + off
    found = own._chosen(seen, np.ones((20, 32)), np.repeat(seen[:, None], 32, axis=1))
    paths = own.simulator.choice.motions(own.simulator.scene, found.numbers, seen).path
    scenes = map(partial(scene_of_push, own.simulator.scene), seen, paths)
    ends = [fixel.simulate(scene, motion="quasistatic")["part"].pose[-1] for scene in scenes]
    assert sum(met(own.simulator, end) for end in ends) >= 12  # 3 by the pushes of the table
    shortest = own.simulator.choice.bounds(own.simulator.scene)[0][2]
    assert (found.numbers[found.refined, 2] < shortest).any()


def test_only_runs_of_a_correction_are_simulated_and_not_its_planned_end(policy):
    """A correction needs the end of a push in its worlds only: 32 rollouts for one push of 32."""
    simulator, numbers = replace(policy.simulator, rollouts=0), policy.table.numbers[:5]
    seen = pushed_square().bodies[0].pose + np.random.default_rng(2).normal(0.0, mm, (5, 3))
    case = seen, np.ones((5, 32)), np.repeat(seen[:, None], 32, axis=1)
    none = np.zeros((5, 1))
    tried = Correction(none.astype(int), none, none, numbers[:, None], none.astype(bool))
    found = policy.table._tried(simulator, case, tried, 32)
    assert simulator.rollouts == 5 * 32
    planned = simulator.planned(numbers[:, None], seen)
    for own, other in zip(simulator.single(numbers, seen), planned, strict=True):
        if isinstance(own, np.ndarray):
            np.testing.assert_array_equal(own, other)
    worlds = policy.table.worlds.rows(np.tile(np.arange(32), 5))
    misfit = policy.table.draws[1] / np.array([1.0, 1.0, policy.table.arm])
    worlds = worlds._replace(misfit=np.tile(misfit, (5, 1)))
    met = simulator.margins(simulator.run(planned, np.repeat(np.arange(5), 32), worlds)) >= 0.0
    np.testing.assert_allclose(found.probability[:, 0], met.reshape(5, 32).mean(axis=1))


def test_no_push_among_fixels_is_simulated_twice_in_the_same_worlds(policy, monkeypatch):
    fixel_far_away = Fixel("far", Disk(5 * mm), pose=(0.3, 0.0, 0.0), friction=0.2)
    scene = replace(policy.simulator.scene, fixels=(fixel_far_away,))
    simulated, tried = [], CorrectionTable._tried

    def recorded(table, simulator, case, pushes, worlds):
        simulated.extend((worlds, *own) for own in pushes.numbers[0].tolist())
        return tried(table, simulator, case, pushes, worlds)

    monkeypatch.setattr(CorrectionTable, "_tried", recorded)
    seen = pushed_square().bodies[0].pose[None] + np.array([1 * mm, 2 * mm, 0.05])
    case = seen, np.ones((1, 32)), np.repeat(seen[:, None], 32, axis=1)
    found = replace(policy, simulator=replace(policy.simulator, scene=scene))._chosen(*case)
    assert found.refined.all()
    assert len(simulated) == len(set(simulated)) > 20
    alone = policy._chosen(*case)  # the fixel is out of reach
    assert (found.numbers == alone.numbers).all()


def test_refined_pushes_stay_near_those_of_the_table(policy):
    seen = pushed_square().bodies[0].pose + np.array([[1, 2, 0.05], [0, -1, 0.0]]) * (mm, mm, 1.0)
    start = policy._starts(seen, None)
    found = policy._chosen(seen, np.ones((2, 32)), start)
    low, high = policy.simulator.choice.bounds(policy.simulator.scene)
    off = (found.numbers - policy.table.numbers[found.row]) / (high - low)
    assert (np.abs(off) <= 0.15 + 1e-9).all()
    assert (found.refined == (off != 0.0).any(axis=1)).all()
    assert (found.numbers[:, 2] <= high[2]).all()
    # A pose alone and among others has the same correction.
    alone = policy._chosen(seen[1:], np.ones((1, 32)), start[1:])
    assert (alone.numbers[0] == found.numbers[1]).all()


def test_starts_are_the_product_of_prediction_and_view(policy):
    """Drawn starts agree with importance weights of many poses, another method."""
    rng = np.random.default_rng(8)
    draws = rng.standard_normal((2, 32, 3))
    size = np.array([0.08 * mm, 0.15 * mm, 0.1 * deg])
    ends = size * rng.standard_normal((32, 24, 3))
    own = replace(policy, table=replace(policy.table))
    vars(own).update(_ends=ends.reshape(-1, 3))
    seen = np.array([[0.1 * mm, -0.1 * mm, 0.1 * deg]])
    vars(own.table).update(draws=draws)
    found = own._starts(seen, None)[0]
    for world in range(3):
        many = rng.multivariate_normal(ends[world].mean(axis=0), np.cov(ends[world].T), 100_000)
        weight = np.exp(-0.5 * np.sum(((many - seen) / CAMERA.size) ** 2, axis=1))
        mean = weight @ many / weight.sum()
        root = np.linalg.cholesky(np.cov(many.T, aweights=weight))
        expected = mean + root @ draws[0, world]
        assert found[world] == pytest.approx(expected, abs=0.02 * mm)
    far = seen + np.array([10 * mm, 10 * mm, 0.0])
    off = np.abs(own._starts(far, None)[0] - far).max(axis=0)
    assert (off < (0.5 * mm, 0.5 * mm, 1.0 * deg)).all()  # about the view, not the prediction


def test_a_table_of_no_trusted_pushes_is_refused():
    search = search_of(pushed_square(), GOAL, FreePushes(), UNKNOWN, rollouts=4_000, seed=0)
    with pytest.raises(InvalidInput, match="untrusted=True"):
        CorrectionTable.of(search.simulator, UNKNOWN, 4_000, 3, lambda numbers: False)


def test_weights_of_predictions_are_those_of_a_linear_filter():
    """A scalar linear case: the weighted mean is that of the product of two normal densities."""
    rng = np.random.default_rng(0)
    spread, error, seen = 2.0 * mm, 1.0 * mm, 1.5 * mm
    predicted = np.zeros((1, 40_000, 3))
    predicted[0, :, 0] = spread * rng.standard_normal(40_000)
    weight = likelihoods(np.array([[seen, 0.0, 0.0]]), predicted, np.full(3, error), 32.0)[0]
    mean = weight @ predicted[0, :, 0] / weight.sum()
    assert mean == pytest.approx(seen * spread**2 / (spread**2 + error**2), abs=0.03 * mm)


def test_a_pose_unlike_all_predictions_counts_them_by_their_spread():
    predicted = np.zeros((1, 64, 3))
    predicted[0, :, 0] = np.linspace(-1.0, 1.0, 64) * mm
    weight = likelihoods(np.array([[50 * mm, 0.0, 0.0]]), predicted, np.full(3, 0.01 * mm), 16.0)
    assert np.isfinite(weight).all()
    assert weight.argmax() == 63


@pytest.mark.system
def test_a_part_in_the_middle_of_the_goal_is_left_alone(plan):
    found = plan.correction(GOAL.pose)
    assert found.push is None
    assert found.probability > 0.99


@pytest.mark.system
def test_the_chart_of_looks_names_the_direction_in_which_each_push_moves_the_part(plan):
    axes = plan.plot("looks")
    labels = axes[0].get_legend_handles_labels()[1]
    assert any(label.startswith("no push: ") for label in labels)
    rows = looks_chart(plan).data.records()
    assert len(rows) == len(plan.runs.margin)
    towards = {"towards +x": (1, 0), "towards -x": (-1, 0), "towards +y": (0, 1)}
    towards["towards -y"] = (0, -1)
    chosen = [row for row in rows if row["next"] != "no push"]
    assert len(chosen) > 5
    for row in chosen[:5]:
        seen = np.array([row["seen_x_m"], row["seen_y_m"], row["seen_angle_rad"]])
        found = plan.correction(seen)
        assert found.probability == pytest.approx(row["probability"])
        world = {"mu_pusher": 0.3, "friction_centre_y": 0.0}
        end = fixel.simulate(found.scene, world, motion="quasistatic")["part"].pose[-1]
        way = (end - seen)[:2]
        along = way @ towards[row["next"]] / np.hypot(*way)
        assert along > np.cos(np.radians(60.0))  # a sector of 90 degrees, and another world


def test_a_plan_without_looks_has_no_chart_of_them_and_no_corrections():
    plan = fixel.plan(pushed_square(), GOAL, rollouts=1_000, progress=False)
    refused(plan.plot, "looks", match="no looks")
    refused(plan.correction, (0.0, 0.0, 0.0), match="looks=1")


@pytest.mark.system
def test_looks_that_see_nothing_push_nothing(plan):
    pushes = []
    assert plan.perform(pushes.append, lambda: None) == ()
    assert len(pushes) == len(plan.pushes)


@pytest.mark.system
def test_lost_views_lower_the_stated_success():
    options = dict(looks=1, camera=CAMERA, rollouts=4_000, progress=False)
    scene, choose = pushed_square(), FreePushes(length=(2 * mm, 60 * mm))
    seen, half = (
        fixel.plan(scene, GOAL, choose, UNKNOWN, lost_views=lost, **options) for lost in (0.0, 0.5)
    )
    low, high = half.looks.worth[0].mean, seen.success.mean
    assert half.success.mean == pytest.approx(0.5 * (low + high), abs=0.05)


def test_a_part_that_is_seen_after_a_lost_view_is_corrected_as_one_that_is_seen_first(monkeypatch):
    """The stated policy and `correction` choose from the same seen poses, also after lost views."""
    goal = replace(GOAL, position=1 * mm, angle=1.5 * deg)
    search = searched(goal, looks=2)
    table = CorrectionTable.of(search.simulator, UNKNOWN, 4_000, 3)
    policy = Policy(
        simulator=search.simulator, belief=UNKNOWN, table=table, refined=False,
        planned=search.simulator.planned(search.candidates()[0][None]),
        views=Views(2, CAMERA, lost_views=0.5),
    )  # fmt: skip
    chosen, choose = [], CorrectionTable.chosen

    def recorded(self, simulator, case, *options):
        found = choose(self, simulator, case, *options)
        chosen.append((case[0], found))
        return found

    monkeypatch.setattr(CorrectionTable, "chosen", recorded)
    policy.walk(UNKNOWN.scenarios(search.simulator.scene, worlds=12, runs=1), 3)
    (first, _), (seen, found), (again, _) = chosen
    assert 0 < len(seen) <= 12 - len(first)
    assert 0 < len(again) <= len(first)
    for k, pose in enumerate(seen):
        own = policy.next(pose)
        assert own.row[0] == found.row[k]
        assert own.probability[0] == found.probability[k]


@pytest.mark.parametrize("kind", ["rest", "drift"])
def test_corrections_expect_the_error_of_a_model_or_of_runs(kind):
    """Ends after pushes of the table scatter by a belief's error, as those of plans do."""
    search = searched()
    table = CorrectionTable.of(search.simulator, UNKNOWN, 4_000, 3)
    rng = np.random.default_rng(3)
    error = rng.standard_normal((32, 3)) * (1 * mm, 2 * mm, 0.05)
    own = replace(table, worlds=table.worlds._replace(**{kind: error}))
    row = np.array([5])
    start = np.tile([10 * mm, 0.0, 0.1], (1, 32, 1))
    off = own.after(row, start) - table.after(row, start)
    turned = np.abs(table.moved[5, :, 2].astype(float))[:, None] if kind == "rest" else 0.25
    np.testing.assert_allclose(off[0], error * turned / 0.25, atol=1e-12)


@pytest.mark.system
def test_a_plan_with_looks_states_no_worth_of_measuring_for_plans_without_them(plan):
    assert all(own.worth == 0.0 for own in plan.explain().effects)
    assert "Measuring" not in str(plan.explain())


@pytest.mark.system
@pytest.mark.parametrize("looks", [0, 3])
def test_a_correction_after_the_last_look_has_no_probability(plan, looks):
    with pytest.raises(InvalidInput, match=f"found {looks} poses, but fixel needs 1 to 2"):
        plan.correction(*[plan.end] * looks)


@pytest.mark.system
def test_a_plan_judges_what_it_sees_by_its_own_belief_in_any_world(plan, monkeypatch):
    """Success in another world weighs seen poses by the plan's own belief, as corrections do."""
    compared = []

    def recorded(seen, predicted, deviation, least):
        compared.append(predicted)
        return likelihoods(seen, predicted, deviation, least)

    monkeypatch.setattr("fixel.planning.looks.likelihoods", recorded)
    plan.correction(plan.end)
    plan.success_under(replace(UNKNOWN, parameters={"mu_pusher": 0.4, "friction_centre_y": 2 * mm}))
    assert len(compared) > 1
    np.testing.assert_array_equal(compared[1], compared[0])


@pytest.mark.system
def test_a_saved_plan_chooses_the_same_corrections(plan, tmp_path):
    again = fixel.load(plan.save(tmp_path / "looks.plan"))
    seen = (28 * mm, 12 * mm, 0.1)
    assert again.correction(seen).push == plan.correction(seen).push
    assert again.success.mean == plan.success.mean


@pytest.mark.parametrize(("options", "found"), [
    ({"looks": -1}, "looks"),
    ({"looks": 9}, "looks"),
    ({"looks": 1, "lost_views": 1.0}, "lost_views"),
    ({"looks": 1, "camera": (1, 1, 1)}, "camera"),
])  # fmt: skip
def test_wrong_looks_are_refused_before_any_search(options, found):
    refused(fixel.plan, pushed_square(), GOAL, belief=UNKNOWN, **options, match=found)


def test_goals_that_a_seen_pose_cannot_meet_are_refused():
    scene = grasp()
    goal = Seated(*[own.name for own in scene.fixels])
    refused(fixel.plan, scene, goal, FreePushes(), looks=1, progress=False, match="seen pose")
