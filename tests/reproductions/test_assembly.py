"""Assembly of the ASME paper: the goal, the last push, and the tree over nominal simulations."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from reproductions import asme_assembly as assembly
from reproductions.charts.assembly import assembly_figure
from reproductions.nominal_rrt import nominal_rrt
from reproductions.result import RunOptions
from reproductions.thesis_grasps import grasp_scenes, seating_modes

import fixel
from fixel.model.goals import BodyTrack
from fixel.planning.plan import simulator_of
from fixel.planning.success import SuccessProbability
from fixel.testing.scenes import pushed_square
from fixel.units import deg, mm

UM = 1e-6


@pytest.mark.parametrize(("front", "y", "angle", "met"), [
    (850 * UM, 0.0, 90.0, True),
    (850 * UM, 0.0, -90.0, True),
    (700 * UM, 0.0, 90.0, False),
    (850 * UM, 200 * UM, 90.0, False),
    (850 * UM, 0.0, 0.0, False),
])  # fmt: skip
def test_part_is_in_the_slot_where_its_front_is_deep_enough(front, y, angle, met):
    scene = assembly.last_push(130 * UM, 50 * UM, 0.0, assembly.ellipsoid())
    pose = (front - 0.5 * assembly.PART_LENGTH, y, np.radians(angle))
    assert assembly.in_slot(130 * UM).met(scene, BodyTrack.of_ends([pose]))[0] == met


def test_success_of_the_last_push_rises_with_the_clearance():
    values = {**assembly._start_values(assembly.ASME, 64), "mu_pusher": np.full(64, 0.6)}
    rates = [assembly._inserted(c, 300, 0, assembly.ellipsoid(), values) for c in (13, 20, 40, 158)]
    assert rates == sorted(rates)
    assert rates[0] < 0.9
    assert rates[-1] == 1.0


def test_tree_over_nominal_simulations_reaches_the_goal_without_errors():
    scene, choose = pushed_square(), fixel.FreePushes(length=(10 * mm, 60 * mm))
    goal = fixel.PoseRegion((0.04, 0.01, 0.2), position=15 * mm, angle=25 * deg)
    prepared = choose.prepared(replace(scene, duration=1.0))
    simulator = simulator_of(prepared, goal, choose, fixel.Belief(), None, None, 1)
    plan = nominal_rrt(simulator, seed=1)
    end = simulator.planned(plan[None]).nominal
    assert simulator.margins(end)[0] >= 0.0
    assert (nominal_rrt(simulator, seed=1) == plan).all()


def test_quick_run_states_looks_from_few_runs(monkeypatch):
    rate = SuccessProbability.of(np.ones((8, 8)))
    looks = SimpleNamespace(worth=(rate, rate), pushes=3.0)
    sizes = []

    def plan(scene, goal, choose, belief, **options):
        push = SimpleNamespace(success=rate, nominal_success=rate, pushes=())
        return SimpleNamespace(scene=choose.prepared(scene), **vars(push))

    def looks_of(policy, stages, seed):
        sizes.append(sum(own.worlds * own.runs for own in stages))
        return looks, None

    monkeypatch.setattr(fixel, "plan", plan)
    monkeypatch.setattr(assembly.FreePushes, "numbers", lambda choose, pushes: pushes)
    monkeypatch.setattr(assembly, "nominal_rrt", lambda simulator, seed: None)
    monkeypatch.setattr(assembly, "policy_of", lambda search, plans, trusted: ((), None))
    monkeypatch.setattr(assembly, "looks_of", looks_of)
    options = RunOptions(folder=Path(), progress=lambda done, total, note="": None, quick=True)
    assert assembly.run(options).tables["assembly"][0]["look_1um"] == rate.mean
    assert len(sizes) == 2
    assert sum(sizes) < 50


def test_arrows_of_pushes_lie_inside_the_axes():
    scene, far = pushed_square(), np.array([[0.0, -0.4, 0.3, 0.0], [1.0, 0.1, -0.5, 0.0]])
    plan = SimpleNamespace(
        scene=scene, start=scene.bodies[0].pose[None], path=far[None],
        runs=SimpleNamespace(outcome=[""], end=scene.bodies[0].pose[None]),
        success=SimpleNamespace(stated=1.0),
    )  # fmt: skip
    probes = {f"probe_{k:+d}_um": 1.0 for k in assembly.OFFSETS}
    row = {"start": "normal", "clearance_um": 13, **probes}
    curve = [{**row, "mouth_ahead_um": ahead} for ahead in assembly.AHEAD]
    axes = assembly_figure(curve, [(plan, 13)]).axes[1]
    for limits, values in zip((axes.get_xlim(), axes.get_ylim()), far[:, 1:3].T, strict=True):
        assert limits[0] < 1e3 * values.min()
        assert 1e3 * values.max() < limits[1]


def test_tightly_seated_square_touches_all_fixels():
    first = grasp_scenes()[0]
    modes = list(seating_modes(first.scene, n=200))
    assert len(grasp_scenes()) == 20
    assert modes[0] == ("fixel-1", "fixel-2", "fixel-3")
    assert sorted(map(len, modes), reverse=True) == [len(mode) for mode in modes]
