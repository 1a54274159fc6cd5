"""What a replay leaves behind: rows, aggregates, and how they were made."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

Row = dict[str, Any]

# Length by which angles count in the error of the thesis [m/rad] (section 5.1: "a scale of 35").
ANGLE_LENGTH = 35e-3

# Told after each part: how many of how many are done, and what they are.


class Timing(NamedTuple):
    """Where the time went [s]."""

    reading: float
    compiling: float  # or loading compiled kernels, and one push
    simulation: float
    total: float
    simulated: int

    def summary(self) -> Row:
        """Plain numbers; the rate is that of the simulation alone."""
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
    """Recorded pushes, simulated again.

    Attributes
    ----------
    dataset : str
    pushes : list of dict
        One row for each push, window or run, as plain numbers; units are in the names.
    groups : list of dict
        Aggregates; the last one is of all, where there is more than one.
    left_out : dict from reason to count
        Records that were not replayed.
    not_solved : int
        Simulations that did not finish; they count in no aggregate.
    settings : dict
        Values and methods, enough to do it again.
    notes : list of str
        What was done to the data, in sentences.
    timing : Timing
    picture : object
        What the drawing of this dataset asks for.
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
        """The answer of `fixel replay --json`."""
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
    """Of the numbers that are there; None where there are none."""
    numbers = np.asarray(values, dtype=np.float64)
    numbers = numbers[np.isfinite(numbers)]
    if not numbers.size:
        return {"mean": None, "median": None}
    return {"mean": float(numbers.mean()), "median": float(np.median(numbers))}


def rms(values: ArrayLike) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(np.asarray(values, dtype=np.float64)))))


def _plain(value: Any) -> Any:
    """Numbers and containers that JSON knows; what is not finite becomes None."""
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
