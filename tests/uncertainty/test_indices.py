"""Sobol indices against closed forms."""

import math
from importlib.util import find_spec

import numpy as np
import pytest
from tests.fixtures import refused

from fixel.testing.scenes import micro_push
from fixel.uncertainty.error_terms import ASME
from fixel.uncertainty.indices import Factor, indices_of, sobol_indices

pytestmark = pytest.mark.skipif(find_spec("SALib") is None, reason="no SALib")


def ishigami(points):
    x, y, z = points.T
    return (np.sin(x) + 7.0 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x))[:, None]


def test_ishigami():
    """Ishigami and Homma (1990), a = 7, b = 0.1; the indices are known in closed form."""
    factors = [Factor(name, -math.pi, math.pi) for name in ("x", "y", "z")]
    found = sobol_indices(ishigami, factors, ["f"], 2**13)
    np.testing.assert_allclose(found.first[0], [0.3139, 0.4424, 0.0], atol=0.02)
    np.testing.assert_allclose(found.total[0], [0.5576, 0.4424, 0.2437], atol=0.02)
    assert found.evaluations == 5 * 2**13


def test_a_sum_of_normal_and_even_inputs():
    """Variances of 4 and of (6 / sqrt(12))^2 = 3: shares of 4/7 and 3/7, without interaction."""
    factors = [Factor("a", -2.0, 2.0, "normal"), Factor("b", 0.0, 6.0)]
    found = sobol_indices(lambda p: p.sum(axis=1, keepdims=True), factors, ["f"], 2**10)
    np.testing.assert_allclose(found.first[0], [4 / 7, 3 / 7], atol=0.03)
    np.testing.assert_allclose(found.total[0], [4 / 7, 3 / 7], atol=0.03)
    assert found.deviation[0] == pytest.approx(math.sqrt(7.0), rel=0.01)


def test_same_seed_same_bits_and_nothing_to_share_out():
    factors = [Factor("a", 0.0, 1.0), Factor("b", 0.0, 1.0)]

    def model(points):
        return np.column_stack((points[:, 0] * points[:, 1], np.ones(len(points))))

    one, two = (sobol_indices(model, factors, ["f", "one"], 64, seed=2) for _ in range(2))
    np.testing.assert_array_equal(one.total, two.total)
    np.testing.assert_array_equal(one.total_error, two.total_error)
    assert (one.first[1] == 0.0).all()
    assert one.summary()["outcomes"]["one"]["standard_deviation"] == 0.0


def test_missing_outcomes_are_filled_when_few_and_refused_when_many():
    def model(points):
        found = points[:, :1].copy()
        found[points[:, 0] > limit] = math.nan
        return found

    limit = 0.99
    assert sobol_indices(model, [Factor("a", 0.0, 1.0)], ["f"], 64).failed > 0
    limit = 0.5
    refused(sobol_indices, model, [Factor("a", 0.0, 1.0)], ["f"], 64, match="without an outcome")


def test_of_a_push():
    found = indices_of(micro_push(3), ASME, {"mu_pusher": (0.4, 0.9)}, 32)
    assert [f.name for f in found.factors] == ["mu_pusher", "start_x", "start_y", "start_theta"]
    # Off the middle, the angle of the start stays in the angle of the end.
    assert found.total[2].argmax() == 3
    assert found.evaluations == 32 * 6


def test_what_cannot_be_asked():
    refused(sobol_indices, ishigami, [Factor("x", 0.0, 1.0)], ["f"], 100, match="power of two")
    refused(sobol_indices, ishigami, [Factor("x", 0.0, 1.0)], ["f"], 2**40, match="to 1048576")
    refused(sobol_indices, ishigami, [], ["f"], match="at least one")
    for name, interval in (("mu_pusher", (0.5, 0.1)), ("mu_pusher", (-1.0, 1.0))):
        refused(
            indices_of,
            micro_push(1),
            ASME,
            {name: interval},
            2,
            match="bounds .*the lower bound first",
        )
    refused(indices_of, micro_push(1), ASME, {"start_x": (0.0, 1.0)}, 2, match="start error")
