"""Studies: calibrations as generators that request simulations.

A study is a generator that requests rollouts, receives their errors, and returns its result. The
errors come from `run_study`, a cluster, or a journal of an interrupted job; a study itself does not
simulate. For the same errors it requests the same rollouts, bit for bit.

Source: RPI thesis, sections 5.1.1, 5.2.1 and 5.2.2; mechanics of Dakota's search in
`fixel.calibration.direct_search`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np

from fixel.calibration.objective import Evaluation
from fixel.calibration.optimiser import AbstractOptimiser, Best, Feasible, Search, SearchBox
from fixel.errors import InvalidInput
from fixel.model.space import ParameterSpace
from fixel.typing import BoolArray, FloatArray, IntArray

T = TypeVar("T")
Ask = TypeVar("Ask")
Answer = TypeVar("Answer")


class RolloutRequest(NamedTuple):
    """Rollouts that a study requests."""

    which: IntArray  # (n,) index of the target of each
    points: FloatArray  # (n, n_free)


Study = Generator[RolloutRequest, Evaluation, T]

# Number of requests of a search whose points are not simulated again; most returns are to the last
# two.
RECENT: Final = 4

OUT_OF_BUDGET: Final = "the budget is used up"
MADE: Final = "evaluations were made"


def made(evaluations: int) -> str:
    """Return the reason of a search that ended after its maximum number of evaluations."""
    return f"{evaluations} {MADE}"


class Trace(NamedTuple):
    """All evaluations of one search, in order."""

    point: FloatArray  # (n_free,) best point
    error: float  # inf if nothing could be evaluated
    points: FloatArray  # (n, n_free)
    errors: FloatArray  # (n,)
    reasons: list[str]  # why an evaluation failed; empty if it did not
    ended: str  # why the search ended
    iterations: IntArray = np.zeros(0, np.int64)  # (n,) of each evaluation; empty if unknown
    starts: IntArray = np.zeros(0, np.int64)  # (n,) search of each; empty if there was only one

    @property
    def begins(self) -> IntArray:
        """First evaluation (n_iteration,) of each iteration; empty if unknown."""
        return np.flatnonzero(np.diff(self.iterations, prepend=-1))

    def ends(self) -> list[Best]:
        """Return the best point of each of several searches; none if there was only one."""
        found = []
        for k in range(int(self.starts.max(initial=-1)) + 1):
            own = np.flatnonzero(self.starts == k)
            best = own[np.argmin(self.errors[own])]
            found.append(Best(self.points[best], float(self.errors[best])))
        return found


def box_of(space: ParameterSpace) -> SearchBox:
    """Return the search box of a parameter space."""
    return SearchBox(space.low, space.high, space.nominal, space.scale)


def run_study(study: Generator[Ask, Answer, T], evaluate: Callable[[Ask], Answer]) -> T:
    """Run a study to its end, or another generator that requests answers; return its result."""
    try:
        ask = next(study)
        while True:
            ask = study.send(evaluate(ask))
    except StopIteration as end:
        result: T = end.value
        return result


def relayed(
    study: Generator[Ask, Answer, T], ask: Callable[[Ask], Generator[Any, Any, Answer]]
) -> Generator[Any, Any, T]:
    """Run a study whose requests are answered by steps of another generator."""
    try:
        wanted = next(study)
        while True:
            wanted = study.send((yield from ask(wanted)))
    except StopIteration as end:
        result: T = end.value
        return result


# --- searches -----------------------------------------------------------------------------------


def calibrate_each(
    members: Sequence[int],
    box: SearchBox,
    optimiser: AbstractOptimiser,
    seed: int = 0,
    feasible: Feasible | None = None,
    max_evaluations: float = math.inf,
) -> Study[list[Trace]]:
    """Calibrate every member alone; all searches advance together, so that batches are large.

    The result of a member does not depend on the others. A search ends after `max_evaluations`.
    Pattern searches return to points of their last polls: such points count as evaluations, but
    are not simulated again.
    """
    logs = [_Log(optimiser.start(box, seed, feasible), max_evaluations) for _ in members]
    while True:
        running = [(m, log) for m, log in zip(members, logs, strict=True) if not log.done]
        if not running:
            return [log.trace() for log in logs]
        new = [log.ask_new() for _, log in running]
        which = np.repeat([m for m, _ in running], [len(points) for points in new])
        answer = Evaluation(np.zeros(0), [])
        if len(which):
            answer = yield RolloutRequest(which, np.concatenate(new))
        at = 0
        for (_, log), points in zip(running, new, strict=True):
            end = at + len(points)
            log.tell_new(answer.error[at:end], answer.reasons[at:end])
            at = end


def calibrate_joint(
    members: Sequence[int],
    box: SearchBox,
    optimiser: AbstractOptimiser,
    combine: Callable[[FloatArray], FloatArray],
    seed: int = 0,
    feasible: Feasible | None = None,
    stop: Callable[[], str] = str,
    max_evaluations: float = math.inf,
) -> Study[tuple[Trace, Search]]:
    """Calibrate one parameter set for all members, by minimisation of their combined error.

    Errors (k, n_member) are combined to (k,). `stop` is called after every batch and returns the
    reason to end the search early, empty to continue.
    """
    log = _Log(optimiser.start(box, seed, feasible), max_evaluations)
    while not log.done:
        points = log.ask()
        errors, reasons = yield from at_points(members, points)
        log.tell(points, combine(errors), reasons)
        if reason := stop():
            return log.trace(reason), log.search
    return log.trace(), log.search


def at_points(members: Sequence[int], points: FloatArray) -> Study[tuple[FloatArray, list[str]]]:
    """Evaluate all members at points (k, n_free): errors (k, n_member) and reasons of failures."""
    k, n = len(points), len(members)
    answer = yield RolloutRequest(
        np.tile(np.asarray(members, np.int64), k), np.repeat(points, n, axis=0)
    )
    reasons = []
    for row in range(k):
        own = answer.reasons[row * n : (row + 1) * n]
        reasons.append(next((reason for reason in own if reason), ""))
    return answer.error.reshape(k, n), reasons


class _Log:
    """Search with all its evaluations, at most a given number."""

    def __init__(self, search: Search, max_evaluations: float) -> None:
        self.search = search
        self._left = max_evaluations
        self._points: list[FloatArray] = []
        self._errors: list[FloatArray] = []
        self._reasons: list[str] = []
        self._owners: list[IntArray] = []
        # Errors of the points of the last requests, without those that failed.
        self._recent: deque[dict[bytes, float]] = deque(maxlen=RECENT)
        self._known: list[float | None] = []  # of each point of the present request

    @property
    def done(self) -> bool:
        """Whether the search has ended, or has no evaluations left."""
        return self.search.done or self._left <= 0

    def ask(self) -> FloatArray:
        """Return the requested points, or the first of them if too few evaluations are left."""
        points = self.search.ask()
        return points if len(points) <= self._left else points[: int(self._left)]

    def ask_new(self) -> FloatArray:
        """Return the requested points that were not in recent requests."""
        points = self.ask()
        keys = map(bytes, points)
        self._known = [next((r[key] for r in self._recent if key in r), None) for key in keys]
        return points[[error is None for error in self._known]]

    def tell_new(self, errors: FloatArray, reasons: list[str]) -> None:
        """Take the errors and reasons of the points of `ask_new`."""
        points, new = self.ask(), zip(errors.tolist(), reasons, strict=True)
        every = [next(new) if error is None else (error, "") for error in self._known]
        pairs = zip(map(bytes, points), every, strict=True)
        self._recent.append({key: error for key, (error, why) in pairs if not why})
        self.tell(points, np.array([error for error, _ in every]), [why for _, why in every])

    def tell(self, points: FloatArray, errors: FloatArray, reasons: list[str]) -> None:
        if self.search.has_iterations:
            self._owners.append(self.search.owners()[: len(points)])
        if len(points) == len(self.search.ask()):
            self.search.tell(errors)
        self._left -= len(points)
        self._points.append(points)
        self._errors.append(errors)
        self._reasons += reasons

    def trace(self, ended: str = "") -> Trace:
        n = self.search.box.n
        best = better_of(self.search.best, self._points, self._errors)
        if self._left <= 0:
            ended = made(sum(map(len, self._errors)))
        sizes = [len(own) for own in self._owners]
        owners = np.concatenate([np.zeros(0, np.int64), *self._owners])
        return Trace(
            best.point,
            best.error,
            np.concatenate([np.zeros((0, n)), *self._points]),
            np.concatenate([np.zeros(0), *self._errors]),
            self._reasons,
            self.search.reason or ended,
            np.repeat(np.arange(len(sizes)), sizes),
            owners if owners.any() else owners[:0],
        )


def better_of(best: Best, points: Sequence[FloatArray], errors: Sequence[FloatArray]) -> Best:
    """Return the best of a search, or a better point of a last batch that it did not receive."""
    if not errors:
        return best
    k = int(np.argmin(errors[-1]))
    last = Best(points[-1][k], float(errors[-1][k]))
    return last if last.error < best.error else best


# --- several experiments ------------------------------------------------------------------------


def exchange_with_neighbours(
    points: FloatArray, errors: FloatArray, groups: Sequence[Sequence[int]]
) -> Study[tuple[FloatArray, FloatArray]]:
    """Replace parameters of each member by the best ones of its neighbours, if these are better.

    From points (n_member, n_free) and errors (n_member,) of the single calibrations it returns the
    same or better ones. Neighbours are members that differ in x, in y or in theta only.

    Source: RPI thesis, section 5.2.1.
    """
    pairs = sorted({(a, b) for group in groups for a in group for b in group if a != b})
    if not pairs:
        return points, errors
    own, other = np.array(pairs).T
    answer = yield RolloutRequest(own, points[other])
    best, least = points.copy(), errors.copy()
    for k, (a, b) in enumerate(pairs):
        if answer.error[k] < least[a]:
            best[a], least[a] = points[b], answer.error[k]
    return best, least


NOMINAL: Final = "nominal"  # axis of the experiment without an offset

# Smallest error in weights; otherwise one perfect fit would decide alone [mm^2 or mm].
MIN_ERROR: Final = 1e-6
CANDIDATES: Final = 24  # subsets of each kind in one round...
ROUNDS: Final = 20  # ... and the maximum number of rounds


def weighted_mean(
    points: FloatArray, errors: FloatArray, informed: BoolArray | None = None
) -> FloatArray:
    """Return the mean (n_free,) of points (n, n_free), weighted with inverse errors (n,).

    Members that are not informed (n, n_free) about an unknown have its start value, which does not
    count.

    Source: RPI thesis, section 5.2.2.
    """
    found = np.isfinite(errors)
    if not found.any():
        raise InvalidInput(
            "weighted mean",
            found="no calibrated member",
            expected="at least one member with a finite error",
        )
    weight = 1.0 / np.maximum(errors[found], MIN_ERROR)
    mean = np.asarray(weight @ points[found] / weight.sum())
    if informed is not None:
        some = informed[found]
        for k in np.flatnonzero(some.any(axis=0) & ~some.all(axis=0)).tolist():
            own = weight * some[:, k]
            mean[k] = own @ points[found][:, k] / own.sum()
    return mean


class CombinedFit(NamedTuple):
    """Parameter set computed from those of single calibrations."""

    point: FloatArray  # (n_free,)
    members: FloatArray  # (n_member,) errors of all members
    used: tuple[int, ...]  # indices of the members whose parameters were used


def weighted(
    members: Sequence[int],
    points: FloatArray,
    errors: FloatArray,
    informed: BoolArray | None = None,
) -> Study[CombinedFit]:
    """Evaluate all members at the weighted mean of all single calibrations."""
    mean = weighted_mean(points, errors, informed)
    found, _ = yield from at_points(members, mean[None])
    return CombinedFit(mean, found[0], tuple(np.flatnonzero(np.isfinite(errors)).tolist()))


def best_subset(
    members: Sequence[int],
    points: FloatArray,
    errors: FloatArray,
    combine: Callable[[FloatArray], FloatArray],
    seed: int = 0,
    informed: BoolArray | None = None,
) -> Study[CombinedFit]:
    """Find the subset of single calibrations whose weighted mean is best for all members.

    It begins with all members. Each round tries subsets without one member and random halves, and
    continues with the best subset, until there is no improvement.

    Source: RPI thesis, section 5.2.2, "iteratively with many different combinations of the sample
    set"; the combinations are not specified there.
    """
    draw = np.random.default_rng(seed)
    said = np.ones(points.shape, bool) if informed is None else informed
    best = yield from weighted(members, points, errors, said)
    value = float(combine(best.members[None])[0])
    for _ in range(ROUNDS):
        subsets = _smaller(best.used, draw)
        if not subsets:
            break
        means = np.array([weighted_mean(points[s], errors[s], said[s]) for s in map(list, subsets)])
        found, _ = yield from at_points(members, means)
        values = combine(found)
        k = int(np.argmin(values))
        if not values[k] < value:
            break
        best, value = CombinedFit(means[k], found[k], subsets[k]), float(values[k])
    return best


def _smaller(used: tuple[int, ...], draw: np.random.Generator) -> list[tuple[int, ...]]:
    """Return subsets: without one member, and random halves, at most `CANDIDATES` of each kind."""
    n = len(used)
    if n < 2:
        return []
    left_out = draw.permutation(n)[:CANDIDATES].tolist()
    singles = [tuple(m for k, m in enumerate(used) if k != out) for out in left_out]
    halves = [
        tuple(used[k] for k in sorted(draw.permutation(n)[: (n + 1) // 2].tolist()))
        for _ in range(CANDIDATES if n > 3 else 0)
    ]
    return list(dict.fromkeys(singles + halves))


def minimax_of_stored(members: Sequence[int], points: FloatArray) -> Study[CombinedFit]:
    """Find the point among (k, n_free) whose largest error over the members is smallest."""
    found, _ = yield from at_points(members, points)
    k = int(np.argmin(found.max(axis=1)))
    return CombinedFit(points[k], found[k], (k,))


def neighbours(conditions: Sequence[Mapping[str, str | float]]) -> list[list[int]]:
    """Return groups of experiments of one shape and layout that differ along one axis only.

    Conditions are those of a sampling plan: `shape`, `layout` and `axis`, which is `"nominal"` for
    the one that belongs to every group. Experiments without an axis are ignored.
    """
    groups: dict[tuple[str, str, str], list[int]] = {}
    for k, own in enumerate(conditions):
        if "axis" in own:
            key = (str(own.get("shape", "")), str(own.get("layout", "")), str(own["axis"]))
            groups.setdefault(key, []).append(k)
    nominal = {key[:2]: group for key, group in groups.items() if key[2] == NOMINAL}
    return [
        sorted({*group, *nominal.get(key[:2], [])})
        for key, group in groups.items()
        if key[2] != NOMINAL
    ]
