"""The filter frame by frame: repeatable, never NaN, back after it has lost the object."""

from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import refused

from fixel.filtering.particle_filter import DEFAULT_PRIORS, ParticleFilter
from fixel.filtering.running import FilterFrame, start_filter
from fixel.model import Disk, Ellipsoid, Scene
from fixel.simulation import Dynamic, FirstOrder
from fixel.testing.scenes import grasp, heap, sliding_block

SCENE = grasp("slip")
START, HEAD = SCENE.bodies[0].pose, SCENE.pushers[0].pose
FEW = ParticleFilter(n_particles=60)


def finite(estimate):
    return all(
        np.isfinite(getattr(estimate, name)).all()
        for name in ("pose", "covariance", "mean", "quantiles", "touch", "ess")
    )


def forward(k):
    """A head that moves 0.45 mm a frame."""
    return HEAD + np.array([0.00045 * k, 0.0, 0.0])


def test_same_seed_same_bits_on_any_number_of_threads():
    def run(seed, threads):
        running = start_filter(replace(FEW, threads=threads), SCENE, seed)
        for k in range(1, 50):
            estimate = running.step(FilterFrame(k / 30, forward(k), START if k < 30 else None))
        return np.concatenate([x.ravel() for x in (*running.particles, estimate.pose)])

    first = run(3, 1)
    np.testing.assert_array_equal(first, run(3, 1))
    np.testing.assert_array_equal(first, run(3, 3))
    assert (first != run(4, 1)).any()


def test_the_mean_angle_goes_on_past_half_a_turn():
    body = replace(SCENE.bodies[0], shape=Disk(0.05), pose=np.array([0.09, 0.0, 3.1]))
    running = start_filter(FEW, replace(SCENE, bodies=(body,)))
    angles = []
    for k in range(1, 60):
        seen = np.array([0.09, 0.0, (3.1 + 0.002 * k + np.pi) % (2 * np.pi) - np.pi])
        angles.append(running.step(FilterFrame(k / 30, HEAD, seen)).pose[2])

    assert np.abs(np.diff(angles)).max() < 0.05
    # It turns without being pushed, by less than the camera's noise in ten frames: it lags.
    assert angles[-1] == pytest.approx(3.1 + 0.118, abs=0.04)
    assert angles[-1] > np.pi


def test_what_the_camera_has_corrected_stays_while_it_sees_nothing():
    """An object creeps without a push; then it is hidden, and most likely where it was."""
    running = start_filter(FEW, SCENE)
    for k in range(1, 46):
        seen = START + np.array([0.0, 0.0004 * k, 0.0])
        last = running.step(FilterFrame(k / 30, HEAD, seen)).pose

    assert last[1] - START[1] > 0.015
    for k in range(46, 66):
        hidden = running.step(FilterFrame(k / 30, HEAD)).pose
        np.testing.assert_allclose(hidden, last, atol=1e-3)


def test_an_object_that_is_elsewhere_is_found_again():
    running = start_filter(FEW, SCENE)
    away = START + np.array([0.05, 0.03, 1.0])
    first = running.step(FilterFrame(1 / 30, HEAD, away))
    second = running.step(FilterFrame(2 / 30, HEAD, away))

    assert (first.recovered, second.recovered) == (True, False)
    for estimate in (first, second):
        assert finite(estimate)
        np.testing.assert_allclose(estimate.pose, away, atol=0.02)


def test_when_no_particle_can_be_simulated_it_starts_again_wider(monkeypatch):
    from fixel.filtering import particles as module

    real = module.simulate_packed

    def failing(*args, **kwargs):
        result = real(*args, **kwargs)
        return replace(result, status=np.full_like(result.status, 3), pose=result.pose * np.nan)

    running = start_filter(FEW, SCENE)
    calm = running.estimate
    monkeypatch.setattr(module, "simulate_packed", failing)
    estimates = [running.step(FilterFrame(k / 30, HEAD)) for k in range(1, 8)]
    assert all(e.recovered and e.failed == 60 and finite(e) for e in estimates)
    spread = [np.trace(e.covariance[:2, :2]) for e in (calm, *estimates)]
    assert spread[3] > spread[1] > spread[0]
    monkeypatch.setattr(module, "simulate_packed", real)
    back = running.step(FilterFrame(9 / 30, HEAD, START))
    assert finite(back)
    np.testing.assert_allclose(back.pose[:2], START[:2], atol=0.02)


def test_no_frame_simulates_all_proposals_at_once(monkeypatch):
    """Cost is even: the proposals of a third of 300 particles are simulated with the 300."""
    from fixel.filtering import particles as module

    real, rollouts = module.simulate_packed, []

    def counted(*args, **kwargs):
        result = real(*args, **kwargs)
        rollouts[-1] += len(result.pose)
        return result

    monkeypatch.setattr(module, "simulate_packed", counted)
    rollouts.append(0)
    running = start_filter(ParticleFilter(n_particles=300), SCENE)
    for k in range(1, 10):
        rollouts.append(0)
        running.step(FilterFrame(k / 30, forward(k), START))
    assert rollouts[1:] == [300 + 2 * 100] * 9


def test_an_island_that_alone_is_lost_is_replaced():
    running = start_filter(ParticleFilter(n_particles=250), SCENE)
    running._particles.pose[125:] += (0.05, 0.03, 1.0)
    estimate = running.step(FilterFrame(1 / 30, HEAD, START))

    assert not estimate.recovered
    poses, _, weight = running.particles
    assert np.abs(poses - START)[weight > 0.0].max() < 0.2
    np.testing.assert_allclose(weight[125:].sum(), 0.5)
    np.testing.assert_allclose(estimate.pose[:2], START[:2], atol=2e-3)


def test_squeezed_particles_never_give_nan():
    """The head runs the object into the fixels, and on: what no real head could do."""
    running = start_filter(FEW, SCENE)
    for k in range(1, 40):
        estimate = running.step(FilterFrame(k / 3, forward(12 * k), None, [0.0, 0.0, 0.0]))
        assert finite(estimate)


def test_a_parameter_that_nothing_depends_on_stays_as_believed():
    running = start_filter(ParticleFilter(n_particles=300), SCENE)
    for k in range(1, 30):  # before the head arrives
        estimate = running.step(FilterFrame(k / 30, forward(k) - np.array([0.02, 0, 0]), START))

    for (low, high), quantiles in zip(DEFAULT_PRIORS.values(), estimate.quantiles, strict=True):
        expected = low + (high - low) * np.array([0.05, 0.5, 0.95])
        np.testing.assert_allclose(quantiles, expected, atol=0.12 * (high - low))


def test_beliefs_fit_the_scene_and_can_be_changed():
    bare = Scene(bodies=SCENE.bodies, pushers=SCENE.pushers, duration=1.0)
    assert start_filter(FEW, bare).estimate.names == ("mu_support", "mu_pusher", "tripod_radius")
    options = replace(FEW, priors={"mu_pusher": (0.3, 0.3), "mu_support": None})
    estimate = start_filter(options, SCENE).step(FilterFrame(1 / 30, HEAD, START))

    assert estimate.names == ("mu_pusher", "mu_fixel", "tripod_radius")
    np.testing.assert_array_equal(estimate.quantiles[0], 0.3)
    options = replace(FEW, priors=dict.fromkeys(DEFAULT_PRIORS))  # nothing to learn
    estimate = start_filter(options, SCENE).step(FilterFrame(1 / 30, HEAD, START))
    assert estimate.names == ()
    assert finite(estimate)


def test_first_order_motion_and_rigid_drives():
    rigid = grasp("slip", force_limit=None)
    running = start_filter(replace(FEW, motion=FirstOrder()), rigid)

    assert running.scene.pushers[0].drive.force_limit == pytest.approx(20 * 0.15 * 9.81, rel=1e-2)
    assert finite(running.step(FilterFrame(1 / 30, HEAD, START)))


@pytest.mark.parametrize(("options", "sentence"), [
    ({"n_particles": 1}, "n_particles is 1, but must be a whole number of at least 2"),
    ({"n_particles": 2.5}, "n_particles"),
    ({"threads": 0}, "threads"),
    ({"priors": {"mu_pushr": (0.1, 1.0)}}, "did you mean 'mu_pusher'"),
    ({"priors": {"start_x": (0.1, 1.0)}}, "particles cannot have"),
    ({"priors": {"mu_pusher": (1.0, 0.1)}}, "the lower one first"),
    ({"priors": {"mu_pusher": (0.1,)}}, "two numbers"),
    ({"priors": {"mu_pusher": (-0.1, 1.0)}}, "at least 0"),
    ({"position_deviation": 0.0}, "position_deviation"),
    ({"contact_reliability": 1.0}, "between 0 and 1"),
    ({"motion": Dynamic()}, "particles have no velocities"),
    ({"force_limit": -1.0}, "force_limit"),
])  # fmt: skip
def test_impossible_options_are_refused(options, sentence):
    refused(ParticleFilter, match=sentence, **options)


@pytest.mark.parametrize(("scene", "options", "sentence"), [
    (heap(3), FEW, "3 free bodies and 1 pushers"),
    (sliding_block(), FEW, "1 free bodies and 0 pushers"),
    (SCENE.bodies[0], FEW, "a Scene or an Experiment"),
    (Scene(bodies=SCENE.bodies, pushers=SCENE.pushers, duration=1.0),
     replace(FEW, priors={"mu_fixel": (0.1, 0.2)}), "no fixels"),
    (replace(SCENE, bodies=(replace(SCENE.bodies[0], support=Ellipsoid(force=0.5, torque=0.02)),)),
     replace(FEW, priors={"mu_support": (0.1, 0.2)}), "ellipsoidal"),
])  # fmt: skip
def test_scenes_that_do_not_fit_are_refused(scene, options, sentence):
    refused(start_filter, options, scene, match=sentence)


@pytest.mark.parametrize(("frame", "sentence"), [
    (FilterFrame(0.0, HEAD), "a time after 0 s"),
    (FilterFrame(np.nan, HEAD), "a time after"),
    (FilterFrame(0.1, HEAD[:2]), "frame.pusher"),
    (FilterFrame(0.1, HEAD * np.nan), "frame.pusher"),
    (FilterFrame(0.1, HEAD, START * np.inf), "frame.seen"),
    (FilterFrame(0.1, HEAD, None, [1.0]), "3 readings, one per fixel"),
    (FilterFrame(0.1, HEAD, None, [1.0, 0.5, 0.0]), "each 0, 1 or NaN"),
])  # fmt: skip
def test_impossible_frames_are_refused(frame, sentence):
    refused(start_filter(FEW, SCENE).step, frame, match=sentence)
