"""Replay of recorded pushes: simulation of imported experiments along their measured paths."""

from __future__ import annotations

import time as clock
from dataclasses import replace
from pathlib import Path

from fixel.datasets import importer_for
from fixel.datasets.mit_push import has_pushes
from fixel.errors import DatasetMissing
from fixel.replay.base import AbstractReplay, Replay, ReplayRequest
from fixel.replay.pushes import PushReplay
from fixel.replay.runs import RunReplay
from fixel.replay.trials import TrialReplay
from fixel.typing import ProgressCallback

EXPECTED = (
    "pushes.csv.gz and shapes.json (mit_push_endpoints), experiments.csv, object_trajectory.csv.gz"
    " and exp<number>_setup.json (rpi_2dgad), or cpush_*.csv.gz and shapes.json (mit_timeseries)"
)


def replay_dataset(
    folder: str | Path,
    request: ReplayRequest | None = None,
    progress: ProgressCallback | None = None,
) -> Replay:
    """Replay the pushes of a folder; by default all records with nominal values.

    `progress` is called after each part with the numbers of finished records and of all, and its
    name. A folder without a known dataset raises `DatasetMissing`.
    """
    begun = clock.perf_counter()
    folder = Path(folder)
    replay = _replay_of(folder)(folder, request or ReplayRequest())
    total = sum(n for _, n, _ in replay.parts)

    read = clock.perf_counter()
    replay.simulate(replay.parts[0][2])  # compile, or load compiled code
    started = clock.perf_counter()
    outcomes, done = [], 0
    for name, n, item in replay.parts:
        outcomes.append(replay.simulate(item))
        done += n
        if progress is not None:
            progress(done, total, name)
    ended = clock.perf_counter()

    answer = replay.result(outcomes)
    n = len(answer.pushes)
    seconds = clock.perf_counter() - begun
    timing = {
        "reading_s": read - begun,
        "compiling_s": started - read,
        "simulation_s": ended - started,
        "total_s": seconds,
        "simulated": n,
        "per_second": n / (ended - started),
        "per_second_end_to_end": n / seconds,
    }
    return replace(answer, timing=timing)


def _replay_of(folder: Path) -> type[AbstractReplay]:
    """Kind of replay for a folder, by the importer that recognises it."""
    hint = None
    try:
        name = importer_for(folder).name
    except DatasetMissing as problem:
        name, hint = "", problem.hint
    if name == "mit-push" and has_pushes(folder):
        return PushReplay
    if name in KINDS:
        return KINDS[name]
    raise DatasetMissing(folder, EXPECTED, hint)


KINDS = {"rpi-2dgad": TrialReplay, "mit-pusher-slider": RunReplay}

__all__ = ["Replay", "ReplayRequest", "replay_dataset"]
