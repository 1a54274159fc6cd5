"""A calibration as a generator that yields questions and returns sets of parameters.

It simulates nothing. Its questions are answered in parts, by `answer` in this process or in
workers. The same answers give the same questions and the same result, bit for bit, so an
interrupted calibration is continued by replay.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np

from fixel.calibration import assess
from fixel.calibration.assess import Assessment, AssessmentRequest, AssessmentSteps, Frames
from fixel.calibration.honest import quoted
from fixel.calibration.least_squares import LeastSquares, NormalPrior
from fixel.calibration.noise import Noise
from fixel.calibration.objective import Comparer, Evaluation, combined_errors, lengths_of
from fixel.calibration.optimiser import AbstractOptimiser, Best
from fixel.calibration.result import (
    CalibrationResult,
    FitKind,
    ParameterSet,
    find_solutions,
    found_arrays,
    found_of,
    json_array,
    json_of,
)
from fixel.calibration.study import (
    OUT_OF_BUDGET,
    CombinedFit,
    RolloutRequest,
    Study,
    Trace,
    at_points,
    best_subset,
    better_of,
    box_of,
    calibrate_each,
    calibrate_joint,
    exchange_with_neighbours,
    made,
    minimax_of_stored,
    neighbours,
    relayed,
    run_study,
    weighted,
)
from fixel.errors import FixelError, InvalidInput
from fixel.kernels import codes
from fixel.model.records import Estimate
from fixel.typing import FloatArray

T = TypeVar("T")

# Experiments calibrated alone in one part, in step: seconds of work. Of many experiments more, for
# larger batches, as long as there are parts for many workers.
MEMBERS_A_PART: Final = 4
MAX_MEMBERS_A_PART: Final = 16
PARTS_FOR_WORKERS: Final = 32
ROLLOUTS_A_PART: Final = 4000  # about a second of them
VERDICTS: Final = "verdicts"  # stage of the questions that follow the search
TIME: Final = "cpu_s"  # name of the computing time among the arrays of an answer [s]
# Share of a budget that the search may take where verdicts are wanted.
SEARCH_SHARE: Final = 0.5
# Errors up to so much larger than the least are nearly as good: noise in the measurements moves the
# error of the best by about as much.
NEARLY: Final = 0.02

Rows = Mapping[str, Any]
PartAnswer = Mapping[str, Any] | str  # named arrays, or the reason why there are none


class Question(NamedTuple):
    """Request of a calibration; the rows of its arrays are independent of each other."""

    kind: str  # name of a function in `ANSWERS`, or `"ends"`
    stage: str  # beginning of the names of its parts
    rows: Rows  # named arrays, each with a row for each thing to compute
    size: int  # maximum number of rows of a part
    note: str  # what a progress bar shows
    # Parts of the questions after this one, known or estimated; None if there may be any number.
    left: int | None = None
    best: float | None = None  # smallest error so far [m]

    def parts(self) -> list[dict[str, Any]]:
        """Return the rows in parts that can be answered one by one."""
        n = len(next(iter(self.rows.values())))
        return [
            {name: rows[at : at + self.size] for name, rows in self.rows.items()}
            for at in range(0, n, self.size)
        ]


Steps = Generator[Question, Sequence[PartAnswer], T]


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibrationTask:
    """Experiments to calibrate, and the method; what answers to questions depend on.

    Parameters
    ----------
    comparer : Comparer
        Experiments, parameters, error and motion model.
    mode : str
        `"each"`, `"joint"`, `"campaign"` or `"stored"`.
    optimiser : AbstractOptimiser or LeastSquares
        Search; least squares only in mode joint.
    noise : Noise, optional
        Noise of measured poses, if it was stated.
    stored : sequence of points
        Values of the free parameters in earlier calibrations, for mode stored.
    combine, seed, max_evaluations, level, verdicts, budget
        As for `fixel.calibrate`.
    """

    comparer: Comparer
    mode: str
    optimiser: AbstractOptimiser | LeastSquares
    combine: str
    seed: int
    max_evaluations: int | None
    noise: Noise | None
    level: float | None
    verdicts: bool
    budget: float | None
    stored: Sequence[Sequence[float]]

    @property
    def members(self) -> range:
        """Indices of the experiments."""
        return range(len(self.comparer.targets))

    def combined(self, errors: FloatArray) -> FloatArray:
        """Return the combined errors (k,) of errors (k, n_member)."""
        return combined_errors(errors, self.combine)

    def assessment(self, one: ParameterSet) -> AssessmentSteps[Assessment]:
        """Return the assessment of a set of parameters."""
        assert self.level is not None  # of a new calibration
        return assess.assessment_steps(
            self.comparer,
            one.members,
            one.point,
            noise=self.noise,
            level=self.level,
            solutions=list(one.solutions[1:]),
        )


class CalibrationSearch:
    """Search for the parameters of a task, its used budget, and the best point found so far.

    Computing times come from the answers, so they are the same after an interruption.
    """

    def __init__(self, task: CalibrationTask) -> None:
        self.task, self.comparer, self.members = task, task.comparer, task.members
        self.best = Best(task.comparer.space.nominal, math.inf)
        self.nominal = np.full(len(task.members), math.nan)  # errors before the calibration
        self.found: list[ParameterSet] = []  # complete sets
        self._spent = 0.0
        self._points: list[FloatArray] = []
        self._errors: list[FloatArray] = []

    def record(self, points: FloatArray, errors: FloatArray) -> None:
        """Record the combined errors (k,) of points (k, n_free) that a search evaluated."""
        self._points.append(points)
        self._errors.append(errors)
        k = int(np.argmin(errors))
        if errors[k] < self.best.error:
            self.best = Best(points[k], float(errors[k]))

    @property
    def shown(self) -> float | None:
        """Smallest error so far, as a length of one experiment [m]; None without any."""
        share = len(self.members) if self.task.combine == "sum" else 1
        length = lengths_of(np.array(self.best.error / share), self.comparer.error.unit)
        return 1e-3 * float(length) if self._points else None

    @property
    def evaluations(self) -> int:
        """Number of points that a search evaluated."""
        return sum(map(len, self._points))

    def trace(self, best: Best | None = None, ended: str = "it was interrupted") -> Trace:
        """Return the evaluations so far, with another best point if the search has one."""
        points = np.concatenate([np.zeros((0, len(self.best.point))), *self._points])
        errors = np.concatenate([np.zeros(0), *self._errors])
        return Trace(*(best or self.best), points, errors, [""] * len(errors), ended)

    @property
    def is_over(self) -> bool:
        """Whether the budget of the whole calibration is used up."""
        return self.task.budget is not None and self._spent > self.task.budget

    @property
    def search_end(self) -> str:
        """Reason to end the search now; empty to continue."""
        most = self.task.max_evaluations
        if most is not None and self.evaluations >= most:
            return made(self.evaluations)
        share = SEARCH_SHARE if self.task.verdicts else 1.0
        if self.task.budget is not None and self._spent > share * self.task.budget:
            return OUT_OF_BUDGET
        return ""

    def steps(self) -> Steps[CalibrationResult]:
        """Calibrate by questions and answers; return the result."""
        members, start = self.members, self.comparer.space.nominal
        at_start = at_points(members, start[None])
        (self.nominal,), _ = yield from self._evaluate(at_start, "nominal")
        if self.task.mode in ("each", "campaign"):
            self.found = yield from self._alone()
        found = [*self.found]
        if self.task.mode == "campaign" and len(members) > 1:
            found = yield from self._campaign(found)
        elif self.task.mode == "stored":
            points = np.array(self.task.stored)
            pooled = yield from self._evaluate(minimax_of_stored(members, points), "stored")
            found.append(_pooled(FitKind.STORED, members, pooled))
        elif self.task.mode == "joint":
            found.append((yield from self._direct(start)))
        if self.task.verdicts and self.task.mode != "each":
            self.found = [*found]
            for k, one in enumerate(found):
                if one.how == FitKind.DIRECT:
                    found[k] = yield from self._with_check((yield from self._with_verdicts(one)))
        return self.result(found)

    def result(self, found: Sequence[ParameterSet]) -> CalibrationResult:
        """Return the result that consists of these sets."""
        keys = tuple(target.key for target in self.comparer.targets)
        labels = self.comparer.space.labels
        return CalibrationResult(keys=keys, labels=labels, nominal=self.nominal, found=tuple(found))

    # --- questions ------------------------------------------------------------------------------

    def _count(self, answers: Sequence[PartAnswer]) -> None:
        """Count the computing time of answers."""
        if self.task.budget is not None:
            self._spent += sum(float(own[TIME]) for own in answers if not isinstance(own, str))

    def _evaluate(self, study: Study[T], stage: str, *, searches: bool = False) -> Steps[T]:
        """Answer a study by questions; those of a search count, and show its best."""

        def ask(wanted: RolloutRequest) -> Steps[Evaluation]:
            best = self.shown if searches else None
            rows = wanted._asdict()
            question = Question("rollouts", stage, rows, ROLLOUTS_A_PART, stage, None, best)
            answers = yield question
            found = [
                _evaluated(own, len(part["which"]))
                for own, part in zip(answers, question.parts(), strict=True)
            ]
            errors = np.concatenate([one.error for one in found])
            if searches:
                self._count(answers)
                n = len(self.members)
                self.record(wanted.points[::n], self.task.combined(errors.reshape(-1, n)))
            return Evaluation(errors, [reason for one in found for reason in one.reasons])

        return (yield from relayed(study, ask))

    def _table(
        self, wanted: AssessmentRequest, stage: str, best: float | None = None
    ) -> Steps[FloatArray]:
        """Request a row for each point (k, n) of a question."""
        size = max(1, ROLLOUTS_A_PART // (1 if wanted.single else len(self.members)))
        left = None if wanted.left is None else math.ceil(wanted.left / size)
        rows = {"points": wanted.points}
        answers = yield Question(wanted.kind, stage, rows, size, wanted.note, left, best)
        self._count(answers)
        tables: list[FloatArray] = []
        for k, own in enumerate(answers):
            if isinstance(own, str):
                raise InvalidInput(f"{stage}/{k}", found=f"none ({own})", expected="runs")
            tables.append(own["table"])
        return np.concatenate(tables)

    # --- sets of parameters ---------------------------------------------------------------------

    def _alone(self) -> Steps[list[ParameterSet]]:
        n = len(self.members)
        size = max(MEMBERS_A_PART, min(MAX_MEMBERS_A_PART, n // PARTS_FOR_WORKERS))
        left, rows = 0 if self.task.mode == "each" else None, {"members": np.arange(n)}
        question = Question(FitKind.ALONE, FitKind.ALONE, rows, size, "each experiment", left)
        found: list[ParameterSet] = []
        for own, part in zip((yield question), question.parts(), strict=True):
            if not isinstance(own, str):
                found += found_of(own)
                continue
            found += [
                ParameterSet(
                    how=FitKind.ALONE,
                    members=(m,),
                    point=self.comparer.space.nominal,
                    errors=np.array([math.inf]),
                    note=own,
                )
                for m in part["members"].tolist()
            ]
        return found

    def _campaign(self, alone: list[ParameterSet]) -> Steps[list[ParameterSet]]:
        """After the single calibrations: neighbours' values, and one set for all in three ways."""
        task, comparer, members = self.task, self.comparer, self.members
        points = np.array([one.point for one in alone])
        errors = np.array([one.errors[0] for one in alone])
        groups = neighbours([target.conditions for target in comparer.targets])
        better, least = yield from self._evaluate(
            exchange_with_neighbours(points, errors, groups), "neighbours"
        )
        free = comparer.space.free
        informed = np.array([[u.covers(t.conditions) for u in free] for t in comparer.targets])
        pooled = yield from self._evaluate(
            weighted(members, better, least, informed), "weighted mean"
        )
        subset = yield from self._evaluate(
            best_subset(members, better, least, task.combined, task.seed, informed=informed),
            "subsets",
        )
        direct = yield from self._direct(subset.point)
        return [
            *alone,
            *_improved(alone, better, least),
            _pooled(FitKind.WEIGHTED, members, pooled),
            _pooled(FitKind.SUBSET, members, subset),
            direct,
        ]

    def _direct(self, start: FloatArray) -> Steps[ParameterSet]:
        """Search one set for all, from a start; return it with its error for each experiment."""
        begun, optimiser = time.perf_counter(), self.task.optimiser
        if isinstance(optimiser, LeastSquares):
            trace, solutions = (yield from self._by_squares(optimiser)), np.zeros((0, 0))
        else:
            trace = yield from self._by_errors(optimiser, start)
            solutions = distinct_solutions(self.comparer, trace)
        at_best = at_points(self.members, trace.point[None])
        (errors,), (reason,) = yield from self._evaluate(at_best, "best")
        note = ""
        if reason:
            first = int(np.argmin(np.isfinite(errors)))
            note = f"{self.comparer.targets[first].key}: {explained(reason)}"
        return ParameterSet(
            how=FitKind.DIRECT,
            members=tuple(self.members),
            point=trace.point,
            errors=errors,
            trace=trace,
            seconds=time.perf_counter() - begun,
            note=note,
            solutions=solutions,
        )

    def _by_errors(self, optimiser: AbstractOptimiser, start: FloatArray) -> Steps[Trace]:
        task, comparer = self.task, self.comparer
        study = calibrate_joint(
            self.members,
            box_of(comparer.space.started_at(start)),
            optimiser,
            task.combined,
            task.seed,
            comparer.feasible,
            lambda: self.search_end,
            task.max_evaluations or math.inf,
        )
        trace, _ = yield from self._evaluate(study, "all together", searches=True)
        return trace

    def _by_squares(self, optimiser: LeastSquares) -> Steps[Trace]:
        """Search by least squares, with tens of evaluations an unknown."""
        comparer, most = self.comparer, self.task.max_evaluations
        box, prior = box_of(comparer.space), NormalPrior.of(comparer.space)
        search = optimiser.start(box, self.task.seed, comparer.feasible, prior)
        ended, searches = "", []
        while not search.done:
            wanted = search.ask()
            points = wanted[: most and most - self.evaluations]
            question = AssessmentRequest("squares", points, "least squares")
            table = yield from self._table(question, "squares", self.shown)
            searches.append(search.asking[: len(points)])
            if len(points) == len(wanted):
                search.tell(table)
            self.record(points, np.einsum("km,km->k", table, table))
            if (ended := self.search_end) and not search.done:
                break
        best = better_of(search.best, self._points, self._errors)._replace(error=self.best.error)
        trace = self.trace(best, search.reason or ended)
        if len(search.descents) > 1:
            trace = Trace(*trace[:-1], np.concatenate(searches))
        return trace

    # --- what the data determine ----------------------------------------------------------------

    def _with_verdicts(self, one: ParameterSet) -> Steps[ParameterSet]:
        """Add a verdict on every parameter."""

        def ask(wanted: AssessmentRequest) -> Steps[FloatArray]:
            answers = yield from self._table(wanted, VERDICTS)
            if self.is_over:
                more = "allow a larger budget, or calibrate a sample of the experiments"
                raise FixelError(f"{OUT_OF_BUDGET}; {more}")
            return answers

        if not np.isfinite(one.errors).all():
            return one
        try:
            found = yield from relayed(self.task.assessment(one), ask)
        except FixelError as problem:  # the values that were found stay worth having
            return replace(one, note=f"no verdicts: {problem}")
        return with_assessment(self.comparer, one, found)

    def _with_check(self, one: ParameterSet) -> Steps[ParameterSet]:
        """Compare recorded ends with those predicted from the other experiments."""
        if not one.estimates or len(one.members) < 2 or self.is_over:
            return one
        value, sd = quoted(one.estimates, self.comparer.space.labels, self.task.level)
        rows = {"point": one.point[None], "value": value[None], "sd": sd[None]}
        (own,) = yield Question("ends", "check", rows, 1, "predictions", 0)
        if isinstance(own, str):
            return one
        inside, n = own["count"].tolist()
        return replace(one, prediction_check=(inside, n))


def _evaluated(answer: PartAnswer, n: int) -> Evaluation:
    """Errors out of an answer; a part without one is evaluations without one."""
    if isinstance(answer, str):
        return Evaluation(np.full(n, math.inf), [answer] * n)
    reasons = [""] * n
    for k, reason in json_of(answer["reasons"]).items():
        reasons[int(k)] = reason
    return Evaluation(answer["error"], reasons)


def _improved(
    alone: Sequence[ParameterSet], points: FloatArray, errors: FloatArray
) -> list[ParameterSet]:
    return [
        ParameterSet(
            how=FitKind.NEIGHBOUR, members=one.members, point=point, errors=np.array([error])
        )
        for one, point, error in zip(alone, points, errors, strict=True)
        if error < one.errors[0]
    ]


def _pooled(how: FitKind, members: Sequence[int], pooled: CombinedFit) -> ParameterSet:
    return ParameterSet(how=how, members=tuple(members), point=pooled.point, errors=pooled.members)


# --- answers ------------------------------------------------------------------------------------


def _rollouts(task: CalibrationTask, rows: Rows) -> dict[str, Any]:
    """Errors of experiments under points."""
    found = task.comparer.errors(rows["which"], rows["points"])
    failed = {str(k): reason for k, reason in enumerate(found.reasons) if reason}
    return {"error": found.error, "reasons": json_array(failed)}


def _alone(task: CalibrationTask, rows: Rows) -> dict[str, Any]:
    """Calibrate some experiments, each by itself; all advance together."""
    assert not isinstance(task.optimiser, LeastSquares)
    comparer, members = task.comparer, rows["members"].tolist()
    begun = time.perf_counter()
    traces = run_study(
        calibrate_each(
            members,
            box_of(comparer.space),
            task.optimiser,
            task.seed,
            comparer.feasible,
            task.max_evaluations or math.inf,
        ),
        lambda ask: comparer.errors(ask.which, ask.points),
    )
    found = [
        ParameterSet(
            solutions=distinct_solutions(comparer, trace),
            how=FitKind.ALONE,
            members=(member,),
            point=trace.point,
            errors=np.array([trace.error]),
            trace=trace,
            note=explained(next((reason for reason in trace.reasons if reason), ""))
            if math.isinf(trace.error)
            else "",
        )
        for member, trace in zip(members, traces, strict=True)
    ]
    if task.verdicts:
        found = _with_estimates(task, found)
    seconds = (time.perf_counter() - begun) / len(members)
    return found_arrays([replace(one, seconds=seconds) for one in found])


def _with_estimates(task: CalibrationTask, alone: Sequence[ParameterSet]) -> list[ParameterSet]:
    """Add verdicts to single calibrations, whose assessments run side by side."""
    wanted = [one for one in alone if np.isfinite(one.errors).all()]
    running = [task.assessment(one) for one in wanted]
    members = [one.members for one in wanted]
    assessed = iter(assess.run_assessments(task.comparer, members, running))
    found = []
    for one in alone:
        own = next(assessed) if np.isfinite(one.errors).all() else None
        if isinstance(own, InvalidInput):
            one = replace(one, note=f"no verdicts: {own}")
        elif own is not None:
            one = with_assessment(task.comparer, one, own)
        found.append(one)
    return found


def _squares(task: CalibrationTask, rows: Rows) -> dict[str, Any]:
    """Residuals of all experiments under points, whose squares add up to the summed error.

    A few frames stand for all of a long trajectory.
    """
    members, scale = np.array(task.members), task.comparer.error.angle_scale
    noise = Noise(position_m=1e-3, angle_rad=1e-3 / scale, source="stated")
    frames = Frames(task.comparer, members)
    share = len(members) if task.combine == "mean" else 1
    table = frames.residuals(noise)(rows["points"]) / np.sqrt(share * frames.weights)
    return {"table": table}


def _assessed(kind: str, task: CalibrationTask, rows: Rows) -> dict[str, Any]:
    """Answer to a question of `assessment_steps` on all experiments."""
    members = np.array(task.members)
    return {"table": assess.answer(task.comparer, members, kind, rows["points"])}


# Functions that answer a part of a question, by its kind.
ANSWERS: Final[Mapping[str, Callable[[CalibrationTask, Rows], dict[str, Any]]]] = {
    "rollouts": _rollouts,
    FitKind.ALONE: _alone,
    "squares": _squares,
    **{kind: partial(_assessed, kind) for kind in assess.ANSWERS},
}


def distinct_solutions(comparer: Comparer, trace: Trace) -> FloatArray:
    """(k, n_free) points nearly as good as the best, one a cluster of those evaluated."""
    if not np.isfinite(trace.error):
        return np.zeros((0, len(trace.point)))
    box = box_of(comparer.space)
    threshold = NEARLY * trace.error
    clusters = find_solutions(trace.points, trace.errors, box.scale, threshold)
    return np.array([cluster.point for cluster in clusters])


def with_assessment(comparer: Comparer, one: ParameterSet, found: Assessment) -> ParameterSet:
    """Return a parameter set with its estimates, profiles and misfit."""
    best, estimates = comparer.space.values(one.point), (*found.quoted, *_frozen(comparer))
    return replace(
        one,
        estimates=tuple(replace(e, best_fit=best[e.label]) for e in estimates),
        profiles=found.profiles.records(comparer.space.labels),
        noise=found.noise.text,
        misfit=() if found.misfit is None else found.misfit.sentences,
        misfit_ratio=math.nan if found.misfit is None else found.misfit.ratio,
    )


def _frozen(comparer: Comparer) -> list[Estimate]:
    return [
        Estimate(label=u.label, unit=u.unit, value=u.nominal, verdict="frozen")
        for u in comparer.space.unknowns
        if u.frozen
    ]


def explained(reason: str) -> str:
    """Return why a simulation failed, with advice for its status."""
    status = reason.partition(" at ")[0]
    if status not in codes.STATUS_NAMES:
        return reason
    return f"{reason}. {codes.STATUS_ADVICE[codes.STATUS_NAMES.index(status)]}"
