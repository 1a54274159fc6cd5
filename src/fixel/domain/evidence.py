"""Held-out errors: folds of experiments, and errors where a calibration did not use them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np

from fixel.errors import InvalidInput
from fixel.model.fields import Comparable, frozen, settle, whole
from fixel.typing import FloatArray, IntArray

Value = str | float | None
Measure = Literal["absolute", "relative"]

# Smallest error, since zero has no logarithm; simulations are exact to a micrometre [mm^2].
MIN_ERROR: Final = 1e-6


FOLDS: Final = 5
MANY: Final = 2000  # experiments above which two folds are sufficient


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOutErrors(Comparable):
    """Held-out errors, one row per experiment."""

    keys: tuple[str, ...]  # names of the experiments
    ids: tuple[int, ...]  # ids of the experiments in the project
    coordinates: Mapping[str, tuple[Value, ...]]  # conditions [SI]; None if an experiment lacks one
    # (n,) Error E of each with a parameter set that was calibrated without it [mm^2]; inf if the
    # simulation failed, nan if there is no held-out error.
    error_mm2: FloatArray
    # (n,) Smallest E of each with parameters of its own [mm^2]; nan if it was not calibrated.
    own_mm2: FloatArray = field(default_factory=lambda: np.zeros(0))
    # (n,) Fold in which it was held out.
    fold: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    group: tuple[str, ...] = ()  # map to which it belongs; by default one map for all
    # Label that repetitions of one experiment share; by default the key.
    configuration: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()  # reason why there is no held-out error, else empty

    def __post_init__(self) -> None:
        n = len(self.keys)
        fold = np.asarray(self.fold if len(self.fold) else np.zeros(n), np.int64)
        settle(
            self,
            keys=tuple(self.keys),
            ids=tuple(self.ids),
            coordinates={name: tuple(column) for name, column in self.coordinates.items()},
            error_mm2=frozen(self.error_mm2),
            own_mm2=frozen(self.own_mm2 if len(self.own_mm2) else np.full(n, np.nan)),
            fold=fold,
            group=tuple(self.group) or ("",) * n,
            configuration=tuple(self.configuration) or tuple(self.keys),
            notes=tuple(self.notes) or ("",) * n,
        )
        columns = {name: len(column) for name, column in self.coordinates.items()}
        for name in ("ids", "error_mm2", "own_mm2", "fold", "group", "configuration", "notes"):
            columns[name] = len(getattr(self, name))
        wrong = [name for name, length in columns.items() if length != n]
        if n == 0 or wrong:
            found = f"{n} experiments and columns of other lengths: {', '.join(wrong)}"
            expected = "one row per experiment, and at least one"
            raise InvalidInput("evidence", found=found, expected=expected)
        if (self.error_mm2 < 0.0).any() or (self.own_mm2 < 0.0).any():
            raise InvalidInput("evidence.error_mm2", found="a negative value", expected="errors")

    def __len__(self) -> int:
        return len(self.keys)

    def column(self, name: str) -> tuple[Value, ...]:
        """Return a coordinate of all experiments, or raise `InvalidInput` with the known names."""
        if name not in self.coordinates:
            raise InvalidInput(
                f"axis {name}",
                found="no experiment with this condition",
                expected="one of " + ", ".join(sorted(self.coordinates)),
            )
        return self.coordinates[name]

    def rows(self, which: Sequence[int] | IntArray) -> HeldOutErrors:
        """Return the rows of some of the experiments."""
        own = np.asarray(which, np.int64)
        pick = own.tolist()
        return replace(
            self,
            keys=tuple(self.keys[k] for k in pick),
            ids=tuple(self.ids[k] for k in pick),
            coordinates={
                name: tuple(column[k] for k in pick) for name, column in self.coordinates.items()
            },
            error_mm2=self.error_mm2[own],
            own_mm2=self.own_mm2[own],
            fold=self.fold[own],
            group=tuple(self.group[k] for k in pick),
            configuration=tuple(self.configuration[k] for k in pick),
            notes=tuple(self.notes[k] for k in pick),
        )

    def scores(self, measure: Measure = "absolute") -> FloatArray:
        """Return scores (n,), logarithms of errors that are compared with a threshold.

        Absolute: log of the root of E, in millimetres. Relative: log of E over the own best of the
        experiment, nan if that is unknown. inf if the simulation failed.
        """
        error = np.maximum(self.error_mm2, MIN_ERROR)
        if measure == "absolute":
            return np.asarray(0.5 * np.log(error))
        own = np.maximum(self.own_mm2, MIN_ERROR)
        # The best known is an upper bound of the true best, so ratios below 1 are set to 1.
        return np.asarray(np.log(np.maximum(error / own, 1.0)))


def threshold_score(threshold: float, measure: Measure) -> float:
    """Return the score of a threshold, to compare scores with.

    The threshold is a root mean square error [mm]; or, if relative, the excess of E over the own
    best of an experiment, as a share of it: 1 for twice as large.
    """
    if not (np.isfinite(threshold) and threshold > 0.0):
        where, unit = ("threshold", " mm") if measure == "absolute" else ("relative", "")
        raise InvalidInput(where, found=f"{threshold:g}{unit}", expected="a positive number")
    return float(np.log(threshold) if measure == "absolute" else np.log1p(threshold))


def value_of(score: float, measure: Measure) -> float:
    """Inverse of `threshold_score`."""
    return float(np.exp(score) if measure == "absolute" else np.expm1(score))


def default_folds(n: int) -> int:
    """Return the default number of folds for n experiments."""
    return 2 if n > MANY else FOLDS


def folds_of(blocks: Sequence[str], strata: Sequence[str], folds: int, seed: int = 0) -> IntArray:
    """Distribute experiments over folds (n,), by the labels of their blocks and strata.

    Blocks are held out as a whole: repetitions of one configuration, or a group. Blocks of a
    stratum are distributed over the folds as evenly as possible, in the order of the seed. Raise
    `InvalidInput` for fewer than two folds, or fewer blocks than folds.
    """
    first = dict(zip(reversed(blocks), reversed(strata), strict=True))
    whole(folds, "folds", 2)
    if len(first) < folds:
        found = f"{len(first)} configurations"
        expected = f"at least {folds}, the number of folds"
        hint = "add experiments, or use fewer folds: folds=2"
        raise InvalidInput("experiments", found=found, expected=expected, hint=hint)
    rng = np.random.default_rng(seed)
    place: dict[str, int] = {}
    at = 0
    for stratum in sorted(set(first.values())):
        own = sorted(block for block, s in first.items() if s == stratum)
        for k in rng.permutation(len(own)).tolist():
            # The count continues from the last stratum, so that small strata fill all folds evenly.
            place[own[k]] = at % folds
            at += 1
    return np.array([place[block] for block in blocks], np.int64)
