"""Interface of the optimisers: a search returns points and receives their errors.

The options of an optimiser are a frozen dataclass; `start` begins a search in a box. The search is
a state machine that evaluates nothing itself, so the same search runs in a loop, on a cluster, or
from a journal of an interrupted job. The same errors give the same points, bit for bit.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Callable, Generator
from dataclasses import dataclass
from functools import partial
from typing import Annotated, ClassVar, NamedTuple, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model.fields import Value, positive, settle, whole
from fixel.typing import FloatArray, IntArray


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

    # Whether the points of one request are an iteration, instead of one point after another.
    has_iterations: bool = True

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
        values = np.asarray(errors, np.float64)
        if values.shape != (len(asked),):
            raise InvalidInput(
                "errors", found=f"shape {values.shape}", expected=f"({len(asked)},), one per point"
            )
        values = np.where(np.isnan(values), math.inf, values)
        self.evaluations += len(values)
        if len(values):
            k = int(np.argmin(values))
            if values[k] < self._best.error:
                self._best = Best(asked[k].copy(), float(values[k]))
        self._asked = None
        self._learn(asked, values)

    def owners(self) -> IntArray:
        """Return which of several parallel searches requests each point; zeros for one search."""
        return np.zeros(len(self.ask()), np.int64)

    @abc.abstractmethod
    def _next(self) -> FloatArray:
        """Return points (k, n), k at least 1. Called once for each `_learn`."""

    @abc.abstractmethod
    def _learn(self, points: FloatArray, errors: FloatArray) -> None:
        """Take the errors of the points of `_next`; set `reason` to end."""


class AbstractOptimiser(abc.ABC):
    """Options of a search. Subclasses are frozen, keyword-only dataclasses."""

    name: ClassVar[str]

    @property
    def limit(self) -> int | None:
        """Maximum number of evaluations; None if it has no such option."""
        found: int | None = getattr(self, "max_evaluations", None)
        return found

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


# Types of options, whose values `check_fields` checks.
Size = Annotated[float, Value(positive)]
Count = Annotated[int, Value(whole)]
CountOrZero = Annotated[int, Value(partial(whole, least=0))]

Moves = Generator[FloatArray, FloatArray, str]
"""Yields points (k, n), is sent their errors (k,), returns why it ended."""


class GeneratorSearch(Search):
    """Search whose algorithm is a generator.

    `walk` is called with the search, whose `evaluations` and `best` include the last errors that
    the generator received.
    """

    def __init__(self, box: SearchBox, walk: Callable[[Search], Moves]) -> None:
        super().__init__(box)
        self._walk = walk
        self._moves: Moves | None = None
        self._points = np.zeros((0, box.n))

    def _next(self) -> FloatArray:
        if self._moves is None:
            self._moves = self._walk(self)
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


BATCH = 256  # points drawn at a time; a power of two, as the sequence requires
TRIES = 64 * BATCH


def feasible_points(
    box: SearchBox, count: int, seed: int = 0, feasible: Feasible | None = None
) -> FloatArray:
    """Return the first `count` feasible points of a scrambled Sobol' sequence over a box.

    There is at least one, but fewer than `count` if `TRIES` points contain no more.

    Source
    ------
    Owen (1998), scrambled Sobol' points, as in SciPy.
    """
    from scipy.stats import qmc

    rng = np.random.default_rng(whole(seed, "seed", 0))
    sequence = qmc.Sobol(d=box.n, scramble=True, seed=rng)
    found = np.zeros((0, box.n))
    for _ in range(TRIES // BATCH):
        points = box.low + sequence.random(BATCH) * (box.high - box.low)
        points = np.clip(points, box.low, box.high)
        if feasible is not None:
            points = points[np.asarray(feasible(points), bool)]
        found = np.concatenate((found, points))
        if len(found) >= count:
            return found[:count]
    if not len(found):
        raise InvalidInput(
            "start",
            found=f"no feasible start among {TRIES} random points",
            expected="bounds that contain points which can be simulated",
            hint="narrow the bounds around a parameter set that works",
        )
    return found


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class MultiStart(AbstractOptimiser):
    """Several parallel searches, for errors with more than one minimum.

    The first starts from the start of the box, if that is feasible, the others from random feasible
    points. They advance together, so that every batch contains points of all searches and can be
    evaluated on several cores. The cost is `starts` times the evaluations of one search.

    Parameters
    ----------
    optimiser : AbstractOptimiser
        Optimiser of each search.
    starts : int
        Number of starts; fewer if feasible points are too rare.
    """

    name: ClassVar[str] = "multi-start"
    optimiser: AbstractOptimiser
    starts: int = 8

    @property
    def limit(self) -> int | None:
        return None if self.optimiser.limit is None else self.starts * self.optimiser.limit

    def __post_init__(self) -> None:
        if not isinstance(self.optimiser, AbstractOptimiser):
            raise InvalidInput(
                "MultiStart.optimiser", found=self.optimiser, expected="an optimiser: NelderMead()"
            )
        settle(self, starts=whole(self.starts, "MultiStart.starts"))

    def start(
        self, box: SearchBox, seed: int = 0, feasible: Feasible | None = None
    ) -> MultiStartSearch:
        given = box.start[None]
        if feasible is not None and not np.asarray(feasible(given), bool)[0]:
            given = given[:0]
        wanted = self.starts - len(given)
        try:
            drawn = feasible_points(box, wanted, seed, feasible) if wanted else given[:0]
        except InvalidInput:
            if not len(given):
                raise
            drawn = given[:0]
        return MultiStartSearch(
            box,
            [
                self.optimiser.start(box._replace(start=point), seed + k, feasible)
                for k, point in enumerate(np.concatenate((given, drawn)))
            ],
        )


class MultiStartSearch(Search):
    """Parallel searches that are running."""

    def __init__(self, box: SearchBox, searches: list[Search]) -> None:
        super().__init__(box)
        # Searches, each with its own `best`, `reason` and `evaluations`.
        self.searches = tuple(searches)
        self.has_iterations = all(search.has_iterations for search in searches)

    def owners(self) -> IntArray:
        running = [k for k, search in enumerate(self.searches) if not search.done]
        return np.repeat(running, [len(self.searches[k].ask()) for k in running])

    def _next(self) -> FloatArray:
        return np.concatenate([search.ask() for search in self._running()])

    def _learn(self, points: FloatArray, errors: FloatArray) -> None:
        begin = 0
        for search in self._running():
            end = begin + len(search.ask())
            search.tell(errors[begin:end])
            begin = end
        if not self._running():
            self.reason = f"all {len(self.searches)} searches ended"

    def _running(self) -> list[Search]:
        return [search for search in self.searches if not search.done]
