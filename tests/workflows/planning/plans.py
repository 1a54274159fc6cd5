"""Small plans, made without a search."""

import numpy as np

import fixel
from fixel.planning.belief import Belief
from fixel.planning.plan import PlanRuns, PushPlan, simulator_of
from fixel.planning.pushes import FreePushes, RigPushes
from fixel.planning.success import SuccessProbability
from fixel.testing.scenes import grasp, pushed_square
from fixel.units import deg, mm

START = fixel.StartError(x=1 * mm, y=1 * mm, theta=1 * deg, kind="uniform")


def plan_of(scene, goal, choose, numbers, belief=None) -> PushPlan:
    """Return a plan with given numbers of its pushes, in 8 x 8 scenarios."""
    belief = belief or Belief(start=START)
    scene = choose.prepared(scene)
    simulator = simulator_of(scene, goal, choose, belief, None, None, 1)
    plan = np.array(numbers)[None]
    planned = simulator.planned(plan)
    scenarios = belief.scenarios(scene, worlds=8, runs=8, seed=3)
    runs = simulator.run(planned, np.zeros(scenarios.n, np.int64), scenarios)
    margin = simulator.margins(runs)
    success = SuccessProbability.of(margin.reshape(8, 8))
    why = tuple("" if ok else "misses the goal" for ok in margin >= 0.0)
    return PushPlan(
        scene=scene,
        goal=goal,
        choose=choose,
        belief=belief,
        pushes=choose.pushes(scene, plan[0]),
        start=planned.start[0],
        path=planned.path[0],
        end=planned.nominal.pose[0, -1],
        fixels=None if planned.fixels is None else planned.fixels[0],
        success=success,
        nominal_success=success,
        runs=PlanRuns(scenarios, margin, runs.pose[:, -1], why),
        alternatives=margin[None],
        compared=scenarios,
        unseen=(),
        motion=simulator.motion,
        stepper=None,
        rollouts=0,
        seed=0,
    )


def square_plan() -> PushPlan:
    """A push of a square by a finger, 30 mm straight ahead."""
    goal = fixel.PoseRegion((0.03, 0.0, 0.0), position=5 * mm, angle=5 * deg)
    return plan_of(pushed_square(), goal, FreePushes(), [(0.875, 0.0, 0.03)])


def rig_plan(goal=None) -> PushPlan:
    """A stroke of 20 mm of the thesis's head."""
    goal = goal or fixel.AllOf(
        fixel.PoseRegion((0.1, 0.0, 0.3927), position=30 * mm), never=[fixel.ForceAbove(1e3)]
    )
    return plan_of(
        grasp("seated"), goal, RigPushes(retract=5 * mm, stroke=(0.02, 0.1)), [(0, 0, 0, 0.02)]
    )
