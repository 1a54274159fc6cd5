"""Covariance matrix adaptation (CMA-ES): a population that learns the shape of a valley."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Annotated, Any, ClassVar, final

import numpy as np

from fixel.calibration.optimiser import (
    AbstractOptimiser,
    Count,
    CountOrZero,
    Feasible,
    GeneratorSearch,
    Moves,
    Search,
    SearchBox,
    Size,
    feasible_points,
)
from fixel.model.fields import Value, check_fields, whole
from fixel.typing import FloatArray

_MORE_WORDS = {
    "tolx": "the cloud shrank to the tolerance",
    "tolflatfitness": "all points have the same error",
    "tolfun": "errors in the cloud no longer differ",
    "tolfunhist": "errors no longer change",
    "tolstagnation": "errors no longer decrease",
    "tolxstagnation": "the cloud no longer moves",
}


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CmaEs(AbstractOptimiser):
    """CMA-ES, for errors that are rough or have several minima, and for more than five unknowns.

    It needs hundreds of evaluations. With a few dozen, or for a smooth error with one minimum,
    `NelderMead` is better.

    Parameters
    ----------
    sigma : float
        Standard deviation of the first population about the start, in scales of the box. If the
        scale is a tenth of the range, 3 covers the box.
    population : int, optional
        Points per iteration; 4 + 3 ln(n) by default.
    tolerance : float
        Size of the population at which the search ends, in scales.
    restarts : int
        Number of restarts from random feasible points, each with twice the population.
    max_evaluations : int
        Number of evaluations after which no new iteration begins.

    Notes
    -----
    The start is evaluated with the first population. Failed points rank behind all others, by
    their distance from the best point, so that a population of failures returns to it.

    Source
    ------
    Hansen & Ostermeier (2001); restarts after Auger & Hansen (2005); the package pycma.
    """

    name: ClassVar[str] = "cma-es"
    sigma: Size = 2.0
    population: Annotated[int | None, Value(partial(whole, least=3))] = None
    tolerance: Size = 1e-4
    restarts: CountOrZero = 0
    max_evaluations: Count = 20_000

    def __post_init__(self) -> None:
        check_fields(self, "CmaEs")

    def start(self, box: SearchBox, seed: int = 0, feasible: Feasible | None = None) -> Search:
        starts = box.start[None]
        if self.restarts:
            more = feasible_points(box, self.restarts, seed, feasible)
            starts = np.concatenate((starts, more))
        rng = np.random.default_rng(seed)
        return GeneratorSearch(box, lambda search: self._clouds(search, starts, rng))

    def _clouds(self, search: Search, starts: FloatArray, rng: np.random.Generator) -> Moves:
        reason = ""
        population = self.population or 4 + int(3 * math.log(search.box.n))
        for k, start in enumerate(starts):
            cloud = self._strategy(search.box, start, population * 2**k, rng)
            reason = yield from self._cloud(search, start, cloud)
            if search.evaluations >= self.max_evaluations:
                break
        return reason

    def _cloud(self, search: Search, start: FloatArray, cloud: Any) -> Moves:
        """Run CMA-ES once, in coordinates relative to its start, in scales."""
        box = search.box
        worst = -math.inf
        first = True
        while not (reason := self._ended(search, cloud)):
            with _quiet():
                places = cloud.ask()
            # The start itself comes first: its coordinates here are zero.
            table = np.array([np.zeros_like(places[0])] * first + places)[:, : box.n]
            points = start + table * box.scale
            errors = yield np.clip(points, box.low, box.high)
            errors = errors[1:] if first else errors
            first = False
            worst = float(np.max(errors, initial=worst, where=np.isfinite(errors)))
            home = (search.best.point - start) / box.scale
            away = np.linalg.norm(np.array(places)[:, : box.n] - home, axis=1)
            with _quiet():
                cloud.tell(places, _ranked(errors, worst, away).tolist())
        return reason

    def _strategy(
        self, box: SearchBox, start: FloatArray, population: int, rng: np.random.Generator
    ) -> Any:
        # The package needs at least two unknowns: add one without effect to a single one.
        spare = max(0, 2 - box.n)
        low = [*((box.low - start) / box.scale).tolist(), *[-10.0] * spare]
        high = [*((box.high - start) / box.scale).tolist(), *[10.0] * spare]
        options = {
            "bounds": [low, high],
            "popsize": population,
            "tolx": self.tolerance,
            "seed": math.nan,  # do not change NumPy's global random numbers
            "randn": lambda *shape: rng.standard_normal(shape),
            "verbose": -10,  # and read no file of signals
            "verb_log": 0,
            "verb_disp": 0,
        }
        with _quiet():
            strategy = import_module("cma").CMAEvolutionStrategy
            return strategy([0.0] * len(low), self.sigma, options)

    def _ended(self, search: Search, cloud: Any) -> str:
        if search.evaluations >= self.max_evaluations:
            return f"{self.max_evaluations} evaluations were made"
        with _quiet():
            stopped = list(cloud.stop())
        return _MORE_WORDS.get(stopped[0], f"CMA-ES stopped: {stopped[0]}") if stopped else ""


def _ranked(errors: FloatArray, worst: float, away: FloatArray) -> FloatArray:
    """Return errors with failures ranked behind the worst; the package does not accept inf."""
    behind = 0.0 if worst == -math.inf else worst
    return np.where(np.isfinite(errors), errors, behind + max(abs(behind), 1.0) * (1.0 + away))


@contextmanager
def _quiet() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
