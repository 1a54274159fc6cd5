"""Writer of recordings that stay readable however they end."""

from __future__ import annotations

import errno
import math
import os
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Final, final

from fixel.errors import InvalidInput, os_reason
from fixel.formats.recording_files import (
    HEAD,
    HEADER,
    MICRO,
    ROWS,
    VIDEO,
    RecordingEnd,
    RecordingHeader,
    RecordingRow,
    row_text,
    write_end,
    write_header,
)
from fixel.formats.recording_video import StoredPacket, VideoSink
from fixel.vision.frame import Frame

MAX_READING: Final = 255
RESERVE: Final = ".reserve"  # reserves space for the end mark, in case the disk becomes full
RESERVED: Final = 65536  # [bytes]


@final
class RecordingWriter:
    """Writer of a recording, frame by frame and without buffering.

    Parameters
    ----------
    folder : str or Path
        Folder to create.
    header : RecordingHeader

    Raises
    ------
    InvalidInput
        The folder exists already or cannot be created.

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
        try:
            (self.folder / RESERVE).write_bytes(bytes(RESERVED))
            self._rows = open(self.folder / ROWS, "xb", buffering=0)  # noqa: SIM115
            self._rows_end = self._rows.write(HEAD.encode("ascii"))
            self._video = VideoSink(self.folder / VIDEO, header.size, exact=header.codec == "exact")
        except OSError as problem:
            raise _refusal(self.folder, problem) from None

    @property
    def seconds(self) -> float:
        """Time of the last frame [s], 0 before the first."""
        return max(self._last_us, 0) / MICRO

    def write(
        self, frame: Frame, reading: int | None = None, reading_time: float | None = None
    ) -> None:
        """Append a frame and its tactile reading.

        Parameters
        ----------
        frame : Frame
            Frame at least a microsecond later than the previous one.
        reading : int, optional
            Tactile byte; None if none arrived.
        reading_time : float, optional
            Time at which the tactile byte was read, on the clock of the frames [s].

        Raises
        ------
        InvalidInput
            A picture of another size, a time that does not increase, a reading that is no byte.
        OSError
            The disk is full or not available.
        """
        width, height = self.header.size
        if self.header.codec == "as-it-comes":
            raise InvalidInput(
                "recording.codec",
                found="a decoded picture",
                expected="JPEG data; the codecs near and exact take pictures",
            )
        if frame.picture.shape != (height, width, 3) or frame.picture.dtype.name != "uint8":
            raise InvalidInput(
                f"frame {self.frames}",
                found=f"a picture of shape {frame.picture.shape}, {frame.picture.dtype}",
                expected=f"({height}, {width}, 3), uint8",
            )
        time_us = self._micro(frame.time)
        self._check_reading(reading)
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
        time_us = self._micro(time)
        self._check_reading(reading)
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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()

    def _note(
        self, time_us: int, reading: int | None, reading_time: float | None, written: StoredPacket
    ) -> None:
        """Append the row of a picture already in the video; without a row it would not count."""
        row = RecordingRow(
            frame=self.frames,
            time_us=time_us,
            reading=-1 if reading is None else reading,
            reading_time_us=-1 if reading_time is None else max(round(reading_time * MICRO), 0),
            size=written.size,
            video_end=written.end,
            crc=written.crc,
        )
        text = row_text(row)
        if self._rows.write(text) != len(text):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.folder / ROWS))
        self.frames += 1
        self.bytes = written.end
        self._rows_end += len(text)
        self._last_us = time_us

    def _micro(self, time: float) -> int:
        """Convert a time to microseconds; raise if it does not increase."""
        if not math.isfinite(time) or time < 0.0 or (micro := round(time * MICRO)) <= self._last_us:
            raise InvalidInput(
                f"frame {self.frames}",
                found=f"time {time} s after {self.seconds:.6f} s",
                expected="increasing times from 0",
            )
        return micro

    def _check_reading(self, reading: int | None) -> None:
        if reading is not None and not 0 <= reading <= MAX_READING:
            raise InvalidInput(f"frame {self.frames}", found=reading, expected="a byte or None")

    def _let_go(self) -> None:
        self._closed = True
        self._rows.close()
        self._video.close()
        with suppress(OSError):  # cut off the part of a frame that a full disk accepted
            if self.frames:
                os.truncate(self.folder / ROWS, self._rows_end)
                os.truncate(self.folder / VIDEO, self.bytes)
        (self.folder / RESERVE).unlink(missing_ok=True)


def _make(folder: Path) -> None:
    """Create a folder; raise if it exists already."""
    if (folder / HEADER).exists():
        raise InvalidInput(str(folder), found="a recording", expected="a new folder")
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise InvalidInput(
            str(folder), found="an existing file or folder", expected="a new folder"
        ) from None
    except OSError as problem:
        raise _refusal(folder, problem) from None


def _refusal(folder: Path, problem: OSError) -> InvalidInput:
    reason = os_reason(problem)
    return InvalidInput(
        str(folder), found=reason, expected="a folder that can be created and written to"
    )
