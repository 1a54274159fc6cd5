"""Base and result of replays: parts to simulate, rows, aggregates, and settings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model import Body, Disk, LineDrive, Pusher, Scene, UniformPressure
from fixel.reproductions.replay.request import ReplayRequest
from fixel.reproductions.result import Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Place of the pusher of a template, clear of the object [m].
CLEAR_DISTANCE = 1.0


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
