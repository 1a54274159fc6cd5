"""Request, base and result of replays: selection of records, parts to simulate, and rows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fixel.errors import InvalidInput, unknown_name
from fixel.model import Body, Disk, LineDrive, Pusher, Scene, UniformPressure, pose_error
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Place of the pusher of a template, clear of the object [m].
CLEAR_DISTANCE = 1.0


Row = dict[str, Any]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayRequest:
    """Request of a replay: records, values and method.

    Parameters
    ----------
    select : mapping from column to values
        Select records whose columns all have one of the given values.
    limit : int, optional
        Maximum number of records, spread evenly over those selected.
    settings : mapping from name to number
        Values that replace the nominal ones.
    motion : str, optional
        Name of a motion model; by default that of the dataset.
    everything : bool
        Include records that the quality filter would exclude.
    window : float
        Length of the windows of long runs [s]; 0 for whole runs.
    """

    select: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    limit: int | None = None
    settings: Mapping[str, float] = field(default_factory=dict)
    motion: str | None = None
    everything: bool = False
    window: float = 2.0


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
    figure : callable
        Function that draws the replay.
    timing : dict
        Wall times of the parts [s]; `per_second` counts the simulation alone.
    """

    dataset: str
    pushes: list[Row]
    groups: list[Row]
    left_out: dict[str, int]
    not_solved: int
    settings: Row
    notes: list[str]
    figure: Callable[[], Figure] = field(repr=False)
    timing: Row = field(default_factory=dict)

    def summary(self) -> Row:
        """Return the output of `fixel replay --json`."""
        names = ("dataset", "settings", "left_out", "not_solved", "groups", "notes", "timing")
        return {name: getattr(self, name) for name in (*names, "pushes")}


class ReplayPart(NamedTuple):
    """Part of a replay that is simulated at once."""

    name: str
    n: int  # number of its records
    item: Any


class AbstractReplay(ABC):
    """Base class of replays, which read a dataset and simulate the requested records."""

    parts: list[ReplayPart]

    @abstractmethod
    def __init__(self, folder: Path, request: ReplayRequest) -> None:
        """Read the dataset and select its parts."""

    @abstractmethod
    def simulate(self, item: Any) -> Any:
        """Simulate one part."""

    @abstractmethod
    def result(self, outcomes: list[Any]) -> Replay:
        """Compare the outcomes of all parts with the measurements."""


def template(
    body: Body, tip: Disk, settings: dict[str, float], speed: float, duration: float
) -> Scene:
    """Build a scene whose starts and paths vary: a tip clear of a body with even pressure.

    Measured starts may overlap, due to noise of the tracker; the first step separates them.
    """
    n_points = settings["support_points"]
    if n_points != int(n_points):
        raise InvalidInput("--set support_points", found=n_points, expected="a whole number")
    support = UniformPressure(friction=settings["mu_support"], n_points=int(n_points))
    return Scene(
        bodies=(replace(body, name="object", pose=np.zeros(3), support=support),),
        pushers=(
            Pusher(
                name="pusher",
                shape=tip,
                pose=np.array([CLEAR_DISTANCE, 0.0, 0.0]),
                drive=LineDrive(direction=np.array([1.0, 0.0]), speed=speed),
                friction=settings["mu_pusher"],
            ),
        ),
        duration=duration,
    )


# --- selection and settings ----------------------------------------------------------------------


def columns_and_values(pairs: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Parse `["shape=rect1", "shape=hex"]` to a mapping from column to requested values."""
    wanted: dict[str, tuple[str, ...]] = {}
    for pair in pairs:
        name, value = _cut(pair, "--select", "COLUMN=VALUE, as in shape=rect1")
        wanted[name] = (*wanted.get(name, ()), value)
    return wanted


def names_and_numbers(pairs: Iterable[str]) -> dict[str, float]:
    """Parse `["mu_pusher=0.2"]` to a mapping from name to number."""
    values: dict[str, float] = {}
    for pair in pairs:
        name, text = _cut(pair, "--set", "NAME=VALUE, as in mu_pusher=0.2")
        try:
            values[name] = float(text)
        except ValueError:
            raise InvalidInput(f"--set {name}", found=repr(text), expected="a number") from None
    return values


def matching(
    columns: Mapping[str, Sequence[object]], wanted: Mapping[str, tuple[str, ...]], n: int
) -> NDArray[np.bool_]:
    """Mask (n,) of the matching records; raise if a column or a value occurs in none of them."""
    fits = np.ones(n, dtype=bool)
    for name, values in wanted.items():
        if name not in columns:
            raise unknown_name("--select", name, columns)
        cells = [str(cell) for cell in columns[name]]
        for value in values:
            if not any(_same(cell, value) for cell in set(cells)):
                raise InvalidInput(
                    f"--select {name}",
                    found=repr(value),
                    expected="one of " + _shortened(sorted(set(cells))),
                )
        chosen = {cell for cell in set(cells) if any(_same(cell, value) for value in values)}
        fits &= np.array([cell in chosen for cell in cells], dtype=bool)
    if not fits.any():
        raise InvalidInput(
            "--select",
            found=", ".join(f"{name}={'|'.join(values)}" for name, values in wanted.items()),
            expected="values that occur together in at least one record",
        )
    return fits


def spread(n: int, limit: int | None) -> NDArray[np.intp]:
    """Select at most `limit` of `n` records, evenly spread, in order."""
    if limit is None or limit >= n:
        return np.arange(n)
    return np.arange(limit) * n // limit


def settings_from(
    nominal: Mapping[str, float], given: Mapping[str, float], where: str = "--set"
) -> dict[str, float]:
    """Replace nominal values by given ones; raise for unknown names."""
    for name in given:
        if name not in nominal:
            raise unknown_name(where, name, nominal)
    return {**nominal, **given}


def _cut(pair: str, option: str, expected: str) -> tuple[str, str]:
    name, mark, value = pair.partition("=")
    if not mark or not name.strip() or not value.strip():
        raise InvalidInput(option, found=repr(pair), expected=expected)
    return name.strip(), value.strip()


def _same(cell: str, value: str) -> bool:
    try:
        return cell == value or float(cell) == float(value)
    except ValueError:
        return False


def _shortened(values: Sequence[str], most: int = 12) -> str:
    more = f", ... ({len(values)} in all)" if len(values) > most else ""
    return ", ".join(values[:most]) + more


def errors_in_mm_and_deg(
    predicted: FloatArray, measured: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Distances of the frames' origins [mm] and absolute angles between them [deg]."""
    position, angle = pose_error(predicted, measured)
    missing = np.isnan(predicted).any(axis=1)
    return (
        np.where(missing, np.nan, position * 1e3),
        np.where(missing, np.nan, np.degrees(np.abs(angle))),
    )


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
