"""Gaussian processes on what physics leaves over."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from reproductions.residuals import NINETY, ResidualProcess

from fixel.errors import InvalidInput
from fixel.typing import FloatArray

pytest.importorskip("sklearn")


def made_up(n: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Residuals of two outputs that two of three features explain, but for noise."""
    rng = np.random.default_rng(seed)
    features = rng.uniform(-2.0, 2.0, (n, 3))
    residuals = 1e-3 * np.column_stack((np.sin(features[:, 0]), features[:, 1]))
    return features, residuals + rng.normal(0.0, 0.1e-3, (n, 2))


def test_it_learns_and_knows_how_well() -> None:
    features, residuals = made_up(120, 1)
    new, truth = made_up(200, 2)

    mean, sd = ResidualProcess(features, residuals).predict(new)

    assert np.abs(mean - truth).mean() < 0.15 * np.abs(truth).mean()
    inside = np.abs(mean - truth) <= NINETY * sd
    assert 0.8 < inside.mean() < 0.97


def test_noise_teaches_nothing() -> None:
    rng = np.random.default_rng(3)
    features, residuals = rng.normal(size=(60, 4)), rng.normal(size=(60, 1))

    mean, sd = ResidualProcess(features, residuals).predict(rng.normal(size=(40, 4)))

    assert np.abs(mean).mean() < 0.5
    assert sd.mean() == pytest.approx(1.0, abs=0.4)


def test_features_that_never_change_are_left_out() -> None:
    features, residuals = made_up(40, 4)
    still = np.column_stack((features, np.full(40, 7.0)))

    mean, _ = ResidualProcess(still, residuals).predict(still)

    assert np.isfinite(mean).all()


@pytest.mark.parametrize("n", [3, 20])
def test_too_few_or_broken_examples_are_refused(n: int) -> None:
    features, residuals = made_up(n, 5)
    residuals[0] = np.nan

    with pytest.raises(InvalidInput, match="expected finite ones"):
        ResidualProcess(features, residuals)


def test_without_scikit_learn_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sklearn", None)

    with pytest.raises(InvalidInput, match=r'pip install "fixel\[learn\]"'):
        ResidualProcess(*made_up(20, 6))
