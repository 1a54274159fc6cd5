"""Interface of the optimisers: a search returns points and receives their errors.

The options of an optimiser are a frozen dataclass; `start` begins a search in a box. The search is
a state machine that evaluates nothing itself, so the same search runs in a loop, on a cluster, or
from a journal of an interrupted job. The same errors give the same points, bit for bit.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Callable
from typing import ClassVar, NamedTuple, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.typing import FloatArray


class SearchBox(NamedTuple):
    """Box of a search: arrays (n,) in the units of the parameters."""

    low: FloatArray
    high: FloatArray
    start: FloatArray
    scale: FloatArray  # typical steps

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return len(self.low)


Feasible = Callable[[FloatArray], np.ndarray]
"""Points (k, n) -> (k,) bool: which of them can be evaluated at all."""


class Best(NamedTuple):
    """Best point so far."""

    point: FloatArray  # (n,)
    error: float  # inf without a finite error


class Search(abc.ABC):
    """Running search, advanced by the errors of the points that it requests."""

    def __init__(self, box: SearchBox) -> None:
        self.box = box
        self.evaluations = 0
        self.reason = ""
        self._best = Best(np.array(box.start, np.float64), math.inf)
        self._asked: FloatArray | None = None

    @property
    def best(self) -> Best:
        """First of the points with the smallest error."""
        return self._best

    @property
    def done(self) -> bool:
        """Whether the search has ended, for `reason`."""
        return bool(self.reason)

    @final
    def ask(self) -> FloatArray:
        """Return the points (k, n) to evaluate next, within the bounds; none at the end.

        It returns the same points until their errors are given.
        """
        if self._asked is None:
            self._asked = np.zeros((0, self.box.n)) if self.done else self._next()
        return self._asked

    @final
    def tell(self, errors: FloatArray) -> None:
        """Take the errors (k,) of the requested points; inf or NaN for failures."""
        asked = self.ask()
        told = np.asarray(errors, np.float64)
        if told.shape != (len(asked),):
            raise InvalidInput(
                "errors", found=f"shape {told.shape}", expected=f"({len(asked)},), one a point"
            )
        told = np.where(np.isnan(told), math.inf, told)
        self.evaluations += len(told)
        if len(told):
            k = int(np.argmin(told))
            if told[k] < self._best.error:
                self._best = Best(asked[k].copy(), float(told[k]))
        self._asked = None
        self._learn(asked, told)

    @abc.abstractmethod
    def _next(self) -> FloatArray:
        """Return points (k, n), k at least 1. Called once for each `_learn`."""

    @abc.abstractmethod
    def _learn(self, points: FloatArray, errors: FloatArray) -> None:
        """Take the errors of the points of `_next`; set `reason` to end."""


class AbstractOptimiser(abc.ABC):
    """Options of a search. Subclasses are frozen, keyword-only dataclasses."""

    name: ClassVar[str]

    @abc.abstractmethod
    def start(self, box: SearchBox, seed: int = 0, feasible: Feasible | None = None) -> Search:
        """Begin a search.

        Parameters
        ----------
        box : SearchBox
        seed : int
            Seed of the random numbers.
        feasible : callable, optional
            Test of points for random starts; a search may also request other points.
        """
