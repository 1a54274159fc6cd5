"""Ranks of truths: even for a right posterior, and not for one that is too sure."""

import numpy as np
import pytest
from benchmarks.sbc import some_ranks
from benchmarks.simulation_based_calibration import Ranks, rank_of, uniformity

from fixel.errors import InvalidInput


def conjugate(width, shift=0.0, n=300):
    """Ranks under a normal model whose posterior is known: mean y / 2, variance 1 / 2."""
    rng = np.random.default_rng(4)
    truths = rng.standard_normal((n, 1))
    data = truths + rng.standard_normal((n, 1))
    ranks = np.array([
        rank_of(
            truth, 0.5 * y + shift + width * np.sqrt(0.5) * rng.standard_normal((400, 1)), rng
        )
        for truth, y in zip(truths, data, strict=True)
    ])  # fmt: skip
    return Ranks(("p",), truths, ranks)


def test_a_right_posterior_passes():
    found = conjugate(1.0)
    assert found.uniformity[0] > 0.01
    assert 0.92 <= found.coverage[0] <= 0.98


@pytest.mark.parametrize(("width", "shift"), [(0.6, 0.0), (1.6, 0.0), (1.0, 0.3)])
def test_one_too_sure_too_shy_or_aside_does_not(width, shift):
    assert conjugate(width, shift).uniformity[0] < 0.01


def test_a_posterior_too_sure_holds_too_few():
    assert conjugate(0.6).coverage[0] < 0.92


def test_ties_are_broken_evenly():
    rng = np.random.default_rng(0)
    ranks = np.array([rank_of(np.zeros(1), np.zeros((20, 1)), rng)[0] for _ in range(400)])
    assert uniformity(ranks) > 0.01


def test_few_ranks_say_nothing():
    with pytest.raises(InvalidInput, match="20 or more"):
        uniformity(np.linspace(0.0, 1.0, 5))


@pytest.mark.slow
def test_posteriors_of_pushes_mean_what_they_say():
    found = some_ranks((1000, 40))
    assert found.labels == ("mu_pusher", "tripod_radius", "model_error")
    assert (found.uniformity > 0.001).all()
    # Of 40, 34 or fewer in 95 % intervals happen by chance in 0.3 % of cases.
    assert (found.coverage >= 35 / 40).all()
