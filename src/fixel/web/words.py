"""Numbers and names as pages show them: filters of the templates."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any, Final

from markupsafe import Markup

from fixel.errors import counted
from fixel.progress import time_text
from fixel.table import Table
from fixel.typing import FloatArray
from fixel.units import displayed, split_unit

NONE: Final = "\u2013"  # for what is not known

# Sign and colour of a verdict: never the colour alone.
_VERDICTS: Final = {
    "identified": ("\u2713", "good"),
    "trades off": ("\u21c4", "off"),
    "not identified": ("?", "off"),
    "not excited": ("\u2205", "off"),
    "at bound": ("\u21e5", "fault"),
    "effective": ("\u2248", "off"),
    "precise, but the model misfits": ("\u2260", "fault"),
    "at least": ("\u2265", "off"),
    "at most": ("\u2264", "off"),
    "frozen": ("\u2016", ""),
}


def fixed(value: float | None, digits: int = 1, factor: float = 1.0) -> str:
    """Format a number with a true minus sign, and none before a zero."""
    if value is None or not math.isfinite(value):
        return NONE
    text = f"{abs(factor * value):.{digits}f}"
    return f"\u2212{text}" if value < 0.0 and float(text) else text


def short(value: float | None) -> str:
    """Format a number with at most four digits."""
    if value is None or not math.isfinite(value):
        return NONE
    return f"{value:.4g}".replace("-", "\u2212", 1)


def minus(text: str) -> str:
    """Return a text with true minus signs before its numbers."""
    return re.sub(r"(^|\s)-(?=[\d.])", "\\1\u2212", text)


def count(number: int) -> str:
    """Format a number with its thousands apart."""
    return f"{number:,}".replace(",", "\u202f")


def several(number: int, what: str) -> str:
    """Return a number of things: `1 experiment`, `2 experiments`."""
    return counted(count(number), what)


def condition(name: str, value: str | float) -> tuple[str, str, str]:
    """Return name, value and unit of a condition, in the unit that its name ends with."""
    if isinstance(value, str):
        return name.replace("_", " "), value, ""
    stem, si = split_unit(name)
    unit, factor = displayed(si)
    return stem.removesuffix("_ratio").replace("_", " "), short(factor * value), unit


def lasting(seconds: float | None) -> str:
    """Format a duration, if it is known."""
    return NONE if seconds is None or not math.isfinite(seconds) else time_text(seconds)


def size(number: int | None) -> str:
    """Format a size in decimal units."""
    if number is None:
        return "stored on a server"
    value = float(number)
    for unit in ("byte", "kB", "MB", "GB"):
        if value < 1000.0:
            return f"{value:.3g} {unit}" if unit != "byte" else f"{number} byte"
        value /= 1000.0
    return f"{value:.3g} TB"


def instant(iso: str) -> str:
    """Format a time in UTC to the minute."""
    return f"{iso[:10]} {iso[11:16]}" if len(iso) >= 16 else iso


def touched(contacts: str) -> str:
    """Describe a measured contact mode: `fixel 1 and 3`, `no fixel`."""
    found = [str(k) for k, digit in enumerate(contacts, 1) if digit == "1"]
    return "fixel " + " and ".join(found) if found else "no fixel"


def rms(error: float | None, unit: str) -> float | None:
    """Return an error that is a mean square as its root [mm]; any other as it is."""
    return math.sqrt(error) if error is not None and unit == "mm^2" else error


def verdict(name: str) -> tuple[str, str]:
    """Return the sign and the class of a verdict."""
    return _VERDICTS.get("trades off" if name.startswith("trades") else name, ("", ""))


def corners(outline: FloatArray) -> str:
    """Return the corners of an outline for an SVG [mm]; its y points down."""
    return " ".join(f"{1e3 * x:.3f},{-1e3 * y:.3f}" for x, y in outline)


def html(table: Table) -> Markup:
    """Return a table as markup; it escapes its texts itself."""
    return Markup(table.html())


FILTERS: Final[Mapping[str, Callable[..., Any]]] = {
    filter.__name__: filter
    for filter in (
        fixed, short, minus, count, several, lasting, size, instant, touched, rms, verdict, corners,
        html,
    )
}  # fmt: skip
