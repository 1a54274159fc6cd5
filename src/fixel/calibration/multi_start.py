"""Searches of one optimiser from several starts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from fixel.calibration.optimiser import AbstractOptimiser, Feasible, Search, SearchBox
from fixel.calibration.options import settle, whole
from fixel.calibration.starts import feasible_points
from fixel.errors import InvalidInput
from fixel.typing import FloatArray


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


@final
class MultiStartSearch(Search):
    """Parallel searches that are running.

    Attributes
    ----------
    searches : tuple of Search
        Searches, each with its own `best`, `reason` and `evaluations`.
    """

    def __init__(self, box: SearchBox, searches: list[Search]) -> None:
        super().__init__(box)
        self.searches = tuple(searches)

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
