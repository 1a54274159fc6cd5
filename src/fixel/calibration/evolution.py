"""Covariance matrix adaptation (CMA-ES): a population that learns the shape of a valley."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
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
    whole,
)
from fixel.model.fields import Value, check_fields
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
        return _CmaWalk(box, self, starts, np.random.default_rng(seed))


@final
class _CmaWalk(GeneratorSearch):
    def __init__(
        self, box: SearchBox, options: CmaEs, starts: FloatArray, rng: np.random.Generator
    ) -> None:
        super().__init__(box)
        self.options = options
        self._starts = starts
        self._rng = rng

    def _walk(self) -> Moves:
        reason = ""
        population = self.options.population or 4 + int(3 * math.log(self.box.n))
        for k, start in enumerate(self._starts):
            reason = yield from self._cloud(start, population * 2**k)
            if self.evaluations >= self.options.max_evaluations:
                break
        return reason

    def _cloud(self, start: FloatArray, population: int) -> Moves:
        """Run CMA-ES once, in coordinates relative to its start, in scales."""
        cloud = self._strategy(start, population)
        worst = -math.inf
        first = True
        while not (reason := self._ended(cloud)):
            with _quiet():
                places = cloud.ask()
            # The start itself comes first: its coordinates here are zero.
            table = np.array([np.zeros_like(places[0])] * first + places)[:, : self.box.n]
            points = start + table * self.box.scale
            errors = yield np.clip(points, self.box.low, self.box.high)
            errors = errors[1:] if first else errors
            first = False
            worst = float(np.max(errors, initial=worst, where=np.isfinite(errors)))
            home = (self.best.point - start) / self.box.scale
            away = np.linalg.norm(np.array(places)[:, : self.box.n] - home, axis=1)
            with _quiet():
                cloud.tell(places, _ranked(errors, worst, away).tolist())
        return reason

    def _strategy(self, start: FloatArray, population: int) -> Any:
        box = self.box
        # The package needs at least two unknowns: add one without effect to a single one.
        spare = max(0, 2 - box.n)
        low = [*((box.low - start) / box.scale).tolist(), *[-10.0] * spare]
        high = [*((box.high - start) / box.scale).tolist(), *[10.0] * spare]
        options = {
            "bounds": [low, high],
            "popsize": population,
            "tolx": self.options.tolerance,
            "seed": math.nan,  # do not change NumPy's global random numbers
            "randn": _normal(self._rng),
            "verbose": -10,  # and read no file of signals
            "verb_log": 0,
            "verb_disp": 0,
        }
        with _quiet():
            strategy = import_module("cma").CMAEvolutionStrategy
            return strategy([0.0] * len(low), self.options.sigma, options)

    def _ended(self, cloud: Any) -> str:
        if self.evaluations >= self.options.max_evaluations:
            return f"{self.options.max_evaluations} evaluations were made"
        with _quiet():
            stopped = list(cloud.stop())
        return _MORE_WORDS.get(stopped[0], f"CMA-ES stopped: {stopped[0]}") if stopped else ""


def _ranked(errors: FloatArray, worst: float, away: FloatArray) -> FloatArray:
    """Return errors with failures ranked behind the worst; the package does not accept inf."""
    behind = 0.0 if worst == -math.inf else worst
    return np.where(np.isfinite(errors), errors, behind + max(abs(behind), 1.0) * (1.0 + away))


def _normal(rng: np.random.Generator) -> Callable[..., FloatArray]:
    return lambda *shape: rng.standard_normal(shape)


@contextmanager
def _quiet() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
