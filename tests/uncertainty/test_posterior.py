"""Posteriors whose answer is known: evidence, separated minima, seeds, and plateaus of failure."""

import math

import numpy as np
import pytest

from fixel.errors import InvalidInput
from fixel.uncertainty.likelihood import FLOOR
from fixel.uncertainty.posterior import Mode, NestedSampling, Posterior, equal_weight, modes_of

SD = 0.02


class Cube:
    """A uniform prior on the unit cube."""

    def __init__(self, n):
        self.labels = tuple(f"p{k}" for k in range(n))
        self.units = ("-",) * n
        self.low, self.high = np.zeros(n), np.ones(n)

    def transform(self, unit):
        return np.array(unit, np.float64)


def peak(points, centre):
    return -0.5 * np.sum((points - np.array(centre)) ** 2, axis=1) / SD**2


def two_minima(points):
    """Twice as much probability in the first."""
    second = peak(points, (0.8, 0.7)) - math.log(2.0)
    return np.logaddexp(peak(points, (0.2, 0.3)), second)


@pytest.fixture(scope="module")
def two():
    return NestedSampling(samples=800).sample(two_minima, Cube(2), seed=1)


@pytest.mark.system
def test_separated_minima_survive_with_their_weights(two):
    assert [mode.weight for mode in two.modes] == pytest.approx([2 / 3, 1 / 3], abs=0.08)
    np.testing.assert_allclose(two.modes[0].best, (0.2, 0.3), atol=0.5 * SD)
    np.testing.assert_allclose(two.modes[1].best, (0.8, 0.7), atol=0.5 * SD)


def test_the_evidence_is_that_of_the_integral(two):
    # Two normal peaks inside of the cube: 1.5 times 2 pi sd^2.
    exact = math.log(1.5 * 2.0 * math.pi * SD**2)
    assert two.log_evidence == pytest.approx(exact, abs=4.0 * two.log_evidence_error)
    assert two.log_evidence_error < 0.2
    assert two.effective >= 800
    assert len(two.points) == min(1000, int(two.effective))


@pytest.mark.system
def test_few_samples_wanted_do_not_break_one_mode_into_many():
    found = NestedSampling(samples=50).sample(lambda p: peak(p, (0.5,) * 4), Cube(4), seed=1)
    assert len(found.modes) == 1


def test_a_seed_gives_the_same_bits_and_another_gives_others():
    def run(seed):
        wanted = NestedSampling(samples=50, live=50)
        return wanted.sample(lambda p: peak(p, (0.5, 0.5)), Cube(2), seed)

    np.testing.assert_array_equal(run(3).points, run(3).points)
    assert not np.array_equal(run(3).points, run(4).points)


@pytest.mark.parametrize("walks", [False, pytest.param(True, marks=pytest.mark.system)])
def test_a_normal_posterior_has_its_spread(walks):
    found = NestedSampling(samples=300, live=150, walks=walks).sample(
        lambda p: peak(p, (0.4, 0.5, 0.6)), Cube(3), seed=5
    )
    assert len(found.modes) == 1
    np.testing.assert_allclose(found.points.mean(axis=0), (0.4, 0.5, 0.6), atol=0.3 * SD)
    np.testing.assert_allclose(found.points.std(axis=0), SD, rtol=0.2)


def test_half_a_prior_that_fails_is_half_the_evidence():
    def some(points):
        return np.where(points[:, 0] < 0.5, FLOOR, peak(points, (0.75, 0.5)))

    found = NestedSampling(samples=200, live=120).sample(some, Cube(2), seed=2)
    exact = math.log(2.0 * math.pi * SD**2)
    assert found.log_evidence == pytest.approx(exact, abs=4.0 * found.log_evidence_error)
    assert (found.points[:, 0] >= 0.5).all()


def test_a_prior_that_fails_everywhere_is_refused():
    with pytest.raises(InvalidInput, match="could be simulated"):
        NestedSampling(samples=50).sample(lambda p: np.full(len(p), FLOOR), Cube(2))


def test_progress_ends_at_one():
    shown = []
    NestedSampling(samples=50, live=50).sample(
        lambda p: peak(p, (0.5, 0.5)), Cube(2), progress=lambda *own: shown.append(own)
    )
    done, total, points = shown[-1]
    assert done == total
    assert int(points.removesuffix(" points")) > 100


def test_equal_weights_follow_weights():
    rows = equal_weight(np.array([1.0, 0.0, 3.0]), 400, np.random.default_rng(0))
    assert np.bincount(rows, minlength=3).tolist() == [100, 0, 300]


def test_tails_of_one_cloud_are_no_modes():
    cloud = np.random.default_rng(1).standard_normal((1000, 4)) * np.array([1.0, 1e-3, 5.0, 0.1])
    assert len(modes_of(cloud, -np.sum(cloud**2, axis=1))) == 1


@pytest.mark.parametrize("bad", [{"samples": 5}, {"live": 3}])
def test_settings_that_cannot_be_are_refused(bad):
    with pytest.raises(InvalidInput):
        NestedSampling(**bad)


def lengths(modes):
    """A posterior of a length of 38 mm and an angle of 0.1 rad, without spread."""
    return Posterior(
        labels=("radius", "angle"), units=("m", "rad"), low=np.array((0.01, -0.2)),
        high=np.array((0.06, 0.2)), points=np.tile((0.038, 0.1), (5, 1)), modes=modes,
        log_likelihood=np.zeros(5), log_evidence=-1.0, log_evidence_error=0.1, effective=400.0,
        information=1.0, evaluations=4000, failed=0, seconds=1.0, seed=0,
    )  # fmt: skip


def test_a_posterior_prints_millimetres_and_degrees():
    printed = [line.split() for line in str(lengths(())).splitlines()]

    assert ["radius", *["38"] * 4, "10", "..", "60", "mm"] in printed
    assert ["angle", *["5.73"] * 4, "-11.5", "..", "11.5", "deg"] in printed
    assert "400 effective samples from 4000 simulated points" in str(lengths(()))


def test_modes_of_a_posterior_are_printed_with_their_weights():
    none = np.zeros(0, np.int64)
    modes = [Mode(weight, np.array((at, 0.1)), 0.0, np.array((at - 1e-3, 0.0)),
                  np.array((at + 1e-3, 0.1)), none) for weight, at in ((0.75, 0.038), (0.25, 0.058))
             ]  # fmt: skip
    printed = [line.split() for line in str(lengths(tuple(modes))).splitlines()]

    assert ["1", "75", "37", "..", "39", "0", "..", "5.73"] in printed
    assert ["2", "25", "57", "..", "59", "0", "..", "5.73"] in printed
