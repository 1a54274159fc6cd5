"""The learned prior is compared with parts drawn about a known mean."""

import numpy as np
import pytest

from fixel.parts.fit import NAMES, UNPUSHED, PartValues, SupportPrior, learned_prior

RIM, CORNER = NAMES.index("pressure_rim"), NAMES.index("pressure_corner")
SHIFT, BEND = NAMES.index("registration_x"), NAMES.index("table_bend_xy")


def fits(n, seed=0, **means):
    """n parts on two surfaces, each drawn about the means with the spread before any push."""
    rng = np.random.default_rng(seed)
    rows = []
    for k in range(n):
        for surface in ("wood", "steel"):
            own = {name: rng.normal(spread.mean, spread.sd) for name, spread in UNPUSHED.items()}
            for name, value in means.items():
                where, _, surface_only = name.partition("__")
                if not surface_only or surface_only == surface:
                    own[where] += value
            rows.append(PartValues(f"part-{k}", surface, np.array([own[n] for n in NAMES])))
    return rows


def test_without_parts_it_is_equal_loads():
    prior = learned_prior([], "wood", 1.0)
    np.testing.assert_array_equal(prior.mean, SupportPrior.unpushed().mean)


def test_the_mean_of_many_parts_is_found_and_the_share_scales_it():
    rows = fits(200, pressure_rim=1.5)
    full, half, none = (learned_prior(rows, "wood", share).mean[RIM] for share in (1.0, 0.5, 0.0))
    assert full == pytest.approx(1.5, abs=0.2)
    assert half == pytest.approx(0.5 * full)
    assert none == 0.0


def test_pushes_that_hardly_determine_a_part_do_not_draw_the_mean_to_that_before_any_push():
    """Fits of parts lie between truth and prior; the mean of many parts must be near the truth."""
    rng = np.random.default_rng(3)
    sd = np.array([spread.sd for spread in UNPUSHED.values()])
    start = SupportPrior.unpushed().mean
    truth = start + np.where(np.arange(len(NAMES)) == RIM, 1.5, 0.0)
    rows = []
    for k in range(400):
        noise = sd * (0.2 if k % 4 == 0 else 2.0)  # one part in four is pushed often
        measured = rng.normal(rng.normal(truth, sd), noise)
        variance = 1.0 / (1.0 / sd**2 + 1.0 / noise**2)
        value = variance * (start / sd**2 + measured / noise**2)
        rows.append(PartValues(f"part-{k}", "wood", value, np.diag(variance)))
    assert np.mean([own.values[RIM] for own in rows]) < 0.8
    found = learned_prior(rows, "wood", 1.0).mean
    assert found[RIM] == pytest.approx(1.5, abs=0.25)
    assert found[SHIFT] == pytest.approx(0.0, abs=2e-4)


def test_the_mean_is_that_of_generalised_least_squares():
    """Weights are the inverse of the spread of parts plus the uncertainty of each measurement."""
    rng = np.random.default_rng(4)
    prior = SupportPrior.unpushed()
    rows, weights, products = [], [np.linalg.inv(prior.covariance)], [0.0 * prior.mean]
    for k in range(5):
        away = rng.normal(size=2 * [len(NAMES)]) * np.sqrt(np.diag(prior.covariance))
        uncertain = away.T @ away  # covariance of what pushes say alone
        measured = rng.multivariate_normal(prior.mean, prior.covariance + uncertain)
        gain = prior.covariance @ np.linalg.inv(prior.covariance + uncertain)
        value = prior.mean + gain @ (measured - prior.mean)
        rows.append(PartValues(f"{k}", "wood", value, prior.covariance - gain @ prior.covariance))
        weights.append(np.linalg.inv(prior.covariance + uncertain))
        products.append(weights[-1] @ (measured - prior.mean))
    expected = prior.mean + np.linalg.solve(sum(weights), sum(products))
    free = [k for k, own in enumerate(UNPUSHED.values()) if not own.symmetric]
    found = learned_prior(rows, "wood", 1.0).mean
    np.testing.assert_allclose(found[free], expected[free], rtol=1e-6, atol=1e-9)


def test_what_belongs_to_a_surface_is_learned_from_its_parts_only():
    rows = fits(100, table_bend_xy__wood=-1.5, registration_x__steel=2e-3)
    wood, steel = (learned_prior(rows, surface, 1.0).mean for surface in ("wood", "steel"))
    assert wood[BEND] == pytest.approx(-1.5, abs=0.2)
    assert steel[BEND] == pytest.approx(0.0, abs=0.2)
    assert steel[SHIFT] - wood[SHIFT] == pytest.approx(2e-3, abs=4e-4)
    assert learned_prior(rows, "felt", 1.0).mean[BEND] == pytest.approx(-0.75, abs=0.2)


def test_signs_that_mean_nothing_on_another_part_stay_centred():
    rows = fits(50, pressure_diagonal=2.0)
    assert learned_prior(rows, "wood", 1.0).mean[NAMES.index("pressure_diagonal")] == 0.0


def test_new_parts_are_within_the_spread_as_often_as_a_normal_distribution_says():
    """A prior of six parts contains a seventh from the same distribution often enough."""
    inside, n = 0, 0
    for seed in range(200):
        rows = fits(7, seed)
        prior = learned_prior(rows[:12], "wood", 1.0)
        away = rows[12].values - prior.mean
        sd = np.sqrt(np.diag(prior.covariance))
        inside += int((np.abs(away) <= 1.645 * sd).sum())
        n += len(away)
    assert 0.9 < inside / n < 0.99  # wider than 90 %, because the model is known to misfit


def test_samples_have_the_mean_and_covariance_and_stay_within_bounds():
    prior = learned_prior(fits(6), "wood", 1.0)
    values = prior.at(np.random.default_rng(0).normal(size=(20000, len(NAMES))))
    free = [RIM, CORNER, SHIFT]
    np.testing.assert_allclose(values[:, free].mean(axis=0), prior.mean[free], atol=0.15)
    low = np.array([spread.low for spread in UNPUSHED.values()])
    high = np.array([spread.high for spread in UNPUSHED.values()])
    assert (values >= low).all()
    assert (values <= high).all()
