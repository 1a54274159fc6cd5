"""Replay recorded pushes: build their scenes, drive the measured paths, and compare."""

from __future__ import annotations

import time as clock
from pathlib import Path

from fixel.datasets.raw import MitPushes, RpiTrials, read_dataset
from fixel.reproductions.replay.choose import ReplayRequest, columns_and_values, names_and_numbers
from fixel.reproductions.replay.mit_push import replay_pushes
from fixel.reproductions.replay.mit_timeseries import replay_runs
from fixel.reproductions.replay.report import Replay, Timing
from fixel.reproductions.replay.rpi_2dgad import replay_trials
from fixel.typing import NotedProgress


def replay_dataset(
    folder: str | Path, choice: ReplayRequest | None = None, progress: NotedProgress | None = None
) -> Replay:
    """Replay the pushes of a folder.

    Parameters
    ----------
    folder : str or Path
        One of the datasets that `fixel.datasets.raw` knows.
    choice : ReplayRequest, optional
        Which records, with which values; all of them with nominal values where left out.
    progress : callable, optional
        Told after each part how many records of how many are done, and what they are.

    Raises
    ------
    DatasetMissing
        Nothing known in the folder.
    InvalidInput
        Files, a selection or a value that cannot be.
    """
    choice = choice or ReplayRequest(select={}, settings={})
    progress = progress or _silent
    started = clock.perf_counter()
    data = read_dataset(Path(folder))
    reading = clock.perf_counter() - started
    if isinstance(data, MitPushes):
        return replay_pushes(data, choice, progress, reading)
    if isinstance(data, RpiTrials):
        return replay_trials(data, choice, progress, reading)
    return replay_runs(data, choice, progress, reading)


def draw_replay(replay: Replay, file: Path) -> None:
    """Draw a replay into a file: .png, .svg or .pdf."""
    from fixel.reproductions.charts.replay import draw

    draw(replay.picture, file)


def refuse_picture(file: Path) -> None:
    """Refuse a file that cannot be drawn into, before the work is done."""
    from fixel.reproductions.charts.replay import refuse_file

    refuse_file(file)


def _silent(done: int, of: int, what: str) -> None:
    """Nobody watches."""


__all__ = [
    "Replay",
    "ReplayRequest",
    "Timing",
    "columns_and_values",
    "draw_replay",
    "names_and_numbers",
    "refuse_picture",
    "replay_dataset",
]
