"""Tasks that each ask for points and wait for their residuals, run side by side."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from typing import final

import numpy as np

from fixel.typing import FloatArray

Task = Generator[FloatArray, FloatArray, None]
"""Yields points (k, n), is sent their residuals (k, m)."""


@final
class Tasks:
    """Several tasks whose points make one batch.

    Parameters
    ----------
    tasks : iterable of Task
    most : int
        Points of a batch, unless one task alone asks for more; later tasks then wait.
    """

    def __init__(self, tasks: Iterable[Task], most: int) -> None:
        self._most = most
        self._running: list[tuple[Task, FloatArray]] = []
        for task in tasks:
            self._advance(task, None)

    @property
    def done(self) -> bool:
        """Whether all have ended."""
        return not self._running

    def ask(self) -> FloatArray:
        """(k, n) points of those whose turn it is."""
        return np.concatenate([points for _, points in self._turn()])

    def tell(self, residuals: FloatArray) -> None:
        """Residuals (k, m) of the points asked for."""
        turn = self._turn()
        waiting = self._running[len(turn) :]
        self._running = []
        begin = 0
        for task, points in turn:
            self._advance(task, residuals[begin : begin + len(points)])
            begin += len(points)
        # Those that waited go first, or the first ones alone would be served until they end.
        self._running = waiting + self._running

    def _turn(self) -> list[tuple[Task, FloatArray]]:
        total = np.cumsum([len(points) for _, points in self._running])
        count = max(1, int(np.searchsorted(total, self._most, side="right")))
        return self._running[:count]

    def _advance(self, task: Task, residuals: FloatArray | None) -> None:
        """Run a task to the next points it needs; an empty request is answered at once."""
        try:
            points = next(task) if residuals is None else task.send(residuals)
            while not len(points):
                points = task.send(np.zeros((0, 0)))
        except StopIteration:
            return
        self._running.append((task, points))
