"""One simulation: samples, durations, refusals, and failure as a value."""

import pickle
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
from tests.fixtures import refused

from fixel import (
    Fixel,
    InvalidInput,
    LineDrive,
    Parameters,
    PathDrive,
    Polygon,
    Pusher,
    SolveFailed,
    load,
)
from fixel.io.saved import save
from fixel.simulation import (
    Adaptive,
    Dynamic,
    GaussSeidel,
    Lemke,
    Midpoint,
    QuasiStatic,
    Simulator,
    StewartTrinkle,
    simulate,
    simulate_batch,
)
from fixel.simulation.simulate import sample_times
from fixel.testing.scenes import grasp, heap, micro_push, pushed_square, sliding_block


def test_samples_at_the_end_of_every_step_by_default():
    run = simulate(grasp(), stepper=StewartTrinkle(step=0.1))
    assert run.steps == 110
    assert run.time == pytest.approx(0.1 * np.arange(111))
    assert run.pose["object"].shape == run.twist["object"].shape == (111, 3)
    assert run.pushers["actuator"].force.shape == (111,)


@pytest.mark.parametrize("stepper", [Adaptive(), StewartTrinkle(step=0.013)])
def test_output_interval_samples_from_zero_and_includes_the_end(stepper):
    run = simulate(grasp(), stepper=stepper, output_interval=0.3)
    assert run.time[:3] == pytest.approx([0.0, 0.3, 0.6])
    assert run.time[-2:] == pytest.approx([10.8, 11.0])
    fine = simulate(grasp(), stepper=stepper)
    # Samples lie on the chords of the steps.
    chords = fine["object"].at(run.time)
    assert np.abs(run.pose["object"] - chords).max() < 1e-9


@pytest.mark.parametrize("stepper", [StewartTrinkle(step=2.0**-7), Midpoint(step=2.0**-7)])
def test_an_early_end_at_a_sample_is_one_sample(stepper):
    """A part that a head pushes flush against a wall, in steps as long as the interval."""
    shape = Polygon.rectangle(0.02, 0.1)
    drive = LineDrive(speed=0.02)
    head = Pusher("finger", shape, pose=(-0.06, 0.0, 0.0), friction=0.3, drive=drive)
    wall = Fixel("wall", shape, pose=(0.09, 0.0, 0.0), friction=0.3)
    scene = replace(pushed_square(), pushers=(head,), fixels=(wall,))
    run = simulate(scene, motion="quasistatic", stepper=stepper, output_interval=2.0**-7)
    assert run.status == "jammed"
    assert np.diff(run.time) == pytest.approx(2.0**-7)
    assert run["part"].time[-1] == pytest.approx(run.stopped_at)
    assert ("part", "finger") in run.touching


def test_the_last_step_before_an_early_end_may_be_short():
    """Five steps of microseconds, of a duration next to which they are nothing."""
    stepper = Adaptive(tolerance=1e-12, max_steps=5)
    run = simulate(pushed_square(), stepper=stepper, duration=1e9)
    assert run.status == "max_steps"
    assert len(run.time) == 6
    assert run.time[-1] == run.stopped_at


@pytest.mark.parametrize(
    ("duration", "interval", "n", "last"),
    [(1.0, 0.25, 5, 1.0), (1.0, 0.3, 5, 1.0), (0.3, 0.1, 4, 0.3), (1.0, 2.0, 2, 1.0), (1, 1, 2, 1)],
)
def test_sample_times(duration, interval, n, last):
    times = sample_times(duration, interval)
    assert len(times) == n
    assert times[0] == 0.0
    assert times[-1] == last
    assert (np.diff(times) > 0.0).all()


def test_duration_replaces_the_scenes_own():
    run = simulate(grasp(), duration=2.5)
    assert run.duration == 2.5
    assert run.time[-1] == pytest.approx(2.5, rel=1e-12)
    whole = simulate(replace(grasp(), duration=2.5))
    assert np.array_equal(run.pose["object"], whole.pose["object"])


def test_parameters_replace_the_scenes_own_values():
    run = simulate(grasp("slip"), Parameters(mu_pusher=0.0, mu_fixel=0.0))
    smooth = grasp("slip")
    smooth = replace(
        smooth,
        pushers=tuple(replace(p, friction=0.0) for p in smooth.pushers),
        fixels=tuple(replace(f, friction=0.0) for f in smooth.fixels),
    )
    assert np.array_equal(run.pose["object"][-1], simulate(smooth).pose["object"][-1])
    assert run.parameters == Parameters(mu_pusher=0.0, mu_fixel=0.0)
    assert (run.contacts["tangential_force"] == 0.0).all()


def test_failure_is_a_value_with_advice():
    run = simulate(grasp(force_limit=None))
    assert run.status == "jammed"
    assert not run.converged
    assert "force_limit" in run.advice
    assert run.duration == run.stopped_at == pytest.approx(run.time[-1])
    assert simulate(sliding_block()).advice == ""


def test_check_raises_instead_of_stopping_early():
    with pytest.raises(SolveFailed, match=r"jammed at 5\.\d+ s\. .*force_limit") as failure:
        simulate(grasp(force_limit=None), check=True)
    assert isinstance(pickle.loads(pickle.dumps(failure.value)), SolveFailed)
    assert simulate(grasp(), check=True).converged


def test_no_room_for_contacts_is_reported():
    run = simulate(grasp(), max_contacts=0)
    assert run.status == "contact_overflow"
    assert "max_contacts" in run.advice
    assert simulate(grasp(), max_contacts=0, plain=True).status == "contact_overflow"


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
@pytest.mark.parametrize("name", ["duration", "output_interval"])
def test_times_that_cannot_be_are_refused(name, value):
    assert (
        "greater than 0" in refused(simulate, sliding_block(), **{name: value}, match=name).expected
    )


def test_too_many_samples_are_refused():
    refused(simulate, sliding_block(), output_interval=1e-9, match=r"output_interval.*at most")
    with pytest.raises(InvalidInput, match=r"output_interval.*at most"):
        simulate(sliding_block(), stepper=StewartTrinkle(step=1e-7))


def test_methods_that_do_not_fit_are_refused():
    refused(simulate, grasp(), solver=Lemke(), match="support_directions")
    loose = replace(sliding_block(), gravity=0.0)
    refused(simulate, loose, motion=QuasiStatic(), match="support friction")
    refused(simulate, grasp(), {"tripod_radiu": 0.1}, match="tripod_radiu")


def test_an_own_limit_of_steps_is_not_called_that_of_lemkes_method():
    scene = replace(sliding_block(), support_directions=4)
    run = simulate(scene, stepper=Adaptive(max_steps=2), solver=Lemke())
    assert (run.status, run.steps) == ("max_steps", 2)
    assert "max_steps" in run.advice
    assert "5000" not in run.advice


def test_a_force_beyond_friction_needs_inertia():
    """On a table tilted further than its friction holds, a block slides away ever faster."""
    scene = sliding_block()
    (block,) = scene.bodies
    most = block.support.friction * block.mass * scene.gravity
    held, lost = (
        replace(scene, bodies=(replace(block, velocity=(0.0, 0.0, 0.0), force=(f, 0.0, 0.0)),))
        for f in (0.9 * most, 1.1 * most)
    )
    assert simulate(held, motion="quasistatic").converged
    run = simulate(lost, motion="quasistatic")
    assert not run.converged
    assert "use the motion model dynamic" in run.advice
    assert simulate(lost).converged


def test_lemke_ends_after_a_stated_number_of_steps_with_advice():
    scene = replace(pushed_square(duration=2.0), support_directions=8)
    run = simulate(scene, stepper=StewartTrinkle(step=2e-4), solver=Lemke())
    assert run.status == "max_steps"
    assert run.steps == 5000
    assert run.stopped_at == pytest.approx(1.0)
    assert "Use the solver newton" in run.advice
    assert simulate(scene, stepper=StewartTrinkle(step=2e-4)).converged


def test_motion_that_alternates_on_friction_polygons_ends_early_with_advice(monkeypatch, tmp_path):
    """A square that two velocities move in turn, in ten thousands of short steps."""
    module = import_module("fixel.simulation.simulate")
    monkeypatch.setattr(module, "ALTERNATING_STEPS", 20)
    module._converted.cache_clear()
    scene = replace(pushed_square(duration=1.0), support_directions=4)
    finger = replace(scene.pushers[0], friction=0.0)
    scene = replace(scene, pushers=(finger,))
    run = simulate(scene, motion="quasistatic")
    assert (run.status, run.method["stepper.max_steps"]) == ("max_steps", 20)
    assert "use a fixed step" in run.advice
    assert simulate_batch(scene, motion="quasistatic").status[0] == "max_steps"
    module._converted.cache_clear()
    assert simulate(scene, motion="quasistatic", stepper=StewartTrinkle(step=2e-3)).converged
    stepper = Adaptive(tolerance=4e-5, max_steps=100_000)
    explicit = simulate(scene, motion="quasistatic", stepper=stepper)
    assert explicit.converged
    assert explicit.steps > 20
    for run in (explicit, simulate(scene)):
        assert run.method["stepper.max_steps"] == 100_000
    for own in (Adaptive(), stepper):  # earlier versions saved the latter for the default
        assert load(save(own, tmp_path / "stepper")) == own


@pytest.mark.parametrize(("build", "options"), [
    (StewartTrinkle, {"step": 0.0}),
    (Midpoint, {"step": -1.0}),
    (Midpoint, {"step": float("inf")}),
    (Adaptive, {"tolerance": 0.0}),
    (Adaptive, {"tolerance": float("nan")}),
    (Adaptive, {"largest_step": 0.0}),
    (Adaptive, {"max_steps": 0}),
    (Adaptive, {"max_steps": 1.5}),
    (GaussSeidel, {"max_sweeps": 0}),
    (Lemke, {"max_pivots": 0}),
])  # fmt: skip
def test_options_that_cannot_be_are_refused(build, options):
    (name,) = options
    refused(build, **options, match=rf"{build.__name__}\.{name} is .*, but must be")


def test_method_and_options_are_described():
    run = simulate(grasp(), motion=Dynamic(), stepper=Midpoint(step=0.05), solver=GaussSeidel())
    assert run.method == {
        "motion": "dynamic",
        "stepper": "midpoint",
        "stepper.step": 0.05,
        "solver": "gauss-seidel",
        "solver.max_sweeps": 10_000,
    }


def test_last_step_of_a_fixed_stepper_ends_at_the_end():
    run = simulate(sliding_block(duration=0.105), stepper=StewartTrinkle(step=0.02))
    assert run.time == pytest.approx([0, 0.02, 0.04, 0.06, 0.08, 0.1, 0.105])


def test_a_step_longer_than_the_whole_is_the_whole():
    run = simulate(sliding_block(duration=0.01), stepper=StewartTrinkle(step=5.0))
    assert run.steps == 1
    assert run.time[-1] == pytest.approx(0.01, rel=1e-12)


@pytest.mark.parametrize("force_limit", [None, 34.3])
@pytest.mark.parametrize("stepper", [Adaptive(), StewartTrinkle(step=0.01)])
def test_a_measured_path_may_rest(force_limit, stepper):
    scene = grasp("seated")
    pusher = scene.pushers[0]
    x, y, angle = pusher.pose
    rows = [(0.0, x), (0.5, x), (1.0, x + 0.005), (1.5, x + 0.005), (2.0, x + 0.0135)]
    path = PathDrive(waypoints=[(t, at, y, angle) for t, at in rows], force_limit=force_limit)
    moved = replace(pusher, pose=None, drive=path)
    run = simulate(replace(scene, pushers=[moved]), stepper=stepper, duration=2.5)
    assert run.pushers[pusher.name].travel == pytest.approx(0.0135, abs=1e-9)


def test_the_travel_of_a_path_out_and_back_needs_no_sample_between():
    scene = pushed_square()
    way = [
        (0.0, 1.0, 1.0, 0.0),
        (0.5, 1.03, 1.04, 0.0),
        (1.0, 1.0, 1.0, 0.0),
    ]  # far from the square
    pusher = replace(scene.pushers[0], pose=None, drive=PathDrive(waypoints=way))
    run = simulate(replace(scene, pushers=[pusher]), output_interval=1.0, duration=1.0)
    assert len(run.time) == 2
    assert run.pushers[pusher.name].travel == pytest.approx(0.1, abs=1e-12)


# ---- simulator -----------------------------------------------------------------------------------


def _timeless(run):
    return replace(run, wall_time_s=0.0)


@pytest.mark.parametrize(("scene", "parameters", "motion"), [
    (grasp("slip"), [None, {"mu_pusher": 0.2}, {"mu_support": 0.3, "tripod_radius": 0.03}], None),
    (micro_push(3), [{"mu_support": 0.3}, None, {"start_x": 1e-5}], "quasistatic"),
    (heap(4, duration=0.3), [None, None], None),
    (sliding_block(), [None, {"mass": 0.2}, {"mu_support": 0.1}], "first-order"),
])  # fmt: skip
def test_a_simulator_returns_the_bits_of_simulate(scene, parameters, motion):
    simulator = Simulator(scene, motion=motion)
    for values in (*parameters, *reversed(parameters)):
        fresh = replace(scene)  # an equal scene, of which nothing is stored
        expected = simulate(fresh, values, motion=motion, output_interval=scene.duration)
        run = simulator.run(values, output_interval=scene.duration)
        assert _timeless(run) == _timeless(expected)


def test_a_simulator_changes_start_and_path_for_one_run():
    scene = pushed_square()
    simulator = Simulator(scene)
    before = simulator.run()
    path = [(0.0, -0.055, 0.01, 0.0), (0.5, -0.045, 0.01, 0.0), (1.0, -0.04, 0.02, 0.0)]
    start = (0.001, -0.002, 0.05)
    run = simulator.run({"mu_support": 0.3}, start=start, waypoints=path, duration=1.2)
    changed = replace(
        scene,
        bodies=replace(scene.bodies[0], pose=start),
        pushers=replace(scene.pushers[0], drive=PathDrive(path)),
    )
    assert run.scene == changed
    assert _timeless(run) == _timeless(simulate(changed, {"mu_support": 0.3}, duration=1.2))
    assert _timeless(simulator.run()) == _timeless(before)


@pytest.mark.parametrize(("scene", "shift", "parameters"), [
    (grasp("slip"), (0.01, 0.005, 0.1), {"mu_fixel": 0.2, "start_theta": 0.02}),
    (micro_push(3), (1e-5, 1e-5, 0.0), {"outline_x": 1e-6}),
    (heap(4, duration=0.2), (1e-4, 0.0, 0.0), {}),
])  # fmt: skip
def test_another_start_gives_the_bits_of_another_scene(scene, shift, parameters):
    start = [body.pose + shift for body in scene.bodies]
    bodies = [replace(b, pose=pose) for b, pose in zip(scene.bodies, start, strict=True)]
    run = Simulator(scene).run(parameters, start=start)
    assert _timeless(run) == _timeless(simulate(replace(scene, bodies=bodies), parameters))


def test_a_simulator_of_a_template_takes_its_path_from_the_run():
    whole = pushed_square()
    pusher = whole.pushers[0]
    simulator = Simulator(replace(whole, pushers=replace(pusher, drive=None)))
    path = [(0.0, *pusher.pose), (2.0, -0.015, 0.02, 0.0)]
    assert simulator.run(waypoints=path).converged
    refused(simulator.run, match="template")


@pytest.mark.parametrize(("changes", "match"), [
    ({"start": [0.0, 0.0]}, r"start.*shape \(2,\).*\(1, 3\)"),
    ({"start": np.zeros((2, 3))}, r"start.*shape \(2, 3\)"),
    ({"start": (np.nan, 0.0, 0.0)}, r"'part'.*pose"),
    ({"start": (-0.01, 0.0, 0.0)}, "overlap"),
    ({"waypoints": np.zeros((3, 3))}, "waypoints"),
    ({"waypoints": [(1, 0, 0, 0), (0, 1, 0, 0)]}, "times"),
    ({"parameters": {"mu_pushr": 0.1}}, "mu_pusher"),
    ({"duration": -1.0}, "duration"),
    ({"output_interval": 0.0}, "output_interval"),
])  # fmt: skip
def test_changes_that_do_not_suit_the_scene_are_refused(changes, match):
    refused(Simulator(pushed_square()).run, **changes, match=match)


def test_a_path_needs_one_pusher_and_a_start_every_body():
    simulator = Simulator(heap(4))
    refused(simulator.run, start=(0, 0, 0), match=r"start.*\(4, 3\)")
    refused(Simulator(sliding_block()).run, waypoints=[(0, 0, 0, 0)], match="0 pushers")


def test_a_simulator_raises_where_asked_to_check():
    with pytest.raises(SolveFailed, match="max_steps"):
        Simulator(grasp(), stepper=Adaptive(max_steps=3)).run(check=True)


def test_a_call_does_not_depend_on_the_calls_before():
    long, short = grasp("seated"), pushed_square()
    first = [simulate(scene) for scene in (long, short, heap(4))]
    for scene, kept in zip((short, long, heap(4)), (first[1], first[0], first[2]), strict=True):
        own = simulate(scene)
        again = simulate(scene)
        for one in (own, again, simulate(replace(scene))):
            assert np.array_equal(one.contacts, kept.contacts)
            assert np.array_equal(one.time, kept.time)
            for name in kept.pose:
                assert np.array_equal(one.pose[name], kept.pose[name])
                assert np.array_equal(one.twist[name], kept.twist[name])
            for name, trace in kept.pushers.items():
                assert np.array_equal(one.pushers[name].force, trace.force)
        own.time[:] = own.contacts["time"][:] = np.nan  # a result shares nothing with others
        for name in own.pose:
            own.pose[name][:] = np.nan
