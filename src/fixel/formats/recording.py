"""Recordings: folders with a video, a table with one row per frame, and metadata.

    recording.json   header, written before the first frame
    video.nut        pictures
    frames.csv       one row per frame: arrival time, tactile reading, checksum of its picture
    end.json         reason of the end; missing after a crash

Every row identifies its picture by time, length and checksum. From an interrupted recording, the
longest beginning in which each row has its picture is read; any other mismatch is an error.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from fixel.errors import InvalidInput, os_reason
from fixel.formats.recording_files import (
    CODECS,
    END,
    HEADER,
    MICRO,
    ROWS,
    VIDEO,
    RecordingEnd,
    RecordingHeader,
    RecordingRow,
    RecordingRows,
    read_end,
    read_header,
    read_rows,
    write_end,
)
from fixel.formats.recording_video import PictureDecoder, packets
from fixel.formats.recording_writer import RESERVE, RecordingWriter
from fixel.typing import FloatArray
from fixel.vision.frame import Frame

__all__ = [
    "CODECS",
    "VIDEO",
    "Recording",
    "RecordingEnd",
    "RecordingHeader",
    "RecordingWriter",
    "is_recording",
    "open_recording",
    "repair_recording",
]

NO_READING: Final = -1


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """Recording that has been loaded and checked."""

    folder: Path
    header: RecordingHeader
    end: RecordingEnd | None  # end mark; None if the recording was interrupted
    time: FloatArray  # (n,) arrival time of each frame, since the recording began [s]
    readings: NDArray[np.int64]  # (n,) tactile byte of each frame, -1 for none
    reading_time: FloatArray  # (n,) time at which the tactile byte was read [s], NaN for none
    video: Path
    problems: tuple[str, ...]  # defects, such as missing frames, one sentence each

    @property
    def complete(self) -> bool:
        """Whether the recording has an end mark and no frames are missing."""
        return self.end is not None and self.end.frames == len(self.time)

    @property
    def n_frames(self) -> int:
        """Number of readable frames."""
        return len(self.time)

    def jpegs(self) -> Iterator[tuple[float, bytes]]:
        """Yield time [s] and JPEG data of every frame; raise for the codec `exact`."""
        if self.header.codec == "exact":
            raise InvalidInput(str(self.folder), found="an exact recording", expected="JPEG")
        for time, (_, data) in zip(self.time, packets(self.video), strict=False):
            yield float(time), data

    def frames(self) -> Iterator[Frame]:
        """Yield all frames in order, with their recorded times.

        Raises
        ------
        InvalidInput
            A picture that cannot be decoded because the camera sent it corrupt.
        """
        decoder = PictureDecoder(self.header.size, exact=self.header.codec == "exact")
        for k, (_, data) in enumerate(packets(self.video)):
            if k == self.n_frames:
                return
            where = f"{self.video}, frame {k}"
            frame = decoder.frame(float(self.time[k]), data, where)
            if frame is None:
                width, height = self.header.size
                raise InvalidInput(
                    where,
                    found="no picture in it",
                    expected=f"a picture of {width} x {height} pixels",
                    hint="the camera sent it so",
                )
            yield frame


class _Agreement(NamedTuple):
    """Rows of a recording, and the number of them whose pictures match."""

    rows: RecordingRows
    matched: int
    seen: int  # pictures in the video


def is_recording(folder: str | Path) -> bool:
    """Whether a folder contains a recording."""
    return (Path(folder) / HEADER).is_file()


def open_recording(folder: str | Path) -> Recording:
    """Load a recording and check every row against its picture.

    Raises
    ------
    InvalidInput
        No recording, or one whose rows and pictures do not match.
    """
    folder = Path(folder)
    header, end = read_header(folder), read_end(folder)
    check = _checked(folder)
    n = check.matched
    rows = check.rows.rows[:n]
    if end is not None and len(check.rows.rows) > end.frames:
        raise InvalidInput(
            str(folder / ROWS),
            found=f"{len(check.rows.rows)} rows",
            expected=f"{end.frames} rows, as in {END}",
        )
    reading_us = np.array([row.reading_time_us for row in rows], dtype=np.float64)
    return Recording(
        folder=folder,
        header=header,
        end=end,
        time=np.array([row.time_us for row in rows], dtype=np.float64) / MICRO,
        readings=np.array([row.reading for row in rows], dtype=np.int64),
        reading_time=np.where(reading_us < 0.0, np.nan, reading_us / MICRO),
        video=folder / VIDEO,
        problems=tuple(_problems(check, end)),
    )


def repair_recording(folder: str | Path) -> Recording:
    """Cut off rows and pictures without a counterpart at the end, and write the end mark.

    Both files are shortened in place, rows first, so that an interrupted repair can be repeated.

    Raises
    ------
    InvalidInput
        As in `open_recording`; or the folder cannot be written to.
    """
    folder = Path(folder)
    recording = open_recording(folder)
    check = _checked(folder)
    last = check.rows.rows[check.matched - 1]
    try:
        os.truncate(folder / ROWS, check.rows.ends[check.matched - 1])
        os.truncate(folder / VIDEO, last.video_end)
        (folder / RESERVE).unlink(missing_ok=True)
    except OSError as problem:
        reason = os_reason(problem)
        raise InvalidInput(
            str(folder), found=reason, expected="a folder that can be written to"
        ) from None
    if not recording.complete:
        before = recording.end
        reason = before.reason if before else f"interrupted at t = {last.time_us / MICRO:.3f} s"
        write_end(
            folder,
            RecordingEnd(
                frames=check.matched,
                seconds=last.time_us / MICRO,
                reason=reason,
                lost=before.lost if before else 0,
                problems=tuple(_broken_off(check, before)) + (before.problems if before else ()),
            ),
        )
    return open_recording(folder)


def _checked(folder: Path) -> _Agreement:
    """Compare rows with pictures; raise if more than the end of the recording is damaged."""
    rows = read_rows(folder / ROWS)
    matched = seen = 0
    for seen, packet in enumerate(packets(folder / VIDEO), 1):
        fits = seen <= len(rows.rows) and _belong(rows.rows[seen - 1], *packet)
        matched += fits and matched == seen - 1
    strangers = min(seen, len(rows.rows)) - matched
    # Only the picture that was being written at the crash can be torn; more indicate other damage.
    if strangers > 1 or (strangers == 1 and seen > len(rows.rows)):
        raise InvalidInput(
            f"{folder / VIDEO}, frame {matched}",
            found="a picture that does not match its row",
            expected=f"the pictures that {ROWS} was written with",
            hint="frames and readings can no longer be paired without guessing",
        )
    if matched == 0:
        raise InvalidInput(
            str(folder),
            found="a recording that ended before its first frame was whole",
            expected="one frame at least",
        )
    return _Agreement(rows, matched, seen)


def _belong(row: RecordingRow, time_us: int, data: bytes) -> bool:
    return (row.time_us, row.size) == (time_us, len(data)) and row.crc == zlib.crc32(data)


def _problems(check: _Agreement, end: RecordingEnd | None) -> Iterator[str]:
    """Defects of a recording, one sentence each."""
    yield from _broken_off(check, end)
    if end is not None:
        yield from end.problems
        if end.lost:
            yield f"{_frames(end.lost)} lost while recording"


def _broken_off(check: _Agreement, end: RecordingEnd | None) -> Iterator[str]:
    """Defects at the end of a recording, one sentence each."""
    n, n_rows = check.matched, len(check.rows.rows)
    seconds = check.rows.rows[n - 1].time_us / MICRO
    if end is None:
        yield f"interrupted at t = {seconds:.3f} s: no end mark"
    elif end.frames > n:
        yield (f"interrupted at t = {seconds:.3f} s: {n} of {end.frames} frames are left")
    if check.rows.torn:
        yield f"the last row of {ROWS} is torn; left out"
    if n_rows > n:
        yield f"{_frames(n_rows - n)} at the end without a whole picture; left out"
    if check.seen > n_rows:
        yield f"{_frames(check.seen - n_rows)} at the end without a row; left out"


def _frames(n: int) -> str:
    return f"{n} frame" + ("" if n == 1 else "s")
