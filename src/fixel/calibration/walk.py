"""Searches whose algorithm is written from top to bottom, as a generator."""

from __future__ import annotations

import abc
from collections.abc import Generator

import numpy as np

from fixel.calibration.optimiser import Search, SearchBox
from fixel.typing import FloatArray

Moves = Generator[FloatArray, FloatArray, str]
"""Yields points (k, n), is sent their errors (k,), returns why it ended."""


class GeneratorSearch(Search):
    """A search that follows a generator."""

    def __init__(self, box: SearchBox) -> None:
        super().__init__(box)
        self._moves: Moves | None = None
        self._points = np.zeros((0, box.n))

    @abc.abstractmethod
    def _walk(self) -> Moves:
        """The algorithm. `evaluations` and `best` already count what was sent last."""

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
    """(k,) bool: which of the points (k, n) lie within the bounds."""
    return np.asarray(((points >= box.low) & (points <= box.high)).all(axis=1))
