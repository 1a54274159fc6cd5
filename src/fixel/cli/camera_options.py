"""Parse the options of `fixel camera`."""

import math
import re
import shlex
from pathlib import Path

from fixel.errors import InvalidInput

THESIS_HEIGHTS = (0.0, 25.4)  # [mm] plate, upper face of the object


def heights_of(typed: list[float] | None) -> tuple[float, ...]:
    """Return heights above the plate [m]; those of the thesis by default."""
    return tuple(mm / 1e3 for mm in (typed or THESIS_HEIGHTS))


def pose_of(text: str) -> tuple[float, float, float]:
    """Parse `X,Y,ANGLE` in mm and degrees to metres and radians."""
    try:
        x, y, angle = (float(part) for part in text.split(","))
    except ValueError:
        raise InvalidInput(
            "--at", found=repr(text), expected="x and y [mm] and an angle [deg]: 0,0,0"
        ) from None
    return x / 1e3, y / 1e3, math.radians(angle)


def size_of(text: str | None) -> tuple[int, int] | None:
    """Parse `1280x720` to width and height [px]."""
    if text is None:
        return None
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if not found:
        raise InvalidInput("--size", found=repr(text), expected="width and height [px]: 1280x720")
    return int(found[1]), int(found[2])


def range_of(text: str) -> tuple[int, int]:
    """Parse `0-9` to the first and the last number."""
    found = re.fullmatch(r"(\d{1,4})(?:-(\d{1,4}))?", text)
    if not found:
        raise InvalidInput("--ids", found=repr(text), expected="numbers such as 0-9")
    return int(found[1]), int(found[2] or found[1])


def quoted(path: Path | str) -> str:
    """Quote a path for a shell."""
    return shlex.quote(str(path))
