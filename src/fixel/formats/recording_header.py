"""Metadata files of a recording: `recording.json`, and `end.json` after a regular end."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, final

from fixel.errors import InvalidInput
from fixel.io.atomic import written_whole
from fixel.model.fields import name_of, settle

VERSION: Final = 1
HEADER: Final = "recording.json"
END: Final = "end.json"
ROWS: Final = "frames.csv"
VIDEO: Final = "video.nut"

CODECS: Final = ("as-it-comes", "near", "exact")
CLOCK: Final = "monotonic, in seconds since the recording began; one for frames and readings"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingHeader:
    """Header of a recording, written before the first frame.

    Parameters
    ----------
    size : (int, int)
        Width and height of the pictures [px].
    codec : str
        `as-it-comes` stores the JPEG pictures of a camera bit for bit, `near` writes JPEG of high
        quality, `exact` is lossless.
    rig : str
        Name of the rig; empty for none.
    source : str
        Source of the pictures.
    simulated_by : str
        Program that generated the pictures, if no camera did.
    started : str
        Time at which the clock was zero, ISO 8601 in UTC; empty for now.
    rate : float
        Nominal frames per second of the source, 0 for unknown; exact times are in the rows.
    about : mapping of str to anything JSON can hold
        Further metadata.
    """

    size: tuple[int, int]
    codec: str = "near"
    rig: str = ""
    source: str = ""
    simulated_by: str = ""
    started: str = ""
    rate: float = 0.0
    about: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        width, height = (int(side) for side in self.size)
        if width < 1 or height < 1:
            raise InvalidInput(
                "recording.size", found=f"{width} x {height}", expected="width and height [px]"
            )
        if self.codec not in CODECS:
            raise InvalidInput(
                "recording.codec", found=repr(self.codec), expected=", ".join(CODECS)
            )
        if self.rig:
            name_of(self.rig, "recording.rig")
        settle(
            self,
            size=(width, height),
            started=self.started or datetime.now(UTC).isoformat(timespec="milliseconds"),
            about=MappingProxyType(dict(self.about)),
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingEnd:
    """End mark of a recording, written after a regular end.

    Parameters
    ----------
    frames : int
        Number of frames.
    seconds : float
        Time of the last frame [s].
    reason : str
        Reason why the recording ended.
    lost : int
        Number of frames lost because the recorder was too slow.
    problems : tuple of str
        Other problems, one sentence each.
    """

    frames: int
    seconds: float
    reason: str
    lost: int = 0
    problems: tuple[str, ...] = ()


def write_header(folder: Path, header: RecordingHeader) -> None:
    """Write `recording.json`."""
    import fixel

    content = {name: getattr(header, name) for name in header.__dataclass_fields__}
    content |= {"about": dict(header.about), "size": list(header.size)}
    content = {"version": VERSION, "fixel": fixel.__version__, "clock": CLOCK, **content}
    _write(folder / HEADER, content)


def write_end(folder: Path, end: RecordingEnd) -> None:
    """Write `end.json`, the mark of a regular end."""
    _write(folder / END, asdict(end))


def read_header(folder: Path) -> RecordingHeader:
    """Load `recording.json`; raise `InvalidInput` if it is missing or invalid."""
    content = _read(folder / HEADER)
    if content is None:
        raise InvalidInput(
            str(folder), found=f"no {HEADER}", expected="a folder written by `fixel record`"
        )
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
        raise InvalidInput(str(folder / HEADER), found=str(problem), expected="a header") from None


def read_end(folder: Path) -> RecordingEnd | None:
    """Load `end.json`; None if there is none."""
    content = _read(folder / END)
    if content is None:
        return None
    try:
        end = RecordingEnd(**content)
        return RecordingEnd(**(asdict(end) | {"problems": tuple(end.problems)}))
    except TypeError as problem:
        raise InvalidInput(str(folder / END), found=str(problem), expected="an end mark") from None


def _write(path: Path, content: dict[str, Any]) -> None:
    with written_whole(path) as unfinished:
        unfinished.write_text(
            json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + "\n",
            encoding="utf-8",
        )


def _read(path: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as problem:
        raise InvalidInput(str(path), found=str(problem), expected="a JSON file") from None
    if not isinstance(content, dict):
        raise InvalidInput(str(path), found=content, expected="a JSON object")
    return content
