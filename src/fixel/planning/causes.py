"""Why a plan fails: the unknowns that decide, what measuring them is worth, and tolerances."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model.fields import settle
from fixel.model.parameters import KNOWN_PARAMETERS
from fixel.model.probability import Probability
from fixel.planning.success import effective_number, finite_margins, interval
from fixel.results import Result, Summary
from fixel.table import Column, Table
from fixel.typing import BoolArray, FloatArray, IntArray
from fixel.units import displayed

FOLDS: Final = 8
MIN_SCENARIOS: Final = 64
BINS: Final = (2, 4, 8, 16, 32)
CURVE_BINS: Final = 10
REGION_BINS: Final = 40
SHRINKAGE: Final = 8.0  # scenarios that the overall success of a plan counts as in each bin
USEFUL: Final = 2.0  # standard errors from which folds use a measurement
SIGNIFICANT: Final = 3.0  # standard errors from which a share or a worth is not zero
MIN_SHARE: Final = 0.01  # share explained from which an unknown has a region of failures
TOLERANCES: Final = (0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0)


@dataclass(frozen=True, slots=True)
class FailureRegion:
    """Values of an unknown where a plan fails most."""

    # The plan fails below and above these values; None for no limit on that side.
    below: float | None
    above: float | None
    # Share of all failures that lie there, in scenarios that did not choose the limits.
    failures: float
    scenarios: float  # share of these scenarios that lie there


@dataclass(frozen=True, slots=True, kw_only=True)
class UnknownEffect:
    """Effect of one unknown on the success of a plan."""

    # Its name and SI unit.
    name: str
    unit: str
    # Share of the variance of success that the unknown alone predicts in other scenarios, from 0 to
    # 1; 0 unless it exceeds its standard error three times.
    share: float
    region: FailureRegion | None  # where the plan fails most; None for an unknown without an effect
    # Success probability gained by measuring the unknown exactly and then choosing among the plans;
    # 0 unless it exceeds its standard error three times.
    worth: float
    worth_error: float  # standard error of `worth`
    value: FloatArray  # (k,) middle of each of k intervals with about equally many scenarios
    # Success of the plan there, with 95 % confidence intervals that regard the number of parameter
    # draws.
    success: tuple[Probability, ...]


@dataclass(frozen=True, slots=True, kw_only=True, repr=False, eq=False)
class Explanation(Result):
    """Reasons why a plan fails, from its margins in scenarios with known unknowns.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> load = rng.uniform(-0.01, 0.01, 1024)  # [m]
    >>> friction = rng.uniform(0.2, 0.4, 1024)
    >>> margins = np.stack([1.0 - load / 0.006, 0.5 + load / 0.006])
    >>> found = Explanation.of(margins, {"load": load, "mu_pusher": friction}, units={"load": "m"})
    >>> for sentence in found.sentences:
    ...     print(sentence)
    Fails when load is above 5.74 mm: 98 % of the failures, in 22 % of the scenarios.
    Measuring load before choosing the plan would raise success from 0.79 to 1.00.
    Measuring mu_pusher would not help to choose a plan.
    A tolerance 1.25 times as wide would raise success to 0.88.
    """

    success: float  # share of scenarios in which the plan succeeds
    n: int  # number of scenarios
    n_plans: int  # number of plans among which a measurement could choose
    effects: tuple[UnknownEffect, ...]  # effects of the unknowns, the largest share first
    # Success probability gained if everything were known before choosing among the plans, also the
    # chance of each run: no measurement is worth more.
    regret: float
    tolerance: Mapping[float, float]  # success if the tolerance were this many times as wide
    # Number of failures of each kind, the most frequent first; empty if not given.
    kinds: Mapping[str, int]

    def __post_init__(self) -> None:
        settle(
            self,
            effects=tuple(self.effects),
            tolerance=MappingProxyType(dict(self.tolerance)),
            kinds=MappingProxyType(dict(self.kinds)),
        )

    @classmethod
    def of(
        cls,
        margins: ArrayLike,
        unknowns: Mapping[str, ArrayLike],
        *,
        plan: int = 0,
        worlds: ArrayLike | None = None,
        units: Mapping[str, str] | None = None,
        kinds: Sequence[str] = (),
    ) -> Explanation:
        """Explain the failures of a plan.

        Parameters
        ----------
        margins : (n_plans, n) float64
            Margins of plans in the same scenarios, in units of the goal's tolerance; the plans are
            alternatives among which a measurement could choose.
        unknowns : mapping of str to (n,) float64
            Value of each unknown in the scenarios, in SI units.
        plan : int
            Row of the plan to explain.
        worlds : (n,) int64, optional
            Parameter draw of each scenario. For unknowns with one value for each draw, scenarios of
            one draw then stay together when some are used to choose and others to judge. Necessary
            if draws have several scenarios.
        units : mapping of str to str, optional
            SI units of unknowns; those of parameters are known.
        kinds : sequence of str, optional
            Kind of failure of the plan in each scenario; ignored for a success.

        Returns
        -------
        Explanation

        Raises
        ------
        InvalidInput
            There are fewer than 64 scenarios, or arrays of different lengths or with NaN.

        Notes
        -----
        Everything that is chosen, such as intervals, limits of a region or plans, is chosen in some
        eighths of the scenarios and judged in the others. So chance alone has no effect.

        Source
        ------
        Value of measuring: expected value of partial perfect information, Strong et al. (2014),
        Medical Decision Making 34, 311-326, with intervals instead of a smooth regression.
        """
        own = finite_margins(margins, 2)
        n_plans, n = own.shape
        if n < MIN_SCENARIOS:
            raise InvalidInput("margins", found=f"{n} scenarios", expected=f"{MIN_SCENARIOS}")
        if not 0 <= plan < n_plans:
            raise InvalidInput("plan", found=plan, expected=f"from 0 to {n_plans - 1}")
        good = own >= 0.0
        world = _worlds(n, worlds)
        effects = [
            _effect(name, _column(values, n, name), good, plan, world, (units or {}).get(name))
            for name, values in unknowns.items()
        ]
        failed = [kind for kind, met in zip(kinds, good[plan], strict=bool(kinds)) if not met]
        return cls(
            success=float(np.mean(good[plan])),
            n=n,
            n_plans=n_plans,
            effects=tuple(sorted(effects, key=lambda own: -own.share)),
            regret=float(np.mean(good.any(axis=0)) - good.mean(axis=1).max()),
            tolerance={wide: float(np.mean(own[plan] >= 1.0 - wide)) for wide in TOLERANCES},
            kinds=dict(Counter(failed).most_common()),
        )

    def with_worth(self, other: Explanation) -> Explanation:
        """Return this explanation with the worth of measuring from another one.

        The other one is of the same plan, from scenarios in which it is compared with other plans.
        """
        worth = {own.name: (own.worth, own.worth_error) for own in other.effects}
        effects = []
        for own in self.effects:
            value, error = worth.get(own.name, (0.0, 0.0))
            value = min(value, 1.0 - self.success)
            effects.append(replace(own, worth=value, worth_error=error))
        return replace(self, effects=tuple(effects), n_plans=other.n_plans, regret=other.regret)

    @property
    def sentences(self) -> tuple[str, ...]:
        """Sentences on where the plan fails, and what would help, the most important first."""
        if self.success == 1.0:
            return (f"The plan fails in none of {self.n} scenarios.",)
        found = [_where(own) for own in self.effects[:3] if own.region is not None]
        if not found:
            found.append("No single unknown explains the failures.")
        return tuple([*found, *self._measurements(), *self._tolerances()])

    def _measurements(self) -> list[str]:
        if self.n_plans < 2 or not self.effects:
            return []
        worth = sorted((own for own in self.effects if own.worth > 0.0), key=lambda own: -own.worth)
        found = [
            f"Measuring {own.name} before choosing the plan would raise success from "
            f"{self.success:.2f} to {min(1.0, self.success + own.worth):.2f}."
            for own in worth[:2]
        ]
        useless = [own.name for own in self.effects if own.worth == 0.0][:3]
        if useless:
            found.append(f"Measuring {' or '.join(useless)} would not help to choose a plan.")
        return found

    def _tolerances(self) -> list[str]:
        enough = min(0.02, 0.5 * (1.0 - self.success))
        for wide, success in self.tolerance.items():
            if wide > 1.0 and success >= self.success + enough:
                text = f"A tolerance {wide:g} times as wide would raise success to {success:.2f}."
                return [text]
        return ["A tolerance up to 3 times as wide would not help."]

    def _summary(self) -> Summary:
        columns = (
            "unknown", "fails mostly", Column("explains", "%", ".0f"), Column("worth", "", "+.3f"),
            Column("failures", "%", ".0f"), Column("scenarios", "%", ".0f"),
        )  # fmt: skip
        rows = []
        for own in self.effects:
            region = own.region
            inside = (None, None) if region is None else (region.failures, region.scenarios)
            shares = [None if one is None else 100.0 * one for one in inside]
            rows.append((own.name, _limits(own), 100.0 * own.share, own.worth, *shares))
        heading = f"Success in {100.0 * self.success:.1f} % of {self.n} scenarios"
        kinds = ", ".join(f"{kind} {number}" for kind, number in self.kinds.items())
        notes = [*self.sentences, *([f"Failures: {kinds}."] if kinds else [])]
        return Summary(heading, [Table(columns, rows, title="Causes of failures", left=2)], notes)


def _where(own: UnknownEffect) -> str:
    region = own.region
    assert region is not None
    return (
        f"Fails when {own.name} is {_limits(own)}: {100.0 * region.failures:.0f} % of the "
        f"failures, in {100.0 * region.scenarios:.0f} % of the scenarios."
    )


def _limits(own: UnknownEffect) -> str | None:
    """Format the region where a plan fails: `above 6 mm`."""
    if own.region is None:
        return None
    unit, factor = displayed(own.unit)
    limits = (("below", own.region.below), ("above", own.region.above))
    parts = [f"{word} {factor * value:.3g}" for word, value in limits if value is not None]
    return " or ".join(parts) + (f" {unit}" if unit not in ("", "-") else "")


def _column(values: ArrayLike, n: int, name: str) -> FloatArray:
    own = finite_margins(values, 1, where=f"unknowns[{name!r}]")
    if len(own) != n:
        raise InvalidInput(
            f"unknowns[{name!r}]", found=f"{len(own)} values", expected=f"{n} values"
        )
    return own


def _worlds(n: int, worlds: ArrayLike | None) -> IntArray:
    """Number the parameter draws (n,) of scenarios from 0."""
    own = np.arange(n) if worlds is None else np.asarray(worlds)
    if own.shape != (n,):
        raise InvalidInput("worlds", found=f"shape {own.shape}", expected=f"shape ({n},)")
    return np.asarray(np.unique(own, return_inverse=True)[1], dtype=np.int64)


def _is_of_draws(value: FloatArray, world: IntArray) -> bool:
    """Whether an unknown has one value for each parameter draw."""
    first = np.unique(world, return_index=True)[1]
    return bool(np.all(value == value[first[world]]))


def _folds(world: IntArray) -> IntArray:
    """Divide scenarios into folds (n,), those of one parameter draw together."""
    # In a fixed random order, so that no pattern of the scenarios falls into one fold.
    order = np.random.default_rng(0).permutation(int(world.max()) + 1)
    return np.asarray(order[world] % FOLDS, dtype=np.int64)


class _Counts(NamedTuple):
    """Successes and scenarios in intervals of an unknown, by fold."""

    good: FloatArray  # (n_folds, n_plans, n_bins)
    number: FloatArray  # (n_folds, n_bins)
    edges: FloatArray  # (n_bins - 1,)

    def of(self, folds: Sequence[int] | slice = slice(None)) -> tuple[FloatArray, FloatArray]:
        return self.good[folds].sum(axis=0), self.number[folds].sum(axis=0)


def _intervals(value: FloatArray, n: int) -> tuple[FloatArray, IntArray]:
    """Return the borders of intervals with equally many values, and the interval of each."""
    edges = np.unique(np.quantile(value, np.arange(1, n) / n, method="inverted_cdf"))
    return edges, np.searchsorted(edges, value, side="left")


def _counts(good: BoolArray, value: FloatArray, fold: IntArray, bins: int) -> _Counts:
    edges, own = _intervals(value, bins)
    n_bins = len(edges) + 1
    inside = (own[:, None] == np.arange(n_bins)).astype(np.float64)
    folds = [fold == k for k in range(FOLDS)]
    return _Counts(
        np.stack([good[:, rows].astype(np.float64) @ inside[rows] for rows in folds]),
        np.stack([inside[rows].sum(axis=0) for rows in folds]),
        edges,
    )


def _effect(
    name: str, value: FloatArray, good: BoolArray, plan: int, world: IntArray, unit: str | None
) -> UnknownEffect:
    # Scenarios of one draw stay together for an unknown of the draw; for one of each run, no draw
    # is known by its value, and scenarios are divided.
    fold = _folds(world if _is_of_draws(value, world) else np.arange(len(value)))
    tables = [_counts(good, value, fold, bins) for bins in BINS]
    known = KNOWN_PARAMETERS.get(name)
    share = max(0.0, *(_share_explained(table, plan) for table in tables))
    worth, error = _worth(tables) if len(good) > 1 else (0.0, 0.0)
    regions = _counts(good[plan : plan + 1], value, fold, REGION_BINS)
    middles, success = _curve(good[plan], value, world)
    return UnknownEffect(
        name=name, unit=unit if unit is not None else known.unit if known else "", share=share,
        region=_region(regions) if share >= MIN_SHARE else None,
        worth=worth if worth > SIGNIFICANT * error else 0.0, worth_error=error,
        value=middles, success=success,
    )  # fmt: skip


def _curve(
    good: BoolArray, value: FloatArray, world: IntArray
) -> tuple[FloatArray, tuple[Probability, ...]]:
    """Compute success in intervals with equally many scenarios, and the middles of these."""
    bins = _intervals(value, CURVE_BINS)[1]
    middles, success = [], []
    for k in np.unique(bins):
        rows = bins == k
        numbers = np.bincount(world[rows])
        met = np.bincount(world[rows], good[rows])[numbers > 0]
        numbers = numbers[numbers > 0]
        share = float(met.sum() / numbers.sum())
        n = effective_number(met, numbers, 0.95) if 0.0 < share < 1.0 else float(len(numbers))
        middles.append(np.median(value[rows]))
        success.append(Probability(share, *interval(share, n), int(numbers.sum())))
    return np.array(middles), tuple(success)


def _share_explained(table: _Counts, plan: int) -> float:
    """Share of the variance of success that intervals of other folds predict; 0 if not certain."""
    own_error, all_error = np.zeros((2, FOLDS))
    for k in range(FOLDS):
        good, number = table.of(_others(k))
        mean = good[plan].sum() / number.sum()
        rate = (good[plan] + SHRINKAGE * mean) / (number + SHRINKAGE)
        met, missed = table.good[k, plan], table.number[k] - table.good[k, plan]
        own_error[k] = met @ (1.0 - rate) ** 2 + missed @ rate**2
        all_error[k] = met.sum() * (1.0 - mean) ** 2 + missed.sum() * mean**2
    gain = all_error - own_error
    certain = gain.mean() > SIGNIFICANT * np.std(gain, ddof=1) / FOLDS**0.5
    return float(gain.sum() / all_error.sum()) if certain else 0.0


def _worth(tables: Sequence[_Counts]) -> tuple[float, float]:
    """Value of measuring an unknown, and its standard error.

    Each fold judges a choice that the others made. These also decide, by folds of their own, how
    many intervals to distinguish, and whether to use the measurement at all.
    """
    gains = np.zeros(FOLDS)
    for k in range(FOLDS):
        others = _others(k)
        best = 0.0
        for table in tables:
            inner = np.array([_gain(table, [i for i in others if i != j], j) for j in others])
            error = float(np.std(inner, ddof=1)) / len(inner) ** 0.5
            if inner.mean() > max(best, USEFUL * error):
                best, gains[k] = float(inner.mean()), _gain(table, others, k)
    return float(np.mean(gains)), float(np.std(gains, ddof=1)) / FOLDS**0.5


def _gain(table: _Counts, train: Sequence[int], test: int) -> float:
    """Success gained in a fold by the best plan of each interval instead of the best of all."""
    good, number = table.of(train)
    mean = good.sum(axis=1) / number.sum()
    rate = (good + SHRINKAGE * mean[:, None]) / (number + SHRINKAGE)
    chosen = np.argmax(rate, axis=0)
    met = table.good[test]
    gain = met[chosen, np.arange(met.shape[1])].sum() - met[np.argmax(mean)].sum()
    return float(gain / table.number[test].sum())


def _others(fold: int) -> list[int]:
    return [k for k in range(FOLDS) if k != fold]


def _region(table: _Counts) -> FailureRegion:
    """Find where a plan fails most; its shares are of folds that did not choose the limits."""
    failures = inside = 0.0
    for k in range(FOLDS):
        rows = _worst_rows(*table.of(_others(k)))
        failures += float((table.number[k] - table.good[k, 0])[rows].sum())
        inside += float(table.number[k][rows].sum())
    rows = _worst_rows(*table.of())
    good, number = table.of()
    low = int(np.argmin(rows)) if rows[0] else 0  # first interval that is not in the region
    high = len(rows) - int(np.argmin(rows[::-1])) if rows[-1] else len(rows)
    return FailureRegion(
        below=float(table.edges[low - 1]) if low else None,
        above=float(table.edges[high - 1]) if high < len(rows) else None,
        failures=failures / max(1.0, float(number.sum() - good.sum())),
        scenarios=inside / float(number.sum()),
    )


def _worst_rows(good: FloatArray, number: FloatArray) -> BoolArray:
    """Select the lower, upper or both ends (n_bins,) that separate failures best."""
    missed = number - good[0]
    n, n_bins = number.sum(), len(number)
    rate = missed.sum() / n
    place = np.arange(n_bins)
    ends: list[Callable[[int], BoolArray]] = [
        lambda k: place < k,
        lambda k: place >= n_bins - k,
        lambda k: (place < k) | (place >= n_bins - k),
    ]
    best, found = -1.0, place < 0
    for end in ends:
        for k in range(1, n_bins):
            rows = end(k)
            inside = number[rows].sum()
            excess = missed[rows].sum() - rate * inside
            if not 0.0 < inside < n or excess <= 0.0:
                continue
            strength = excess**2 / (inside * (1.0 - inside / n))
            if strength > best:
                best, found = strength, rows
    return found
