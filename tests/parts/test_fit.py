"""Fits of support parameters: to pushes made with known ones, and derivatives by other steps."""

import numpy as np
import pytest

from fixel import Body, Polygon, Scene, SupportPoints, UniformPressure, push_candidates
from fixel.calibration.target import target_of
from fixel.model.support import support_grid
from fixel.parts import fit
from fixel.simulation import QuasiStatic, simulate
from fixel.simulation.rollouts import RolloutCase
from fixel.testing.pushes import example_parts

TRIANGLE = Polygon([(-0.05, -0.04), (0.06, -0.03), (-0.02, 0.06)])


def pushes_of(support, n=16):
    """Pushes of a triangle on a support that the fit does not know, simulated adaptively."""
    body = Body("part", TRIANGLE, mass=0.8, support=support)
    even = Body("part", TRIANGLE, mass=0.8, support=UniformPressure(friction=0.3))
    targets = []
    scenes = zip(push_candidates(body, contacts=n), push_candidates(even, contacts=n), strict=True)
    for k, (true, known) in enumerate(list(scenes)[::3]):
        end = simulate(true, motion=QuasiStatic()).final["part"]
        case = RolloutCase(known, np.array([known.duration]))
        pose = np.array([[float(x) for x in end]])
        targets.append(target_of(example_parts(1, 1)[0])._replace(key=f"{k}", case=case, pose=pose))
    return fit.PartPushes(targets)


@pytest.fixture(scope="module")
def pushes():
    points = support_grid(TRIANGLE)[0]
    loads = np.random.default_rng(2).uniform(0.2, 2.0, len(points))
    return pushes_of(SupportPoints(points=points, friction=0.3, loads=loads))


def mean_error(pushes, prior):
    every = np.arange(len(pushes))
    ends, good = fit.simulated(pushes, every, prior.mean[None])
    return pushes.distance(every, ends[0], good[0])


def test_a_fit_predicts_pushes_that_it_has_not_seen_better_than_the_prior(pushes):
    prior = fit.SupportPrior.unpushed()
    found = fit.fit_part(pushes, np.arange(0, len(pushes), 2), prior, np.full(8, 1e-3))
    assert mean_error(pushes, found) < 0.6 * mean_error(pushes, prior)


def test_a_part_that_stands_on_its_middle_is_fitted_inside_the_bounds():
    """Real plates do: one stood at a bound of -4, and beyond it without."""
    points = support_grid(TRIANGLE)[0]
    away = np.hypot(*(points - TRIANGLE.centroid).T)
    middle = pushes_of(
        SupportPoints(points=points, friction=0.3, loads=np.exp(-((away / 0.023) ** 2)))
    )
    noise = np.full(len(middle), 0.3e-3)
    found = fit.fit_part(middle, np.arange(len(middle)), fit.SupportPrior.unpushed(), noise)
    rim = fit.NAMES.index("pressure_rim")
    low, high = fit.bounds()
    assert found.mean[rim] < -4.1
    assert low[rim] + 0.1 < found.mean[rim] < high[rim]


def test_pushes_narrow_the_distribution_and_none_widens_it(pushes):
    prior = fit.SupportPrior.unpushed()
    before = prior.covariance
    for n in (2, 6, 16):
        found = fit.fit_part(pushes, np.arange(n), prior, np.full(n, 2.5e-3)).covariance
        assert np.linalg.eigvalsh(before - found).min() > -1e-6
        assert np.trace(found) < np.trace(prior.covariance)


def test_large_noise_leaves_the_prior(pushes):
    prior = fit.SupportPrior.unpushed()
    found = fit.fit_part(pushes, np.arange(4), prior, np.full(4, 10.0))
    np.testing.assert_allclose(found.mean, prior.mean, atol=1e-3)


def test_derivatives_agree_with_differences_of_single_simulations(pushes):
    prior = fit.SupportPrior.unpushed()
    which = np.array([0, 5])
    found = fit.slopes(pushes, which, prior, step=0.05)
    name = fit.NAMES.index("mu_pusher")
    for row, k in enumerate(which.tolist()):
        scene = fit.paced(pushes.targets[k].case.scene, pushes.targets[k].case.times[-1])
        ends = []
        for sign in (1.0, -1.0):
            values = dict(zip(fit.NAMES, prior.mean.tolist(), strict=True))
            values["mu_pusher"] += sign * 0.05 * np.sqrt(prior.covariance[name, name])
            ends.append(np.array(simulate(scene, values, motion=QuasiStatic()).final["part"]))
        by_hand = (ends[0] - ends[1]) / 0.1 * [1.0, 1.0, 35e-3]
        np.testing.assert_allclose(found[row, :, name], by_hand, atol=2e-4)


def test_the_pace_of_a_push_does_not_change_its_quasi_static_end():
    scene = push_candidates(Body("part", TRIANGLE, mass=0.8,
                                 support=UniformPressure(friction=0.3)))[4]  # fmt: skip
    slow = fit.paced(scene, scene.duration)
    assert isinstance(slow, Scene)
    ends = [np.array(simulate(own, motion=QuasiStatic()).final["part"]) for own in (scene, slow)]
    np.testing.assert_allclose(ends[0], ends[1], atol=2e-5)


def test_results_are_the_same_for_any_number_of_threads(pushes):
    other = fit.PartPushes(pushes.targets, threads=1)
    prior, which = fit.SupportPrior.unpushed(), np.arange(6)
    first, second = (fit.fit_part(own, which, prior, np.full(6, 2e-3)) for own in (pushes, other))
    np.testing.assert_array_equal(first.mean, second.mean)
    np.testing.assert_array_equal(first.covariance, second.covariance)
