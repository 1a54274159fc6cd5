"""Text files of a recording: its header, its end mark, and one row per frame.

`recording.json` is the header, `end.json` is written after a regular end, and `frames.csv` is
append-only. A row of it identifies its picture in the video by time, length and checksum. Any
program that reads CSV can read the file; the checksum at the end of a row is that of the text
before it.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from fixel.errors import InvalidInput, check_name
from fixel.io.atomic import usable, write_whole
from fixel.model.fields import name_of, settle

VERSION: Final = 1
HEADER: Final = "recording.json"
END: Final = "end.json"
ROWS: Final = "frames.csv"
VIDEO: Final = "video.nut"

CODECS: Final = ("as-it-comes", "near", "exact")
CLOCK: Final = "monotonic, in seconds since the recording began; one for frames and readings"
HEAD: Final = "frame,time_s,reading,reading_time_s,bytes,video_bytes,picture_crc32,row_crc32\n"
MICRO: Final = 1_000_000
MAX_PIXELS: Final = 89_000_000  # of a picture; decoders take more for an attack


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingHeader:
    """Header of a recording, written before the first frame."""

    size: tuple[int, int]  # width and height of the pictures [px]
    # `as-it-comes` stores the JPEG pictures of a camera bit for bit, `near` writes JPEG of high
    # quality, `exact` is lossless.
    codec: str = "near"
    rig: str = ""  # name of the rig; empty for none
    source: str = ""  # source of the pictures
    simulated_by: str = ""  # program that generated the pictures, if no camera did
    started: str = ""  # time at which the clock was zero, ISO 8601 in UTC; empty for now
    # Nominal frames per second of the source, 0 for unknown; exact times are in the rows.
    rate: float = 0.0
    about: Mapping[str, Any] = field(default_factory=dict)  # further metadata

    def __post_init__(self) -> None:
        width, height = (int(side) for side in self.size)
        if min(width, height) < 1 or width * height > MAX_PIXELS:
            expected = f"width and height [px], at most {MAX_PIXELS // 10**6} megapixels"
            raise InvalidInput("recording.size", found=f"{width} x {height}", expected=expected)
        check_name("recording.codec", self.codec, CODECS)
        if self.rig:
            name_of(self.rig, "recording.rig")
        settle(
            self,
            size=(width, height),
            started=self.started or datetime.now(UTC).isoformat(timespec="milliseconds"),
            about=MappingProxyType(dict(self.about)),
        )


class RecordingEnd(NamedTuple):
    """End mark of a recording, written after a regular end."""

    frames: int  # number of frames
    seconds: float  # time of the last frame [s]
    reason: str  # reason why the recording ended
    lost: int = 0  # number of frames lost because the recorder was too slow
    problems: tuple[str, ...] = ()  # other problems, one sentence each


def write_header(folder: Path, header: RecordingHeader) -> None:
    """Write `recording.json`."""
    content = {name: getattr(header, name) for name in header.__dataclass_fields__}
    content |= {"about": dict(header.about), "size": list(header.size)}
    content = {"version": VERSION, "fixel": version("fixel"), "clock": CLOCK, **content}
    _write(folder / HEADER, content)


def write_end(folder: Path, end: RecordingEnd) -> None:
    """Write `end.json`, the mark of a regular end."""
    _write(folder / END, end._asdict())


def read_header(folder: Path) -> RecordingHeader:
    """Load `recording.json`; raise `InvalidInput` if it is missing or invalid."""
    content = _read(folder / HEADER)
    if content is None:
        found = f"no {HEADER}" if folder.is_dir() else "no such folder"
        raise InvalidInput(str(folder), found=found, expected="a folder written by `fixel record`")
    version = content.get("version")
    if version != VERSION:
        raise InvalidInput(
            str(folder / HEADER), found=f"version {version}", expected=f"version {VERSION}"
        )
    known = {key: content[key] for key in RecordingHeader.__dataclass_fields__ if key in content}
    try:
        return RecordingHeader(**known)
    except InvalidInput as problem:
        raise problem.within(str(folder / HEADER)) from None
    except (TypeError, ValueError) as problem:
        raise InvalidInput(str(folder / HEADER), found=problem, expected="a header") from None


def read_end(folder: Path) -> RecordingEnd | None:
    """Load `end.json`; None if there is none."""
    content = _read(folder / END)
    if content is None:
        return None
    with usable(folder / END, "an end mark", TypeError):
        end = RecordingEnd(**content)
        return end._replace(problems=tuple(end.problems))


def _write(path: Path, content: dict[str, Any]) -> None:
    write_whole(path, json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def _read(path: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as problem:
        raise InvalidInput(str(path), found=problem, expected="a JSON file") from None
    if not isinstance(content, dict):
        raise InvalidInput(str(path), found=content, expected="a JSON object")
    return content


class RecordingRow(NamedTuple):
    """Row of one frame."""

    frame: int  # number of the frame, from 0
    time_us: int  # time of its arrival [µs]
    reading: int  # tactile byte, -1 for none
    reading_time_us: int  # time at which the tactile byte was read [µs], -1 for none
    size: int  # size of its picture in the video [bytes]
    video_end: int  # offset of the end of its picture in the video file [bytes]
    crc: int  # CRC-32 of its picture in the video


class RecordingRows(NamedTuple):
    """Intact rows of a file."""

    rows: list[RecordingRow]  # all intact rows
    ends: list[int]  # offset of the end of each row in the file [bytes]
    torn: bool  # whether the file ends with incomplete or damaged rows


def row_text(row: RecordingRow) -> bytes:
    """Encode a row as a line of the file, with its checksum."""
    reading = "" if row.reading < 0 else str(row.reading)
    text = (
        f"{row.frame},{_seconds(row.time_us)},{reading},{_seconds(row.reading_time_us)},"
        f"{row.size},{row.video_end},{row.crc:08x}"
    ).encode("ascii")
    return b"%s,%08x\n" % (text, zlib.crc32(text))


def read_rows(path: Path) -> RecordingRows:
    """Load all intact rows; raise if a damaged or missing row is before intact ones."""
    with usable(path, "the rows of a recording"):
        lines = path.read_bytes().splitlines(keepends=True)
    if not lines or lines[0] != HEAD.encode("ascii"):
        state = "unexpected" if lines and lines[0].endswith(b"\n") else "incomplete"
        found, expected = f"an {state} first line", f"the header {HEAD.strip()}"
        raise InvalidInput(str(path), found=found, expected=expected)
    rows: list[RecordingRow] = []
    ends: list[int] = []
    end, broken = len(lines[0]), 0
    for number, line in enumerate(lines[1:], 2):
        end += len(line)
        row = _row(line)
        if row is None:
            broken = broken or number
            continue
        if broken:
            raise InvalidInput(
                f"{path}, line {broken}",
                found="a damaged row before valid rows",
                expected="rows of a recording",
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
            hint="rows were lost or inserted, so frames and readings cannot be matched",
        )
    if rows and row.time_us <= rows[-1].time_us:
        found = f"time {_seconds(row.time_us)} s after {_seconds(rows[-1].time_us)} s"
        raise InvalidInput(f"{path}, line {number}", found=found, expected="increasing times")
