"""What experiments say about parameters that were found without them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal, final, get_args

import numpy as np

from fixel.errors import InvalidInput
from fixel.model.fields import Comparable, frozen, settle
from fixel.typing import FloatArray, IntArray

Value = str | float | None
Measure = Literal["absolute", "relative"]

MEASURES: Final[tuple[Measure, ...]] = get_args(Measure)
# Endings of names that say a unit; what ends otherwise has none.
_UNITS: Final = {"_m_s": "m/s", "_rad_s": "rad/s", "_rad": "rad", "_m": "m", "_s": "s", "_n": "N"}
# An error of nothing has no logarithm [mm^2]; simulations are not more exact than a micrometre.
MIN_ERROR: Final = 1e-6


def unit_in(name: str) -> str:
    """Unit at the end of a condition's name; empty where there is none."""
    return next((unit for end, unit in _UNITS.items() if re.fullmatch(rf"\w+{end}", name)), "")


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOutErrors(Comparable):
    """Held-out errors, one row an experiment.

    Parameters
    ----------
    keys : tuple of str
        Names of the experiments.
    ids : tuple of int
        Of the same in the project.
    coordinates : mapping of name to tuple of (str, float or None)
        Conditions [SI]; None where an experiment has none of the name.
    error_mm2 : (n,) array_like
        E of each under a parameter set that was found without it [mm^2]; inf where the simulation
        failed, nan where there is no evidence.
    own_mm2 : (n,) array_like, optional
        The least E that parameters of its own reach [mm^2]; nan where nobody looked.
    fold : (n,) array_like of int, optional
        In which it was held out.
    group : tuple of str, optional
        Which map it belongs to; one map for all where left out.
    configuration : tuple of str, optional
        The same for repetitions of one experiment; its key where left out.
    notes : tuple of str, optional
        Why there is no evidence, where there is none.
    """

    keys: tuple[str, ...]
    ids: tuple[int, ...]
    coordinates: Mapping[str, tuple[Value, ...]]
    error_mm2: FloatArray
    own_mm2: FloatArray = field(default_factory=lambda: np.zeros(0))
    fold: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    group: tuple[str, ...] = ()
    configuration: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

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
            raise InvalidInput(
                "evidence",
                found=f"{n} experiments and columns of other lengths: {', '.join(wrong)}",
                expected="one row an experiment, one at least",
            )
        if (self.error_mm2 < 0.0).any() or (self.own_mm2 < 0.0).any():
            raise InvalidInput("evidence.error_mm2", found="a negative one", expected="errors")

    def __len__(self) -> int:
        return len(self.keys)

    def column(self, name: str) -> tuple[Value, ...]:
        """A coordinate of all experiments, or a refusal that names those there are."""
        if name not in self.coordinates:
            raise InvalidInput(
                f"axis {name}",
                found="no experiment with this condition",
                expected="one of " + ", ".join(sorted(self.coordinates)),
            )
        return self.coordinates[name]

    def rows(self, which: Sequence[int] | IntArray) -> HeldOutErrors:
        """Some of the experiments."""
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
        """(n,) logarithms that a threshold is held against.

        Absolute: log of the root of E, in millimetres. Relative: log of E over the experiment's own
        best, nan where that is not known. inf where the simulation failed.
        """
        error = np.maximum(self.error_mm2, MIN_ERROR)
        if measure == "absolute":
            return np.asarray(0.5 * np.log(error))
        own = np.maximum(self.own_mm2, MIN_ERROR)
        # The best found is an upper bound of the best there is: nothing can be better than itself.
        return np.asarray(np.log(np.maximum(error / own, 1.0)))


def threshold_score(threshold: float, measure: Measure) -> float:
    """What scores are held against.

    Parameters
    ----------
    threshold : float
        Root mean square error [mm]; or, relative, how much larger than an experiment's own best E
        may be, as a share of it: 1 for twice as large.
    """
    if not (np.isfinite(threshold) and threshold > 0.0):
        raise InvalidInput("threshold", found=threshold, expected="a positive number")
    return float(np.log(threshold) if measure == "absolute" else np.log1p(threshold))


def value_of(score: float, measure: Measure) -> float:
    """The other way round."""
    return float(np.exp(score) if measure == "absolute" else np.expm1(score))
