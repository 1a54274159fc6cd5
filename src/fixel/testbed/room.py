"""Disk space that a recording needs, and free space."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Final

from fixel.errors import InvalidInput
from fixel.testbed.frame_source import Stream

MIN_TIME: Final = 60.0  # [s] of recording that must fit on the disk
SPARE: Final = 32 * 1024 * 1024  # [bytes] of the disk that stay free
USUAL_RATE: Final = 30.0  # [frames/s] assumed for a camera that does not report its rate
# Bytes per pixel for pictures of a testbed with noise, with a margin.
ROOM: Final = {"as-it-comes": 0.45, "near": 0.45, "exact": 2.0}


def free_space(folder: Path) -> int:
    """Free space [bytes] on the disk of a folder, which need not exist yet."""
    place = folder.absolute()
    while not place.exists():
        place = place.parent
    return shutil.disk_usage(place).free


def bytes_a_second(stream: Stream, codec: str) -> float:
    """Approximate growth of a recording [bytes/s]."""
    width, height = stream.size
    return width * height * ROOM[codec] * (stream.rate or USUAL_RATE)


def refuse_full_disk(folder: Path, stream: Stream, codec: str, limit: float | None) -> None:
    """Raise if a minute of recording, or the shorter limit, does not fit on the disk."""
    duration = MIN_TIME if limit is None else min(limit, MIN_TIME)
    needed = bytes_a_second(stream, codec) * duration + SPARE
    free = free_space(folder)
    if free < needed:
        raise InvalidInput(
            str(folder),
            found=f"{free / 1e6:.0f} MB free on its disk",
            expected=f"{needed / 1e6:.0f} MB, for {duration:.0f} s of {codec}",
            hint="make space, record elsewhere, or choose --codec near"
            if codec == "exact"
            else "make space, or record elsewhere",
        )
