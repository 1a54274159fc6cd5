"""Replay of recorded pushes: build their scenes, drive the measured paths, and compare."""

from __future__ import annotations

import time as clock
from pathlib import Path

from fixel.datasets.raw import MitPushes, RpiTrials, read_dataset
from fixel.reproductions.replay.choose import ReplayRequest, columns_and_values, names_and_numbers
from fixel.reproductions.replay.mit_push import replay_pushes
from fixel.reproductions.replay.mit_timeseries import replay_runs
from fixel.reproductions.replay.report import Replay, Timing
from fixel.reproductions.replay.rpi_2dgad import replay_trials
from fixel.typing import Progress


def replay_dataset(
    folder: str | Path, choice: ReplayRequest | None = None, progress: Progress | None = None
) -> Replay:
    """Replay the pushes of a folder.

    Parameters
    ----------
    folder : str or Path
        Folder of a dataset that `fixel.datasets.raw` can read.
    choice : ReplayRequest, optional
        Selection of records and values; by default all records with nominal values.
    progress : callable, optional
        Called after each part with the numbers of finished records and of all, and its name.

    Raises
    ------
    DatasetMissing
        The folder has no known dataset.
    InvalidInput
        Invalid files, selection or value.
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
    """Draw a replay to a file: .png, .svg or .pdf."""
    from fixel.reproductions.charts.replay import draw

    draw(replay.picture, file)


def refuse_picture(file: Path) -> None:
    """Raise `InvalidInput` for a file that cannot be drawn to, before the replay is computed."""
    from fixel.reproductions.charts.replay import refuse_file

    refuse_file(file)


def _silent(done: int, total: int, note: str = "") -> None:
    """Progress callback that does nothing."""


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
