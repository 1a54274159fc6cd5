"""Results of a replay: rows, aggregates, and settings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

Row = dict[str, Any]

# Length by which angles count in the error of the thesis [m/rad] (section 5.1: "a scale of 35").
ANGLE_LENGTH = 35e-3


class Timing(NamedTuple):
    """Wall times of the parts of a replay [s]."""

    reading: float
    compiling: float  # compiling or loading kernels, and one push
    simulation: float
    total: float
    simulated: int

    def summary(self) -> Row:
        """Return the times as plain numbers; `per_second` counts the simulation alone."""
        rate = self.simulated / self.simulation if self.simulation > 0.0 else None
        end_to_end = self.simulated / self.total if self.total > 0.0 else None
        return {
            "reading_s": self.reading,
            "compiling_s": self.compiling,
            "simulation_s": self.simulation,
            "total_s": self.total,
            "simulated": self.simulated,
            "per_second": rate,
            "per_second_end_to_end": end_to_end,
        }


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Replay:
    """Result of replaying recorded pushes.

    Attributes
    ----------
    dataset : str
    pushes : list of dict
        One row of plain numbers for each push, window or run; units are in the names.
    groups : list of dict
        Aggregates; the last one includes all records, if there are several.
    left_out : dict from reason to count
        Records that were not replayed.
    not_solved : int
        Number of simulations that did not finish; aggregates exclude them.
    settings : dict
        Values and methods, sufficient to repeat the replay.
    notes : list of str
        Remarks on the treatment of the data, in sentences.
    timing : Timing
    picture : object
        Data of the figure, of a kind that depends on the dataset.
    """

    dataset: str
    pushes: list[Row]
    groups: list[Row]
    left_out: dict[str, int]
    not_solved: int
    settings: Row
    notes: list[str]
    timing: Timing
    picture: Any

    def summary(self) -> Row:
        """Return the output of `fixel replay --json`."""
        answer = {
            "dataset": self.dataset,
            "settings": self.settings,
            "left_out": self.left_out,
            "not_solved": self.not_solved,
            "groups": self.groups,
            "notes": self.notes,
            "timing": self.timing.summary(),
            "pushes": self.pushes,
        }
        plain = _plain(answer)
        assert isinstance(plain, dict)
        return plain


def mean_and_median(values: ArrayLike) -> Row:
    """Mean and median of the finite numbers; None if there are none."""
    numbers = np.asarray(values, dtype=np.float64)
    numbers = numbers[np.isfinite(numbers)]
    if not numbers.size:
        return {"mean": None, "median": None}
    return {"mean": float(numbers.mean()), "median": float(np.median(numbers))}


def rms(values: ArrayLike) -> float:
    """Root mean square of numbers."""
    return float(np.sqrt(np.mean(np.square(np.asarray(values, dtype=np.float64)))))


def _plain(value: Any) -> Any:
    """Convert to numbers and containers of JSON; numbers that are not finite become None."""
    if isinstance(value, dict):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
