"""A calibration as rounds of chunks, for this machine and for a cluster alike.

What a chunk answers depends on the experiments and the request only. So a calibration that was
interrupted, or ran on other machines, ends with the same bits.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar, final

import numpy as np

from fixel.calibration.assess import (
    Assessment,
    AssessmentSteps,
    Frames,
    answer,
    assessment_steps,
    run_assessments,
)
from fixel.calibration.cost import NormalPrior
from fixel.calibration.joint import draw_joint, linear_fit, quoted
from fixel.calibration.noise import Noise
from fixel.calibration.objective import Comparer, Evaluation, Objective
from fixel.calibration.optimiser import Best
from fixel.calibration.solutions import find_solutions
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
    run_study,
    weighted,
)
from fixel.calibration.target import Target
from fixel.errors import InvalidInput
from fixel.io.array_bytes import arrays_of, bytes_of
from fixel.jobs.functions import callable_by_jobs, threads
from fixel.jobs.work import Answer, Answers, Chunk, Failure, Round, Work
from fixel.kernels import codes
from fixel.model.records import Estimate
from fixel.typing import FloatArray
from fixel.uncertainty.predictive import DRAWS, LEAST, check_predictions, predictive_of
from fixel.workflows.calibration.request import CalibrationRequest, read_targets
from fixel.workflows.calibration.result import (
    CalibrationResult,
    FitKind,
    ParameterSet,
    found_arrays,
    found_of,
    outcome_bytes,
)

T = TypeVar("T")

REQUEST: Final = "request.json"

# Experiments calibrated alone in one chunk, in step: seconds of work. Of many experiments more, for
# larger batches, as long as there are chunks for many workers.
MEMBERS_A_CHUNK: Final = 4
MAX_MEMBERS_A_CHUNK: Final = 16
CHUNKS_FOR_WORKERS: Final = 32
TIME: Final = "cpu_s"  # name of the computing time among the arrays of an answer [s]
# Share of a budget that the search may take where verdicts are wanted.
SEARCH_SHARE: Final = 0.5
# Rollouts evaluated in one chunk, about a second of them.
ROLLOUTS_A_CHUNK: Final = 4000


@callable_by_jobs
def calibration_work(inputs: Path, options: Mapping[str, Any]) -> Work:
    """Return the rounds of the calibration that is described in a folder of inputs."""
    return CalibrationSearch(*_load_job(inputs)).rounds()


ChunkFunction = Callable[[CalibrationRequest, Comparer, bytes], bytes]
CHUNKS: Final[dict[str, ChunkFunction]] = {}  # functions of chunks by their name in a round


def _chunk(function: ChunkFunction) -> Callable[[Path, bytes], bytes]:
    """Enter a function of a chunk into `CHUNKS`, and let it be called by jobs."""
    CHUNKS[f"calibration:{function.__name__}"] = function

    @functools.wraps(function)
    def load_and_call(inputs: Path, payload: bytes) -> bytes:
        return function(*_load_job(inputs), payload)

    return callable_by_jobs(load_and_call)


Rounds = Generator[Round, Answers, T]


@final
class CalibrationSearch:
    """Rounds of a calibration, its used budget, and the best point found so far.

    Computing times come from the answers of chunks, so they are the same after an interruption.
    """

    def __init__(self, request: CalibrationRequest, comparer: Comparer) -> None:
        self.request, self.comparer = request, comparer
        self.objective = Objective(comparer, None, request.combine)
        self.members = range(len(comparer.targets))
        self._spent = 0.0
        self._points: list[FloatArray] = []
        self._errors: list[FloatArray] = []
        self.best = Best(request.space.nominal, math.inf)
        self.found: list[ParameterSet] = []  # complete sets

    def add(self, answers: Sequence[Answer]) -> None:
        """Count the time of a round."""
        if self.request.budget is not None:
            good = (one for one in answers if not isinstance(one, Failure))
            self._spent += sum(float(arrays_of(one)[TIME]) for one in good)

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
        lengths = self.request.lengths(np.array(self.best.error), len(self.members))
        return 1e-3 * float(lengths) if self._points else None

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
        return self.request.budget is not None and bool(self._spent > self.request.budget)

    @property
    def search_end(self) -> str:
        """Reason to end the search now; empty to continue."""
        most, budget = self.request.max_evaluations, self.request.budget
        if most is not None and self.evaluations >= most:
            return made(self.evaluations)
        share = SEARCH_SHARE if self.request.verdicts else 1.0
        if budget is not None and self._spent > share * budget:
            return OUT_OF_BUDGET
        return ""

    def rounds(self) -> Work:
        """Calibrate in rounds of chunks; the result is a `CalibrationResult` as bytes."""
        request, comparer = self.request, self.comparer
        members = self.members
        start = comparer.space.nominal
        before, _ = yield from self._evaluate(at_points(members, start[None]), "nominal")
        found: list[ParameterSet] = []
        if request.mode in ("each", "campaign"):
            alone = yield from self._alone()
            found += alone
        if request.mode == "campaign" and len(members) > 1:
            found = yield from self._campaign(found)
        elif request.mode == "stored":
            points = np.array(request.stored)
            pooled = yield from self._evaluate(minimax_of_stored(members, points), "stored")
            found.append(_pooled(FitKind.STORED, members, pooled))
        elif request.mode == "joint":
            search = self._direct(start) if request.least_squares is None else self._by_squares()
            found.append((yield from search))
        if request.verdicts and request.mode != "each":
            self.found = [*found]
            for k, one in enumerate(found):
                if one.how == FitKind.DIRECT:
                    found[k] = yield from self._with_check((yield from self._with_verdicts(one)))
        return outcome_bytes(self.result(before[0], found))

    def result(self, nominal: FloatArray, found: Sequence[ParameterSet]) -> CalibrationResult:
        """Return the result with errors (n_target,) before the calibration."""
        keys = tuple(target.key for target in self.comparer.targets)
        labels = self.comparer.space.labels
        return CalibrationResult(keys=keys, labels=labels, nominal=nominal, found=tuple(found))

    def _ask(
        self,
        function: str,
        pieces: Mapping[str, Mapping[str, Any]],
        note: str,
        left: int | None = None,
        best: float | None = None,
    ) -> Rounds[list[Answer]]:
        """Let chunks answer for arrays by the name of a chunk; return the answers in order."""
        chunks = [Chunk(name, bytes_of(**arrays)) for name, arrays in pieces.items()]
        answers = yield Round(f"calibration:{function}", chunks, note, left, best)
        return [answers[name] for name in pieces]

    def _evaluate(self, study: Study[T], stage: str, *, searches: bool = False) -> Rounds[T]:
        """Answer a study in rounds of chunks; those of a search count, and show its best."""
        try:
            ask = next(study)
            while True:
                pieces = {
                    f"{stage}/{k}": {
                        "which": ask.which[at : at + ROLLOUTS_A_CHUNK],
                        "points": ask.points[at : at + ROLLOUTS_A_CHUNK],
                    }
                    for k, at in enumerate(range(0, len(ask.which), ROLLOUTS_A_CHUNK))
                }
                best = self.shown if searches else None
                answers = yield from self._ask("evaluate", pieces, stage, best=best)
                parts = [
                    _evaluated(data, len(own["which"]))
                    for data, own in zip(answers, pieces.values(), strict=True)
                ]
                errors = np.concatenate([part.error for part in parts])
                if searches:
                    self.add(answers)
                    n = len(self.members)
                    combined = self.objective.combined(errors.reshape(-1, n))
                    self.record(ask.points[::n], combined)
                reasons = [reason for part in parts for reason in part.reasons]
                ask = study.send(Evaluation(errors, reasons))
        except StopIteration as end:
            result: T = end.value
            return result

    def _alone(self) -> Rounds[list[ParameterSet]]:
        n = len(self.members)
        size = max(MEMBERS_A_CHUNK, min(MAX_MEMBERS_A_CHUNK, n // CHUNKS_FOR_WORKERS))
        pieces = {
            f"alone/{at}": {"members": np.arange(at, min(n, at + size))} for at in range(0, n, size)
        }
        left = 0 if self.request.mode == "each" else None
        answers = yield from self._ask("calibrate_alone", pieces, "each experiment", left)
        found: list[ParameterSet] = []
        for data, own in zip(answers, pieces.values(), strict=True):
            if not isinstance(data, Failure):
                found += found_of(arrays_of(data))
                continue
            found += [
                ParameterSet(
                    how=FitKind.ALONE,
                    members=(m,),
                    point=self.comparer.space.nominal,
                    errors=np.array([math.inf]),
                    note=data.reason,
                )
                for m in own["members"].tolist()
            ]
        return found

    def _campaign(self, alone: list[ParameterSet]) -> Rounds[list[ParameterSet]]:
        """After the single calibrations: neighbours' values, and one set for all in three ways."""
        request, comparer, members = self.request, self.comparer, self.members
        points = np.array([one.point for one in alone])
        errors = np.array([one.errors[0] for one in alone])
        groups = neighbours([target.conditions for target in comparer.targets])
        better, least = yield from self._evaluate(
            exchange_with_neighbours(points, errors, groups), "neighbours"
        )
        combine, free = self.objective.combined, comparer.space.free
        informed = np.array([[u.covers(t.conditions) for u in free] for t in comparer.targets])
        pooled = yield from self._evaluate(
            weighted(members, better, least, informed), "weighted mean"
        )
        subset = yield from self._evaluate(
            best_subset(members, better, least, combine, request.seed, informed=informed), "subsets"
        )
        direct = yield from self._direct(subset.point)
        return [
            *alone,
            *_improved(alone, better, least),
            _pooled(FitKind.WEIGHTED, members, pooled),
            _pooled(FitKind.SUBSET, members, subset),
            direct,
        ]

    def _direct(self, start: FloatArray) -> Rounds[ParameterSet]:
        request, comparer = self.request, self.comparer
        begun = time.perf_counter()
        trace, _ = yield from self._evaluate(
            calibrate_joint(
                self.members,
                box_of(comparer.space.started_at(start)),
                request.made_optimiser,
                self.objective.combined,
                request.seed,
                comparer.feasible,
                lambda: self.search_end,
                request.max_evaluations or math.inf,
            ),
            "all together",
            searches=True,
        )
        solutions = _distinct_solutions(comparer, trace)
        return (yield from self._searched(trace, begun, solutions=solutions))

    def _by_squares(self) -> Rounds[ParameterSet]:
        """Search one set for all by least squares, with tens of evaluations an unknown."""
        request, comparer, space = self.request, self.comparer, self.comparer.space
        options = request.least_squares
        assert options is not None
        begun = time.perf_counter()
        prior = NormalPrior.of(space)
        search = options.start(box_of(space), request.seed, comparer.feasible, prior)
        ended, searches = "", []
        while not search.done:
            wanted = search.ask()
            most = request.max_evaluations and request.max_evaluations - self.evaluations
            points = wanted[:most]
            table = yield from self._rows(
                "residuals", "squares", points, note="least squares", best=self.shown
            )
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
        return (yield from self._searched(trace, begun))

    def _searched(self, trace: Trace, begun: float, **more: Any) -> Rounds[ParameterSet]:
        """Return the best point of a search, with its error for each experiment."""
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
            **more,
        )

    def _rows(
        self,
        function: str,
        stage: str,
        points: FloatArray,
        *,
        note: str,
        left: int | None = None,
        best: float | None = None,
        **arrays: Any,
    ) -> Rounds[FloatArray]:
        """Let chunks answer for points (k, n_free) of all members: one row for each point.

        The answer of the function has the rows as `table`. `stage` is the beginning of the chunks'
        names, and `left` an estimate of the number of points after these.
        """
        size = max(1, ROLLOUTS_A_CHUNK // len(self.members))
        pieces = {
            f"{stage}/{k}": {**arrays, "points": points[at : at + size]}
            for k, at in enumerate(range(0, len(points), size))
        }
        rounds = None if left is None else math.ceil(left / size)
        answers = yield from self._ask(function, pieces, note, rounds, best)
        self.add(answers)
        tables: list[FloatArray] = []
        for name, data in zip(pieces, answers, strict=True):
            if isinstance(data, Failure):
                raise InvalidInput(name, found=f"none ({data.reason})", expected="runs")
            tables.append(arrays_of(data)["table"])
        return np.concatenate(tables)

    def _with_verdicts(self, one: ParameterSet) -> Rounds[ParameterSet]:
        """Add a verdict on every parameter; the journal has every simulation behind them."""
        if not np.isfinite(one.errors).all():
            return one
        running = _assessing(self.request, self.comparer, one)
        try:
            ask = next(running)
            while True:
                told = yield from self._rows(
                    "assess_points",
                    "verdicts",
                    ask.points,
                    note=ask.note,
                    left=ask.left,
                    kind=ask.kind,
                    members=np.array(one.members, np.int64),
                )
                if self.is_over:
                    more = "allow a larger budget, or calibrate a sample of the experiments"
                    return dataclasses.replace(one, note=f"no verdicts: {OUT_OF_BUDGET}; {more}")
                ask = running.send(told)
        except StopIteration as end:
            return with_assessment(self.comparer, one, end.value)
        except InvalidInput as problem:  # the values that were found stay worth having
            return dataclasses.replace(one, note=f"no verdicts: {problem}")

    def _with_check(self, one: ParameterSet) -> Rounds[ParameterSet]:
        """Compare recorded ends with those predicted from the other experiments."""
        if not one.estimates or len(one.members) < 2 or self.is_over:
            return one
        count = [0, 0]
        if len(one.members) >= LEAST:
            value, sd = quoted(one.estimates, self.comparer.space.labels, self.request.level)
            check = {"check": {"point": one.point, "value": value, "sd": sd}}
            (data,) = yield from self._ask("check_ends", check, "predictions", 0)
            if isinstance(data, Failure):
                return one
            count = arrays_of(data)["count"].tolist()
        return dataclasses.replace(one, prediction_check=(count[0], count[1]))


def _timed(begun: float, **arrays: Any) -> bytes:
    """Serialise an answer together with the time that it took to compute."""
    return bytes_of(**arrays, **{TIME: time.process_time() - begun})


def _evaluated(answer: bytes | Failure, n: int) -> Evaluation:
    """Errors out of a chunk's answer; a chunk without one is evaluations without one."""
    if isinstance(answer, Failure):
        return Evaluation(np.full(n, math.inf), [answer.reason] * n)
    arrays = arrays_of(answer)
    reasons = [""] * n
    for k, reason in json.loads(arrays["reasons"].tobytes()).items():
        reasons[int(k)] = reason
    return Evaluation(arrays["error"], reasons)


@_chunk
def evaluate(request: CalibrationRequest, comparer: Comparer, payload: bytes) -> bytes:
    """Chunk: errors of experiments under points."""
    begun, asked = time.process_time(), arrays_of(payload)
    answer = comparer.errors(asked["which"], asked["points"])
    failed = {str(k): reason for k, reason in enumerate(answer.reasons) if reason}
    said = np.frombuffer(json.dumps(failed).encode(), np.uint8)
    return _timed(begun, error=answer.error, reasons=said)


# --- every experiment by itself -----------------------------------------------------------------


@_chunk
def calibrate_alone(request: CalibrationRequest, comparer: Comparer, payload: bytes) -> bytes:
    """Chunk: the calibration of some experiments, each by itself; all advance together."""
    members = arrays_of(payload)["members"].tolist()
    begun = time.perf_counter()
    traces = run_study(
        calibrate_each(
            members,
            box_of(comparer.space),
            request.made_optimiser,
            request.seed,
            comparer.feasible,
            request.max_evaluations or math.inf,
        ),
        evaluate_here(comparer),
    )
    found = [
        ParameterSet(
            solutions=_distinct_solutions(comparer, trace),
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
    if request.verdicts:
        found = _with_estimates(request, comparer, found)
    seconds = (time.perf_counter() - begun) / len(members)
    return bytes_of(**found_arrays([dataclasses.replace(one, seconds=seconds) for one in found]))


# Errors up to so much larger than the least are nearly as good: noise in the measurements moves the
# error of the best by about as much.
NEARLY: Final = 0.02


def _distinct_solutions(comparer: Comparer, trace: Trace) -> FloatArray:
    """(k, n_free) points nearly as good as the best, one a cluster of those evaluated."""
    if not np.isfinite(trace.error):
        return np.zeros((0, len(trace.point)))
    box = box_of(comparer.space)
    threshold = NEARLY * trace.error
    clusters = find_solutions(trace.points, trace.errors, box.scale, threshold)
    return np.array([cluster.point for cluster in clusters])


# --- several experiments ------------------------------------------------------------------------


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


@_chunk
def residuals(request: CalibrationRequest, comparer: Comparer, payload: bytes) -> bytes:
    """Chunk: residuals of all experiments under points, whose squares add up to the summed error.

    A few frames stand for all of a long trajectory.
    """
    begun = time.process_time()
    members = np.arange(len(comparer.targets))
    scale = request.made_error.angle_scale
    noise = Noise(position_m=1e-3, angle_rad=1e-3 / scale, source="stated")
    frames = Frames(comparer, members)
    table = frames.residuals(noise)(arrays_of(payload)["points"])
    share = len(members) if request.combine == "mean" else 1
    return _timed(begun, table=table / np.sqrt(share * frames.weights))


# --- what the data determine --------------------------------------------------------------------


@_chunk
def assess_points(request: CalibrationRequest, comparer: Comparer, payload: bytes) -> bytes:
    """Chunk: answers to a question of `assessment_steps`."""
    begun = time.process_time()
    asked = arrays_of(payload)
    kind = str(asked["kind"])
    return _timed(begun, table=answer(comparer, asked["members"], kind, asked["points"]))


@_chunk
def check_ends(request: CalibrationRequest, comparer: Comparer, payload: bytes) -> bytes:
    """Chunk: how many recorded ends are in the regions predicted from the other experiments."""
    begun, asked = time.process_time(), arrays_of(payload)
    best, value, space, motion = asked["point"], asked["value"], comparer.space, request.made_motion
    near = linear_fit(comparer, best)
    drawn = draw_joint(value, space.low, space.high, asked["sd"], near.correlation, DRAWS, 0)
    predictive = predictive_of(comparer.targets, space, motion, best, value, drawn)
    count = check_predictions(predictive, comparer.targets, motion, best, near.left_out())
    return _timed(begun, count=np.array(count))


def _assessing(
    request: CalibrationRequest, comparer: Comparer, one: ParameterSet
) -> AssessmentSteps[Assessment]:
    assert request.level is not None  # of a new calibration; `check` refuses it
    return assessment_steps(
        comparer,
        one.members,
        one.point,
        noise=request.noise,
        level=request.level,
        solutions=list(one.solutions[1:]),
    )


def _with_estimates(
    request: CalibrationRequest, comparer: Comparer, alone: Sequence[ParameterSet]
) -> list[ParameterSet]:
    """The same within one chunk, for experiments by themselves, side by side."""
    wanted = [one for one in alone if np.isfinite(one.errors).all()]
    running = [_assessing(request, comparer, one) for one in wanted]
    assessed = iter(run_assessments(comparer, [one.members for one in wanted], running))
    found = []
    for one in alone:
        own = next(assessed) if np.isfinite(one.errors).all() else None
        if isinstance(own, InvalidInput):
            one = dataclasses.replace(one, note=f"no verdicts: {own}")
        found.append(with_assessment(comparer, one, own) if isinstance(own, Assessment) else one)
    return found


def with_assessment(comparer: Comparer, one: ParameterSet, found: Assessment) -> ParameterSet:
    """Return a parameter set with its estimates, profiles and misfit."""
    best, estimates = comparer.space.values(one.point), (*found.quoted, *_frozen(comparer))
    return dataclasses.replace(
        one,
        estimates=tuple(dataclasses.replace(e, best_fit=best[e.label]) for e in estimates),
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


# --- shared -------------------------------------------------------------------------------------


def evaluate_here(comparer: Comparer) -> Callable[[RolloutRequest], Evaluation]:
    """Return a function that answers a study in this process."""
    return lambda ask: comparer.errors(ask.which, ask.points)


def comparer_of(
    request: CalibrationRequest, targets: Sequence[Target], n_threads: int | None
) -> Comparer:
    """Return the comparison of the experiments of a calibration with simulations."""
    space, error, motion = request.space, request.made_error, request.made_motion
    return Comparer(targets, space, error, motion, None, n_threads)


def _load_job(inputs: Path) -> tuple[CalibrationRequest, Comparer]:
    """Load request and experiments of a job; kept in memory from chunk to chunk."""
    return _read(inputs.resolve(), (inputs / REQUEST).stat().st_mtime_ns)


@functools.lru_cache(maxsize=2)
def _read(inputs: Path, _: int) -> tuple[CalibrationRequest, Comparer]:
    request = CalibrationRequest.model_validate_json((inputs / REQUEST).read_bytes())
    return request, comparer_of(request, read_targets(inputs), threads())
