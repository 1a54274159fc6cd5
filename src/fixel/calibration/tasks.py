"""Parallel tasks that request points and wait for their residuals."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from typing import final

import numpy as np

from fixel.typing import FloatArray

Task = Generator[FloatArray, FloatArray, None]
"""Yields points (k, n), is sent their residuals (k, m)."""


@final
class Tasks:
    """Several tasks whose points are combined into batches.

    Parameters
    ----------
    tasks : iterable of Task
    most : int
        Maximum number of points of a batch, unless one task alone requests more.
    """

    def __init__(self, tasks: Iterable[Task], most: int) -> None:
        self._most = most
        self._running: list[tuple[Task, FloatArray]] = []
        for task in tasks:
            self._advance(task, None)

    @property
    def done(self) -> bool:
        """Whether all tasks have ended."""
        return not self._running

    def ask(self) -> FloatArray:
        """Return the points (k, n) of the next tasks."""
        return np.concatenate([points for _, points in self._turn()])

    def tell(self, residuals: FloatArray) -> None:
        """Take the residuals (k, m) of the requested points."""
        turn = self._turn()
        waiting = self._running[len(turn) :]
        self._running = []
        begin = 0
        for task, points in turn:
            self._advance(task, residuals[begin : begin + len(points)])
            begin += len(points)
        # Tasks that waited go first; otherwise the first tasks would run alone until they end.
        self._running = waiting + self._running

    def _turn(self) -> list[tuple[Task, FloatArray]]:
        total = np.cumsum([len(points) for _, points in self._running])
        count = max(1, int(np.searchsorted(total, self._most, side="right")))
        return self._running[:count]

    def _advance(self, task: Task, residuals: FloatArray | None) -> None:
        """Run a task until it requests points; empty requests are answered at once."""
        try:
            points = next(task) if residuals is None else task.send(residuals)
            while not len(points):
                points = task.send(np.zeros((0, 0)))
        except StopIteration:
            return
        self._running.append((task, points))
