"""Bounds on the error of the calibrated simulator that hold with a stated probability.

They apply to untried configurations, and are learned from experiments that the calibration has not
seen. docs/theory/error-bounds.md states the guarantee and its assumptions.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fixel.calibration import known_pushes
from fixel.calibration.mixed import numbered
from fixel.domain.features import Scale, ScaleModel, default_model, fitted_model, powered, unpowered
from fixel.errors import InvalidInput, counted
from fixel.model.fields import inner_share
from fixel.typing import BoolArray, FloatArray, IntArray

LEVEL: Final = 0.9
# Parts that are left out in turn, so that the model of every score has not seen its experiment.
FOLDS: Final = 5
# Number of a group's own scores that the scores of all groups together count as. A larger one makes
# bounds sharper, and less reliable in unusual groups; chosen on inner splits of real pushes.
BORROWED: Final = 40.0
# Largest distance to the evidence of a bound, over what is a large distance within the evidence.
FAR_RATIO: Final = 2.0
FAR_SHARE: Final = 0.99
SAME: Final = 1e-6  # distance of features below which they count as repeated
FAR_AWAY: Final = "its features are far from those of all experiments"

NO_DATA: Final = "no data"

# How scores of units that were left out as a whole bound the error in a new unit.
GUARANTEED: Final = "guaranteed"  # a new unit is one more draw; it has a weight at infinity
TYPICAL: Final = "typical"  # for the pushes of all new units, whose sizes of errors are drawn
CAUTIOUS: Final = "cautious"  # for the pushes of a new unit with large errors
RULES: Final = (GUARANTEED, TYPICAL, CAUTIOUS)
MIN_UNITS: Final = 2
MIN_DRAWS: Final = 2000  # of an error and the size of a new unit
GOLDEN: Final = (math.sqrt(5.0) - 1.0) / 2.0  # its multiples fill the unit interval evenly
MIN_SIZE: Final = 1e-3  # of the errors of a unit, over those of all
MAX_LOG: Final = 30.0
TINY: Final = 1e-300

Labels = Sequence[Hashable]


@dataclass(frozen=True, slots=True, eq=False)
class ConformalBound:
    """Bounds on errors that hold with a stated probability; made by `ConformalBound.fit`."""

    level: float  # probability with which a bound holds
    # `"forest"`, `"neighbours"` (without scikit-learn) or `"constant"` (few experiments).
    model: str
    n: int  # number of experiments that it is calibrated on
    _models: tuple[ScaleModel, ...]
    _fold: IntArray  # (n,) number of the model that has not seen an experiment
    _score: FloatArray  # (n,) power of the error minus the prediction of that model; may be inf
    _group: IntArray  # (n,)
    _groups: tuple[Hashable, ...]
    _near: _Near
    _unit: IntArray | None = None  # (n,) number of the unit that was left out as a whole
    _sizes: _Sizes | None = None  # of the errors of these units
    _pushed: known_pushes.PushedContacts | None = None
    _beyond: ConformalBound | None = None
    _part: ConformalBound | None = None
    # Rule for new units, if it was fitted with `units`: `"guaranteed"`, `"typical"` or
    # `"cautious"`.
    rule: str = GUARANTEED

    @classmethod
    def fit(
        cls,
        features: ArrayLike,
        errors: ArrayLike,
        groups: Labels | None = None,
        level: float = LEVEL,
        seed: int = 0,
        *,
        also: tuple[ArrayLike, ArrayLike] | None = None,
        model: str | None = None,
        units: Labels | None = None,
        rule: str = GUARANTEED,
    ) -> ConformalBound:
        """Learn from experiments that the calibration has not seen.

        Raise `InvalidInput` for too few experiments for the level, or invalid numbers.

        Parameters
        ----------
        features : (n, f) array_like
            Features known before an experiment; finite, any units.
        errors : (n,) array_like
            Errors of the calibrated simulator, 0 or more in any unit; inf for a failed simulation.
        groups : (n,) sequence, optional
            Labels, such as shape and surface. Bounds hold in each group that has enough
            experiments.
        level : float
            Probability of a bound, between 0 and 1, both excluded.
        seed : int
            Seed of the folds and trees.
        also : ((k, f) array_like, (k,) array_like), optional
            Features and errors for fitting the model of errors, but never for judging it, such as
            those of the experiments of the calibration.
        model : str, optional
            Name of the model of errors; by default the best that is available.
        units : (n,) sequence, optional
            Labels of parts, sides or speeds that were left out of the calibration as a whole.
            Bounds then hold for a new unit: models leave out whole groups (whole units without
            groups), and all units have the same weight, whatever their number of experiments.
        rule : str
            Rule for new units. `"guaranteed"` needs 9 units for 90 %. `"typical"` aims at the level
            over the pushes of all new units, `"cautious"` in as large a share of new units; both
            are wider the fewer units, or groups of them, there are. See `proved_level`.
        """
        table, off = _checked(features, errors)
        labels = _labels(groups, len(off))
        _check_experiments(level, len(off))
        more, more_off = (table[:0], off[:0]) if also is None else _checked(*also)
        if more.shape[1] != table.shape[1]:
            raise InvalidInput("also.features", found=f"{more.shape[1]} columns",
                               expected=f"{table.shape[1]}")  # fmt: skip
        known = tuple(dict.fromkeys(labels))
        group = numbered(labels)
        unit = None if units is None else numbered(_labels(units, len(off)))
        if unit is not None:
            _check_units(rule, level, int(unit.max()) + 1)
        whole = unit if len(known) == 1 else group
        fold = _folds(group, seed) if unit is None or whole is None else _whole_folds(whole, seed)
        name = model or default_model(len(off))
        models, seen = [], np.empty(len(off))
        for k in range(FOLDS):
            own = fold == k
            use = np.concatenate((table[~own], more))
            value = powered(np.concatenate((off[~own], more_off)))
            good = np.isfinite(value)
            models.append(fitted_model(name, use[good], value[good], seed + k))
            if own.any():
                seen[own] = models[-1](table[own])
        score = powered(off) - seen
        near = _Near.of(np.concatenate((table, more)))
        sizes = None
        if unit is not None and whole is not None:
            level_of = np.array([model(table).mean() for model in models])
            sizes = _Sizes.of(powered(off), seen, fold, level_of, unit, whole)
        made = tuple(models), fold, score, group, known, near, unit, sizes
        return cls(level, name, len(off), *made, rule=rule)

    @property
    def n_unit(self) -> int:
        """Number of units that were left out as a whole; 0 without units."""
        return 0 if self._unit is None else int(self._unit.max()) + 1

    @property
    def proved_level(self) -> float:
        """Probability that n units can prove at most, if new units are drawn like them.

        Guaranteed: the level, or n / (n + 1) if that is less. Typical: n / (n + 1) of the level,
        for a push of a new unit. Cautious: n / (n + 1), for the event that a new unit (a new group
        of n, if it was fitted with groups) has `level` of its pushes within.
        """
        n = self.n_unit
        if self.rule == CAUTIOUS and len(self._groups) >= MIN_UNITS:
            n = len(self._groups)
        most = 1.0 if self._unit is None else n / (n + 1.0)
        return {GUARANTEED: min(self.level, most), TYPICAL: most * self.level}.get(self.rule, most)

    def with_rule(self, rule: str) -> ConformalBound:
        """Return the same bounds with another rule for new units (`"typical"`, `"cautious"`)."""
        if self._unit is not None:
            _check_units(rule, self.level, self.n_unit)
        beyond, part = (
            None if b is None else b.with_rule(rule) for b in (self._beyond, self._part)
        )
        return replace(self, rule=rule, _beyond=beyond, _part=part)

    def for_contacts(
        self,
        contacts: known_pushes.TouchedPlaces | None = None,
        groups: Labels | None = None,
        beyond: ConformalBound | None = None,
        part: ConformalBound | None = None,
    ) -> ConformalBound:
        """Return the same bounds with others where a side, a speed or a group is new.

        Parameters
        ----------
        contacts : TouchedPlaces, optional
            Contacts of the experiments; sides and speeds that were never pushed then have no data.
        groups : (k,) sequence, optional
            Labels of these; a group is one part.
        beyond : ConformalBound, optional
            Bounds for a new side or a new speed of a pushed part, fitted with `units`. A contact
            that is new in both has no bound.
        part : ConformalBound, optional
            Bounds for a new group, fitted with whole groups as `units`. Without it a group that no
            experiment has is without data.
        """
        for where, own in (("beyond", beyond), ("part", part)):
            if own is not None and own._unit is None:
                expected = "units=, with whole sides or groups left out"
                raise InvalidInput(where, found="bounds fitted without units", expected=expected)
        pushed = None
        if contacts is not None:
            pushed = known_pushes.PushedContacts(contacts, _labels(groups, len(contacts.normal)))
        return replace(self, _pushed=pushed, _beyond=beyond, _part=part)

    def bounds(
        self,
        features: ArrayLike,
        groups: Labels | None = None,
        contacts: known_pushes.TouchedPlaces | None = None,
    ) -> FloatArray:
        """Return bounds on the errors of new configurations (m,).

        Each error stays below with probability `level`. Infinite where there is no data (see
        `reasons`), and in a group whose simulations fail.
        """
        return np.asarray(self.quantiles(features, groups, (self.level,), contacts)[0])

    def quantiles(
        self,
        features: ArrayLike,
        groups: Labels | None,
        levels: Sequence[float],
        contacts: known_pushes.TouchedPlaces | None = None,
    ) -> FloatArray:
        """Return bounds at several levels (n_level, m), for features (m, f).

        The contacts of the new configurations are required after `for_contacts`.
        """
        table = self._table(features)
        for level in levels:
            inner_share(level, "level")
        labels = _labels(groups, len(table))
        kind = np.array([kind for kind, _ in self._novelty(contacts, labels)], object)
        answer = self._quantiles(table, labels, levels)
        answer[:, kind != ""] = np.inf
        for new, other in self._others(kind):
            if other is not None and new.any():
                answer[:, new] = other.quantiles(table[new], None, levels)
        return answer

    def reasons(
        self,
        features: ArrayLike,
        groups: Labels | None = None,
        contacts: known_pushes.TouchedPlaces | None = None,
    ) -> tuple[str, ...]:
        """Return reasons (m,) why new configurations have no data; empty for those that have."""
        table = self._table(features)
        novelty = self._novelty(contacts, _labels(groups, len(table)))
        far = np.where(self._near(table), "", FAR_AWAY)
        answer = [new or away for (_, new), away in zip(novelty, far.tolist(), strict=True)]
        for mask, other in self._others(np.array([kind for kind, _ in novelty], object)):
            new = np.flatnonzero(mask)
            if other is not None:
                for k, why in zip(new.tolist(), other.reasons(table[new]), strict=True):
                    answer[k] = why
        return tuple(answer)

    def unseen(
        self, groups: Labels | None = None, contacts: known_pushes.TouchedPlaces | None = None
    ) -> tuple[str, ...]:
        """Return what is new about configurations (m,): a group, a side, a speed; else empty.

        Unlike `reasons`, also where left-out units give a bound.
        """
        n = len(groups) if groups is not None else 0 if contacts is None else len(contacts.normal)
        return tuple(reason for _, reason in self._novelty(contacts, _labels(groups, n)))

    def _others(
        self, kind: NDArray[np.object_]
    ) -> Sequence[tuple[BoolArray, ConformalBound | None]]:
        """Return masks (m,) of the configurations whose bounds come from left-out units."""
        return (
            (np.isin(kind, (known_pushes.SIDE, known_pushes.SPEED)), self._beyond),
            (np.asarray(kind == known_pushes.PART, bool), self._part),
        )

    def _novelty(
        self, contacts: known_pushes.TouchedPlaces | None, labels: list[Hashable]
    ) -> list[tuple[str, str]]:
        """Return the kind of novelty of each configuration, and its reason."""
        if (self._pushed is None) != (contacts is None):
            found = "none" if contacts is None else "some, for bounds without contacts"
            raise InvalidInput("contacts", found=found, expected="what `for_contacts` got")
        if self._pushed is not None and contacts is not None:
            return self._pushed.novelty(contacts, labels)
        if self._unit is not None or self._groups == (None,):
            new = [""] * len(labels)  # for any label: units are left out to bound new ones
        else:
            count = dict(zip(self._groups, np.bincount(self._group).tolist(), strict=True))
            count[None] = self.n  # a label that is not given
            new = [_few(label, count.get(label, 0)) for label in labels]
        return [(known_pushes.PART if reason else "", reason) for reason in new]

    def _table(self, features: ArrayLike) -> FloatArray:
        table = _table(features, "features")
        if table.shape[1] != self._near.n_column:
            raise InvalidInput("features", found=f"{table.shape[1]} columns",
                               expected=f"{self._near.n_column}, as in the evidence")  # fmt: skip
        return table

    def _quantiles(
        self, table: FloatArray, labels: list[Hashable], levels: Sequence[float]
    ) -> FloatArray:
        """Return bounds (n_level, m), disregarding contacts."""
        if not len(table):
            return np.zeros((len(levels), 0))
        expected = np.stack([model(table) for model in self._models])
        answer = np.full((len(levels), len(table)), np.inf)
        near = self._near(table)
        for label in dict.fromkeys(labels):
            own = np.flatnonzero(near & np.array([other == label for other in labels], bool))
            answer[:, own] = self._judged(expected[:, own], label, levels)
        return unpowered(answer)

    def _judged(self, expected: FloatArray, label: Hashable, levels: Sequence[float]) -> FloatArray:
        """Return quantiles (n_level, m) of what is reached if errors exceed the values that models
        expect (FOLDS, m) as those of the experiments did."""
        weight, itself = self._weights(label)
        if self._sizes is None or self.rule == GUARANTEED:
            reached = expected[self._fold] + self._score[:, None]
            return _weighted(reached, weight, itself, levels)
        shape = expected / self._sizes.model[:, None]
        reached = np.maximum(shape[self._fold] + self._sizes.score[:, None], 0.0)
        repeated = math.ceil(MIN_DRAWS / self.n)
        rows = np.repeat(np.argsort(self._sizes.score, kind="stable"), repeated)
        draw = (np.arange(len(rows)) + 0.5) * GOLDEN % 1.0
        size = self._sizes.quantile(np.asarray(draw, np.float64), self._sizes.sd)
        typical = _weighted(reached[rows] * size[:, None], weight[rows], repeated * itself, levels)
        if self.rule == TYPICAL:
            return typical
        large = self._sizes.quantile(np.array(self.level), self._sizes.wide)
        return np.maximum(typical, large * _weighted(reached, weight, itself, levels))

    def _weights(self, label: Hashable) -> tuple[FloatArray, float]:
        """Return the weights (n,) of the scores for a group, and that of the new configuration."""
        if self._unit is not None:
            weight = 1.0 / np.bincount(self._unit)[self._unit]
            return weight, 1.0 if self.rule == GUARANTEED else float(weight.mean())
        if label not in self._groups or len(self._groups) == 1:
            return np.ones(self.n), 1.0
        own = self._group == self._groups.index(label)
        borrowed = BORROWED / self.n
        return np.where(own, 1.0 + borrowed, borrowed), 1.0 + borrowed


def min_experiments(level: float) -> int:
    """Return the number of held-out experiments for a finite bound: 9 for 90 %, 19 for 95 %."""
    inner_share(level, "level")
    return math.ceil(round(level / (1.0 - level), 9))


def constant_bound(errors: ArrayLike, level: float = LEVEL) -> float:
    """Return one bound for all configurations: split conformal prediction without features.

    Source: Vovk, Gammerman & Shafer (2005); the (n + 1) level'th smallest error.
    """
    off = np.sort(np.asarray(errors, np.float64))
    _check_experiments(level, len(off))
    return float(off[math.ceil(round((len(off) + 1) * level, 9)) - 1])


class _Sizes(NamedTuple):
    """Sizes of the errors of units: a new one is one more draw from those of the parts.

    The level of a model that leaves out a part is that of the others, and would count their
    scatter twice. Models therefore contribute their shape only, in units of their level.
    """

    score: FloatArray  # (n,) scores of errors in units of the size of their unit
    model: FloatArray  # (FOLDS,) levels of the models
    mean: float  # mean logarithm of the sizes
    sd: float  # scale of the logarithm of a new size
    wide: float  # the same with the scatter of sizes that are learned from few experiments
    freedom: float  # degrees of freedom of its Student distribution

    @classmethod
    def of(
        cls,
        power: FloatArray,
        seen: FloatArray,
        fold: IntArray,
        model: FloatArray,
        unit: IntArray,
        whole: IntArray,
    ) -> _Sizes:
        """Learn from powers of errors (n,) and what models expect, the fold, unit and group (part)
        of each, and the levels of the models; units of one part are not independent.

        Source: Satterthwaite (1946) for the degrees of freedom of a sum of variances.
        """
        good = np.isfinite(power)
        least = max(MIN_SIZE * float(power[good].mean()), TINY) if good.any() else TINY
        model = np.maximum(model, least)
        shape = seen / model[fold]
        some = np.unique(unit[good])
        size, part, noise = np.ones(unit.max() + 1), np.zeros(unit.max() + 1, np.int64), 0.0
        for k in some:
            own = good & (unit == k)
            mean = max(power[own].mean(), least)
            size[k] = mean / max(shape[own].mean(), MIN_SIZE)
            noise += power[own].var() / mean**2 / own.sum() / len(some)
        part[unit] = whole
        log, (_, part) = np.log(size[some]), np.unique(part[some], return_inverse=True)
        n = np.bincount(part)
        centre = np.bincount(part, log) / n
        within = float(np.mean(np.bincount(part, (log - centre[part]) ** 2) / n))
        between = float(np.var(centre, ddof=1)) if len(n) > 1 else 0.0
        lower, upper = max(len(n) - 1, 1), max(len(log) - len(n), 1)
        total = between + within
        freedom = total**2 / (between**2 / lower + within**2 / upper) if total > 0.0 else lower
        # A few experiments of a unit do not show its size exactly.
        more = 1.0 + 1.0 / max(len(n), 1)
        sd, wide = math.sqrt(more * max(total - noise, 0.0)), math.sqrt(more * total)
        score = power / size[unit] - shape
        return cls(score, model, float(centre.mean()), sd, wide, float(freedom))

    def quantile(self, share: FloatArray, sd: float) -> FloatArray:
        """Return quantiles of the size of a new unit, with a scale of its logarithm."""
        from scipy.special import stdtrit

        log = self.mean + sd * stdtrit(self.freedom, share)
        return np.asarray(np.exp(np.minimum(log, MAX_LOG)))


class _Near(NamedTuple):
    """Neighbourhood of the evidence: within a multiple of the distances between its rows."""

    evidence: FloatArray
    scale: Scale
    farthest: float

    @classmethod
    def of(cls, features: FloatArray) -> _Near:
        from scipy.spatial import KDTree

        scale = Scale.of(features)
        table = scale(features)
        if table.shape[1] == 0 or len(table) < 2:
            return cls(features, scale, 0.0)
        apart = KDTree(table).query(table, k=2)[0][:, 1]
        if np.quantile(apart, FAR_SHARE) < SAME:  # repeated rows, such as those of a plan
            table = np.unique(np.round(table / SAME), axis=0) * SAME
            apart = (
                KDTree(table).query(table, k=min(2, len(table)))[0].reshape(len(table), -1)[:, -1]
            )
        return cls(features, scale, FAR_RATIO * float(np.quantile(apart, FAR_SHARE)))

    @property
    def n_column(self) -> int:
        return int(self.evidence.shape[1])

    def __call__(self, features: FloatArray) -> BoolArray:
        from scipy.spatial import KDTree

        tiny = 1e-9 * np.maximum(np.abs(self.scale.centre), 1e-9)
        fixed = self.scale.spread <= tiny
        same = (np.abs(features - self.scale.centre) <= 1e3 * tiny)[:, fixed].all(axis=1)
        table = self.scale(self.evidence)
        if table.shape[1] == 0:
            return np.asarray(same)
        away = KDTree(table).query(self.scale(features), k=1)[0]
        return np.asarray(same & (away <= self.farthest))


def _weighted(
    values: FloatArray, weight: FloatArray, itself: float, levels: Sequence[float]
) -> FloatArray:
    """Return weighted quantiles (n_level, m) of values (n, m); the new configuration itself lies at
    infinity with the weight `itself`."""
    order = np.argsort(values, axis=0, kind="stable")
    reached = np.cumsum(weight[order], axis=0)
    ordered = np.take_along_axis(values, order, axis=0)
    answer = np.full((len(levels), values.shape[1]), np.inf)
    for k, level in enumerate(levels):
        wanted = level * (weight.sum() + itself)
        row = (reached < wanted * (1.0 - 1e-12)).sum(axis=0)
        found = row < len(values)
        columns = np.flatnonzero(found)
        answer[k, columns] = ordered[row[columns], columns]
    return answer


def _folds(group: IntArray, seed: int) -> IntArray:
    """Return folds (n,) that divide every group evenly and at random."""
    rng = np.random.default_rng(seed)
    fold, dealt = np.empty(len(group), np.int64), 0
    for g in np.unique(group):
        own = rng.permutation(np.flatnonzero(group == g))
        fold[own] = (dealt + np.arange(len(own))) % FOLDS
        dealt += len(own)
    return fold


def _whole_folds(whole: IntArray, seed: int) -> IntArray:
    """Return folds (n,) that divide no group or unit."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(int(whole.max()) + 1)
    return np.asarray(np.argsort(order)[whole] % FOLDS)


def _checked(features: ArrayLike, errors: ArrayLike) -> tuple[FloatArray, FloatArray]:
    table = _table(features, "features")
    off = np.asarray(errors, np.float64)
    if off.shape != (len(table),):
        raise InvalidInput("errors", found=f"shape {off.shape}", expected=f"({len(table)},)")
    if np.isnan(off).any() or (off < 0.0).any():
        expected = "errors of 0 or more; inf for failed simulations"
        raise InvalidInput("errors", found="negative numbers, or none", expected=expected)
    return table, off


def _table(features: ArrayLike, where: str) -> FloatArray:
    table = np.asarray(features, np.float64)
    if table.ndim != 2 or not np.isfinite(table).all():
        found = f"shape {table.shape}" if table.ndim != 2 else "numbers that are not finite"
        raise InvalidInput(where, found=found, expected="a table of finite numbers (n, f)")
    return table


def _labels(groups: Labels | None, n: int) -> list[Hashable]:
    labels: list[Hashable] = [None] * n if groups is None else list(groups)
    if len(labels) != n:
        raise InvalidInput("groups", found=f"{len(labels)} labels", expected=f"{n}")
    return labels


def _check_experiments(level: float, n: int) -> None:
    _check_number(level, n, "experiments", f"{n} held out", "run more experiments")


def _check_number(level: float, n: int, where: str, found: str, more: str, on: str = "") -> None:
    least = min_experiments(level)
    if n < least:
        raise InvalidInput(
            where,
            found=found,
            expected=f"at least {least} for bounds with {100.0 * level:g} %{on}",
            hint=f"{more}, or use a lower level",
        )


def _few(label: Hashable, n: int) -> str:
    """Return why a group counts as unseen; empty if it has enough experiments."""
    if not n:
        return f"no experiment with {label}"
    return (
        "" if n >= known_pushes.MIN_EXPERIMENTS else f"only {counted(n, 'experiment')} with {label}"
    )


def _check_units(rule: str, level: float, n_unit: int) -> None:
    """Raise if there are too few units for a rule: n units prove at most n / (n + 1)."""
    if rule not in RULES:
        raise InvalidInput("rule", found=repr(rule), expected=" or ".join(map(repr, RULES)))
    if rule == GUARANTEED:
        most = f"{n_unit} prove at most {100.0 * n_unit / (n_unit + 1):.3g} %"
        more = f"{most}: leave out more of them, use rule='typical' or 'cautious'"
        _check_number(level, n_unit, "units", f"{n_unit} left out", more, " for a new one")
    elif n_unit < MIN_UNITS:
        raise InvalidInput("units", found=f"{n_unit} left out", expected=f"at least {MIN_UNITS}",
                           hint="one unit does not show how much units differ")  # fmt: skip
