"""Loads of a plate on a table that is not flat."""

import numpy as np
import pytest

from fixel.model import KNOWN_PARAMETERS
from fixel.simulation.load_profile import LENGTH, MAX_TABLE_EXPONENT, TABLE_NAMES, factors_on_table

CROSS = LENGTH * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])


def factors(angle, **values):
    table = {name: np.array([value]) for name, value in values.items()}
    return factors_on_table(CROSS, np.array([angle]), table)[0]


def test_every_one_is_a_known_parameter():
    assert set(TABLE_NAMES) == {name for name in KNOWN_PARAMETERS if name.startswith("table_")}


@pytest.mark.parametrize(("angle", "values", "logarithms"), [
    (0.3, {}, [0.0] * 4),
    (0.3, dict.fromkeys(TABLE_NAMES, 0.0), [0.0] * 4),
    (0.7, {"table_bend": 1.0}, [0.5, 0.5, 0.5, 0.5]),  # the same from all sides
    (0.0, {"table_bend_xy": 0.8}, [0.4, -0.4, 0.4, -0.4]),
    (0.5 * np.pi, {"table_bend_xy": 0.8}, [-0.4, 0.4, -0.4, 0.4]),
    (0.25 * np.pi, {"table_bend_diagonal": 0.8}, [0.4, -0.4, 0.4, -0.4]),
    (np.pi, {"table_slope_x": 0.2}, [-0.2, 0.0, 0.2, 0.0]),  # loads one side
    (0.0, {"table_bend": 50.0}, [MAX_TABLE_EXPONENT] * 4),
])  # fmt: skip
def test_factors_of_a_table(angle, values, logarithms):
    assert factors(angle, **values) == pytest.approx(np.exp(logarithms))
