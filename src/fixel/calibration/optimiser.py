"""What every optimiser promises: ask for points, be told their errors.

An optimiser's options are a frozen dataclass; `start` begins a search in a box. The search is a
state machine that never evaluates anything itself, so the same search runs in a loop, on a cluster
or from a journal of what was evaluated before an interruption: told the same errors, it asks for
the same points, bit by bit.
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
    """Where to search; all arrays (n,), in the units of the parameters."""

    low: FloatArray
    high: FloatArray
    start: FloatArray
    scale: FloatArray  # steps worth taking

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return len(self.low)


Feasible = Callable[[FloatArray], np.ndarray]
"""Points (k, n) -> (k,) bool: which of them can be evaluated at all."""


class Best(NamedTuple):
    """The best point told so far."""

    point: FloatArray  # (n,)
    error: float  # inf where no finite error was told


class Search(abc.ABC):
    """One running search. `ask` and `tell` take turns."""

    def __init__(self, box: SearchBox) -> None:
        self.box = box
        self.evaluations = 0
        self.reason = ""
        self._best = Best(np.array(box.start, np.float64), math.inf)
        self._asked: FloatArray | None = None

    @property
    def best(self) -> Best:
        """The first of the points with the smallest error told."""
        return self._best

    @property
    def done(self) -> bool:
        """Whether it has ended; `reason` then says why."""
        return bool(self.reason)

    @final
    def ask(self) -> FloatArray:
        """(k, n) points to evaluate next, within the bounds; none once the search is done.

        Asking again before telling gives the same points.
        """
        if self._asked is None:
            self._asked = np.zeros((0, self.box.n)) if self.done else self._next()
        return self._asked

    @final
    def tell(self, errors: FloatArray) -> None:
        """Errors (k,) of the points asked for; inf, and NaN, for those that failed."""
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
        """(k, n) points; k at least 1. Called once for each `_learn`."""

    @abc.abstractmethod
    def _learn(self, points: FloatArray, errors: FloatArray) -> None:
        """Take the errors of the points of `_next`; set `reason` to end."""


class AbstractOptimiser(abc.ABC):
    """Options of a search. Members are frozen, keyword-only dataclasses."""

    name: ClassVar[str]

    @abc.abstractmethod
    def start(self, box: SearchBox, seed: int = 0, feasible: Feasible | None = None) -> Search:
        """Begin a search.

        Parameters
        ----------
        box : SearchBox
        seed : int
            Of whatever is random.
        feasible : callable, optional
            For random starts; a search may also ask for points that are not, and be told inf.
        """
