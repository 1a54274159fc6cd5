"""Loads of a plate on a table that is not flat."""

from __future__ import annotations

import numpy as np
import pytest

from fixel.model import KNOWN_PARAMETERS
from fixel.simulation.uneven_table import LENGTH, MAX_EXPONENT, TABLE_NAMES, factors_on_table

CROSS = LENGTH * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])


def factors(angle: float, **values: float) -> np.ndarray:
    table = {name: np.array([value]) for name, value in values.items()}
    return factors_on_table(CROSS, np.array([angle]), table)[0]


def test_every_one_is_a_known_parameter() -> None:
    assert set(TABLE_NAMES) == {name for name in KNOWN_PARAMETERS if name.startswith("table_")}


def test_a_flat_table_changes_nothing() -> None:
    assert factors(0.3) == pytest.approx(np.ones(4))
    assert factors(0.3, **dict.fromkeys(TABLE_NAMES, 0.0)) == pytest.approx(np.ones(4))


def test_a_bend_looks_the_same_from_all_sides() -> None:
    assert factors(0.7, table_bend=1.0) == pytest.approx(np.full(4, np.exp(0.5)))


def test_a_quarter_turn_turns_the_bend_round() -> None:
    up, down = np.exp(0.4), np.exp(-0.4)

    assert factors(0.0, table_bend_xy=0.8) == pytest.approx([up, down, up, down])
    assert factors(0.5 * np.pi, table_bend_xy=0.8) == pytest.approx([down, up, down, up])
    assert factors(0.25 * np.pi, table_bend_diagonal=0.8) == pytest.approx([up, down, up, down])


def test_a_slope_loads_one_side() -> None:
    assert factors(np.pi, table_slope_x=0.2) == pytest.approx([np.exp(-0.2), 1.0, np.exp(0.2), 1.0])


def test_factors_stay_within_reason() -> None:
    assert factors(0.0, table_bend=50.0) == pytest.approx(np.full(4, np.exp(MAX_EXPONENT)))
