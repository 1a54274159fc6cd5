"""Gaussian processes on what physics leaves over, among their examples and beyond them."""

import sys
from importlib.util import find_spec

import numpy as np
import pytest
from reproductions.residual_process import NINETY, ResidualProcess
from tests.fixtures import refused

pytestmark = pytest.mark.skipif(find_spec("sklearn") is None, reason="no sklearn")


def made_up(n, seed):
    """Residuals of two outputs that two of three features explain, but for noise."""
    rng = np.random.default_rng(seed)
    features = rng.uniform(-2.0, 2.0, (n, 3))
    residuals = 1e-3 * np.column_stack((np.sin(features[:, 0]), features[:, 1]))
    return features, residuals + rng.normal(0.0, 0.1e-3, (n, 2))


def predicted_at_one_place(features, residuals, new):
    process = ResidualProcess(features, residuals, np.zeros((len(features), 1)))
    return process.predict(new, np.zeros((len(new), 1)))


def test_it_learns_and_knows_how_well():
    features, residuals = made_up(120, 1)
    new, truth = made_up(200, 2)
    mean, sd = predicted_at_one_place(features, residuals, new)
    assert np.abs(mean - truth).mean() < 0.15 * np.abs(truth).mean()
    inside = np.abs(mean - truth) <= NINETY * sd
    assert 0.8 < inside.mean() < 0.97


def test_noise_teaches_nothing():
    rng = np.random.default_rng(3)
    features, residuals = rng.normal(size=(60, 4)), rng.normal(size=(60, 1))
    mean, sd = predicted_at_one_place(features, residuals, rng.normal(size=(40, 4)))
    assert np.abs(mean).mean() < 0.5
    assert sd.mean() == pytest.approx(1.0, abs=0.4)


def test_features_that_never_change_are_left_out():
    features, residuals = made_up(40, 4)
    still = np.column_stack((features, np.full(40, 7.0)))
    mean, _ = predicted_at_one_place(still, residuals, still)
    assert np.isfinite(mean).all()


def sides_of_a_plate(n, seed):
    """Pushes on four sides: what physics leaves over is of the other sign on the last one.

    Features vary along each side; places also have the direction of the side.
    """
    rng = np.random.default_rng(seed)
    side, along = rng.integers(0, 4, n), rng.uniform(-1.0, 1.0, n)
    sign = np.where(side == 3, -1.0, 1.0)
    residual = 1e-3 * sign * (2.0 + np.sin(2.0 * along)) + rng.normal(0.0, 0.1e-3, n)
    turn = 0.5 * np.pi * side
    features = np.column_stack((along, np.sin(turn + 0.3), rng.uniform(-1.0, 1.0, n)))
    return side, residual[:, None], np.column_stack((features, 2 * np.cos(turn), 2 * np.sin(turn)))


def test_on_a_side_without_examples_only_physics_predicts():
    """The residual of the last side cannot be known from the others, and would be made twice as
    large by what these suggest."""
    side, residual, table = sides_of_a_plate(300, 7)
    known, new = side < 3, side == 3
    process = ResidualProcess(table[known, :3], residual[known], table[known])
    mean, sd = process.predict(table[new, :3], table[new])
    assert np.abs(mean).max() < 0.05e-3
    inside = np.abs(residual[new] - mean) <= NINETY * sd
    assert inside.mean() > 0.8  # errors as large as those among the examples are expected


def test_among_dense_examples_the_process_keeps_its_gain():
    _, residual, table = sides_of_a_plate(400, 8)
    train, held = np.arange(400) % 2 == 0, np.arange(400) % 2 == 1
    mean, sd = ResidualProcess(table[train, :3], residual[train], table[train]).predict(
        table[held, :3], table[held]
    )
    left = np.abs(residual[held] - mean)
    assert left.mean() < 0.15 * np.abs(residual[held]).mean()
    assert 0.82 < (left <= NINETY * sd).mean() < 0.97


def test_equal_places_have_no_spacing_to_go_by():
    """Repeated pushes of one contact: the process predicts there, physics anywhere else."""
    features, residuals = made_up(40, 9)
    residuals += 5e-3
    process = ResidualProcess(features, residuals, np.zeros((40, 2)))
    here, _ = process.predict(features[:1], np.zeros((1, 2)))
    elsewhere, sd = process.predict(features[:1], np.full((1, 2), 1e-3))
    assert np.abs(here).min() > 3e-3
    assert not elsewhere.any()
    assert sd.min() > 3e-3


def test_few_examples_do_not_reach_the_next_side():
    """Ten pushes on two sides that face away from each other, and none on the third."""
    features, residuals = made_up(10, 10)
    residuals += 5e-3
    turn = np.radians([0.0, 120.0, 240.0])
    normal = np.column_stack((np.cos(turn), np.sin(turn)))
    along = np.random.default_rng(11).uniform(-1.5, 1.5, 10)  # few: far apart on each side
    places = np.column_stack((normal[np.arange(10) % 2], along))

    process = ResidualProcess(features, residuals, places)
    mean, _ = process.predict(features, np.column_stack((normal[[2] * 10], along)))

    assert np.abs(mean).max() < 0.15e-3


@pytest.mark.parametrize("n", [3, 20])
def test_too_few_or_broken_examples_are_refused(n):
    features, residuals = made_up(n, 5)
    residuals[0] = np.nan
    refused(ResidualProcess, features, residuals, features, match="fixel needs finite ones")


def test_without_scikit_learn_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn", None)
    features, residuals = made_up(20, 6)
    refused(ResidualProcess, features, residuals, features, match=r'pip install "fixel\[learn\]"')
