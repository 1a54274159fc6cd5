"""Success probability of a plan, from margins of fresh scenarios that no search has seen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betaincinv, chdtrc, stdtrit

from fixel.errors import InvalidInput
from fixel.model.fields import floats, inner_share, numbers, positive, settle, whole
from fixel.results import Result, Summary
from fixel.table import Column, Table
from fixel.typing import FloatArray

WORST: Final = 0.05  # share of parameter draws, and of runs, that count as the worst ones
# Difference of mean and worst draws above which a calibration helps more than a longer search.
MAX_SPREAD: Final = 0.05
CERTAIN: Final = 0.01  # chance of a spread of equal draws below which they count as different


def finite_margins(margins: ArrayLike, *n_dims: int, where: str = "margins") -> FloatArray:
    """Return margins as an array with one of `n_dims` dimensions; reject empty ones and NaN."""
    found = floats(margins, where, "numbers")
    if found.ndim not in n_dims or not found.size:
        expected = f"numbers in {' or '.join(map(str, n_dims))} dimensions"
        raise InvalidInput(where, found=f"shape {found.shape}", expected=expected)
    if not np.isfinite(found).all():
        hint = "count a simulation that failed as a failure of the plan, with a negative margin"
        raise InvalidInput(where, found="NaN or infinity", expected="finite numbers", hint=hint)
    return found


def lower_bound(successes: float, n: float, confidence: float = 0.95) -> float:
    """Compute the one-sided lower confidence bound of a success probability.

    Fractions of successes and of runs are effective numbers.

    Source
    ------
    Clopper & Pearson (1934), Biometrika 26, 404-413.

    Examples
    --------
    >>> round(lower_bound(299, 299), 3)
    0.99
    """
    if not 0.0 <= successes <= positive(n, "n"):
        raise InvalidInput("successes", found=successes, expected=f"a number from 0 to {n}")
    if successes == 0.0:
        return 0.0
    return float(betaincinv(successes, n - successes + 1.0, 1.0 - confidence))


def interval(share: float, n: float, confidence: float = 0.95) -> tuple[float, float]:
    """Compute the two-sided confidence interval of an observed share of n runs."""
    one_sided = 0.5 * (1.0 + confidence)
    low = lower_bound(share * n, n, one_sided)
    return low, 1.0 - lower_bound((1.0 - share) * n, n, one_sided)


def rate_quantile(
    successes: ArrayLike, n_runs: int, share: ArrayLike = WORST, centre: float | None = None
) -> FloatArray:
    """Estimate a quantile (...,) of the success rate over parameter draws.

    Of each draw there are `n_runs` runs, at least 2; `successes` (..., n_worlds) were successful.
    The observed rates scatter by the differences of the draws and by the chance of few runs. They
    are moved towards `centre`, by default their mean, so that their variance becomes the estimated
    variance of the true rates: observed variance less the mean binomial variance. The quantile is
    their order statistic `share * (n_worlds + 1)`. On average, this share of further draws has a
    lower rate, whatever the distribution of the rates is.

    Source
    ------
    Louis (1984), J. Am. Stat. Assoc. 79, 393-398: estimates whose spread is the true one.

    Examples
    --------
    >>> successes = [64] * 60 + [16] * 4
    >>> round(float(rate_quantile(successes, 64)), 2)
    0.25
    """
    rates = numbers(successes, "successes") / whole(n_runs, "n_runs", 2)
    mean = rates.mean(axis=-1, keepdims=True)
    n_worlds = rates.shape[-1]
    spread = np.sum((rates - mean) ** 2, axis=-1, keepdims=True) / max(1, n_worlds - 1)
    noise = np.mean(rates * (1.0 - rates), axis=-1, keepdims=True) / (n_runs - 1)
    scale = np.sqrt(np.maximum(0.0, spread - noise) / np.where(spread > 0.0, spread, 1.0))
    middle = mean if centre is None else centre
    moved, at = middle + scale * (rates - middle), numbers(share, "share")
    return np.asarray(np.quantile(moved, at, axis=-1, method="weibull"))


@dataclass(frozen=True, slots=True, kw_only=True, repr=False, eq=False)
class SuccessProbability(Result):
    """Success probability of one plan, from scenarios that were not used to find it.

    Examples
    --------
    >>> import numpy as np
    >>> margins = np.ones((64, 64))
    >>> margins[:8, :32] = -0.2  # 8 of 64 parameter draws succeed in half of their runs
    >>> found = SuccessProbability.of(margins)
    >>> print(found.sentence)
    success probability 0.94 (0.88 to 0.97); in 90 % of the possible worlds it is 0.50 to 0.9994
    """

    mean: float  # share of successful scenarios: the probability that the next trial succeeds
    # Two-sided confidence interval of `mean`.
    low: float
    high: float
    rates: FloatArray  # (n_worlds,) success rate of each parameter draw, as observed
    n_runs: int  # number of scenarios of each parameter draw
    # Success rates that 95 % and 5 % of the parameter draws exceed, without the chance of few runs.
    # None for one run of each draw, which separates nothing, and for one draw.
    worst: float | None
    best: float | None
    margin: float  # margin that 95 % of the scenarios exceed, in units of the goal's tolerance
    n: int  # number of scenarios from which `mean` and its interval are computed
    confidence: float = 0.95  # confidence level of `low` and `high`

    def __post_init__(self) -> None:
        settle(self, rates=np.asarray(self.rates, dtype=np.float64))

    @classmethod
    def of(
        cls, margins: ArrayLike, confidence: float = 0.95, *, independent: ArrayLike | None = None
    ) -> SuccessProbability:
        """Estimate the success probability of one plan.

        Parameters
        ----------
        margins : (n_worlds, n_runs) or (n,) float64
            Margins of the goal in fresh scenarios, in units of its tolerance; at least 0 for a
            success, and negative for a simulation that failed. A row has the runs of one draw of
            the parameters. Of (n,) margins, each has its own draw.
        independent : (n,) float64, optional
            Margins in further scenarios, each with its own draw of the parameters. The mean, its
            interval and the margin are then computed from these alone.

        Returns
        -------
        SuccessProbability

        Raises
        ------
        InvalidInput
            There are no margins, or some are NaN.

        Notes
        -----
        The interval of Clopper and Pearson is for an effective number of scenarios: runs of one
        draw resemble each other, so 64 draws with 64 runs each prove less than 4096 draws. The
        interval is exact for scenarios with a draw each. For runs of few draws it relies on the
        observed spread of their rates: 64 draws without a failure do not show that fewer than 4 %
        of all draws fail.

        Source
        ------
        Clopper & Pearson (1934); Korn & Graubard (1998), Survey Methodology 24, 193-201.
        """
        inner_share(confidence, "confidence")
        own = finite_margins(margins, 1, 2)
        own = own.reshape(len(own), -1)
        n_runs = own.shape[1]
        rows, successes = own, np.sum(own >= 0.0, axis=1)
        if independent is not None:
            rows = finite_margins(independent, 1, where="independent")[:, None]
        met = np.sum(rows >= 0.0, axis=1)
        share = float(met.sum()) / rows.size
        n = effective_number(met, np.full(len(rows), rows.shape[1]), confidence)
        low, high = interval(share, n, confidence)
        # Draws that differ by chance alone have the stated probability itself as their rate.
        centre = None if independent is None else share
        worst, best = (
            float(rate_quantile(successes, n_runs, at, centre)) if min(own.shape) > 1 else None
            for at in (WORST, 1.0 - WORST)
        )
        return cls(
            mean=share, low=low, high=high, worst=worst, best=best, confidence=confidence,
            rates=successes / n_runs, n_runs=n_runs, n=rows.size,
            margin=float(np.quantile(rows, WORST, method="inverted_cdf")),
        )  # fmt: skip

    @property
    def stated(self) -> float:
        """Stated success probability, that of the next trial: `mean`."""
        return self.mean

    @property
    def least(self) -> float:
        """Least success rate to expect of one laboratory: `worst`, or `low` if that is lower."""
        return self.low if self.worst is None else min(self.worst, self.low)

    @property
    def calibrate_first(self) -> bool:
        """Whether a calibration is the first advice.

        It is if `mean` and `worst` differ by more than 0.05, and the draws by more than chance.
        """
        if self.worst is None or self.mean - self.worst <= MAX_SPREAD:
            return False
        mean = float(np.mean(self.rates))
        variance = max(mean * (1.0 - mean), 1e-12) / self.n_runs
        excess = float(np.sum((self.rates - mean) ** 2)) / variance
        return bool(chdtrc(len(self.rates) - 1, excess) < CERTAIN)

    def spare(self, wanted: float) -> float:
        """Return the share of probability that may be wrong before a wanted success is missed.

        The scenarios are drawn from a belief about the parameters, start and errors. As long as
        that belief misplaces less than this share of its probability, the plan still succeeds
        with the wanted probability. It is negative where the plan misses it already.

        Parameters
        ----------
        wanted : float
            Wanted success probability.
        """
        return self.stated - wanted

    @property
    def sentence(self) -> str:
        """One line: the probability with its interval, and its range over the parameters."""
        places = len(probability_text(self.mean)) - 2
        mean, low, high = (f"{x:.{places}f}" for x in (self.mean, self.low, self.high))
        text = f"success probability {mean} ({low} to {high})"
        if self.worst is None or self.best is None:
            return text
        ends = dict.fromkeys(map(probability_text, (self.worst, self.best)))
        return f"{text}; in 90 % of the possible worlds it is {' to '.join(ends)}"

    def _notes(self) -> list[str]:
        advice = "Calibrate first: success differs much between possible worlds."
        notes = [advice] if self.calibrate_first else []
        if self.worst is not None and len(self.rates) < 59:
            few = f"{len(self.rates)} parameter draws determine the range only roughly"
            notes.append(f"{few}; use 59 or more.")
        return notes

    def _summary(self) -> Summary:
        level, draws = f"{100.0 * self.confidence:g} % confidence", len(self.rates)
        rows = [
            ("stated", self.mean, f"mean of {self.n} fresh scenarios"),
            ("low", self.low, f"lower end of the mean with {level}"),
            ("high", self.high, f"upper end of the mean with {level}"),
            ("worst draws", self.worst, f"rate that 95 % of {draws} parameter draws exceed"),
            ("best draws", self.best, f"rate that 5 % of {draws} parameter draws exceed"),
        ]
        rows = [row for row in rows if row[1] is not None]
        table = Table(("value", Column("probability", "", ".4f"), "meaning"), rows, left=3)
        margin = f"In 95 % of the scenarios the margin exceeds {self.margin:.2f} tolerances."
        return Summary(self.sentence.capitalize(), [table], [*self._notes(), margin])

    def _data(self) -> Table:
        return Table.from_columns({"draw": range(len(self.rates)), "rate": self.rates.tolist()})


def effective_number(successes: ArrayLike, numbers: ArrayLike, confidence: float) -> float:
    """Compute the number of independent runs that determine a mean equally well as groups of runs.

    Groups (n_groups,) have numbers of successes and of runs, which resemble each other. The result
    is for an interval of the given confidence: at most the number of runs, and equal to it for
    groups of one run, or without any success or failure.

    Source
    ------
    Korn & Graubard (1998), Survey Methodology 24, 193-201.
    """
    good, number = np.asarray(successes, np.float64), np.asarray(numbers, np.float64)
    groups, n = len(number), float(number.sum())
    share = float(good.sum()) / n
    if groups == n or groups == 1 or not 0.0 < share < 1.0:
        return n
    variance = groups / (groups - 1) * float(np.sum((good - share * number) ** 2)) / n**2
    effective = share * (1.0 - share) / variance if variance > 0.0 else n
    tail = 0.5 * (1.0 + confidence)
    ratio = float(stdtrit(n - 1.0, tail) / stdtrit(groups - 1.0, tail))
    return min(n, effective * ratio**2)


def probability_text(value: float) -> str:
    """Format a probability; one that is nearly 1 with more digits, never rounded to 1."""
    digits = 2 if value < 0.99 else 3 if value < 0.999 else 4
    return f"{value if value == 1.0 else min(value, 0.9999):.{digits}f}"
