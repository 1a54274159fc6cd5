"""Race between plans: all meet the same scenarios, and the worse half leaves after each round.

Source: successive halving, Jamieson & Talwalkar (2016), AISTATS; racing of motion plans under
uncertainty, Koval et al. (2015), IROS, and Laskey et al. (2015), ICRA. Common scenarios and paired
comparisons, as here, need fewer rollouts than independent ones, because scenarios that are hard
for one plan are often hard for the others.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betainc

from fixel.errors import InvalidInput
from fixel.model.fields import whole
from fixel.planning.success import WORST, finite_margins
from fixel.typing import BoolArray, FloatArray, IntArray

SIZES: Final = (8, 16, 32, 64, 128, 256, 512, 1024)  # scenarios of a plan up to each round's end
# Margin [tolerances] below which a success is counted as partial with 8 scenarios. It shrinks with
# their number, as the noise of a rate does.
SOFTNESS: Final = 0.3
MIN_RUNS: Final = 4  # runs of each parameter draw from which plans are ranked by their worst draws
# Share of the draws that count then. Their mean rate has less noise than a quantile of few runs,
# and plans chosen by it have the higher 5 % quantile.
WORST_DRAWS: Final = 0.1


class RaceRequest(NamedTuple):
    """Rollouts that a race needs next: every one of these plans in every one of these scenarios."""

    plans: IntArray
    scenarios: IntArray


class RaceRound(NamedTuple):
    """State of a race after one round."""

    n_scenarios: int  # number of scenarios that each remaining plan has met
    rollouts: int  # number of rollouts so far
    success: float  # share of scenarios in which the best plan so far succeeded


class RaceResult(NamedTuple):
    """Result of a race between plans."""

    plans: IntArray  # (m,) indices of the plans of the last round, the best first
    # (m,) Success rates by which they are ordered: of all scenarios, or of the worst tenth of the
    # parameter draws. They chose the plan, so they must not state its success probability: use
    # fresh scenarios.
    score: FloatArray
    success: FloatArray  # (n_plans,) success rate of every plan in the scenarios it met
    met: IntArray  # (n_plans,) number of scenarios that every plan met
    rounds: tuple[RaceRound, ...]


def race_rounds(
    n_plans: int,
    *,
    sizes: Sequence[int] = SIZES,
    worlds: ArrayLike | None = None,
    finalists: int = 8,
    confidence: float = 0.99,
    budget: int | None = None,
    report: Callable[[RaceRound], None] | None = None,
) -> Generator[RaceRequest, ArrayLike, RaceResult]:
    """Run a race as a generator that yields requests and receives margins (m, k).

    It depends on the margins alone. To resume a race, send it the stored margins again.

    Parameters
    ----------
    sizes : sequence of int
        Number of scenarios that a plan has met at the end of each round, increasing.
    worlds : (n,) int64, optional
        Parameter draw of each scenario. If given, plans are compared by their success in the worst
        tenth of the draws as soon as each draw has 4 scenarios. Scenario k should be of draw
        `k % n_worlds`.
    finalists : int
        Number of plans that the last round has at least.
    confidence : float
        Confidence of the paired comparisons by which plans leave early.
    budget : int, optional
        Number of rollouts that the race must not exceed. The first round is always done.
    report : callable, optional
        Function that is called with a `RaceRound` after every round.
    """
    _check(n_plans, sizes, finalists, confidence)
    draws = None if worlds is None else np.asarray(worlds, dtype=np.int64)
    if draws is not None and (draws.ndim != 1 or len(draws) < sizes[-1]):
        expected = f"the parameter draws of {sizes[-1]} scenarios"
        raise InvalidInput("worlds", found=f"shape {draws.shape}", expected=expected)
    plans = np.arange(n_plans, dtype=np.int64)
    margins = np.empty((n_plans, 0))
    success, met = np.zeros(n_plans), np.zeros(n_plans, dtype=np.int64)
    rounds: list[RaceRound] = []
    rollouts = 0
    for size in sizes:
        scenarios = np.arange(margins.shape[1], size, dtype=np.int64)
        cost = len(plans) * len(scenarios)
        if budget is not None and rounds and rollouts + cost > budget:
            break
        answer = finite_margins((yield RaceRequest(plans, scenarios)), 2)
        if answer.shape != (len(plans), len(scenarios)):
            expected = f"shape ({len(plans)}, {len(scenarios)})"
            raise InvalidInput("margins", found=f"shape {answer.shape}", expected=expected)
        margins = np.hstack([margins, answer])
        rollouts += cost
        success[plans], met[plans] = np.mean(margins >= 0.0, axis=1), size
        last = size == sizes[-1]
        standing = _standing(margins, None if draws is None else draws[:size], soft=not last)
        kept = _remaining(margins, standing, finalists, 1.0 - confidence)
        rounds.append(RaceRound(size, rollouts, float(success[plans[standing.order[0]]])))
        if report is not None:
            report(rounds[-1])
        if not last:
            plans, margins = plans[kept], margins[kept]
    size = rounds[-1].n_scenarios
    standing = _standing(margins, None if draws is None else draws[:size], soft=False)
    order = standing.order
    return RaceResult(plans[order], standing.score[order], success, met, tuple(rounds))


class _Standing(NamedTuple):
    """Scores of plans, their order, and how to compare them with the first one."""

    order: IntArray
    score: FloatArray
    counts: IntArray | None  # successes by plan and parameter draw, if these are compared
    n_runs: int

    def chance(self, margins: FloatArray) -> FloatArray:
        """Probability of a result at least as bad for each plan, were it as good as the first."""
        if self.counts is None:
            return _sign_test(margins >= 0.0, int(self.order[0]))
        return _jackknife_test(self.counts, self.n_runs, int(self.order[0]))


def _standing(margins: FloatArray, draws: IntArray | None, soft: bool) -> _Standing:
    counts, n_runs = (None, 0) if draws is None else _counts(margins >= 0.0, draws)
    mean = np.mean(margins >= 0.0, axis=1)
    score = mean if counts is None else _worst_rate(counts, n_runs)
    key = score
    if soft and counts is None:
        width = SOFTNESS * (8.0 / margins.shape[1]) ** 0.5
        key = np.mean(0.5 + 0.5 * margins / (np.abs(margins) + width), axis=1)
    worst = np.quantile(margins, WORST, axis=1, method="inverted_cdf")
    order = np.lexsort((np.arange(len(key)), -worst, -mean, -np.round(key, 12)))
    return _Standing(order, score, counts, n_runs)


def _counts(good: BoolArray, draws: IntArray) -> tuple[IntArray | None, int]:
    """Count successes (n_plans, n_worlds), with equally many runs of each draw; None if too few."""
    _, draw = np.unique(draws, return_inverse=True)
    number = np.bincount(draw)
    n_runs = int(number.min())
    if len(number) < 2 or n_runs < MIN_RUNS:
        return None, 0
    order = np.argsort(draw, kind="stable")
    first = np.concatenate([[0], np.cumsum(number)[:-1]])
    columns = order[(first[:, None] + np.arange(n_runs)).ravel()]
    return good[:, columns].reshape(len(good), len(number), n_runs).sum(axis=2), n_runs


def _worst_rate(counts: IntArray, n_runs: int) -> FloatArray:
    """Compute the mean success rate (...,) in the worst tenth of the parameter draws."""
    n = max(1, round(WORST_DRAWS * counts.shape[-1]))
    return np.asarray(np.partition(counts, n - 1, axis=-1)[..., :n].mean(axis=-1) / n_runs)


def _sign_test(good: BoolArray, first: int) -> FloatArray:
    """Compute the chance (n_plans,) that as few of the differing scenarios favour each plan.

    Source: McNemar (1947), Psychometrika 12, 153-157, in its exact form.
    """
    better = np.sum(good[first] & ~good, axis=1)
    worse = np.sum(good & ~good[first], axis=1)
    chance = betainc(np.maximum(better, 1), worse + 1, 0.5)
    return np.where(better > 0, chance, 1.0)


def _jackknife_test(counts: IntArray, n_runs: int, first: int) -> FloatArray:
    """Compute the same for the worst parameter draws, by leaving out blocks of draws."""
    from scipy.special import ndtr

    n_blocks = min(16, counts.shape[1])
    block = np.arange(counts.shape[1]) % n_blocks
    own = np.stack([_worst_rate(counts[:, block != k], n_runs) for k in range(n_blocks)])
    lead = own[:, first, None] - own
    spread = np.sqrt((n_blocks - 1) / n_blocks * np.sum((lead - lead.mean(axis=0)) ** 2, axis=0))
    whole = _worst_rate(counts, n_runs)
    return np.asarray(
        ndtr((whole - whole[first]) / np.maximum(spread, 1.0 / (n_runs * counts.shape[1])))
    )


def _remaining(margins: FloatArray, standing: _Standing, finalists: int, chance: float) -> IntArray:
    """Return the rows of the plans that remain."""
    n = len(margins)
    quota = max(finalists, -(-n // 2))
    rank = np.empty(n, dtype=np.int64)
    rank[standing.order] = np.arange(n)
    rejected = (standing.chance(margins) <= chance) & (rank >= finalists)
    return np.flatnonzero((rank < quota) & ~rejected)


def _check(n_plans: int, sizes: Sequence[int], finalists: int, confidence: float) -> None:
    whole(n_plans, "n_plans")
    steps: Any = np.diff([0, *sizes])
    if not len(sizes) or np.any(steps <= 0):
        raise InvalidInput("sizes", found=tuple(sizes), expected="increasing positive numbers")
    whole(finalists, "finalists")
    if not 0.5 <= confidence < 1.0:
        raise InvalidInput("confidence", found=confidence, expected="at least 0.5 and below 1")
