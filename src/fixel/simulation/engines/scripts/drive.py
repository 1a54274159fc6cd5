"""Drive and poses of a model. Used by `run.py`; needs only Python."""

from __future__ import annotations

import csv
import itertools
import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

Poses = list[Sequence[float]]
SHORTEST = 1e-6  # [s] between two ends of segments


class EngineFailed(Exception):
    """Exception raised by an engine that cannot finish one simulation; its text is the reason."""


def load() -> dict[str, Any]:
    """Load `model.json`, whose numbers are in its units.

    These are SI for parts of 50 to 150 mm and 0.1 to 1 kg. Others are written at such a size and
    at the origin, for which engines are made; gravity is the same number in all units.
    """
    text = Path(__file__).with_name("model.json").read_text("utf-8")
    model: dict[str, Any] = json.loads(text)
    return model


def pusher_path(model: dict[str, Any]) -> list[list[float]]:
    """Return the waypoints of the pusher: time, x, y, theta; one at the origin without a pusher."""
    path: list[list[float]] = model["pusher"]["path"] if model["pusher"] else [[0.0] * 4]
    return path


def pusher_at(path: list[list[float]], time: float) -> list[float]:
    """Return the pose of the pusher at a time; it stands before the first waypoint and after."""
    if time <= path[0][0]:
        return path[0][1:]
    for one, other in itertools.pairwise(path):
        if time < other[0]:
            span = other[0] - one[0]
            return [
                (b - a) / span * (time - one[0]) + a
                for a, b in zip(one[1:], other[1:], strict=True)
            ]
    return path[-1][1:]


def segments(model: dict[str, Any]) -> Iterator[tuple[int, float, list[float], bool]]:
    """Yield number and length of steps, velocity of the pusher, and whether a sample follows.

    A waypoint very near another end is left out: engines divide by the length of a step.
    """
    path, times = pusher_path(model), [time for time in model["times"] if time > 0.0]
    ends = [(time, True) for time in times]
    for row in path[1:]:
        apart = min(abs(row[0] - time) for time in [0.0, *times])
        if apart > SHORTEST and row[0] < times[-1]:
            ends.append((row[0], False))
    before = 0.0
    for end, wanted in sorted(ends):
        duration = end - before
        if duration < SHORTEST and not wanted:
            continue
        poses = zip(pusher_at(path, before), pusher_at(path, end), strict=True)
        velocity = [(b - a) / duration for a, b in poses]
        n = math.ceil(duration / model["choices"]["step"] * (1.0 - 1e-9))
        yield n, duration / n, velocity, wanted
        before = end


def in_frame(pose: Sequence[float], frame: Sequence[float]) -> list[float]:
    """Return the pose of a frame that is fixed to the body, from the pose of the body."""
    x, y, theta = map(float, pose)
    cosine, sine = math.cos(theta), math.sin(theta)
    return [
        x + cosine * frame[0] - sine * frame[1],
        y + sine * frame[0] + cosine * frame[1],
        theta + frame[2],
    ]


def run(simulate: Callable[[dict[str, Any]], Iterable[Sequence[float]]]) -> None:
    """Simulate the model, and write the poses of the body to standard output as CSV."""
    model = load()
    length, second = model["units"]["length_m"], model["units"]["time_s"]
    x0, y0 = model["units"]["origin_m"]
    try:
        poses = simulate(model)
    except EngineFailed as failure:
        raise SystemExit(str(failure)) from None
    table = csv.writer(sys.stdout, lineterminator="\n")
    table.writerow(("time_s", "x_m", "y_m", "theta_rad"))
    for time, (x, y, theta) in zip(model["times"], poses, strict=True):
        pose = in_frame((x0 + length * x, y0 + length * y, theta), model["frame"])
        table.writerow((second * time, *pose))
