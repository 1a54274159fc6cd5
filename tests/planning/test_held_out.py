"""Stated against held success in choices among recorded pushes."""

from types import SimpleNamespace

import numpy as np
import pytest

import fixel
from fixel import InvalidInput
from fixel.planning import held_out
from fixel.planning.held_out import HeldSuccess
from fixel.testing.pushes import example_pushes
from fixel.units import deg, mm
from fixel.workflows.planning.execute import held_out_success

SPACE = {"mu_pusher": (0.0, 1.0), "tripod_radius": 0.038}


@pytest.mark.system
def test_pushes_of_a_right_model_hold_what_is_stated():
    """Recorded by the model itself, so that what is left out ends where it is predicted."""
    pushes = example_pushes(20, duration=0.6)
    fit = fixel.calibrate(pushes, SPACE, verdicts=False, progress=False)
    found = held_out_success(fit, pushes, position=5 * mm, angle=5 * deg, progress=False)
    assert len(found.stated) == len(found.held) == 1000
    assert found.held[found.stated > 0.9].mean() > 0.9
    assert "choices among" in repr(found)


def test_the_curve_counts_pushes_and_not_choices():
    held = HeldSuccess(
        stated=np.full(100, 0.97), held=np.ones(100, bool), push=np.zeros(100, np.int64),
        position=1 * mm, angle=1 * deg,
    )  # fmt: skip
    ((_, choices, pushes, _, share, low, high),) = held.curve.rows
    assert (choices, pushes, share) == (100, 1, 1.0)
    assert (low, high) == (pytest.approx(0.025), 1.0)  # one success proves little


@pytest.mark.parametrize(("pushes", "held"), [(1, 10), (2, 15), (2, 5), (3, 17)])
def test_the_interval_of_misses_is_the_mirrored_one_of_hits(pushes, held):
    """Also where the share of 20 choices is not one of so few pushes."""
    met, push = np.arange(20) < held, np.arange(20) % pushes
    hit, missed = (
        HeldSuccess(stated=np.full(20, 0.97), held=own, push=push, position=1.0, angle=1.0)
        for own in (met, ~met)
    )
    *_, share, low, high = hit.curve.rows[0]
    *_, other, least, most = missed.curve.rows[0]
    assert (share, low, high) == pytest.approx((1.0 - other, 1.0 - most, 1.0 - least))
    assert low < share < high


@pytest.mark.system
def test_choosing_does_not_raise_what_is_stated(monkeypatch):
    """Forty pushes that end equally well, each off by as much in all runs of a world."""
    size, fresh = np.array([2 * mm, 2 * mm, 1 * deg]), np.random.default_rng(5)

    def drawn(belief, target, seed):
        worlds = size * fresh.standard_normal((held_out.WORLDS, 1, 3))
        runs = 0.1 * size * fresh.standard_normal((held_out.WORLDS, held_out.RUNS, 3))
        return (worlds + runs).reshape(-1, 3)

    monkeypatch.setattr(held_out, "target_of", lambda own: SimpleNamespace(pose=np.zeros((1, 3))))
    monkeypatch.setattr(held_out, "learn_run_to_run", lambda *_, **__: None)
    monkeypatch.setattr(held_out, "_ends", drawn)
    monkeypatch.setattr(held_out, "_nominal", lambda *_: np.zeros(3))
    monkeypatch.setattr(held_out, "_motion", lambda *_: size * fresh.standard_normal((1, 3)))
    fit = SimpleNamespace(estimates={})
    monkeypatch.setattr(held_out, "Belief", lambda **_: None)
    rows = [
        held_out._choices(fit, [None] * 40, [None] * 40, (3 * mm, 3 * deg), fresh, 0)[:2]
        for _ in range(40)
    ]
    stated, held = np.mean(rows, axis=(0, 2))
    assert stated == pytest.approx(held, abs=0.03)


def test_too_few_pushes_are_refused():
    pushes = example_pushes(3, duration=0.3)
    fit = fixel.calibrate(pushes, SPACE, verdicts=False, progress=False)
    with pytest.raises(InvalidInput, match="found 3 pushes, but fixel needs 20 or more"):
        held_out_success(fit, pushes, progress=False)
