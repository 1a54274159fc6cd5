"""Likelihoods of paths: against the full covariance, threads, failures, and the camera's noise."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.sbc import MODEL_ERROR, NOISE, pushes
from benchmarks.simulation_based_calibration import measured_path
from scipy.stats import multivariate_normal, norm
from tests.fixtures import refused

from fixel.calibration.noise import Noise
from fixel.calibration.objective import Comparer
from fixel.model.space import ParameterSpace, Unknown
from fixel.uncertainty.error_terms import ModelError, draw_walks, shares_of_way, walk_over
from fixel.uncertainty.likelihood import LogLikelihood, ParameterPrior, camera_noise
from fixel.uncertainty.posterior import NestedSampling

TRUTH = np.array([0.4, 0.035, 1e-3])


def measured(seed=0, threads=None, truth=TRUTH, noise=NOISE):
    """The benchmark's pushes, as a camera would see them under a truth."""
    bare = pushes()
    prior = ParameterPrior(bare.space, MODEL_ERROR)
    rng = np.random.default_rng(seed)
    targets = [
        target._replace(pose=measured_path(bare, k, truth, prior, noise, rng))
        for k, target in enumerate(bare.targets)
    ]
    motion, stepper = bare.ensemble.motion, bare.ensemble.stepper
    return Comparer(targets, bare.space, motion=motion, stepper=stepper, threads=threads)


def sampled(samples, live):
    """Return a comparer of two pushes, and a posterior of the first."""
    comparer = measured(seed=5)
    likelihood = LogLikelihood(comparer, [0], NOISE, MODEL_ERROR)
    found = NestedSampling(samples=samples, live=live).sample(likelihood, likelihood.prior)
    known = {"space": comparer.space, "motion": comparer.ensemble.motion.name}
    return comparer, replace(found, **known, noise=NOISE, model_error=MODEL_ERROR)


@pytest.fixture(scope="module")
def comparer():
    return measured()


def test_it_is_the_normal_density_of_the_whole_covariance(comparer):
    likelihood = LogLikelihood(comparer, [0, 1], NOISE, MODEL_ERROR)
    found = likelihood(TRUTH[None])[0]
    difference, _, _ = comparer.differences(np.array([0, 1]), np.tile(TRUTH[:2], (2, 1)))
    exact = 0.0
    for own in (0, 1):
        share = likelihood.shares(own)
        walk = np.minimum(share[:, None], share)
        for c, sd in enumerate(NOISE.standard_deviations):
            tau = TRUTH[2] / MODEL_ERROR.sides[c]
            covariance = sd**2 * np.eye(len(share)) + tau**2 * walk
            exact += multivariate_normal(cov=covariance).logpdf(difference[own, :, c])
    assert found == pytest.approx(exact, rel=1e-9)


def test_without_model_error_frames_are_independent(comparer):
    found = LogLikelihood(comparer, [0], NOISE)(TRUTH[None, :2])[0]
    difference, _, _ = comparer.differences(np.array([0]), TRUTH[None, :2].copy())
    assert found == pytest.approx(norm(scale=NOISE.standard_deviations).logpdf(difference).sum())


def test_correlated_noise_counts_for_less(comparer):
    points = np.array([[0.4, 0.035], [0.6, 0.035]])
    white = LogLikelihood(comparer, [0, 1], NOISE)(points)
    slow = Noise(position_m=NOISE.position_m, angle_rad=NOISE.angle_rad, correlation=4.0)
    red = LogLikelihood(comparer, [0, 1], slow)(points)
    assert red[0] - red[1] == pytest.approx((white[0] - white[1]) / 4.0)


def test_correlated_noise_of_many_frames_is_that_of_the_mean():
    """The width along a shift of a path of 1200 frames, of which a third are used."""
    n, rho, sd = 1200, 0.8, 1e-3
    unknown = Unknown(name="start_x", low=-1e-3, high=1e-3, nominal=0.0)

    class Path:
        space = ParameterSpace(unknowns=(unknown,))

        def length(self, members):
            return np.full(len(members), n)

        def differences(self, which, points):
            shift = np.zeros((len(which), n, 3))
            shift[:, :, 0] = points[:, :1]
            return shift, np.ones(len(which), bool), [""] * len(which)

    noise = Noise(position_m=sd, angle_rad=sd, correlation=(1.0 + rho) / (1.0 - rho))
    middle, aside = LogLikelihood(Path(), [0], noise)(np.array([[0.0], [sd]]))
    stated = sd / np.sqrt(2.0 * (middle - aside))
    # The same path many times, with noise that forgets by a fifth from frame to frame.
    rng = np.random.default_rng(3)
    path, total = sd * rng.standard_normal(4000), np.zeros(4000)
    for _ in range(n):
        total += path
        path = rho * path + np.sqrt(1.0 - rho**2) * sd * rng.standard_normal(4000)
    assert stated == pytest.approx(np.std(total / n), rel=0.05)


def test_batches_do_not_change_a_bit(comparer):
    likelihood = LogLikelihood(comparer, [0, 1], NOISE, MODEL_ERROR)
    points = likelihood.prior.draw(20, np.random.default_rng(1))
    np.testing.assert_array_equal(likelihood(points)[7:9], likelihood(points[7:9]))
    assert likelihood.evaluations == 22
    assert likelihood.failed == 0


def test_threads_do_not_change_a_bit():
    def samples(threads):
        likelihood = LogLikelihood(measured(threads=threads), [0, 1], NOISE, MODEL_ERROR)
        return NestedSampling(samples=30, live=40).sample(likelihood, likelihood.prior).points

    np.testing.assert_array_equal(samples(1), samples(3))


def test_more_frames_of_a_wrong_model_do_not_make_parameters_certain():
    # The truth drifts away by several millimetres. As noise alone, a wrong radius is certain.
    wrong = measured(seed=8, truth=np.array([0.4, 0.035, 6e-3]))
    points = np.column_stack((np.full(101, 0.4), np.linspace(0.01, 0.06, 101)))
    alone = LogLikelihood(wrong, [0, 1], NOISE)(points)
    joined = LogLikelihood(wrong, [0, 1], NOISE, MODEL_ERROR)(
        np.column_stack((points, np.full(101, 6e-3)))
    )

    def width(values):
        weight = np.exp(values - values.max())
        return np.count_nonzero(weight > 0.05)

    assert width(alone) <= 15
    assert width(joined) >= 3 * width(alone)


def test_the_cameras_noise_is_found_where_the_point_is_off():
    # A radius that is 20 mm off makes smooth errors, which second differences hardly see.
    off = np.array([0.4, 0.055])
    made = [measured(seed, truth=np.array([0.4, 0.035, 1e-4])) for seed in range(4)]
    found = [camera_noise(comparer, [0, 1], off) for comparer in made]
    assert np.mean([n.position_m for n in found]) == pytest.approx(NOISE.position_m, rel=0.3)
    assert np.mean([n.angle_rad for n in found]) == pytest.approx(NOISE.angle_rad, rel=0.3)
    difference, _, _ = made[0].differences(np.array([0, 1]), np.tile(off, (2, 1)))
    assert np.sqrt(np.mean(difference[..., :2] ** 2)) > 2.0 * NOISE.position_m


def test_shares_of_the_way_grow_to_one_even_at_rest():
    moving = np.column_stack((np.linspace(0.01, 0.1, 10), np.zeros(10), np.zeros(10)))
    share = shares_of_way(np.zeros(3), moving, 0.035)
    assert (np.diff(share) > 0.0).all()
    assert share[-1] == pytest.approx(1.0)
    still = shares_of_way(np.zeros(3), np.zeros((4, 3)), 0.035)
    np.testing.assert_allclose(still, [0.25, 0.5, 0.75, 1.0])


def test_walks_have_the_variance_they_are_said_to_have():
    share = np.linspace(0.1, 1.0, 10)
    sides = ModelError().sides
    walks = draw_walks(share, np.full(4000, 2e-3), sides, np.random.default_rng(0))
    np.testing.assert_allclose(walks[:, -1].std(axis=0), 2e-3 / sides, rtol=0.05)
    np.testing.assert_allclose(walks[:, 4, 0].std(), 2e-3 * np.sqrt(0.5), rtol=0.05)
    axes, variance = walk_over(share)
    again = axes * variance @ axes.T
    np.testing.assert_allclose(again, np.minimum(share[:, None], share), atol=1e-12)


def test_priors_are_uniform_or_cut_normal(comparer):
    first, second = comparer.space.unknowns
    space = ParameterSpace(unknowns=(replace(first, prior=0.1), second))
    drawn = ParameterPrior(space, MODEL_ERROR).draw(4000, np.random.default_rng(0))
    assert drawn[:, 0].mean() == pytest.approx(first.nominal, abs=0.01)
    assert drawn[:, 0].std() == pytest.approx(0.1, rel=0.1)
    assert drawn[:, 1].mean() == pytest.approx(0.5 * (second.low + second.high), rel=0.05)
    middle = np.sqrt(MODEL_ERROR.low * MODEL_ERROR.high)
    assert np.median(drawn[:, 2]) == pytest.approx(middle, rel=0.15)
    assert (drawn >= [0.0, second.low, MODEL_ERROR.low]).all()


def test_what_cannot_be_is_refused(comparer):
    refused(LogLikelihood, comparer, [], NOISE, match="experiments: found none")
    refused(ModelError, low=1e-2, high=1e-3, match="increasing bounds")


def test_the_cameras_noise_is_that_of_frames_at_even_times():
    # Every fourth frame was lost: across the gaps, smooth errors do not cancel.
    off = np.array([0.4, 0.055])
    whole = measured(3, truth=np.array([0.4, 0.035, 1e-4]))
    targets = []
    for target in whole.targets:
        kept = np.arange(len(target.pose)) % 4 != 2
        case = target.case._replace(times=target.case.times[kept])
        slow = 4e-4 * np.arange(len(kept))[:, None] * [1.0, -1.0, 20.0]
        targets.append(target._replace(case=case, pose=(target.pose + slow)[kept]))
    comparer = Comparer(targets, whole.space, motion=whole.ensemble.motion)
    found = camera_noise(comparer, [0, 1], off)
    assert found.position_m == pytest.approx(NOISE.position_m, rel=0.4)
    assert found.angle_rad == pytest.approx(NOISE.angle_rad, rel=0.4)


@pytest.mark.parametrize("together", [1, 10])
def test_noise_of_measured_starts_is_integrated_over_the_starts(together, monkeypatch):
    """Compared with weighted simulations from drawn starts, and with the full covariance."""
    monkeypatch.setattr("fixel.uncertainty.likelihood.TOGETHER", together)
    exact, n = measured(seed=2, truth=np.array([0.4, 0.035, 1e-4])), 3000
    sd, rng = NOISE.standard_deviations, np.random.default_rng(4)
    targets = [
        own._replace(
            starts_measured=True,
            case=own.case._replace(
                scene=moved(own.case.scene, rng.standard_normal(3) * sd),
            ),
        )
        for own in exact.targets
    ]
    motion, stepper = exact.ensemble.motion, exact.ensemble.stepper
    comparer = Comparer(targets, exact.space, motion=motion, stepper=stepper)
    likelihood = LogLikelihood(comparer, [0, 1], NOISE, MODEL_ERROR)
    points = np.array([[0.4, 0.035, 1e-4], [0.42, 0.034, 2e-4]])
    without = likelihood(points)
    likelihood.count_starts(TRUTH[:2], NOISE)
    starts = [Unknown(name=f"start_{c}", low=-1, high=1, nominal=0.0) for c in ("x", "y", "theta")]
    free = comparer.over(ParameterSpace(unknowns=(*comparer.space.unknowns, *starts)))
    for point, found, ignored in zip(points, likelihood(points), without, strict=True):
        expected = 0.0
        for own in (0, 1):
            share = likelihood.shares(own)
            walk = np.minimum(share[:, None], share)
            centre, root = np.zeros(3), np.eye(3)
            for _ in range(4):  # importance sampling, about where the last weights were
                z = rng.standard_normal((n, 3))
                drawn = centre + z @ root.T
                rows = np.column_stack((np.tile(point[:2], (n, 1)), drawn * sd))
                difference, good, _ = free.differences(np.full(n, own), rows)
                assert good.all()
                log = norm.logpdf(drawn).sum(axis=1) - norm.logpdf(z).sum(axis=1)
                log += np.linalg.slogdet(root)[1]
                for c in range(3):
                    tau = point[2] / MODEL_ERROR.sides[c]
                    covariance = sd[c] ** 2 * np.eye(len(share)) + tau**2 * walk
                    log += multivariate_normal(cov=covariance).logpdf(difference[:, :, c])
                weight = np.exp(log - log.max())
                value = log.max() + np.log(weight.mean())
                centre = np.average(drawn, axis=0, weights=weight)
                root = 1.3 * np.linalg.cholesky(np.cov(drawn.T, aweights=weight) + 1e-6 * np.eye(3))
            expected += value
        assert found == pytest.approx(expected, abs=0.3)
        assert abs(ignored - expected) > 3.0


def moved(scene, shift):
    """Return a scene that begins elsewhere than it is measured to."""
    body = scene.bodies[0]
    return replace(scene, bodies=(replace(body, pose=tuple(np.add(body.pose, shift))),))
