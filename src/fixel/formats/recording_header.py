"""What a recording says of itself: `recording.json`, and `end.json` once it was ended well."""

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
    """What is known before the first frame.

    Parameters
    ----------
    size : (int, int)
        Width and height of the pictures [px].
    codec : str
        `as-it-comes` keeps the JPEG pictures of a camera bit by bit, `near` writes JPEG of high
        quality, `exact` loses nothing.
    rig : str
        Name of the rig; empty for none.
    source : str
        Where the pictures come from.
    simulated_by : str
        What made the pictures, where no camera did.
    started : str
        When the clock was zero, as ISO 8601 in UTC; now, where empty.
    rate : float
        Frames a second as the source promises them, 0 for unknown; times are in the rows.
    about : mapping of str to anything JSON can hold
        Whatever else is worth keeping.
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
    """What is known once a recording was ended well.

    Parameters
    ----------
    frames : int
        How many there are.
    seconds : float
        Time of the last [s].
    reason : str
        Why it ended, in words.
    lost : int
        Frames the camera sent and the recorder was too slow for.
    problems : tuple of str
        What else went wrong, one sentence each.
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
    """Write `end.json`: the mark of a recording that was ended well."""
    _write(folder / END, asdict(end))


def read_header(folder: Path) -> RecordingHeader:
    """Read `recording.json`, or say why not."""
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
    """Read `end.json`; None where there is none."""
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
