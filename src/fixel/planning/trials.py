"""Executed trials of a plan: what they make of its stated success probability."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from scipy.special import betainc, betaincinv, betaln

from fixel.errors import InvalidInput, counted
from fixel.model.bodies import POSE
from fixel.model.fields import fraction, name_of, settle, vector
from fixel.model.probability import Probability
from fixel.planning.success import WORST, probability_text
from fixel.results import Result, Summary
from fixel.table import Column, Table
from fixel.typing import FloatArray

ALPHA: Final = 0.05  # largest probability of refuting a stated probability that is right
HORIZONS: Final = (30, 40)  # numbers of trials within which the test has the most power
DROP: Final = 0.15  # difference from the stated rate at which it has the most power
RESERVE: Final = 0.03  # least share of the test that regards trials after the horizon, too
MIXTURE: Final = (1.0, 1.0)  # density of the true rate below the stated one: any is as likely
NORMAL_QUANTILE: Final = 1.645  # standard deviations from the mean to the 5 % quantile
MIN_PRIOR_TRIALS: Final = 2.0
MAX_PRIOR_TRIALS: Final = 20.0  # number of trials that a stated probability counts as, at most
MET: Final = "met"

PoseTuple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class PlanTrial:
    """One execution of a plan.

    Parameters
    ----------
    time : str
        Time of its end, as ISO 8601 with a time zone: `"2026-11-22T21:00:00+00:00"`.
    met : bool
        Whether the goal was met.
    failure : str
        Kind of failure, such as `"slid off"`; empty for a success.
    start, end : (3,) tuple of float, optional
        Poses that were seen before and after the trial [m, m, rad].
    by : str
        Person or program that executed the trial.

    Raises
    ------
    InvalidInput
        A value is invalid, or a success has a kind of failure.
    """

    time: str
    met: bool
    failure: str = ""
    start: PoseTuple | None = None
    end: PoseTuple | None = None
    by: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.met, bool):
            raise InvalidInput("met", found=self.met, expected="True or False")
        _check_time(self.time)
        for where in ("failure", "by"):
            text = getattr(self, where)
            if text:
                name_of(text, where)
        if self.met and self.failure:
            raise InvalidInput("failure", found=self.failure, expected="none for a success")
        for where in ("start", "end"):
            pose = getattr(self, where)
            if pose is not None:
                settle(self, **{where: tuple(vector(pose, where, POSE).tolist())})


@dataclass(frozen=True, slots=True, kw_only=True, repr=False, eq=False)
class Trials(Result):
    """Executed trials of one plan, and the success probability stated before them.

    The stated mean is one over all that is unknown; a laboratory has one success rate, which may be
    lower. So the trials test the lower end of the stated range.

    Parameters
    ----------
    plan : str
        Id of the plan.
    stated : float
        Least success rate that was stated, at least 0 and below 1: `SuccessProbability.least`.
    mean : float
        Success probability that was stated, not below `stated`. The success rate is believed to be
        beta distributed with this mean, and to be below `stated` with about 5 % probability.
    trials : sequence of PlanTrial

    Raises
    ------
    InvalidInput
        A probability is not in its range, or the mean is below the least rate.

    Examples
    --------
    >>> trials = Trials(plan="a1", stated=0.95, mean=0.97)
    >>> for k, met in enumerate([True, False, True, False, False, True, False, False]):
    ...     trials = trials.added(PlanTrial(f"2026-11-22T21:0{k}:00+00:00", met))
    >>> trials
    8 trials: 3 met the goal; a success rate of at least 0.95 is refuted
      value     probability  meaning
      stated    0.970        before the trials
      at least  0.950        lower end of the stated range, tested by the trials
      observed  0.375        0.09 to 0.76 with 95 % confidence
      updated   0.400        0.17 to 0.66, with a prior of 2 trials
    """

    plan: str
    stated: float
    mean: float
    trials: tuple[PlanTrial, ...] = ()

    def __post_init__(self) -> None:
        name_of(self.plan, "plan")
        if not fraction(self.stated, "stated") < 1.0:
            raise InvalidInput("stated", found=self.stated, expected="at least 0 and below 1")
        if not self.stated <= fraction(self.mean, "mean"):
            raise InvalidInput("mean", found=self.mean, expected=f"from {self.stated} to 1")
        settle(self, mean=float(self.mean), stated=float(self.stated), trials=tuple(self.trials))

    def added(self, *trials: PlanTrial) -> Trials:
        """Return these trials with further ones."""
        return replace(self, trials=(*self.trials, *trials))

    @property
    def n(self) -> int:
        """Number of trials."""
        return len(self.trials)

    @property
    def successes(self) -> int:
        """Number of trials that met the goal."""
        return sum(trial.met for trial in self.trials)

    @property
    def failures(self) -> dict[str, int]:
        """Number of failures of each kind, the most frequent first."""
        kinds = [trial.failure or "unknown" for trial in self.trials if not trial.met]
        return dict(Counter(kinds).most_common())

    @property
    def evidence(self) -> FloatArray:
        """E-value (n,) against a success rate of at least `stated`, after each trial."""
        return evidence_against(self.stated, [trial.met for trial in self.trials])

    @property
    def refuted(self) -> bool:
        """Whether the e-value has ever reached 20, which happens to at most 5 % of right ones."""
        return bool(np.any(self.evidence >= 1.0 / ALPHA))

    @property
    def observed(self) -> Probability | None:
        """Success rate of the trials alone; None without trials."""
        return Probability.of(self.successes, self.n) if self.trials else None

    @property
    def updated(self) -> Probability:
        """Success rate after the trials: mean and 5 % to 95 % quantiles of its beta posterior.

        A statement that is refuted counts no more: the prior is then uniform.
        """
        a, b = self._prior
        a, b = a + self.successes, b + self.n - self.successes
        low, high = betaincinv(a, b, [WORST, 1.0 - WORST])
        return Probability(a / (a + b), float(low), float(high), self.n)

    @property
    def _prior(self) -> tuple[float, float]:
        return (1.0, 1.0) if self.refuted else prior_counts(self.mean, self.stated)

    def _summary(self) -> Summary:
        verdict = "is refuted" if self.refuted else "is not refuted"
        stated = f"a success rate of at least {probability_text(self.stated)}"
        rows: list[tuple[str, float | None, str]] = [
            ("stated", self.mean, "before the trials"),
            ("at least", self.stated, "lower end of the stated range, tested by the trials"),
        ]
        if (seen := self.observed) is not None:
            text = f"{seen.low:.2f} to {seen.high:.2f} with 95 % confidence"
            rows.append(("observed", seen.value, text))
        own = self.updated
        text = f"{own.low:.2f} to {own.high:.2f}, with a prior of {sum(self._prior):.0f} trials"
        rows.append(("updated", own.value, text))
        heading = f"{counted(self.n, 'trial')}: {self.successes} met the goal; {stated} {verdict}"
        kinds = [f"{kind}: {number}" for kind, number in self.failures.items() if kind != "unknown"]
        notes = [f"Failures: {', '.join(kinds)}."] if kinds else []
        table = Table(("value", Column("probability", "", ".3f"), "meaning"), rows, left=3)
        return Summary(heading, [table], notes)

    def _data(self) -> Table:
        columns = ("time", MET, "failure", "evidence", "by")
        rows = zip(self.trials, self.evidence, strict=True)
        return Table(columns, [(t.time, int(t.met), t.failure, e, t.by) for t, e in rows])


def prior_counts(mean: float, stated: float) -> tuple[float, float]:
    """Return the successes and failures that a belief about a success rate counts as.

    They are the parameters of the beta distribution with this mean. Its variance is that of a
    normal distribution whose 5 % quantile is the least rate. Their sum is at most 20,
    because the model may be wrong in a way that none of its parameters includes, and at least 2.

    Parameters
    ----------
    mean, stated : float
        Stated success probability, and the least success rate stated.

    Examples
    --------
    >>> [round(count, 1) for count in prior_counts(0.95, 0.8)]
    [4.5, 0.2]
    """
    mean, stated = fraction(mean, "mean"), fraction(stated, "stated")
    middle = min(max(mean, 1e-3), 1.0 - 1e-3)
    spread = max(mean - stated, 1e-6) / NORMAL_QUANTILE
    total = middle * (1.0 - middle) / spread**2 - 1.0
    total = min(max(total, MIN_PRIOR_TRIALS), MAX_PRIOR_TRIALS)
    return middle * total, (1.0 - middle) * total


# --- anytime-valid test -------------------------------------------------------------------------


def evidence_against(stated: float, met: Sequence[bool] | Iterable[bool]) -> FloatArray:
    """Compute e-values against a success rate of at least the stated one, after each trial.

    Parameters
    ----------
    stated : float
        Stated success probability, at least 0 and below 1.
    met : sequence of bool
        Outcomes of the trials in their order.

    Returns
    -------
    (n,) float64
        If the true success rate is at least the stated one, the probability that any of these ever
        reaches 20 is at most 5 %. So one may look after every trial, and stop at any time.

    Notes
    -----
    The e-value is a weighted mean of two nonnegative martingales with mean 1. The first one is the
    probability, given the trials so far, that the first h trials have the critical number of
    failures, divided by that probability before the trials. With its weight, the critical number
    alone reaches 20, so within 40 trials the test has nearly the power of the best test of 40
    trials: h is the number from 30 to 40 with the most power against a rate 0.15 lower. The second
    one is the likelihood of a beta mixture of lower rates, divided by that of the stated rate; it
    detects plans that never succeed earlier, and continues after h trials.

    Source
    ------
    Ville (1939); Robbins (1970), Ann. Math. Stat. 41, 1397-1409; Ramdas et al. (2023),
    Statistical Science 38, 576-601. The first martingale is the test of Neyman & Pearson (1933).

    Examples
    --------
    >>> bool(evidence_against(0.95, [False, False, False])[-1] > 20)
    True
    """
    outcomes = np.asarray(list(met), dtype=bool)
    if fraction(stated, "stated") == 0.0 or not outcomes.size:
        return np.ones(len(outcomes))
    fixed = _fixed_test(stated)
    n = np.arange(1, len(outcomes) + 1)
    failures = np.cumsum(~outcomes)
    early = failures[np.minimum(n, fixed.horizon) - 1]
    chance = _tail(fixed.critical - early, np.maximum(fixed.horizon - n, 0), 1.0 - stated)
    return fixed.weight / fixed.size * chance + (1.0 - fixed.weight) * _mixture(stated, n, failures)


class _FixedTest(NamedTuple):
    horizon: int
    critical: int  # number of failures in these first trials that refutes
    size: float  # probability of that many, at the stated rate
    weight: float


@cache
def _fixed_test(stated: float) -> _FixedTest:
    best, found = -1.0, (0, 0, 0.0)
    for horizon in range(HORIZONS[0], HORIZONS[1] + 1):
        failures = np.arange(horizon + 2)
        n = np.full(horizon + 2, horizon)
        sizes = _tail(failures, n, 1.0 - stated)
        critical = int(np.argmax(sizes <= (1.0 - RESERVE) * ALPHA))
        power = float(_tail(failures, n, 1.0 - max(0.0, stated - DROP))[critical])
        if power > best:
            best, found = power, (horizon, critical, float(sizes[critical]))
    horizon, critical, size = found
    # A hair more than size / ALPHA, so that rounding errors do not keep it below 20.
    return _FixedTest(horizon, critical, max(size, 1e-300), size / ALPHA * (1.0 + 1e-12))


def _tail(least: np.ndarray, n: np.ndarray, chance: float) -> FloatArray:
    """Compute the probability of at least this number of events among n independent ones."""
    needed = np.clip(least, 1, np.maximum(n, 1))
    tail = betainc(needed, np.maximum(n - needed + 1, 1), chance)
    return np.where(least <= 0, 1.0, np.where(least > n, 0.0, tail))


def _mixture(stated: float, n: np.ndarray, failures: np.ndarray) -> FloatArray:
    a, b = MIXTURE
    good = n - failures
    with np.errstate(divide="ignore"):  # the logarithm of a chance that is too small for a float
        below = np.log(betainc(a + good, b + failures, stated))
        norm = betaln(a, b) + math.log(betainc(a, b, stated))
    likelihood = betaln(a + good, b + failures) + below - norm
    nominal = good * math.log(stated) + failures * math.log1p(-stated)
    return np.asarray(np.exp(np.minimum(likelihood - nominal, 700.0)))


def _check_time(text: object) -> None:
    try:
        aware = datetime.fromisoformat(str(text)).tzinfo is not None
    except ValueError:
        aware = False
    if not aware:
        expected = "a time with its zone, such as 2026-11-22T21:00:00+00:00"
        raise InvalidInput("time", found=text, expected=expected)
