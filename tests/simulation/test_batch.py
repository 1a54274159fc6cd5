"""Batches: what varies, what is refused, what comes back."""

from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import refused

from fixel import Fixel, InvalidInput, LineDrive, Parameters, Polygon, Seated
from fixel.simulation import Simulator, StewartTrinkle, simulate, simulate_batch
from fixel.simulation.motion import OtherEngine
from fixel.simulation.pack import pusher_path
from fixel.testing.scenes import grasp, heap, micro_push, moved, pushed_square, sliding_block

QUICK = {"stepper": StewartTrinkle(step=0.1)}


def test_shapes_of_what_comes_back():
    n = 5
    times = [0.0, 1.0, 6.0, 11.0]
    run = simulate_batch(grasp(), {"mu_support": np.linspace(0.1, 0.4, n)}, times=times, **QUICK)
    assert run.names == ("object", "actuator")
    assert run.pose.shape == (n, 4, 2, 3)
    assert run.final.shape == (n, 2, 3)
    assert run["object"].pose.shape == (n, 4, 3)
    assert run.force.shape == run.stalled.shape == (n, 1)
    for name in ("status", "steps", "fallbacks", "stopped_at", "max_residual", "converged"):
        assert getattr(run, name).shape == (n,)
    assert np.array_equal(run.time, times)
    assert (run.steps == 110).all()


def test_one_rollout_where_nothing_varies():
    run = simulate_batch(grasp(), **QUICK)
    assert run.pose.shape == (1, 1, 2, 3)
    single = simulate(grasp(), output_interval=11.0, **QUICK)
    assert np.array_equal(run.final[0, 0], single.pose["object"][-1])


def test_sequence_of_parameters_is_the_mapping_of_columns():
    sets = [Parameters(mu_fixel=0.1, mu_pusher=0.3), Parameters(mu_fixel=0.2, mu_pusher=0.1)]
    a = simulate_batch(grasp(), sets, **QUICK)
    b = simulate_batch(grasp(), {"mu_fixel": [0.1, 0.2], "mu_pusher": [0.3, 0.1]}, **QUICK)
    assert np.array_equal(a.pose, b.pose)


def test_a_scene_file_varies_with_its_own_motion(tmp_path):
    path = tmp_path / "push.yaml"
    path.write_text(micro_push(1).save(path).read_text().replace("dynamic", "quasistatic"))
    own = simulate_batch(path, {"mu_pusher": [0.2, 0.3]})
    again = simulate_batch(micro_push(1), {"mu_pusher": [0.2, 0.3]}, motion="quasistatic")
    assert np.array_equal(own.pose, again.pose)


def test_start_and_waypoints_vary():
    start = np.array([[0.09, 0.0, 0.1], [0.10, 0.01, 0.2]])
    a = simulate_batch(grasp(), start=start, times=[0.0, 11.0], **QUICK)
    assert np.abs(a.pose[:, 0, 0] - start).max() < 1e-15
    path = np.array([[[0.0, 0, 0, 0], [11.0, x, 0, 0]] for x in (0.02, 0.04, 0.06)])
    b = simulate_batch(grasp(), waypoints=path, **QUICK)
    assert b.final[:, 1, 0] == pytest.approx([0.02, 0.04, 0.06], rel=1e-9)


@pytest.mark.parametrize("motion", ["dynamic", "quasistatic"])
def test_paths_take_the_steps_of_single_runs_whatever_the_drive_of_the_scene(motion):
    """Paths of 40 mm in 2 s and in 40 s, in a scene whose own finger is fast."""
    scene = pushed_square(duration=40.0)
    fast = replace(scene.pushers[0], drive=LineDrive(speed=0.4))
    way = [[[0.0, -0.055, 0.02, 0.0], [t, -0.015, 0.02, 0.0]] for t in (2.0, 40.0)]
    runs = simulate_batch(replace(scene, pushers=(fast,)), waypoints=way, motion=motion)
    for k, path in enumerate(way):
        alone = Simulator(scene, motion=motion).run(waypoints=path)
        # The errors of both, against a tolerance of 1e-9 m, are about 1e-4 m.
        assert np.allclose(runs.final[k, 0], alone.pose["part"][-1], atol=5e-5)
        assert abs(int(runs.steps[k]) - alone.steps) <= 0.2 * alone.steps
        own = simulate_batch(replace(scene, pushers=(fast,)), waypoints=[path], motion=motion)
        assert np.array_equal(own.final[0], runs.final[k])  # whatever the paths of other runs


def test_rollout_that_stops_early_keeps_its_last_pose():
    run = simulate_batch(grasp(force_limit=None), times=np.arange(0.0, 11.5, 0.5))
    assert not run.converged[0]
    late = run.time > run.stopped_at[0]
    assert late.any()
    poses = run.pose[0, late, 0]
    assert (poses == poses[-1]).all()
    assert np.isfinite(run.pose).all()


@pytest.mark.parametrize("motion", ["dynamic", "quasistatic"])
def test_runs_that_jam_in_their_first_step_stay_at_the_start(motion):
    """A part without room between a rigid finger and a wall."""
    push = pushed_square()
    wall = Fixel("wall", Polygon.rectangle(0.02, 0.2), pose=(0.06, 0.0, 0.0), friction=0.3)
    scene = moved(replace(push, fixels=(wall,)), (0.3, 0.2), 0.4)
    values = {"mu_pusher": [0.1, 0.3]}
    runs = simulate_batch(scene, values, motion=motion, times=[1.0, 2.0])
    assert (runs.status == "jammed").all()
    assert not runs.touching("part", "wall").any()
    ends, status = Simulator(scene, motion=motion).ends(values)
    assert (status == "jammed").all()
    for k, item in enumerate((scene.bodies[0], scene.pushers[0])):
        assert np.abs(runs.pose[:, :, k] - item.pose).max() < 1e-15
    assert np.array_equal(ends, runs.final[:, :1])
    away = replace(scene.pushers[0], pose=(-1.0, 0.0, 0.0))
    path = pusher_path(scene.pushers[0], 2.0)[None]
    runs = simulate_batch(replace(scene, pushers=(away,)), waypoints=path, motion=motion)
    assert runs.status[0] == "jammed"
    assert np.abs(runs.final[0, 1] - scene.pushers[0].pose).max() < 1e-15


@pytest.mark.parametrize(("options", "where", "found", "expected"), [
    ({"parameters": {"mu_fixel": [1, 1], "mu_pusher": [1]}}, "variations", "2", "same length"),
    ({"parameters": {"mu_fixel": [0.1, -0.2]}}, "mu_fixel", "-0.2", "at least 0"),
    ({"parameters": {"anisotropy_xy": [0.0, 1.5]}}, "parameters.anisotropy_xy", "axis", "0.95"),
    ({"parameters": {"mu_fixel": [0.1, np.nan]}}, "mu_fixel", "nan", "finite"),
    ({"parameters": {"mu_fixle": [0.1]}}, "parameters", "mu_fixle", "mu_fixel"),
    ({"parameters": [Parameters(mu_fixel=0.1), Parameters(mu_pusher=0.1)]}, "parameters[1]",
     "mu_pusher", "mu_fixel"),
    ({"start": np.zeros((4, 2))}, "start", "(4, 1, 2)", "(n, 1, 3)"),
    ({"start": np.full((4, 3), np.nan)}, "start", "not all finite", "finite"),
    ({"start": np.zeros((2, 3)), "parameters": {"mu_fixel": [1]}}, "variations", "2", "same"),
    ({"waypoints": np.zeros((2, 3))}, "waypoints", "(2, 3)", "(n, 0, 4)"),
    ({"waypoints": np.zeros((2, 2, 4))}, "waypoints", "does not increase", "increasing"),
    ({"times": [2.0, 1.0]}, "times", "2", "increasing"),
    ({"times": [0.0, 12.0]}, "times", "12", "11 s"),
    ({"times": []}, "times", "[]", "increasing"),
    ({"threads": 0}, "threads", "0", "at least 1"),
    ({"duration": -1.0}, "duration", "-1.0", "greater than 0"),
])  # fmt: skip
def test_what_does_not_fit_is_refused(options, where, found, expected):
    sentence = str(refused(simulate_batch, grasp(), **options, **QUICK))
    assert sentence.startswith(where)
    assert found in sentence
    assert expected in sentence


def test_waypoints_need_one_pusher():
    with pytest.raises(InvalidInput, match=r"waypoints: found 0 pushers"):
        simulate_batch(sliding_block(), waypoints=np.zeros((2, 2, 4)))


def test_several_scenes_give_a_result_each():
    runs = simulate_batch([grasp(), sliding_block(), heap(3)], duration=0.5, **QUICK)
    assert [run.names for run in runs] == [
        ("object", "actuator"),
        ("block",),
        ("body-1", "body-2", "body-3", "plate"),
    ]
    assert [run.pose.shape for run in runs] == [(1, 1, 2, 3), (1, 1, 1, 3), (1, 1, 4, 3)]
    assert simulate_batch([]) == []


def test_several_scenes_with_variations_are_refused():
    refused(simulate_batch, [grasp()], {"mu_fixel": [0.1]}, match="several scenes with variations")


def test_a_printed_batch_fits_on_a_screen():
    batch = simulate_batch(grasp(), {"mu_pusher": np.linspace(0.1, 0.4, 50)}, duration=0.05)
    lines = str(batch).splitlines()
    assert lines[0] == "BatchResult: 50 runs, varying mu_pusher; 50 converged"
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 100
    assert str(batch) == repr(batch)


def test_runs_meet_a_goal_where_single_simulations_do():
    frictions = [0.1, 0.3]
    runs = simulate_batch(grasp("seated"), {"mu_support": frictions})
    for name in ("fixel-1", "fixel-2"):
        own = [
            simulate(grasp("seated"), Parameters(mu_support=mu)).meets(Seated(name))
            for mu in frictions
        ]
        assert runs.meets(Seated(name)).tolist() == own
    failed = replace(runs, status=np.array(["non_finite", "jammed"]))
    assert runs.meets(Seated("fixel-1")).all()
    assert failed.meets(Seated("fixel-1")).tolist() == [False, True]
    refused(runs.meets, Seated("fixel-9"), match="fixel-9")


RIGID = replace(grasp(force_limit=None), duration=12.0)  # ends in a jam


@pytest.mark.parametrize(("scene", "method", "varied"), [
    (grasp("seated"), {}, {"parameters": {"mu_fixel": [0.1, 0.2], "tripod_radius": [2e-2, 3e-2]}}),
    (grasp("seated"), {"motion": "quasistatic"}, {"start": [[0.09, 0, 0.1], [0.1, 0.01, 0.2]]}),
    (grasp(), QUICK, {"waypoints": [[[0.0, 0, 0, 0], [11.0, x, 0, 0]] for x in (0.02, 0.04)]}),
    (grasp(), QUICK, {"parameters": {"outline_y": [0.0, 1e-3]}, "duration": 3.0, "threads": 1}),
    (heap(5), {}, {}),
    (RIGID, {}, {"parameters": [{"mu_fixel": 0.5}, {"mu_fixel": 0.01}]}),
], ids=["parameters", "start", "waypoints", "outline", "heap", "jam"])  # fmt: skip
def test_ends_are_those_of_a_batch(scene, method, varied):
    simulator = Simulator(scene, **method)
    options = dict(varied)
    runs = simulate_batch(scene, options.pop("parameters", None), **method, **options)
    for _ in range(2):
        poses, status = simulator.ends(**varied)
        assert np.array_equal(poses, runs.final[:, : len(scene.bodies)])
        assert np.array_equal(status, runs.status)


def test_ends_refuse_what_a_batch_refuses():
    simulator = Simulator(pushed_square())
    for varied in ({"start": [[0.0, 0.0]]}, {"waypoints": [1.0]}, {"duration": -1.0}):
        with pytest.raises(InvalidInput) as batch:
            simulate_batch(pushed_square(), **varied)
        with pytest.raises(InvalidInput) as ends:
            simulator.ends(**varied)
        assert str(ends.value) == str(batch.value)
    refused(Simulator(pushed_square(), motion=OtherEngine("pymunk")).ends, match="motion")


@pytest.mark.parametrize("scene", [grasp(), pushed_square()])
def test_no_runs_have_no_contact_modes(scene):
    runs = simulate_batch(scene, {"mu_pusher": [0.1, 0.2]}, **QUICK)
    assert runs[runs.max_residual < 0.0].contact_mode.shape == (0,)
