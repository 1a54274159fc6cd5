"""What a benchmark measures: a figure, its bar, and how it is timed."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any, NamedTuple


class Bar(NamedTuple):
    """What a figure must reach."""

    limit: float
    at_most: bool = True

    def __str__(self) -> str:
        return f"{'<=' if self.at_most else '>='} {self.limit:g}"

    def is_met_by(self, value: float) -> bool:
        """Whether a value reaches the bar; a value that is not a number does not."""
        return value <= self.limit if self.at_most else value >= self.limit


def at_most(limit: float) -> Bar:
    return Bar(limit, True)


def at_least(limit: float) -> Bar:
    return Bar(limit, False)


@dataclass(frozen=True)
class Figure:
    """One measured quantity; its median is what counts.

    Parameters
    ----------
    name : str
    unit : str
        ``"-"`` for a pure number.
    values : tuple of float
        One a repeat.
    bar : Bar, optional
        None: reported for what it says, not held to anything.
    """

    name: str
    unit: str
    values: tuple[float, ...]
    bar: Bar | None = None

    def __post_init__(self) -> None:
        if not self.values:
            raise ValueError(f"{self.name}: no values")

    @property
    def median(self) -> float:
        return median(self.values)

    @property
    def passed(self) -> bool | None:
        """Whether the bar is met; None without a bar."""
        return None if self.bar is None else self.bar.is_met_by(self.median)


@dataclass(frozen=True)
class Size:
    """How much work a benchmark does."""

    rollouts: int  # in a batch
    subset: int  # of them checked against a second stepper
    repeats: int  # of a batch or of a process
    calls: int  # of something that takes milliseconds
    heaps: tuple[int, ...]  # bodies of each heap
    heap_seconds: float
    finest_peer_step: float  # [s]


FULL = Size(
    rollouts=10_000,
    subset=200,
    repeats=5,
    calls=51,
    heaps=(30, 100, 300),
    heap_seconds=10.0,
    finest_peer_step=1e-4,
)
SMALL = Size(
    rollouts=16,
    subset=2,
    repeats=1,
    calls=3,
    heaps=(2, 4, 6),
    heap_seconds=0.5,
    finest_peer_step=5e-3,
)


def seconds(
    call: Callable[[], Any],
    repeats: int,
    warm_up: bool = True,
    clock: Callable[[], float] = time.perf_counter,
) -> tuple[float, ...]:
    """Seconds (wall clock) of each of `repeats` calls, after one that does not count."""
    if warm_up:
        call()
    taken = []
    for _ in range(repeats):
        start = clock()
        call()
        taken.append(clock() - start)
    return tuple(taken)
