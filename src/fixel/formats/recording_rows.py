"""Rows of `frames.csv`: one per frame, each with a checksum, append-only.

A row identifies its picture in the video by time, length and checksum. Any program that reads CSV
can read the file; the checksum at the end of a row is that of the text before it.
"""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Final, NamedTuple

from fixel.errors import InvalidInput, os_reason

HEAD: Final = "frame,time_s,reading,reading_time_s,bytes,video_bytes,picture_crc32,row_crc32\n"
MICRO: Final = 1_000_000


class RecordingRow(NamedTuple):
    """Row of one frame.

    Attributes
    ----------
    frame : int
        Number of the frame, from 0.
    time_us : int
        Time of its arrival [µs].
    reading : int
        Tactile byte, -1 for none.
    reading_time_us : int
        Time at which the tactile byte was read [µs], -1 for none.
    size : int
        Size of its picture in the video [bytes].
    video_end : int
        Offset of the end of its picture in the video file [bytes].
    crc : int
        CRC-32 of its picture in the video.
    """

    frame: int
    time_us: int
    reading: int
    reading_time_us: int
    size: int
    video_end: int
    crc: int


class RecordingRows(NamedTuple):
    """Intact rows of a file.

    Attributes
    ----------
    rows : list of RecordingRow
        All intact rows.
    ends : list of int
        Offset of the end of each row in the file [bytes].
    torn : bool
        Whether the file ends with incomplete or damaged rows.
    """

    rows: list[RecordingRow]
    ends: list[int]
    torn: bool


def row_text(row: RecordingRow) -> bytes:
    """Encode a row as a line of the file, with its checksum."""
    reading = "" if row.reading < 0 else str(row.reading)
    text = (
        f"{row.frame},{_seconds(row.time_us)},{reading},{_seconds(row.reading_time_us)},"
        f"{row.size},{row.video_end},{row.crc:08x}"
    ).encode("ascii")
    return b"%s,%08x\n" % (text, zlib.crc32(text))


def read_rows(path: Path) -> RecordingRows:
    """Load all intact rows.

    Raises
    ------
    InvalidInput
        No such file, or a damaged or missing row before intact ones.
    """
    try:
        lines = path.read_bytes().splitlines(keepends=True)
    except OSError as problem:
        reason = os_reason(problem)
        raise InvalidInput(str(path), found=reason, expected="the rows of a recording") from None
    if not lines or lines[0] != HEAD.encode("ascii"):
        found = (
            "another first line" if lines and lines[0].endswith(b"\n") else "no whole first line"
        )
        raise InvalidInput(str(path), found=found, expected=HEAD.strip())
    rows: list[RecordingRow] = []
    ends: list[int] = []
    end = len(lines[0])
    broken = 0
    for number, line in enumerate(lines[1:], 2):
        end += len(line)
        row = _row(line)
        if row is None:
            broken = broken or number
            continue
        if broken:
            raise InvalidInput(
                f"{path}, line {broken}",
                found="a damaged row before rows that are whole",
                expected="rows as they were written",
                hint="frames and readings can no longer be paired without guessing",
            )
        _refuse_disorder(path, number, row, rows)
        rows.append(row)
        ends.append(end)
    return RecordingRows(rows, ends, bool(broken))


def _seconds(micro: int) -> str:
    return "" if micro < 0 else f"{micro // MICRO}.{micro % MICRO:06d}"


def _micro(seconds: bytes) -> int:
    if not seconds:
        return -1
    whole, _, part = seconds.partition(b".")
    return int(whole) * MICRO + int(part)


def _row(line: bytes) -> RecordingRow | None:
    """Parse a line; None if it is torn or damaged."""
    text, comma, crc = line.rstrip(b"\n").rpartition(b",")
    if not line.endswith(b"\n") or not comma or b"%08x" % zlib.crc32(text) != crc:
        return None
    try:
        frame, time, reading, reading_time, size, video_end, picture = text.split(b",")
    except ValueError:
        return None
    return RecordingRow(
        int(frame),
        _micro(time),
        int(reading or -1),
        _micro(reading_time),
        int(size),
        int(video_end),
        int(picture, 16),
    )


def _refuse_disorder(path: Path, number: int, row: RecordingRow, rows: list[RecordingRow]) -> None:
    if row.frame != len(rows):
        raise InvalidInput(
            f"{path}, line {number}",
            found=f"frame {row.frame}",
            expected=f"frame {len(rows)}",
            hint="rows were lost or put in, and which frame belongs to which cannot be told",
        )
    if rows and row.time_us <= rows[-1].time_us:
        raise InvalidInput(
            f"{path}, line {number}",
            found=f"time {_seconds(row.time_us)} s after {_seconds(rows[-1].time_us)} s",
            expected="times that increase",
        )
