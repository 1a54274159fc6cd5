"""Contract of optimisers, as a test suite to inherit from.

Subclass it, override its one fixture, and pytest runs the suite on your plug-in:

    class TestMyOptimiser(OptimiserContract):
        @pytest.fixture
        def optimiser(self):
            return MyOptimiser()
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

from fixel.calibration.optimiser import AbstractOptimiser, Search, SearchBox
from fixel.errors import InvalidInput
from fixel.typing import FloatArray

Error = Callable[[FloatArray], float]

SCALE = np.array([0.1, 0.006, 2.0])
LOW = np.array([0.0, 0.001, -10.0])
TARGET = LOW + SCALE * np.array([4.3, 6.2, 5.4])  # minimum of the errors below


def box(start: tuple[float, ...] = (5.0, 5.0, 5.0)) -> SearchBox:
    """Search box ten scales wide, with different units; `start` in scales from the lower bounds."""
    return _frozen(SearchBox(LOW, LOW + 10.0 * SCALE, LOW + SCALE * np.array(start), SCALE))


def bowl(point: FloatArray) -> float:
    """Smooth error with one minimum, at `TARGET`."""
    x, y, z = ((point - TARGET) / SCALE).tolist()
    return float(1.0 + x * x + 3.0 * y * y + 0.5 * z * z + 0.5 * x * y)


def crease(point: FloatArray) -> float:
    """Error with the same minimum and a crease along every parameter."""
    return float(1.0 + np.array([1.0, 3.0, 0.5]) @ np.abs((point - TARGET) / SCALE))


def failing(error: Error) -> Error:
    """Make one point in ten fail, half with inf and half with NaN; always the same points."""

    def value(point: FloatArray) -> float:
        lot = int.from_bytes(point.tobytes(), "little") % 20011 % 20
        return math.inf if lot == 0 else math.nan if lot == 1 else error(point)

    return value


def run(search: Search, error: Error, limit: int = 10_000) -> list[tuple[FloatArray, FloatArray]]:
    """Run a search to its end or a limit of evaluations; return its points and their errors."""
    journal = []
    while not search.done and search.evaluations < limit:
        points = search.ask()
        errors = np.array([error(point) for point in points])
        search.tell(errors)
        journal.append((points, errors))
    return journal


class OptimiserContract:
    """Tests of an optimiser: bounds, reproducibility, resuming, failures, convergence."""

    # Required distance from the minimum, in scales; override for a search that does not converge.
    precision = 1e-3

    @pytest.fixture
    def optimiser(self) -> AbstractOptimiser:
        """Optimiser under test."""
        raise NotImplementedError

    def test_is_named_options_that_compare_and_hash(self, optimiser: AbstractOptimiser) -> None:
        assert optimiser.name
        same = dataclasses.replace(optimiser)  # type: ignore[type-var]
        assert same == optimiser
        assert hash(same) == hash(optimiser)

    @pytest.mark.parametrize("error", [bowl, crease])
    def test_finds_the_minimum(self, optimiser: AbstractOptimiser, error: Error) -> None:
        search = optimiser.start(box())
        run(search, error)
        assert search.done
        assert search.reason
        assert np.abs((search.best.point - TARGET) / SCALE).max() <= self.precision
        assert search.best.error == error(search.best.point)

    def test_stays_within_the_bounds(self, optimiser: AbstractOptimiser) -> None:
        area = box()

        def downhill(point: FloatArray) -> float:  # smallest at a corner
            assert (point >= area.low).all()
            assert (point <= area.high).all()
            return float(((point - LOW) / SCALE).sum())

        search = optimiser.start(area)
        journal = run(search, downhill, 300)
        assert journal
        assert search.best.error < downhill(area.start)

    def test_starts_at_a_bound(self, optimiser: AbstractOptimiser) -> None:
        search = optimiser.start(box((0.0, 10.0, 0.0)))
        run(search, bowl, 400)
        assert search.best.error < bowl(search.box.start)

    def test_one_unknown(self, optimiser: AbstractOptimiser) -> None:
        low, scale = np.array([2.0]), np.array([0.5])
        search = optimiser.start(
            _frozen(SearchBox(low, low + 10.0 * scale, low + 3.0 * scale, scale))
        )
        run(search, lambda point: abs(float(point[0]) - 4.0) + 1.0)
        assert abs(search.best.point[0] - 4.0) <= self.precision * scale[0]

    def test_same_seed_same_points(self, optimiser: AbstractOptimiser) -> None:
        a, b = (run(optimiser.start(box(), seed=3), bowl, 100) for _ in range(2))
        _assert_same(a, b)

    def test_counts_and_remembers(self, optimiser: AbstractOptimiser) -> None:
        search = optimiser.start(box())
        journal = run(search, bowl, 60)
        errors = np.concatenate([answer for _, answer in journal])
        points = np.concatenate([asked for asked, _ in journal])
        assert search.evaluations == len(errors)
        assert search.best.error == errors.min()
        assert np.array_equal(search.best.point, points[np.argmin(errors)])

    def test_asks_the_same_until_answered(self, optimiser: AbstractOptimiser) -> None:
        search = optimiser.start(box())
        for _ in range(5):
            asked = search.ask().copy()
            assert asked.shape == (len(asked), 3)
            assert len(asked)
            assert np.array_equal(search.ask(), asked)
            search.tell(np.array([bowl(point) for point in asked]))

    def test_refuses_errors_of_other_points(self, optimiser: AbstractOptimiser) -> None:
        search = optimiser.start(box())
        asked = search.ask().copy()
        for length in (0, len(asked) + 1):
            with pytest.raises(InvalidInput, match="errors"):
                search.tell(np.ones(length))
        assert np.array_equal(search.ask(), asked)
        assert search.evaluations == 0

    def test_asks_for_nothing_at_the_end(self, optimiser: AbstractOptimiser) -> None:
        search = optimiser.start(box())
        run(search, lambda point: 1.0)
        assert search.done
        reason = search.reason
        assert search.ask().shape == (0, 3)
        search.tell(np.zeros(0))
        assert search.reason == reason
        assert search.best.error == 1.0

    def test_survives_failures(self, optimiser: AbstractOptimiser) -> None:
        search = optimiser.start(box())
        journal = run(search, failing(bowl), 400)
        errors = np.concatenate([answer for _, answer in journal])
        assert not np.isfinite(errors).all()
        assert search.best.error == errors[np.isfinite(errors)].min()
        assert search.best.error == bowl(search.best.point)
        assert search.best.error < bowl(search.box.start)

    @pytest.mark.parametrize("failure", [math.inf, math.nan])
    def test_survives_a_start_that_fails(
        self, optimiser: AbstractOptimiser, failure: float
    ) -> None:
        area = box()
        search = optimiser.start(area)
        run(search, lambda x: failure if np.array_equal(x, area.start) else bowl(x), 300)
        assert search.best.error < bowl(area.start)

    def test_survives_nothing_but_failures(self, optimiser: AbstractOptimiser) -> None:
        search = optimiser.start(box())
        run(search, lambda point: math.inf, 1000)
        assert search.best.error == math.inf
        assert search.evaluations > 0

    def test_resumes_from_answers(self, optimiser: AbstractOptimiser) -> None:
        whole = optimiser.start(box(), seed=1)
        journal = run(whole, failing(bowl), 150)
        for cut in {1, len(journal) // 3, len(journal) - 1}:
            search = optimiser.start(box(), seed=1)
            for points, errors in journal[:cut]:
                assert np.array_equal(search.ask(), points)
                search.tell(errors)
            # Points that were being evaluated at the interrupt are requested again.
            _assert_same(run(search, failing(bowl), 150), journal[cut:])
            assert search.best.error == whole.best.error
            assert search.reason == whole.reason


def _assert_same(
    a: list[tuple[FloatArray, FloatArray]], b: list[tuple[FloatArray, FloatArray]]
) -> None:
    assert len(a) == len(b)
    for (points, _), (others, _) in zip(a, b, strict=True):
        assert np.array_equal(points, others)


def _frozen(area: SearchBox) -> SearchBox:
    """Make the arrays of a box read-only."""
    for array in area:
        array.flags.writeable = False
    return area
