"""The simulated laboratory: as imperfect as it says, the same for the same seed, never real.

Statistical bounds are five standard deviations of what a correct bench would show; with a fixed
seed a test either always passes or never.
"""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import refused

from fixel.model import (
    Disk,
    LineDrive,
    PairFriction,
    PathDrive,
    PlannedExperiment,
    UniformPressure,
    support_points,
)
from fixel.model.experiment import unit_of
from fixel.simulation import simulate
from fixel.simulation.geometry import gap
from fixel.testbed.imperfections import touching
from fixel.testbed.simulated import SimulatedTestbed
from fixel.testing.scenes import grasp

BENCH = SimulatedTestbed(seed=3)
FRAME = 1.0 / 30.0


def planned(name="push", layout="seated", shift=(0.01, 0.0), turn=0.0, **changes):
    scene = grasp(layout)
    body = replace(scene.bodies[0], pose=scene.bodies[0].pose + np.array([*shift, turn]))
    return PlannedExperiment(
        name=name, scene=replace(scene, bodies=(body,), **changes), conditions={"layout": layout}
    )


PLAN = [
    planned(f"push-{k}", layout, (0.012, 0.002 * k), 0.03 * k)
    for k, layout in enumerate(("seated", "slip") * 3)
]


@pytest.fixture(scope="module")
def recorded():
    return list(BENCH.run(PLAN, threads=2))


@pytest.fixture(scope="module")
def true():
    return [simulate(BENCH.true_scene(item), output_interval=FRAME) for item in PLAN]


def spread_is(values, expected):
    assert abs(np.std(values) - expected) < 5.0 * expected / math.sqrt(2.0 * np.size(values))
    assert abs(np.mean(values)) < 5.0 * expected / math.sqrt(np.size(values))


def share_is(hits, expected):
    deviation = math.sqrt(expected * (1.0 - expected) / len(hits))
    assert len(hits) > 500
    assert abs(np.mean(hits) - expected) < 5.0 * deviation


def test_same_bits_in_any_order_and_on_any_number_of_threads(recorded):
    assert list(BENCH.run(PLAN, threads=1)) == recorded
    assert list(BENCH.run(PLAN[::-1], threads=3)) == recorded[::-1]
    assert list(BENCH.run(PLAN[4:5])) == recorded[4:5]


def test_another_seed_and_another_name_are_another_run(recorded):
    (other_seed,) = SimulatedTestbed(seed=4).run(PLAN[:1])
    (other_name,) = BENCH.run([replace(PLAN[0], name="again")])
    for other in (other_seed, other_name):
        assert other.conditions != recorded[0].conditions
        assert other.trajectory.position_rms(recorded[0].trajectory) > 1e-5


def test_what_is_kept_says_that_no_camera_saw_it(recorded):
    for item, experiment in zip(PLAN, recorded, strict=True):
        assert experiment.key == f"testbed/{item.name}"
        assert not experiment.real
        assert re.fullmatch(r"fixel simulated testbed [\d.]+\S*, seed 3", experiment.simulated_by)
        assert experiment.provenance.seed == 3
        assert experiment.scene == item.scene
        assert experiment.conditions["layout"] == item.conditions["layout"]
        assert experiment.effective == (0.0, 11.0)
        assert experiment.flags == ()


def test_the_truth_is_not_the_model(recorded):
    for item, experiment in zip(PLAN, recorded, strict=True):
        scene, truth = BENCH.true_scene(item), experiment.conditions
        body, nominal = scene.bodies[0], item.scene.bodies[0]
        arguments = body.support, body.shape, body.com, body.mass, scene.gravity
        points, loads, friction = support_points(*arguments)
        centre = truth["truth_centre_of_pressure_x_m"], truth["truth_centre_of_pressure_y_m"]
        assert len(points) > 10
        np.testing.assert_allclose(loads @ points / loads.sum(), centre, atol=1e-15)
        assert loads.sum() == pytest.approx(body.mass * scene.gravity)
        assert np.ptp(loads) > 0.2 * loads.mean()
        ratio = truth["truth_support_friction_ratio"]
        np.testing.assert_allclose(friction, ratio * nominal.support.friction)
        assert scene.pushers[0].friction == pytest.approx(
            truth["truth_pusher_friction_ratio"] * item.scene.pushers[0].friction
        )
        assert scene.fixels[2].friction == pytest.approx(
            truth["truth_fixel_friction_ratio"] * item.scene.fixels[2].friction
        )
        assert isinstance(scene.pushers[0].drive, PathDrive)
        assert body.shape.area == pytest.approx(0.998**2 * nominal.shape.area)
        for name in truth:
            assert not name.startswith("truth_") or unit_of(name)


def test_factors_change_from_run_to_run_as_they_say():
    truths = [BENCH._draw(f"run-{k}") for k in range(2000)]
    spread_is([math.log(x.support / 1.1) for x in truths], 0.05)
    spread_is([math.log(x.pusher / 1.3) for x in truths], 0.03)
    spread_is([math.log(x.fixel / 0.75) for x in truths], 0.03)
    spread_is([math.log(x.speed) for x in truths], 0.01)
    spread_is([x.centre_x - 0.004 for x in truths], 0.0005)
    spread_is([x.centre_y + 0.003 for x in truths], 0.0005)


def test_poses_are_noisy_as_they_say(recorded, true):
    for name, attribute in (("object", "trajectory"), ("actuator", "pusher")):
        off = []
        for experiment, simulation in zip(recorded, true, strict=True):
            measured = getattr(experiment, attribute)
            frame = np.rint(measured.time / FRAME).astype(int)
            off.append(measured.pose - simulation.pose[name][frame])
        noise = np.concatenate(off)
        spread_is(noise[:, :2], 5e-5)
        spread_is(noise[:, 2], 0.002)
        following = (noise[1:] * noise[:-1]).mean(axis=0) / noise.var(axis=0)
        assert np.abs(following).max() < 5.0 / math.sqrt(len(noise))


def test_frames_get_lost_but_the_first_and_the_last():
    bench = replace(BENCH, dropped_frames=0.2)
    lost = []
    for experiment in bench.run(PLAN):
        time = experiment.trajectory.time
        frame = np.rint(time / FRAME).astype(int)
        np.testing.assert_allclose(time, frame * FRAME, atol=1e-12)
        assert (frame[0], frame[-1]) == (0, 330)
        np.testing.assert_array_equal(experiment.pusher.time, time)
        assert len(experiment.channel("tactile").time) == 331
        lost.extend(~np.isin(np.arange(1, 330), frame))
    share_is(lost, 0.2)


def test_fixels_err_as_often_as_the_laboratorys(recorded, true):
    runs = [*zip(recorded, true, strict=True)]
    read, touches = [], []
    for experiment, simulation in runs:
        channel = experiment.channel("tactile")
        assert channel.columns == ("fixel_1_bool", "fixel_2_bool", "fixel_3_bool")
        read.append(channel.values == 1.0)
        touches.append(touching(simulation))
        assert set(np.unique(channel.values)) <= {0.0, 1.0}
        assert experiment.contact_mode == "".join(str(int(x)) for x in touches[-1][-1])
    read, touches = np.concatenate(read), np.concatenate(touches)
    share_is(read[~touches], 0.0425)
    share_is(~read[touches], 0.0125)


def test_contact_is_where_the_outlines_meet(true):
    simulation = true[0]
    body, touches = simulation.scene.bodies[0], touching(simulation)
    assert touches.any()
    for sample in range(1, len(simulation.time), 5):
        for k, fixel in enumerate(simulation.scene.fixels):
            pose = simulation.pose["object"][sample]
            distance = gap(body.shape, pose, fixel.shape, fixel.pose).distance
            assert touches[sample, k] == (distance < 1e-7)


@pytest.mark.parametrize("item", PLAN, ids=lambda item: item.name)
def test_an_ideal_bench_is_the_nominal_model(item):
    (experiment,) = SimulatedTestbed.ideal().run([item])
    nominal = simulate(item.scene, output_interval=FRAME)
    np.testing.assert_allclose(experiment.trajectory.time, nominal.time, atol=1e-14)
    np.testing.assert_array_equal(experiment.trajectory.pose, nominal.pose["object"])
    np.testing.assert_array_equal(experiment.pusher.pose, nominal.pose["actuator"])
    np.testing.assert_array_equal(experiment.channel("tactile").values, touching(nominal))
    assert not experiment.real


def test_each_imperfection_moves_the_object_by_itself():
    ideal = SimulatedTestbed.ideal()
    (nominal,) = ideal.run(PLAN[1:2])
    for change in (
        {"pusher_friction": 1.3},
        {"support_cells": 24},
        {"support_cells": 24, "centre_of_pressure": (0.004, 0.0)},
        {"plate_roughness": 0.1},
        {"size": 0.998},
        {"ripple": 0.05},
        {"speed_spread": 0.01},
        {"lead_in": 0.5},
    ):
        (experiment,) = replace(ideal, **change).run(PLAN[1:2])
        assert experiment.trajectory.position_rms(nominal.trajectory) > 1e-6, change


def test_the_drive_stalls_and_the_object_stays(recorded, true):
    simulation = true[0]
    assert simulation.pushers["actuator"].stalled[-1]
    assert simulation.pushers["actuator"].force.max() == pytest.approx(34.3)
    late = recorded[0].pusher.pose[-10:, 0]
    assert np.ptp(late) < 5e-4
    assert late.mean() < 0.0135 * 11.0 - 0.01


def test_speed_ripples_about_its_mean():
    bench = replace(SimulatedTestbed.ideal(), ripple=0.1, ripple_frequency=1.0)
    (experiment,) = bench.run([planned(layout="slip", shift=(0.5, 0.0))])  # nothing in the way
    path = experiment.pusher
    speed = np.diff(path.pose[:, 0]) / np.diff(path.time)
    assert speed.max() == pytest.approx(1.1 * 0.0135, rel=2e-3)
    assert speed.min() == pytest.approx(0.9 * 0.0135, rel=2e-3)
    assert path.pose[-1, 0] == pytest.approx(11.0 * 0.0135, abs=0.1 * 0.0135 / (2.0 * math.pi))


def test_what_ripples_is_the_planned_motion_whichever_way_it_is_written():
    item = planned(layout="slip")
    pusher = item.scene.pushers[0]
    waypoints = np.array([[0.0, 0.0, 0.0, 0.0], [0.15 / 0.0135, 0.15, 0.0, 0.0]])
    path = replace(pusher, drive=PathDrive(waypoints=waypoints, force_limit=34.3))
    as_path = replace(item, scene=replace(item.scene, pushers=(path,)))
    drives = [BENCH.true_scene(x).pushers[0].drive for x in (item, as_path)]
    np.testing.assert_allclose(drives[0].waypoints, drives[1].waypoints, atol=1e-15)


def test_effective_from_the_start_of_motion():
    bench = replace(SimulatedTestbed.ideal(), lead_in=0.5)
    (experiment,) = bench.run(PLAN[:1])
    assert experiment.effective == (0.5, 11.5)
    path = experiment.pusher
    assert not path.pose[path.time < 0.501].any()
    assert np.unique(experiment.trajectory.pose[path.time < 0.501], axis=0).shape == (1, 3)
    assert path.at(1.5)[0] == pytest.approx(0.0135)


def test_a_jammed_run_is_kept_up_to_there():
    rigid = LineDrive(direction=np.array([1.0, 0.0]), speed=0.0135, travel=0.15)
    item = planned()
    head = replace(item.scene.pushers[0], drive=rigid)
    item = replace(item, scene=replace(item.scene, pushers=(head,)))
    (experiment,) = SimulatedTestbed.ideal().run([item])
    (flag,) = experiment.flags
    stopped = experiment.conditions["truth_stopped_at_s"]
    assert flag.name == "stopped-early"
    assert "jammed" in flag.detail
    assert 0.0 <= stopped - experiment.trajectory.time[-1] < FRAME
    assert experiment.effective[1] == experiment.trajectory.time[-1]
    (stalled,) = replace(SimulatedTestbed.ideal(), stall_force=34.3).run([item])
    assert not stalled.flags
    assert stalled.conditions["truth_stall_force_n"] == 34.3


def test_a_disc_on_even_pressure_without_fixels():
    item = planned(fixels=())
    disc = replace(
        item.scene.bodies[0], shape=Disk(0.05), support=UniformPressure(friction=0.3), inertia=None
    )
    item = replace(item, scene=replace(item.scene, bodies=(disc,)))
    (experiment,) = BENCH.run([item])
    assert experiment.channels == ()
    assert experiment.contact_mode == ""
    true_disc = BENCH.true_scene(item).bodies[0]
    assert true_disc.shape == Disk(0.05 * 0.998)
    ratio = experiment.conditions["truth_support_friction_ratio"]
    np.testing.assert_allclose(true_disc.support.friction, 0.3 * ratio)


def test_progress_is_reported_and_a_run_can_be_left():
    reports = []
    list(BENCH.run(PLAN[:2], progress=lambda done, total: reports.append((done, total))))
    assert reports == [(1, 2), (2, 2)]
    runs = BENCH.run(PLAN)
    assert next(runs).name == "push-0"
    runs.close()
    assert list(BENCH.run([])) == []


@pytest.mark.parametrize(("changes", "words"), [
    ({"seed": -1}, "testbed.seed"),
    ({"support_cells": 3}, "support_cells"),
    ({"pusher_friction": 0.0}, "pusher_friction"),
    ({"dropped_frames": 1.5}, "dropped_frames"),
    ({"position_noise": -1e-3}, "position_noise"),
    ({"frame_rate": 0.0}, "frame_rate.*Hz"),
    ({"stall_force": 0.0}, "stall_force.*N"),
    ({"centre_of_pressure": (1.0,)}, "centre_of_pressure"),
    ({"dataset": ""}, "dataset"),
])  # fmt: skip
def test_refuses_a_bench_that_cannot_be(changes, words):
    refused(SimulatedTestbed, match=words, **changes)


def test_refuses_plans_it_cannot_run():
    item = PLAN[0]
    pair = PairFriction(pair=("object", "fixel-1"), friction=0.3)
    overridden = replace(item, scene=replace(item.scene, contact_friction=(pair,)))
    alone = replace(item, scene=replace(item.scene, pushers=()))
    for plan, words in (
        ([item, item], "'push-0' again"),
        ([item, item.scene], r"planned\[1\].*Scene"),
        ([overridden], "contact_friction"),
        ([alone], "0 pushers"),
        ([replace(item, conditions={"truth_x_m": 1.0})], "truth_x_m"),
    ):
        refused(BENCH.run, plan, match=words)
    refused(BENCH.run, PLAN, threads=0, match="threads")


def test_refuses_a_centre_of_pressure_nothing_can_carry():
    bench = replace(BENCH, centre_of_pressure=(0.05, 0.0))
    refused(list, bench.run(PLAN[:1]), match=r"'push-0'.*centre_of_pressure.*5\d.* mm")


@pytest.mark.parametrize("lead_in", [0.05, 0.51])
def test_a_jam_is_as_late_as_the_recorded_start_of_the_drive(lead_in):
    rigid = LineDrive(direction=np.array([1.0, 0.0]), speed=0.0135, travel=0.15)
    item = planned()
    head = replace(item.scene.pushers[0], drive=rigid)
    item = replace(item, scene=replace(item.scene, pushers=(head,)))
    (at_once,), (later,) = (
        replace(SimulatedTestbed.ideal(), lead_in=own).run([item]) for own in (0.0, lead_in)
    )
    jams = [one.conditions["truth_stopped_at_s"] - one.effective[0] for one in (at_once, later)]
    assert jams[1] == pytest.approx(jams[0], abs=1e-9)
