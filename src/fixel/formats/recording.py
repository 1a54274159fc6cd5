"""Recordings: folders with a video, a table with one row per frame, and metadata.

    recording.json   header, written before the first frame
    video.nut        pictures
    frames.csv       one row per frame: arrival time, tactile reading, checksum of its picture
    end.json         reason of the end; missing after a crash

Every row identifies its picture by time, length and checksum. From an interrupted recording, the
longest beginning in which each row has its picture is read; any other mismatch is an error.
"""

from __future__ import annotations

import errno
import math
import os
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fixel.errors import InvalidInput, counted
from fixel.formats.recording_files import (
    CODECS,
    END,
    HEAD,
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
    row_text,
    write_end,
    write_header,
)
from fixel.formats.recording_video import StoredPacket, VideoSink, lossless, packets, stored_frame
from fixel.io.atomic import usable
from fixel.typing import FloatArray
from fixel.vision.frame import Frame

__all__ = [
    "CODECS",
    "RIG_FILE",
    "SCENE_FILE",
    "VIDEO",
    "Recording",
    "RecordingEnd",
    "RecordingHeader",
    "RecordingWriter",
    "is_recording",
    "open_recording",
    "repair_recording",
]

# Files that describe what a recording shows.
RIG_FILE: Final = "rig.yaml"
SCENE_FILE: Final = "scene.yaml"


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

        A picture that the camera sent corrupt raises `InvalidInput`.
        """
        size = self.header.size
        codec = lossless(size) if self.header.codec == "exact" else None
        for k, (_, data) in enumerate(packets(self.video)):
            if k == self.n_frames:
                return
            where = f"{self.video}, frame {k}"
            frame = stored_frame(float(self.time[k]), data, size, codec, where)
            if frame is None:
                expected = f"a picture of {size[0]} x {size[1]} pixels"
                hint = "the camera sent it so"
                raise InvalidInput(where, found="no picture in it", expected=expected, hint=hint)
            yield frame


def is_recording(folder: str | Path) -> bool:
    """Whether a folder contains a recording."""
    return (Path(folder) / HEADER).is_file()


def open_recording(folder: str | Path) -> Recording:
    """Load a recording and check every row against its picture.

    Raise `InvalidInput` for no recording, or one whose rows and pictures do not match.
    """
    return _opened(Path(folder), *_checked(Path(folder)))


def _opened(folder: Path, every: RecordingRows, n: int, seen: int) -> Recording:
    """Load a recording whose rows and pictures were compared."""
    header, end = read_header(folder), read_end(folder)
    rows, n_rows = every.rows[:n], len(every.rows)
    if end is not None and n_rows > end.frames:
        expected = f"{end.frames} rows, as in {END}"
        raise InvalidInput(str(folder / ROWS), found=f"{n_rows} rows", expected=expected)
    problems = [*_broken_off(every, n, seen, end), *(end.problems if end else ())]
    if end is not None and end.lost:
        problems.append(f"{counted(end.lost, 'frame')} lost while recording")
    reading_us = np.array([row.reading_time_us for row in rows], dtype=np.float64)
    return Recording(
        folder=folder,
        header=header,
        end=end,
        time=np.array([row.time_us for row in rows], dtype=np.float64) / MICRO,
        readings=np.array([row.reading for row in rows], dtype=np.int64),
        reading_time=np.where(reading_us < 0.0, np.nan, reading_us / MICRO),
        video=folder / VIDEO,
        problems=tuple(problems),
    )


def repair_recording(folder: str | Path) -> Recording:
    """Cut off rows and pictures without a counterpart at the end, and write the end mark.

    Both files are shortened in place, rows first, so that an interrupted repair can be repeated.
    """
    folder = Path(folder)
    rows, n, seen = _checked(folder)
    recording = _opened(folder, rows, n, seen)
    last = rows.rows[n - 1]
    with usable(folder, FOLDER):
        os.truncate(folder / ROWS, rows.ends[n - 1])
        os.truncate(folder / VIDEO, last.video_end)
        (folder / RESERVE).unlink(missing_ok=True)
    if not recording.complete:
        seconds = last.time_us / MICRO
        usual = RecordingEnd(n, seconds, reason=f"interrupted at t = {seconds:.3f} s")
        end = (recording.end or usual)._replace(frames=n, seconds=seconds)
        problems = (*_broken_off(rows, n, seen, recording.end), *end.problems)
        write_end(folder, end._replace(problems=problems))
    return open_recording(folder)


def _checked(folder: Path) -> tuple[RecordingRows, int, int]:
    """Compare rows with pictures; raise if more than the end of the recording is damaged.

    Return the rows, the number of those whose pictures match, and that of pictures in the video.
    """
    read_header(folder)  # raises in a folder without a recording
    rows = read_rows(folder / ROWS)
    matched = seen = 0
    for seen, packet in enumerate(packets(folder / VIDEO), 1):
        matched += matched == seen - 1 < len(rows.rows) and _belong(rows.rows[matched], *packet)
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
        found = "a recording that ended before its first frame was whole"
        raise InvalidInput(str(folder), found=found, expected="one frame at least")
    return rows, matched, seen


def _belong(row: RecordingRow, time_us: int, data: bytes) -> bool:
    return (row.time_us, row.size) == (time_us, len(data)) and row.crc == zlib.crc32(data)


def _broken_off(rows: RecordingRows, n: int, seen: int, end: RecordingEnd | None) -> Iterator[str]:
    """Defects at the end of a recording with n whole frames, one sentence each."""
    n_rows, seconds = len(rows.rows), rows.rows[n - 1].time_us / MICRO
    if end is None:
        yield f"interrupted at t = {seconds:.3f} s: no end mark"
    elif end.frames > n:
        yield (f"interrupted at t = {seconds:.3f} s: {n} of {end.frames} frames are left")
    if rows.torn:
        yield f"the last row of {ROWS} is torn; left out"
    if n_rows > n:
        yield f"{counted(n_rows - n, 'frame')} at the end without a whole picture; left out"
    if seen > n_rows:
        yield f"{counted(seen - n_rows, 'frame')} at the end without a row; left out"


MAX_READING: Final = 255
RESERVE: Final = ".reserve"  # name of the reserved space in recordings of earlier versions
RESERVED: Final = 65536  # [bytes]
FOLDER: Final = "a folder that can be created and written to"


class RecordingWriter:
    """Writer of a recording, frame by frame and without buffering, into a new folder.

    Examples
    --------
    >>> with RecordingWriter(folder, RecordingHeader(size=(1280, 720))) as writer:  # doctest: +SKIP
    ...     writer.write(frame, reading=0b010)
    """

    def __init__(self, folder: str | Path, header: RecordingHeader) -> None:
        self.folder = Path(folder)
        self.header = header
        self.frames = 0
        self.bytes = 0
        self._last_us = -1
        self._closed = False
        _make(self.folder)
        write_header(self.folder, header)
        with usable(self.folder, FOLDER):
            # Space for the end mark, in case the disk becomes full. It has no name, so that it is
            # free again also after this process was killed.
            self._reserve = TemporaryFile(dir=self.folder, buffering=0)  # noqa: SIM115
            self._reserve.write(bytes(RESERVED))
            self._rows = open(self.folder / ROWS, "xb", buffering=0)  # noqa: SIM115
            self._rows_end = self._rows.write(HEAD.encode("ascii"))
            self._video = VideoSink(self.folder / VIDEO, header.size, exact=header.codec == "exact")

    @property
    def seconds(self) -> float:
        """Time of the last frame [s], 0 before the first."""
        return max(self._last_us, 0) / MICRO

    def write(
        self, frame: Frame, reading: int | None = None, reading_time: float | None = None
    ) -> None:
        """Append a frame and its tactile reading.

        The frame is at least a microsecond later than the previous one. The tactile byte is None if
        none arrived; `reading_time` is on the clock of the frames [s]. A picture of another size, a
        time that does not increase or a reading that is no byte raises `InvalidInput`.
        """
        width, height = self.header.size
        if self.header.codec == "as-it-comes":
            expected = "JPEG data; the codecs near and exact take pictures"
            raise InvalidInput("recording.codec", found="a decoded picture", expected=expected)
        if frame.picture.shape != (height, width, 3) or frame.picture.dtype.name != "uint8":
            found = f"a picture of shape {frame.picture.shape}, {frame.picture.dtype}"
            raise InvalidInput(
                f"frame {self.frames}", found=found, expected=f"({height}, {width}, 3), uint8"
            )
        time_us = self._checked_time(frame.time, reading)
        written = self._video.append_picture(time_us, frame.picture)
        self._note(time_us, reading, reading_time, written)

    def write_jpeg(
        self,
        time: float,
        jpeg: bytes,
        reading: int | None = None,
        reading_time: float | None = None,
    ) -> None:
        """Append an unchanged JPEG picture and its tactile reading; see `write`."""
        if self.header.codec == "exact":
            raise InvalidInput(
                "recording.codec", found="exact", expected="the codec as-it-comes for JPEG"
            )
        if not jpeg:  # the video would omit it, and its row would have no picture
            raise InvalidInput(f"frame {self.frames}", found="no bytes", expected="a JPEG picture")
        time_us = self._checked_time(time, reading)
        written = self._video.append_jpeg(time_us, jpeg)
        self._note(time_us, reading, reading_time, written)

    def close(self, reason: str = "done", lost: int = 0, problems: tuple[str, ...] = ()) -> None:
        """Write the end mark and close the files; further calls do nothing."""
        if self._closed:
            return
        self._let_go()
        end = RecordingEnd(
            frames=self.frames, seconds=self.seconds, reason=reason, lost=lost, problems=problems
        )
        write_end(self.folder, end)

    def abandon(self) -> None:
        """Close the files without writing the end mark."""
        if not self._closed:
            self._let_go()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()

    def _note(
        self, time_us: int, reading: int | None, reading_time: float | None, written: StoredPacket
    ) -> None:
        """Append the row of a picture already in the video; without a row it would not count."""
        size, crc, video_end = written
        row = RecordingRow(
            frame=self.frames,
            time_us=time_us,
            reading=-1 if reading is None else reading,
            reading_time_us=-1 if reading_time is None else max(round(reading_time * MICRO), 0),
            size=size,
            video_end=video_end,
            crc=crc,
        )
        text = row_text(row)
        if self._rows.write(text) != len(text):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.folder / ROWS))
        self.frames += 1
        self.bytes = video_end
        self._rows_end += len(text)
        self._last_us = time_us

    def _checked_time(self, time: float, reading: int | None) -> int:
        """Convert a time to microseconds; raise unless it increases and a reading is a byte."""
        if not math.isfinite(time) or time < 0.0 or (micro := round(time * MICRO)) <= self._last_us:
            raise InvalidInput(
                f"frame {self.frames}",
                found=f"time {time} s after {self.seconds:.6f} s",
                expected="increasing times from 0",
            )
        if reading is not None and not 0 <= reading <= MAX_READING:
            found = f"the reading {reading!r}"
            raise InvalidInput(f"frame {self.frames}", found=found, expected="a byte or None")
        return micro

    def _let_go(self) -> None:
        self._closed = True
        self._rows.close()
        self._video.close()
        with suppress(OSError):  # cut off the part of a frame that a full disk accepted
            if self.frames:
                os.truncate(self.folder / ROWS, self._rows_end)
                os.truncate(self.folder / VIDEO, self.bytes)
        self._reserve.close()


def _make(folder: Path) -> None:
    """Create a folder; raise if it exists already."""
    if (folder / HEADER).exists():
        raise InvalidInput(str(folder), found="a recording", expected="a new folder")
    if folder.exists():
        raise InvalidInput(str(folder), found="an existing file or folder", expected="a new folder")
    with usable(folder, FOLDER):
        folder.mkdir(parents=True)
