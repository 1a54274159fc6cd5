"""Direct searches, which only compare errors: patterns, and the simplex of Nelder and Mead."""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, final

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
    inside,
)
from fixel.errors import InvalidInput
from fixel.model.fields import (
    Value,
    check_fields,
    finite,
    inner_share,
    non_negative,
    positive,
    whole,
)
from fixel.typing import FloatArray


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PatternSearch(AbstractOptimiser):
    """Search of the thesis: Dakota's `coliny_pattern_search`, coordinate basis, basic pattern.

    All trials of an iteration are requested at once; those out of bounds are skipped, not moved
    inside. The search is robust and simple, but slow for strongly correlated unknowns, for which
    `NelderMead` achieves more with the same number of evaluations.

    Parameters
    ----------
    initial_delta : float
        First step, in scales of the box. As in Dakota's rescaling, the scale of an unknown is a
        tenth of its range unless it is given.
    threshold_delta : float
        Smallest step; the search ends when the step is not larger.
    contraction_factor : float
        Factor on the step after an iteration without success.
    expand_after : int, optional
        Successes in a row after which the step is divided by `contraction_factor`; None: never.
    sufficient_decrease : float
        A trial is a success if its error is smaller than that of the iterate by more than this
        times the square of the step.
    resolution : float
        Smallest decrease that is a success, as a share of the error. Smaller ones are within the
        accuracy of a simulation, and searches that follow them take up to 20,000 evaluations. Zero,
        as in Dakota, follows every decrease.
    solution_accuracy : float, optional
        Error at which the search stops.
    max_iterations, max_function_evaluations : int
        Limits after which no new iteration begins.
    contract_always : bool
        Contract at every iteration and never expand, as in the text of the thesis (5.1.1), but not
        in Dakota.

    Source
    ------
    Dakota reference manual, `coliny_pattern_search`; SCOLIB, PatternSearch.cpp; options of the
    input file in appendix C.7 of the thesis (RPI).
    """

    name: ClassVar[str] = "pattern-search"
    initial_delta: Size = 0.5
    threshold_delta: Size = 1e-6
    contraction_factor: Annotated[float, Value(inner_share)] = 0.9
    expand_after: Annotated[int | None, Value(whole)] = 5
    sufficient_decrease: Annotated[float, Value(non_negative)] = 0.01
    resolution: Annotated[float, Value(non_negative)] = 3e-7
    solution_accuracy: Annotated[float | None, Value(finite)] = 1e-6
    max_iterations: Count = 10_000
    max_function_evaluations: Count = 20_000
    contract_always: bool = False

    def __post_init__(self) -> None:
        check_fields(self, "PatternSearch")

    @property
    def limit(self) -> int:
        return self.max_function_evaluations

    def start(
        self, box: SearchBox, seed: int = 0, feasible: Feasible | None = None
    ) -> PatternSearchSearch:
        return PatternSearchSearch(box, self)


class PatternSearchSearch(GeneratorSearch):
    """Running pattern search."""

    def __init__(self, box: SearchBox, options: PatternSearch) -> None:
        super().__init__(box, self._steps)
        self.options = options
        self.delta = options.initial_delta  # present step, in scales
        self.iterations = 0  # number of iterations begun
        self._successes = 0

    def _steps(self, _: Search) -> Moves:
        point = self.box.start
        error = (yield point[None].copy())[0]
        while not (reason := self._ended()):
            self.iterations += 1
            trials = self._trials(point)
            errors = (yield trials) if len(trials) else np.array([np.inf])
            k = int(np.argmin(errors))
            success = self._is_success(float(errors[k]), float(error))
            if success:
                point, error = trials[k], errors[k]
            self._adapt(success)
        return reason

    def _is_success(self, trial: float, error: float) -> bool:
        if trial == math.inf:
            return False
        options = self.options
        least = max(options.sufficient_decrease * self.delta**2, options.resolution * abs(trial))
        return trial < error - least

    def _trials(self, point: FloatArray) -> FloatArray:
        """Return the trials: up along every unknown, then down along every unknown, as SCOLIB."""
        step = self.delta * np.diag(self.box.scale)
        trials = np.concatenate((point + step, point - step))
        return np.asarray(trials[inside(self.box, trials)], np.float64)

    def _adapt(self, success: bool) -> None:
        options = self.options
        if not success or options.contract_always:
            self._successes = 0
            self.delta *= options.contraction_factor
            return
        self._successes += 1
        if options.expand_after is not None and self._successes >= options.expand_after:
            self._successes = 0
            self.delta *= 1.0 / options.contraction_factor

    def _ended(self) -> str:
        options = self.options
        if self.delta <= options.threshold_delta:
            return f"the step shrank to {options.threshold_delta:g} of the scale"
        if options.solution_accuracy is not None and self.best.error <= options.solution_accuracy:
            return f"the error fell to {options.solution_accuracy:g}"
        if self.iterations >= options.max_iterations:
            return f"{options.max_iterations} iterations were made"
        if self.evaluations >= options.max_function_evaluations:
            return f"{options.max_function_evaluations} evaluations were made"
        return ""


def _steps(value: Sequence[float], where: str) -> tuple[float, ...]:
    return tuple(positive(step, f"{where}[{i}]") for i, step in enumerate(value))


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FixedStepSearch(AbstractOptimiser):
    """Search of the thesis's own code: a few rounds of constant steps, to improve a good start.

    It moves at most `rounds` steps from its start, so a bad start cannot be corrected.

    Parameters
    ----------
    step : float
        Step of every unknown, in scales of the box.
    steps : sequence of float, optional
        One step per unknown, in its own unit, instead of `step`. The thesis takes 0.05 for each
        friction and 0.002 m for the tripod radius.
    rounds : int
        Maximum number of rounds; the search ends after a round without improvement.

    Notes
    -----
    A trial beyond a bound is moved onto it. The thesis moves negative values to zero and has no
    upper bounds, which is the same for a lower bound of zero and a distant upper bound.

    Source
    ------
    Appendix C.5 of the thesis (RPI).
    """

    name: ClassVar[str] = "fixed-step"
    step: Size = 0.5
    steps: Annotated[Sequence[float] | None, Value(_steps)] = None
    rounds: Count = 10

    def __post_init__(self) -> None:
        check_fields(self, "FixedStepSearch")

    def start(self, box: SearchBox, seed: int = 0, feasible: Feasible | None = None) -> Search:
        if self.steps is not None and len(self.steps) != box.n:
            raise InvalidInput(
                "FixedStepSearch.steps",
                found=f"{len(self.steps)} steps",
                expected=f"{box.n}, one per parameter",
            )
        return GeneratorSearch(box, self._rounds)

    def _rounds(self, search: Search) -> Moves:
        box = search.box
        step = np.diag(self.step * box.scale if self.steps is None else self.steps)
        # Up and down along the first unknown, then the second: the order of the thesis.
        pattern = np.stack((step, -step), axis=1).reshape(-1, box.n)
        yield box.start[None].copy()
        for _ in range(self.rounds):
            point, error = search.best
            yield np.clip(point + pattern, box.low, box.high)
            if not search.best.error < error:
                return "no step along any parameter decreased the error"
        return f"{self.rounds} rounds were made"


# Distances of the trials beyond the centre of the other vertices, over that of the worst vertex.
REFLECTION, EXPANSION, OUTSIDE, INSIDE = range(4)
_PLACE: Final = np.array([1.0, 2.0, 0.5, -0.5])
_SHRINK: Final = 0.5


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class NelderMead(AbstractOptimiser):
    """Nelder-Mead on n + 1 vertices, the search of the 2006 paper.

    Good with few unknowns (up to about eight) and rough errors. It finds at most one minimum and
    may stop at a point that is none, so run it from several starts (`MultiStart`).

    Parameters
    ----------
    size : float
        Mean distance of the vertices from their centre at which the search ends, in scales of the
        box. The size at the end is reported as the uncertainty of the minimum.
    step : float
        Distance from the start to the other vertices of the first simplex, in scales.
    random_simplex : bool
        Use random feasible points as the other first vertices instead, as in the paper.
    speculative : bool
        Request the reflected point, the expanded one and both contractions at once. The decisions
        are the same, in the time of one evaluation instead of two, with more evaluations.
    restarts : int
        Maximum number of new simplices of the first size about the best point, as long as each
        finds a better one: a simplex can collapse at a crease that is no minimum.
    max_evaluations : int
        Number of evaluations after which no new step begins.

    Notes
    -----
    A point outside the bounds counts as failed and is not requested.

    Source
    ------
    Nelder & Mead (1965); the rules are those of Lagarias et al. (1998), with coefficients 1, 2,
    1/2, 1/2; size, random vertices and failed points as in the ASME paper (2006); restarts after
    Kelley (1999), from the plain simplex.
    """

    name: ClassVar[str] = "nelder-mead"
    size: Size = 1e-4
    step: Size = 1.0
    random_simplex: bool = False
    speculative: bool = True
    restarts: CountOrZero = 0
    max_evaluations: Count = 20_000

    def __post_init__(self) -> None:
        check_fields(self, "NelderMead")

    def start(
        self, box: SearchBox, seed: int = 0, feasible: Feasible | None = None
    ) -> NelderMeadSearch:
        if self.random_simplex:
            others = feasible_points(box, box.n, seed, feasible)
            if len(others) == box.n:
                return NelderMeadSearch(box, self, np.concatenate((box.start[None], others)))
        return NelderMeadSearch(box, self, stepped_simplex(box, self.step))


class NelderMeadSearch(GeneratorSearch):
    """Running Nelder-Mead search."""

    def __init__(self, box: SearchBox, options: NelderMead, vertices: FloatArray) -> None:
        super().__init__(box, self._descents)
        self.options = options
        self.vertices = vertices  # vertices of the simplex, the best first
        # Mean distance of the vertices from their centre, in scales.
        self.size = simplex_size(box, vertices)

    def _descents(self, _search: Search) -> Moves:
        reason = yield from self._descent()
        for _ in range(self.options.restarts):
            point, error = self.best
            self.vertices = stepped_simplex(self.box._replace(start=point), self.options.step)
            reason = yield from self._descent()
            if not self.best.error < error:
                break
        return reason

    def _descent(self) -> Moves:
        errors = yield from self._errors(self.vertices)
        while True:
            order = np.argsort(errors, kind="stable")
            self.vertices, errors = self.vertices[order], errors[order]
            self.size = simplex_size(self.box, self.vertices)
            if self.size < self.options.size:
                return f"the simplex shrank to {self.options.size:g} of the scale"
            if self.evaluations >= self.options.max_evaluations:
                return f"{self.options.max_evaluations} evaluations were made"
            errors = yield from self._step(errors)

    def _step(self, errors: FloatArray) -> Generator[FloatArray, FloatArray, FloatArray]:
        """Replace the worst vertex, or shrink; return the new errors, unsorted."""
        centre = self.vertices[:-1].mean(axis=0)
        trials = centre + _PLACE[:, None] * (centre - self.vertices[-1])
        found = np.full(len(trials), math.inf)
        first = slice(None) if self.options.speculative else slice(1)
        found[first] = yield from self._errors(trials[first])
        other = _after_reflection(found[REFLECTION], errors)
        if other != REFLECTION and not self.options.speculative:
            found[other] = (yield from self._errors(trials[other][None]))[0]
        chosen = _choice(found, other, errors[-1])
        if chosen is None:
            return (yield from self._shrink(errors))
        self.vertices = np.concatenate((self.vertices[:-1], trials[chosen][None]))
        return np.append(errors[:-1], found[chosen])

    def _shrink(self, errors: FloatArray) -> Generator[FloatArray, FloatArray, FloatArray]:
        best = self.vertices[0]
        shrunk = best + _SHRINK * (self.vertices[1:] - best)
        self.vertices = np.concatenate((best[None], shrunk))
        return np.append(errors[:1], (yield from self._errors(shrunk)))

    def _errors(self, points: FloatArray) -> Generator[FloatArray, FloatArray, FloatArray]:
        """Return errors (k,) of points (k, n); inf for points out of bounds, without a request."""
        errors = np.full(len(points), math.inf)
        within = inside(self.box, points)
        if within.any():
            errors[within] = yield points[within]
        return errors


def stepped_simplex(box: SearchBox, step: float) -> FloatArray:
    """Return vertices (n + 1, n): the start, and one step from it along every unknown, downwards if
    the upper bound is too close and the lower one is farther."""
    vertices = np.tile(box.start, (box.n + 1, 1))
    for i in range(box.n):
        above, below = box.high[i] - box.start[i], box.start[i] - box.low[i]
        length = min(step * box.scale[i], max(above, below))
        vertices[i + 1, i] += length if length <= above else -length
    return np.clip(vertices, box.low, box.high)


def simplex_size(box: SearchBox, vertices: FloatArray) -> float:
    """Return the mean distance of vertices (k, n) from their centre, in scales."""
    places = vertices / box.scale
    return float(np.linalg.norm(places - places.mean(axis=0), axis=1).mean())


def _after_reflection(reflected: float, errors: FloatArray) -> int:
    """Return the trial to compare with the reflected point, or this one if it is accepted."""
    if reflected < errors[0]:
        return EXPANSION
    if reflected < errors[-2]:
        return REFLECTION
    return OUTSIDE if reflected < errors[-1] else INSIDE


def _choice(found: FloatArray, other: int, worst: float) -> int | None:
    """Return the trial that replaces the worst vertex; None to shrink."""
    if other in (REFLECTION, EXPANSION):
        return other if found[other] < found[REFLECTION] else REFLECTION
    if other == OUTSIDE:
        return OUTSIDE if found[OUTSIDE] <= found[REFLECTION] else None
    return INSIDE if found[INSIDE] < worst else None
