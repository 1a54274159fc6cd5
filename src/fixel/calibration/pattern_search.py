"""Pattern searches: try a step up and down along every unknown and take the best."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, final

import numpy as np

from fixel.calibration.optimiser import (
    AbstractOptimiser,
    Count,
    Feasible,
    GeneratorSearch,
    Moves,
    Search,
    SearchBox,
    Size,
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


@final
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
