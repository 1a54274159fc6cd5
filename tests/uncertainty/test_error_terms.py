"""Errors of the start and their samples."""

import math

import numpy as np
import pytest
from tests.fixtures import refused

from fixel.uncertainty.error_terms import ASME, StartError, even_points, preset


def test_a_box_is_filled_evenly():
    error = StartError(x=1e-3, y=2e-3, theta=0.01, kind="uniform")
    found = error.samples(1024, seed=1)
    assert (np.abs(found) <= error.size).all()
    np.testing.assert_allclose(found.mean(axis=0) / error.size, 0.0, atol=2e-3)
    np.testing.assert_allclose(found.std(axis=0), error.deviation, rtol=2e-3)


def test_normal_errors_have_their_deviations():
    error = StartError(x=1e-3, y=0.0, theta=0.01, kind="normal")
    found = error.samples(4096, seed=1)
    np.testing.assert_allclose(found.std(axis=0), error.deviation, rtol=5e-3)
    assert (found[:, 1] == 0.0).all()


def test_same_seed_same_bits_and_more_samples_begin_alike():
    one = ASME.samples(100, seed=3)
    np.testing.assert_array_equal(one, ASME.samples(100, seed=3))
    np.testing.assert_array_equal(one, ASME.samples(1000, seed=3)[:100])
    assert (one != ASME.samples(100, seed=4)).any()


def test_the_papers_error():
    assert preset("asme") is ASME
    np.testing.assert_allclose(ASME.size, [5e-6, 5e-6, math.radians(0.5)])
    assert str(ASME) == "start: +-5 um, +-0.5 deg uniform"


def test_the_kind_is_required_and_printed():
    """The same sizes have other deviations, by the square root of three; the text names which."""
    refused(StartError, x=1e-3, y=1e-3, match=r"kind: found none.*half-widths.*standard deviations")
    box, normal = (StartError(x=1e-3, y=1e-3, kind=kind) for kind in ("uniform", "normal"))
    assert (str(box), str(normal)) == ("start: +-1 mm uniform", "start: 1 mm standard deviation")
    spread = [own.samples(4096)[:, 0].std() for own in (box, normal)]
    np.testing.assert_allclose(spread, [1e-3 / math.sqrt(3.0), 1e-3], rtol=5e-3)
    assert str(StartError(y=2e-3, theta=math.radians(1.5), kind="normal")) == (
        "start: 2 mm (y), 1.5 deg standard deviation"
    )


@pytest.mark.parametrize("wrong", [
    {"x": -1.0, "kind": "normal"},
    {"kind": "uniform"},  # all sizes are zero
    {"x": math.nan, "kind": "normal"},
    {"theta": 1e297, "kind": "uniform"},
    {"x": 1.0, "y": 0.0, "theta": 0.0, "kind": "round"},
])  # fmt: skip
def test_no_such_error(wrong):
    refused(StartError, **wrong)
    refused(StartError, theta=1e7, kind="normal", match=r"theta is .*at most 1000000 \[rad\]")


def test_no_such_preset_or_number():
    refused(preset, "asmee", match="asme")
    refused(even_points, 0, 3, 0, match="samples")
