"""Bands, bounds, what they are made of, their coverage, and fits of many unknowns."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.sbc import NOISE
from reproductions.linear import Outcomes, fit_predictive
from tests.fixtures import refused
from tests.uncertainty.test_likelihood import TRUTH, sampled

from fixel.calibration.result import near_optimal, rise_of
from fixel.uncertainty.prediction import LEVELS, bounds_of, coverage_curve, levels_of, shortest
from fixel.uncertainty.repetition import PARTS, predict_repetition


@pytest.fixture(scope="module")
def found():
    return sampled(300, 100)


def test_the_parts_of_a_prediction_add_up(found):
    comparer, posterior = found
    one = predict_repetition(comparer, 0, posterior, draws=200)
    assert set(one.shares) == {*PARTS, "all"}
    np.testing.assert_allclose(one.shares["noise"], NOISE.standard_deviations, rtol=0.15)
    together = np.sqrt(sum(one.shares[part] ** 2 for part in PARTS))
    np.testing.assert_allclose(one.shares["all"], together, rtol=0.3)
    assert one.failed == 0


def test_a_push_that_was_held_out_lies_in_its_bands(found):
    comparer, posterior = found
    one = predict_repetition(comparer, 1, posterior, draws=200)
    narrow, wide = map(one.bands, LEVELS)
    assert (wide.low <= narrow.low).all()
    assert (wide.high >= narrow.high).all()
    pose = comparer.targets[1].pose
    inside = (pose >= wide.low) & (pose <= wide.high)
    assert inside.mean() > 0.6
    assert max(one.levels_of(pose[-1])) < 0.995


def test_bounds_hold_their_share_of_the_draws():
    rng = np.random.default_rng(2)
    poses = rng.standard_normal((4000, 3)) @ np.array([[2.0, 1.0, 0.0], [0, 1.0, 0], [0, 0, 0.1]])
    bounds = bounds_of(poses, 0.9)
    levels = np.array([levels_of(poses, pose) for pose in poses[:400]])
    assert np.mean(levels[:, 0] <= 0.9) == pytest.approx(0.9, abs=0.03)
    low, high = bounds.angle
    assert np.mean((poses[:, 2] >= low) & (poses[:, 2] <= high)) == pytest.approx(0.9, abs=0.01)
    # sqrt(4.605) standard deviations hold 90 % of a normal plane.
    variances = np.linalg.eigvalsh(np.cov(poses[:, :2].T))[::-1]
    np.testing.assert_allclose(bounds.position.radii, np.sqrt(4.605 * variances), rtol=0.06)


def test_the_shortest_interval_leaves_out_the_long_tail():
    low, high = shortest(np.random.default_rng(0).exponential(size=4000), 0.8)
    assert low < 0.02
    assert high == pytest.approx(-np.log(0.2), rel=0.1)


def test_a_level_outside_of_zero_to_one_is_refused():
    refused(bounds_of, np.zeros((10, 3)), 1.0)


def largest_gap(curve):
    return np.abs(curve.held - curve.levels).max()


def test_the_curve_of_true_levels_is_the_diagonal():
    curve = coverage_curve(np.random.default_rng(1).random(2000))
    assert largest_gap(curve) < 0.03
    assert ((curve.low <= curve.levels) & (curve.levels <= curve.high)).all()
    assert largest_gap(coverage_curve(np.random.default_rng(1).random(2000) ** 2)) > 0.1
    refused(coverage_curve, np.zeros(0))


def linear(n, rng, truth):
    """Outcomes of three numbers, linear in 20 unknowns, some pushes far touchier than others."""
    columns = rng.standard_normal((n, 3, 20)) * 1e-3
    touchy = np.exp(rng.standard_normal(n))
    start = touchy[:, None, None] * rng.standard_normal((n, 3, 2)) * 1e-3
    error = np.einsum("kcm,km->kc", start, rng.standard_normal((n, 2)))
    error += 5e-4 * rng.standard_t(4.0, (n, 3))
    return Outcomes(np.einsum("kcn,n->kc", columns, truth) + error, columns, start)


def test_bounds_after_a_fit_of_many_unknowns_hold_what_they_promise():
    rng = np.random.default_rng(6)
    truth = rng.standard_normal(20)
    train, other = linear(120, rng, truth), linear(1500, rng, truth)
    weight = 1.0 / (np.einsum("kcm,kcm->k", train.start, train.start) + 2e-6)
    table = train.columns.reshape(-1, 20) * np.repeat(np.sqrt(weight), 3)[:, None]
    wanted = train.residual.reshape(-1) * np.repeat(np.sqrt(weight), 3)
    matrix = table.T @ table + np.eye(20)
    point = np.linalg.solve(matrix, table.T @ wanted)
    left = [o._replace(residual=o.residual - o.columns @ point) for o in (train, other)]
    found = fit_predictive(left[0], np.ones(20), ((0, 1), (2,)))
    levels = found.levels_of(left[1])
    for own in (0, 1):
        assert largest_gap(coverage_curve(levels[:, own])) < 0.08
    spreads = found.spreads(left[1])
    assert np.einsum("kcc->", spreads.model) > 0.0
    # The truth lies about where the covariance says: it is that of the likeliest values, and the
    # plain weighted fit above scatters more under heavy tails.
    z = (truth - point) / np.sqrt(np.diag(found.covariance))
    assert 0.5 < np.sqrt(np.mean(z**2)) < 2.2


def test_too_few_outcomes_are_refused():
    refused(fit_predictive, linear(5, np.random.default_rng(0), np.zeros(20)), np.ones(20), ((0,),))


def test_nearly_optimal_points_are_clustered():
    rng = np.random.default_rng(3)
    points = rng.random((3000, 2))
    wells = [np.sum((points - c) ** 2, axis=1) for c in ((0.2, 0.2), (0.8, 0.7))]
    errors = 1.0 + 50.0 * np.minimum(*wells)
    errors[0] = np.inf
    found = near_optimal(points, errors, rise_of(1.0, 100.0, 2))
    assert len(found.clusters) == 2
    assert found.rise == pytest.approx(2 / 98 * 3.09, rel=0.01)  # F(2, 98) at 95 %
    assert found.low[0] < 0.25
    assert found.high[0] > 0.75
    refused(near_optimal, points, np.full(3000, np.inf), 0.1)


def test_truth_is_found_among_the_samples(found):
    _, posterior = found
    low, _, high = posterior.quantiles((0.005, 0.5, 0.995))
    assert ((low <= TRUTH) & (high >= TRUTH)).all()


@pytest.mark.parametrize("ended", [0, 1])
def test_bounds_of_less_than_two_ends_are_refused(found, ended):
    comparer, posterior = found
    one = predict_repetition(comparer, 0, posterior, draws=10)
    few = replace(one, ended=np.arange(len(one.ended)) < ended)
    for bounds in (few.bands, few.region, lambda: few.levels_of(few.nominal[-1])):
        refused(bounds, match=f"found {ended} simulation")
