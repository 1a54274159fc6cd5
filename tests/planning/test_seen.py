"""Beliefs after a pose was seen during a plan."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from tests.workflows.planning.plans import plan_of

import fixel
from fixel import Belief, FreePushes, PoseRegion, QuasiStatic, StartError
from fixel.planning.seen import belief_after, is_met
from fixel.testing.scenes import grasp, pushed_square
from fixel.uncertainty.predictive import EndError
from fixel.units import deg, mm

CAMERA = StartError(x=0.1 * mm, y=0.1 * mm, theta=0.1 * deg, kind="normal")


@pytest.fixture(scope="module")
def plan():
    goal = PoseRegion((0.02, 0.05, 1.0), position=8 * mm, angle=8 * deg)
    return fixel.plan(
        pushed_square(), goal, FreePushes(most=2, length=(10 * mm, 60 * mm)),
        Belief(parameters={"friction_centre_y": (-6 * mm, 6 * mm)}),
        rollouts=4_000, progress=False,
    )  # fmt: skip


@pytest.mark.system
def test_the_seen_pose_tells_the_pressure_centre_of_the_run(plan):
    """A world is simulated apart from the plan; its end after one push leads back to its value."""
    assert len(plan.pushes) == 2
    for truth in (-4 * mm, 3 * mm):
        end = fixel.simulate(plan.scenes[0], {"friction_centre_y": truth}, motion="quasistatic")
        found = belief_after(plan, end["part"].pose[-1], 1, CAMERA)[0]
        drawn = np.array([own["friction_centre_y"] for own in found.parameters])
        assert drawn.mean() == pytest.approx(truth, abs=0.7 * mm)
        assert drawn.std() < 0.7 * mm


def test_a_pose_unlike_all_runs_says_nothing(plan):
    found, note = belief_after(plan, np.array([0.5, 0.5, 1.0]), 1, CAMERA)
    assert "unlike the planned runs" in note
    assert found.parameters == plan.belief.parameters


def test_before_the_first_push_only_the_start_is_new(plan):
    found, _ = belief_after(plan, plan.start[0], 0, CAMERA)
    assert found.start == CAMERA
    assert found.parameters == plan.belief.parameters


@pytest.mark.parametrize("worlds", [8, 64, 201, 804])
def test_few_worlds_are_drawn_from_all_parameter_sets(worlds):
    """Sets after a look are in the order of the runs that they come from."""
    friction = np.linspace(0.1, 0.5, 201)
    sets = [{"mu_pusher": float(own)} for own in friction]
    for belief in (Belief(parameters=sets), Belief(sets=sets)):
        drawn = belief.scenarios(pushed_square(), worlds=worlds, runs=1).values["mu_pusher"]
        assert drawn[0] == 0.1  # the nominal one
        assert drawn.mean() == pytest.approx(0.3, abs=0.03)
        assert drawn.std() == pytest.approx(friction.std(), rel=0.05)


def test_a_part_at_rest_needs_no_force_and_touches_fixels_where_the_plan_has_them():
    """Fixels that are all moved by the same move the end of a grasp by that."""
    goal = fixel.AllOf(fixel.Seated("fixel-1"), never=[fixel.ForceAbove(1.0)])
    choose = fixel.RigPushes(stroke=(0.02, 0.15), fixels={
        f"fixel-{k}": ((-10 * mm, 10 * mm),) * 2 for k in (1, 2, 3)
    })  # fmt: skip
    own, moved = (
        plan_of(grasp("seated"), goal, choose, [(0, 0, 0, 0.12, *3 * (x, 0.0))], Belief())
        for x in (0.0, 5 * mm)
    )
    assert moved.end - own.end == pytest.approx((5 * mm, 0, 0), abs=1e-6)
    assert is_met(own, own.end)
    assert is_met(moved, moved.end)
    assert not is_met(moved, own.end)


class CoarseModel:
    """Calibrated model whose predicted ends err."""

    motion, estimates, known = QuasiStatic(), {}, None

    def __init__(self, error):
        self.error = error

    def values_for(self, **conditions):
        return {"mu_pusher": 0.3}

    def samples(self, n, seed, **conditions):
        return {"mu_pusher": np.random.default_rng(seed).uniform(0.2, 0.4, n)}

    @property
    def predictive(self):
        own = lambda n, seed, conditions: self.samples(n, seed)  # noqa: E731
        return SimpleNamespace(samples=own, error=self.error)


def test_a_look_does_not_make_the_model_exact():
    """The tool decides how far a square goes straight ahead; the rest is the error of the model."""
    goal, start = PoseRegion((0.05, 0.0, 0.0), position=5 * mm), StartError(x=mm, kind="normal")
    plan = plan_of(
        pushed_square(), goal, FreePushes(most=2), [(0.875, 0.0, 0.02), (0.875, 0.0, 0.03)],
        Belief(parameters=CoarseModel(EndError(3 * mm, 40 * mm)), start=start),
    )  # fmt: skip
    found = belief_after(plan, plan.start[1], 1, CAMERA)[0]
    assert found.is_calibrated
    rest = replace(plan, belief=found, start=plan.start[1:], path=plan.path[1:])
    runs = rest.run(found.scenarios(plan.scene, worlds=4096, runs=1), samples=1, threads=1)
    motion = plan.end[0] - plan.start[1][0]
    quartiles = stats.t(2, scale=3 * mm * motion / (40 * mm)).ppf((0.25, 0.75))
    assert np.ptp(np.quantile(runs.pose[:, -1, 0], (0.25, 0.75))) == pytest.approx(
        np.ptp(quartiles), rel=0.12
    )
