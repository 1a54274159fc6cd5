"""Base class of searches whose algorithm is a generator."""

from __future__ import annotations

import abc
from collections.abc import Generator

import numpy as np

from fixel.calibration.optimiser import Search, SearchBox
from fixel.typing import FloatArray

Moves = Generator[FloatArray, FloatArray, str]
"""Yields points (k, n), is sent their errors (k,), returns why it ended."""


class GeneratorSearch(Search):
    """Search whose algorithm is a generator."""

    def __init__(self, box: SearchBox) -> None:
        super().__init__(box)
        self._moves: Moves | None = None
        self._points = np.zeros((0, box.n))

    @abc.abstractmethod
    def _walk(self) -> Moves:
        """Yield points to evaluate; `evaluations` and `best` include the last errors received."""

    def _next(self) -> FloatArray:
        if self._moves is None:
            self._moves = self._walk()
            self._points = next(self._moves)
        return self._points

    def _learn(self, points: FloatArray, errors: FloatArray) -> None:
        if self._moves is None or self.done:
            return
        try:
            self._points = self._moves.send(errors)
        except StopIteration as end:
            self.reason = str(end.value)


def inside(box: SearchBox, points: FloatArray) -> np.ndarray:
    """Return a mask (k,) of the points (k, n) within the bounds."""
    return np.asarray(((points >= box.low) & (points <= box.high)).all(axis=1))
